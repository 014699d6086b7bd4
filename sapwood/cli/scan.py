"""``scan``: what a laser scanner would measure of a tree, with the truth of every point."""

from __future__ import annotations

import math
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from recon.scan_paths import Sweep
    from recon.scan_scenes import Scene
    from recon.scanning import Beam
    from sapwood.scanning import TreeScene
    from treegraph.obstacles import Obstacle

SCANNER, MOVING, SCENE = "The scanner", "On the move", "The scene"
STATION, MOBILE, AIRBORNE = "station", "mobile", "airborne"

DEFAULTS: dict[str, dict[str, Any]] = {
    STATION: {
        "step": "0.06deg", "noise": "2mm", "footprint": "4mm", "divergence": "0.3mrad", "rings": 1,
        "returns": 1, "max_range": "120m",
    },
    MOBILE: {
        "step": "0.2deg", "noise": "8mm", "footprint": "6mm", "divergence": "1.5mrad", "rings": 1,
        "returns": 2, "max_range": "100m",
    },
    AIRBORNE: {
        "step": None, "noise": "15mm", "footprint": "0", "divergence": "0.5mrad", "rings": 3,
        "returns": 7, "max_range": "10km",
    },
}  # fmt: skip
"""Of a time-of-flight instrument on a tripod, on a back and in an aeroplane."""

DISTANCE_PER_HEIGHT, LEAST_DISTANCE = 0.8, 5.0  # of the stations, where none is given
GROUND_MARGIN = 5.0  # metres of ground behind the scanner and around the tree
WALL_REACH = 100.0  # metres: half a side of the square that stands for an endless wall


def _option(panel: str, name: str, metavar: str | None, text: str) -> Any:
    return o.option(panel, name, metavar=metavar, help=text)


Source = Annotated[Path, o.argument("TREE", "A tree (.lobes .swc) or a mesh of one (.glb .obj .ply).")]
Output = Annotated[
    Path,
    o.option(
        o.OUTPUT, "--output", "-o", metavar="FILE", help="Ends in .laz, .las or .ply.", show_default=False
    ),
]
Labels = Annotated[
    bool, _option(o.OUTPUT, "--labels", None, "Also write is_wood, which `reconstruct` takes for labels.")
]

Stations = Annotated[
    int, o.option(SCANNER, "--stations", metavar="N", min=1, max=1000, help="Stations around the tree.")
]
Distance = Annotated[
    str | None,
    _option(SCANNER, "--distance", "LENGTH", "Of stations and track from the trunk. (default: 0.8 x height)"),
]
Places = Annotated[
    list[str] | None,
    _option(SCANNER, "--station", "X,Y,Z", "A station, in the tree's coordinates; repeatable."),
]
Height = Annotated[str, _option(SCANNER, "--height", "LENGTH", "Of the scanner above the ground.")]
Step = Annotated[
    str | None,
    _option(SCANNER, "--step", "ANGLE", "From ray to ray. (default: 0.06deg; with --mobile 0.2deg)"),
]
Noise = Annotated[
    str | None,
    _option(SCANNER, "--noise", "LENGTH", "Sigma of the range. (default: 2mm; 8mm; 15mm)"),
]
Footprint = Annotated[
    str | None,
    _option(SCANNER, "--footprint", "LENGTH", "Diameter of the beam at the exit. (default: 4mm; 6mm; 0)"),
]
Divergence = Annotated[
    str | None,
    _option(SCANNER, "--divergence", "ANGLE", "Full angle of the beam. (default: 0.3mrad; 1.5mrad; 0.5mrad)"),
]
Separation = Annotated[
    str,
    _option(SCANNER, "--separation", "LENGTH", "Surfaces nearer to each other along a beam melt together."),
]
Returns = Annotated[
    int | None,
    o.option(SCANNER, "--returns", metavar="N", min=1, max=15, help="Most of a pulse. (default: 1; 2; 7)"),
]
MinRange = Annotated[str, _option(SCANNER, "--min-range", "LENGTH", "Nothing nearer is measured.")]
MaxRange = Annotated[
    str | None,
    _option(SCANNER, "--max-range", "LENGTH", "Nothing farther is measured. (default: 120m; 100m; 10km)"),
]

Mobile = Annotated[
    bool, _option(MOVING, "--mobile", None, "A profile scanner, carried past the tree or along --track.")
]
Track = Annotated[
    list[str] | None,
    _option(MOVING, "--track", "X,Y,Z", "A corner of its way, in the tree's coordinates; repeatable."),
]
LineSpacing = Annotated[str, _option(MOVING, "--line-spacing", "LENGTH", "Way from profile to profile.")]
Airborne = Annotated[bool, _option(MOVING, "--airborne", None, "Flight lines over the tree.")]
Altitude = Annotated[str, _option(MOVING, "--altitude", "LENGTH", "Of the flight above the ground.")]
Density = Annotated[
    float, _option(MOVING, "--density", "X", "Pulses a square metre of ground, of each flight line.")
]
ScanAngle = Annotated[str, _option(MOVING, "--scan-angle", "ANGLE", "Across the flight line, in full.")]
Strips = Annotated[int, o.option(MOVING, "--strips", metavar="N", min=1, max=100, help="Flight lines.")]
StripSpacing = Annotated[str, _option(MOVING, "--strip-spacing", "LENGTH", "Between flight lines.")]

LeafOff = Annotated[bool, _option(SCENE, "--leaf-off", None, "Without leaves.")]
LeafDensity = Annotated[
    float | None,
    _option(SCENE, "--leaf-density", "X", "Leaf area in clusters, m2 in a m3. (default: 2)"),
]
LeafLength = Annotated[
    str | None, _option(SCENE, "--leaf-length", "LENGTH", "Of leaves in clusters. (default: 6.5cm)")
]
WithGround = Annotated[bool, _option(SCENE, "--ground", None, "Ground, at the foot of the tree.")]
Roughness = Annotated[str, _option(SCENE, "--roughness", "LENGTH", "Sigma of the ground's height.")]
Wind = Annotated[
    str, _option(SCENE, "--wind", "LENGTH", "How far leaves and twigs are from their rest while scanned.")
]
Obstacles = Annotated[
    list[str] | None,
    _option(
        SCENE,
        "--obstacle",
        "WHAT",
        "wall:x=1.5, box:x,y,z,dx,dy,dz, sphere:x,y,z,r or mesh:FILE, in the tree's coordinates; repeatable.",
    ),
]
Detail = Annotated[o.Detail, o.option(SCENE, "--detail", help="How finely the wood of a tree is meshed.")]
MeshUp = Annotated[
    o.Up | None, o.option(SCENE, "--up", help="Axis of a mesh that points up. (default: z; of .glb y)")
]
Scale = Annotated[float, _option(SCENE, "--scale", "X", "Metres in a unit of a mesh.")]
WoodNames = Annotated[
    list[str] | None, _option(SCENE, "--wood-name", "WORD", "Parts of a mesh so called are wood; repeatable.")
]
LeafNames = Annotated[
    list[str] | None, _option(SCENE, "--leaf-name", "WORD", "Parts so called are leaves; repeatable.")
]


def scan(
    source: Source,
    output: Output,
    stations: Stations = 4,
    distance: Distance = None,
    station: Places = None,
    height: Height = "1.6m",
    step: Step = None,
    noise: Noise = None,
    footprint: Footprint = None,
    divergence: Divergence = None,
    separation: Separation = "0.3m",
    returns: Returns = None,
    min_range: MinRange = "0.5m",
    max_range: MaxRange = None,
    mobile: Mobile = False,
    track: Track = None,
    line_spacing: LineSpacing = "2cm",
    airborne: Airborne = False,
    altitude: Altitude = "300m",
    density: Density = 40.0,
    scan_angle: ScanAngle = "60deg",
    strips: Strips = 2,
    strip_spacing: StripSpacing = "100m",
    leaf_off: LeafOff = False,
    leaf_density: LeafDensity = None,
    leaf_length: LeafLength = None,
    ground: WithGround = False,
    roughness: Roughness = "2cm",
    wind: Wind = "0",
    obstacle: Obstacles = None,
    detail: Detail = o.Detail.fine,
    up: MeshUp = None,
    scale: Scale = 1.0,
    wood_name: WoodNames = None,
    leaf_name: LeafNames = None,
    labels: Labels = False,
    force: o.Force = False,
    seed: o.Seed = 0,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Scan a tree with a virtual laser scanner; every point says what it was measured on.

    \b
    Example:  sapwood scan out/oak.lobes --stations 4 --step 0.04deg -o scan.laz
              sapwood scan tree.glb --leaf-off --ground --obstacle wall:x=1.5 -o scan.laz
              sapwood scan tree.glb --airborne --density 100 -o strip.laz

    Angles are given in deg or mrad, lengths in mm, cm, m or km; plain numbers are degrees and metres.
    """
    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    given = dict(locals())
    begin = perf_counter()
    said = _run(given, terminal)
    seconds = round(perf_counter() - begin, 3)
    terminal.result(
        f"{output} ({said['points']} points of {said['rays']} rays: "
        + ", ".join(f"{said[f'n_{part}']} {part}" for part in ("wood", "leaf", "ground", "other"))
        + f"; {seconds:.1f} s)"
    )
    terminal.json("scan", input=str(source), output=str(output), **said, seconds=seconds)
    return 0


def _run(given: dict[str, Any], terminal: Terminal) -> dict[str, Any]:
    """Scan and write; what is to be said of it."""
    import numpy as np

    from recon.scan_scenes import PARTS
    from recon.scanning import scan_scene
    from sapwood.outputs import check_free
    from sapwood.scan_files import SCAN_SUFFIXES, write_scan
    from treegraph.errors import InputError

    output = given["output"]
    if output.suffix.lower() not in SCAN_SUFFIXES:
        raise InputError(f"{output}: the name must end in one of {' '.join(SCAN_SUFFIXES)}.")
    check_free([output], force=given["force"])
    beam, wind = _beam(given), _length(given, "wind")
    tree_seed, noise_seed, ground_seed = np.random.SeedSequence(given["seed"]).spawn(3)
    tree = _tree(given, np.random.default_rng(tree_seed))
    notes = list(tree.notes)
    obstacles = _obstacles(given)
    sweeps, places = _sweeps(given, tree, obstacles, notes)
    scene = _surroundings(given, tree, obstacles, places, np.random.default_rng(ground_seed))
    for note in notes:
        terminal.note(note)
    n_rays = sum(sweep.n_rays for sweep in sweeps)
    with terminal.progress(None, f"{given['source']}: {n_rays} rays"):
        found = scan_scene(scene, sweeps, beam, seed=np.random.default_rng(noise_seed), wind=wind)
        path = write_scan(found, output, labels=given["labels"], force=given["force"])
    counts = np.bincount(found.part, minlength=len(PARTS) + 1)
    return {
        "points": len(found),
        "rays": found.n_rays,
        "stations": len(sweeps),
        "faces": len(scene.faces),
        **{f"n_{name}": int(counts[code]) for code, name in PARTS.items()},
        "n_mixed": int((found.spread > beam.separation / 3.0).sum()),
        "bytes": path.stat().st_size,
        "seed": given["seed"],
        "notes": notes,
    }


def _platform(given: dict[str, Any]) -> str:
    if given["mobile"] and given["airborne"]:
        raise typer.BadParameter("--mobile and --airborne are two scanners; choose one")
    if given["station"] and (given["mobile"] or given["airborne"]):
        raise typer.BadParameter("--station is for a scanner on a tripod, not for --mobile or --airborne")
    if given["track"] and not given["mobile"]:
        raise typer.BadParameter("--track is the way of a --mobile scanner")
    return MOBILE if given["mobile"] else AIRBORNE if given["airborne"] else STATION


def _value(given: dict[str, Any], name: str) -> Any:
    """What was given, or the platform's default."""
    return given[name] if given[name] is not None else DEFAULTS[_platform(given)][name]


def _length(given: dict[str, Any], name: str, text: str | None = None) -> float:
    from sapwood.quantities import parse_length

    return parse_length(given[name] if text is None else text, f"--{name.replace('_', '-')}")


def _angle(given: dict[str, Any], name: str) -> float:
    from sapwood.quantities import parse_angle

    return parse_angle(_value(given, name) if name in ("step", "divergence") else given[name], f"--{name}")


def _beam(given: dict[str, Any]) -> Beam:
    from recon.scanning import Beam

    lengths = {
        name: _length(given, name, _value(given, name)) for name in ("noise", "footprint", "max_range")
    }
    return Beam(
        noise=lengths["noise"],
        exit_diameter=lengths["footprint"],
        divergence=_angle(given, "divergence"),
        rings=DEFAULTS[_platform(given)]["rings"],
        separation=_length(given, "separation"),
        n_returns=_value(given, "returns"),
        min_range=_length(given, "min_range"),
        max_range=lengths["max_range"],
    )


def _tree(given: dict[str, Any], rng: Any) -> TreeScene:
    from sapwood.scanning import LEAF_AREA_DENSITY, LEAF_LENGTH, Foliage, scene_of

    density, length = given["leaf_density"], given["leaf_length"]
    return scene_of(
        given["source"],
        leaf_off=given["leaf_off"],
        foliage=Foliage(
            LEAF_AREA_DENSITY if density is None else density,
            LEAF_LENGTH if length is None else _length(given, "leaf_length"),
        ),
        seed=rng,
        detail=given["detail"].value,
        up=given["up"].value if given["up"] else None,
        scale=given["scale"],
        wood_names=given["wood_name"] or (),
        leaf_names=given["leaf_name"] or (),
    )


def _obstacles(given: dict[str, Any]) -> list[Obstacle]:
    from sapwood.obstacles import parse_obstacle

    return [parse_obstacle(text) for text in given["obstacle"] or ()]


def _sweeps(
    given: dict[str, Any], tree: TreeScene, obstacles: list[Obstacle], notes: list[str]
) -> tuple[list[Sweep], Any]:
    """The sweeps of the scanner, and where it stands or how far the scene should reach, (n, 3)."""
    import numpy as np

    from recon.scan_paths import airborne_sweeps, mobile_sweep, station_sweeps

    target, foot = tree.scene.vertices, tree.foot
    platform = _platform(given)
    if platform == AIRBORNE:
        margin = GROUND_MARGIN * given["ground"] * np.array([[-1, -1, 0], [1, 1, 0], [-1, 1, 0], [1, -1, 0]])
        low, high = target.min(axis=0), target.max(axis=0)
        box = np.where(margin > 0.0, high, low) + margin
        box[:, 2] = foot[2]
        sweeps = airborne_sweeps(
            np.concatenate([target, box]),
            altitude=_length(given, "altitude"),
            density=given["density"],
            scan_angle=_angle(given, "scan_angle"),
            n_strips=given["strips"],
            strip_spacing=_length(given, "strip_spacing"),
            ground=float(foot[2]),
        )
        return sweeps, box
    if platform == MOBILE:
        track = _track(given, tree)
        for corner in track:
            _refuse_inside(obstacles, corner, "--track")
        return [
            mobile_sweep(track, step=_angle(given, "step"), spacing=_length(given, "line_spacing"))
        ], track
    places = _station_places(given, tree, obstacles, notes)
    return station_sweeps(target, places, _angle(given, "step")), places


def _away(given: dict[str, Any], tree: TreeScene) -> float:
    """Distance of stations and track from the trunk, metres."""
    if given["distance"] is not None:
        return _length(given, "distance")
    z = tree.scene.vertices[:, 2]
    return max(LEAST_DISTANCE, DISTANCE_PER_HEIGHT * float(z.max() - z.min()))


def _track(given: dict[str, Any], tree: TreeScene) -> Any:
    """Corners of the track: given, or a straight way past the tree, three times its distance long."""
    import numpy as np

    if given["track"]:
        return np.array([o.parse_point(text) for text in given["track"]])
    away = _away(given, tree)
    ends = np.array([[-1.5 * away, -away, 0.0], [1.5 * away, -away, 0.0]])
    return tree.foot + ends + [0.0, 0.0, _length(given, "height")]


def _station_places(
    given: dict[str, Any], tree: TreeScene, obstacles: list[Obstacle], notes: list[str]
) -> Any:
    import numpy as np

    from treegraph.errors import InputError
    from treegraph.obstacles import stands_inside

    if given["station"]:
        places = np.array([o.parse_point(text) for text in given["station"]])
        for place in places:
            _refuse_inside(obstacles, place, "--station")
        return places
    turn = 2.0 * math.pi * np.arange(given["stations"]) / given["stations"]
    away = _away(given, tree)
    circle = np.column_stack([away * np.cos(turn), away * np.sin(turn), np.zeros(turn.size)])
    places = tree.foot + circle + [0.0, 0.0, _length(given, "height")]
    free = np.array([not any(stands_inside(solid, place) for solid in obstacles) for place in places])
    if not free.all():
        notes.append(f"{(~free).sum()} of {free.size} stations would stand inside an obstacle; left out")
    if not free.any():
        raise InputError("every station would stand inside an obstacle; name others with --station")
    return places[free]


def _refuse_inside(obstacles: list[Obstacle], place: Any, name: str) -> None:
    from treegraph.errors import InputError
    from treegraph.obstacles import stands_inside

    if any(stands_inside(solid, place) for solid in obstacles):
        shown = ",".join(f"{value:g}" for value in place)
        raise InputError(
            f"the scanner would be inside an obstacle at {shown}; name another place with {name}"
        )


def _surroundings(
    given: dict[str, Any], tree: TreeScene, obstacles: list[Obstacle], places: Any, rng: Any
) -> Scene:
    """The tree with ground and obstacles."""
    import numpy as np

    from recon.scan_scenes import ground_scene, join_scenes, obstacle_scene

    foot, scenes = tree.foot, [tree.scene]
    if given["ground"]:
        around = np.concatenate([places, tree.scene.vertices])[:, :2] - foot[:2]
        half = float(np.abs(around).max()) + GROUND_MARGIN
        rough = _length(given, "roughness")
        scenes.append(ground_scene(foot[:2], half, height=float(foot[2]), roughness=rough, seed=rng))
    scenes += [obstacle_scene(solid, near=foot, reach=WALL_REACH) for solid in obstacles]
    return join_scenes(scenes)
