"""Pictures: what is in them and where, whatever draws; small golden images; files; messages."""

import os
from pathlib import Path

import numba
import numpy as np
import numpy.testing as npt
import pytest
from PIL import Image

from render import NoPreviewError, find_gl, gl, preview, turntable, views
from render.picture import BACKDROP
from tests.corpus import TREES, along, realistic_cluster_tree, realistic_tree
from treegraph import DEFAULT_ALLOMETRY, ClusterTree, InputError, TreeError

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT, reason="drawing without compiled loops takes minutes"
)

GOLDEN = Path(__file__).parent / "golden"
SIZE = (256, 256)
TREE = realistic_cluster_tree(realistic_tree(seed=4, step=0.05, height=6.0), 8, seed=1)
BARE = TREE.replace(clusters=())


def tree_of(graph):
    return ClusterTree(graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3))


def scan_of(tree, n=20_000, seed=0):
    """Points around the tree's nodes."""
    rng = np.random.default_rng(seed)
    node = rng.integers(0, tree.graph.n_nodes, n)
    around = rng.normal(size=(n, 3))
    around *= tree.graph.radius[node, None] / np.linalg.norm(around, axis=1, keepdims=True)
    return tree.graph.position[node] + around


def backdrop(height, width):
    from render.lighting import to_linear, to_srgb

    t = ((np.arange(height) + 0.5) / height)[:, None]
    low, high = to_linear(BACKDROP)
    return np.repeat(255 * to_srgb(t * low + (1 - t) * high)[:, None], width, axis=1)


def silhouette(image):
    """Pixels that are much darker than the backdrop: tree, not ground or its shadow."""
    off = backdrop(*image.shape[:2]) - image
    return off.max(axis=2) > 90


def span(mask):
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return rows[0], rows[-1], columns[0], columns[-1]


@pytest.fixture(scope="module")
def opengl():
    status = find_gl()
    if status.platform is None:
        pytest.skip(f"no OpenGL here: {status.reason}")
    return status


# What is in the picture


@pytest.mark.parametrize(
    "graph",
    [
        along([(0, 0, 0), (0, 0, 0.3)], 0.01),
        along([(0, 0, 0), (3, 0, 60)], 0.5),
        along([(0, 0, 1), (4, 0, 1.2)], 0.1),
        TREES["comb"],
        realistic_tree(step=0.1, height=12.0),
    ],
    ids=["0.3 m", "60 m", "level branch", "comb", "realistic"],
)
@pytest.mark.parametrize("size", [(256, 256), (160, 320), (400, 200)])
def test_the_tree_fills_the_frame_and_stays_inside(graph, size):
    image = preview(tree_of(graph), size=size, captions=False, renderer="software").image
    assert image.shape == (size[1], size[0], 3)
    mask = silhouette(image)
    top, bottom, left, right = span(mask)
    assert (
        top > 0.02 * size[1] and bottom < 0.98 * size[1] and left > 0.02 * size[0] and right < 0.98 * size[0]
    )
    assert max((bottom - top) / size[1], (right - left) / size[0]) > 0.7
    assert mask.sum() > 50


def test_the_ground_is_below_and_carries_the_shadow():
    trunk = tree_of(along([(0, 0, 0), (0, 0, 2), (0.3, 0.2, 5)], [0.3, 0.25, 0.1]))
    image = preview(trunk, size=SIZE, captions=False, renderer="software").image.astype(float)
    off = (backdrop(*SIZE) - image).max(axis=2)
    tree = silhouette(image)
    for axis in (0, 1):  # and the pixels that it covers in part
        tree = (
            tree
            | np.roll(tree, 2, axis)
            | np.roll(tree, -2, axis)
            | np.roll(tree, 1, axis)
            | np.roll(tree, -1, axis)
        )
    off[tree] = 0
    assert np.abs(off[:128]).max() < 5
    _, bottom, left, right = span(silhouette(image))
    assert (
        off[bottom - 8 : bottom + 3, right + 3 : right + 30].max() > 25
    )  # the shadow, to the light's far side
    assert off[bottom - 8 : bottom + 3, : left - 3].max() < 40  # the ground in full light


def test_two_panels_have_the_same_scale_and_do_not_overlap():
    thick = BARE.replace(graph=BARE.graph.replace(radius=3 * BARE.graph.radius + 0.01))
    scan = scan_of(thick, 80_000)
    dark = np.tile(np.array([[40, 40, 40], [41, 40, 40]], np.uint8), (len(scan) // 2, 1))
    image = preview(thick, scan=(scan, dark), size=(512, 256), captions=False, renderer="software").image
    mask = silhouette(image)
    panels = [mask[:, :256], mask[:, 256:]]
    spans = np.array([span(panel) for panel in panels])
    npt.assert_allclose(spans[0], spans[1], atol=6)
    assert (spans[:, 2] > 5).all() and (spans[:, 3] < 251).all()
    both = (panels[0] & panels[1]).sum() / min(panel.sum() for panel in panels)
    assert both > 0.5  # the same branches at the same places


def test_stray_points_do_not_shrink_the_picture():
    scan = np.concatenate([scan_of(BARE), [(500.0, 0, 0), (0, -900, 40), (np.nan, 0, 0)]])
    clean = preview(BARE, scan=scan[:-3], size=(256, 128), captions=False, renderer="software").image
    stray = preview(BARE, scan=scan, size=(256, 128), captions=False, renderer="software").image
    npt.assert_allclose(span(silhouette(stray)[:, 128:]), span(silhouette(clean)[:, 128:]), atol=2)


def test_points_are_drawn_in_their_own_colour():
    scan = scan_of(BARE)
    red = np.tile(np.array([[200, 20, 20]], np.uint8), (len(scan), 1))
    red[0] = 0  # not all the same
    image = preview(BARE, scan=(scan, red), size=(256, 128), captions=False, renderer="software").image
    half = image[:, :128][silhouette(image)[:, :128]].astype(float)
    assert len(half) > 300 and (half[:, 0] > 1.7 * half[:, 1]).mean() > 0.95
    plain = preview(BARE, scan=scan, size=(256, 128), captions=False, renderer="software").image
    same = preview(
        BARE, scan=(scan, np.zeros_like(red)), size=(256, 128), captions=False, renderer="software"
    ).image
    npt.assert_array_equal(plain, same)  # a colour field that nobody filled


def test_many_points_are_thinned_always_alike(monkeypatch):
    from render import scene

    monkeypatch.setattr(scene, "MAX_SCAN_POINTS", 5000)
    points, _ = scene.pick_points(scan_of(BARE))
    again, _ = scene.pick_points(scan_of(BARE))
    assert len(points) == 5000
    npt.assert_array_equal(points, again)


def test_the_broad_side_is_seen():
    fan = along([(0, 0, 0), (0, 0, 1), (0, 3, 2), (0, -3, 3)], 0.05)
    image = preview(tree_of(fan), size=SIZE, captions=False, renderer="software").image
    top, bottom, left, right = span(silhouette(image))
    assert right - left > bottom - top


def test_wood_shows_through_the_hulls():
    shown = preview(TREE, size=SIZE, captions=False, renderer="software").image.astype(float)
    green = shown[..., 1] > shown[..., 0] + 8
    assert green.sum() > 2000


def test_default_size_follows_the_tree():
    tall = preview(tree_of(along([(0, 0, 0), (0, 0, 9)])), renderer="software", captions=False).image
    wide = preview(tree_of(along([(0, 0, 0), (9, 0, 1)])), renderer="software", captions=False).image
    assert tall.shape[0] == wide.shape[0] == 1024
    assert tall.shape[1] < 700 and wide.shape[1] > 1400


def test_captions_are_below_the_tree():
    plain = preview(BARE, scan=scan_of(BARE), size=(512, 320), renderer="software")
    bare = np.asarray(plain.image, float)
    strip = np.abs(np.diff(bare[-20:], axis=1)).max(axis=(0, 2))
    marked = np.flatnonzero(strip > 40)
    assert (
        marked.min() < 60
        and ((marked > 110) & (marked < 150)).any()
        and ((marked > 360) & (marked < 400)).any()
    )


@pytest.mark.parametrize(
    "length, rounded, text",
    [(7.3, 5.0, "5 m"), (1.0, 1.0, "1 m"), (0.999, 0.5, "50 cm"), (23, 20, "20 m"), (0.0042, 0.002, "2 mm")],
)
def test_scale_bar_is_a_round_length(length, rounded, text):
    npt.assert_allclose(views._round_length(length), rounded)
    assert views._length_text(rounded) == text


def test_same_tree_same_picture():
    a = preview(TREE, scan=scan_of(TREE), size=(256, 128), renderer="software").image
    b = preview(TREE, scan=scan_of(TREE), size=(256, 128), renderer="software").image
    assert a.tobytes() == b.tobytes()


# Golden images, one for both renderers: they see the same and the light is the same


def check_golden(name, image, tmp_path):
    """Compare with the kept image; ``SAPWOOD_GOLDEN=new`` writes it instead."""
    kept = GOLDEN / f"{name}.png"
    if os.environ.get("SAPWOOD_GOLDEN") == "new":
        Image.fromarray(image).save(kept)
    off = np.abs(np.asarray(Image.open(kept), int) - image)
    if off.mean() > 0.6 or (off.max(axis=2) > 24).mean() > 0.01:
        Image.fromarray(image).save(tmp_path / kept.name)
        pytest.fail(
            f"{name}: mean difference {off.mean():.2f} of 255, at most 0.6; see {tmp_path / kept.name}"
        )


CASES = {
    "bare": (BARE, {}),
    "clusters": (TREE, {}),
    "scan": (TREE, {"scan": scan_of(TREE)}),
    "above": (TREE, {"elevation": 0.9, "azimuth": 1.0}),
}


@pytest.mark.parametrize("name", CASES)
def test_golden_image_without_opengl(name, tmp_path):
    tree, view = CASES[name]
    check_golden(name, preview(tree, size=SIZE, captions=False, renderer="software", **view).image, tmp_path)


@pytest.mark.parametrize("name", CASES)
def test_golden_image_with_opengl(name, opengl, tmp_path):
    tree, view = CASES[name]
    drawn = preview(tree, size=SIZE, captions=False, renderer="gl", **view)
    assert drawn.renderer == opengl.platform and drawn.notice is None
    check_golden(name, drawn.image, tmp_path)


# Files


def test_png_is_the_picture(tmp_path):
    drawn = preview(BARE, tmp_path / "a.png", size=SIZE, renderer="software")
    npt.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), drawn.image)
    preview(BARE, tmp_path / "a.jpg", size=SIZE, renderer="software")
    with Image.open(tmp_path / "a.jpg") as picture:
        assert picture.size == SIZE
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "a.jpg"}


def test_turntable_gif(tmp_path):
    first = turntable(TREE, tmp_path / "t.gif", frames=6, seconds=1.2, size=(96, 128), renderer="software")
    with Image.open(tmp_path / "t.gif") as gif:
        assert gif.n_frames == 6 and gif.size == (96, 128) and gif.info["duration"] == 200
        assert gif.info["loop"] == 0
    assert first.image.shape == (128, 96, 3)


def test_turntable_frames_hold_the_tree_at_every_turn(tmp_path):
    turntable(BARE, tmp_path / "turn", frames=5, size=(128, 128), renderer="software")
    names = sorted(path.name for path in (tmp_path / "turn").iterdir())
    assert names == [f"frame_{k:03d}.png" for k in range(5)]
    images = [np.asarray(Image.open(tmp_path / "turn" / name)) for name in names]
    for image in images:
        top, bottom, left, right = span(silhouette(image))
        assert top > 2 and left > 2 and right < 126 and bottom < 126
    assert all(np.abs(a.astype(int) - b).mean() > 1 for a, b in zip(images, images[1:], strict=False))


def test_a_turntable_comes_round():
    """A frame after half a turn shows the mirrored outline of the first, but for perspective."""
    fan = tree_of(along([(0, 0, 0), (0, 0, 2), (0, 1.5, 3)], 0.1))
    from render.scene import find_outline, orbit, revolve, set_stage

    outline = find_outline(fan, None)
    stage = set_stage(outline, fan)
    camera = views.fit_camera(revolve(outline, stage), views.view_axes(0.0, 0.1), 100, 100)
    there = orbit(camera, stage, np.pi)
    middle = np.array([*stage.centre, 0.0])
    npt.assert_allclose((there.eye - middle)[:2], -(camera.eye - middle)[:2], atol=1e-9)
    npt.assert_allclose(orbit(camera, stage, 2 * np.pi).eye, camera.eye, atol=1e-9)


# Without OpenGL


@pytest.fixture
def no_opengl(monkeypatch):
    """A machine on which no OpenGL starts, in a process that has not tried yet."""
    monkeypatch.setattr(gl, "_found", (None, gl.GLStatus(None, "", "egl: no such library; osmesa: neither")))
    monkeypatch.setattr(views, "_notice_given", type(views._notice_given)())


def test_without_opengl_the_picture_is_drawn_and_said_so_once(no_opengl):
    first = preview(BARE, size=SIZE)
    assert first.renderer == "software"
    assert (
        first.notice.startswith("previews are drawn without OpenGL: ")
        and "egl: no such library" in first.notice
    )
    assert "\n" not in first.notice
    assert preview(BARE, size=SIZE).notice is None


def test_who_insists_on_opengl_gets_an_error(no_opengl):
    with pytest.raises(NoPreviewError, match=r"OpenGL cannot be used here \(egl: no such library"):
        preview(BARE, size=SIZE, renderer="gl")


def test_a_worker_that_dies_ends_nothing_but_itself(monkeypatch, tmp_path):
    """The worker's script is replaced by one that crashes as a driver would."""
    crash = tmp_path / "_gl_worker.py"
    crash.write_text(
        "import os, sys\nsys.stderr.write('driver: out of luck\\n')\nsys.stderr.flush()\nos.abort()\n"
    )
    monkeypatch.setattr(gl, "WORKER", crash)
    monkeypatch.setattr(gl, "_found", None)
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    status = find_gl()
    assert status.platform is None
    assert status.reason == "egl: driver: out of luck; osmesa: driver: out of luck"


def test_a_worker_that_hangs_is_ended(monkeypatch, tmp_path):
    hang = tmp_path / "_gl_worker.py"
    hang.write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(gl, "WORKER", hang)
    monkeypatch.setattr(gl, "START_TIMEOUT", 0.5)
    monkeypatch.setattr(gl, "_found", None)
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    assert find_gl().reason == "egl: ended with status -9"


class KillFirst:
    """A lock that kills a process when it is taken."""

    def __init__(self, process):
        self.process = process

    def __enter__(self):
        self.process.kill()
        self.process.wait()

    def __exit__(self, *error):
        return False


def test_a_worker_that_dies_while_drawing_is_replaced_by_the_software(opengl, monkeypatch):
    child = gl._Child(opengl.platform)
    monkeypatch.setattr(gl, "_found", (child, opengl))
    monkeypatch.setattr(views, "_notice_given", type(views._notice_given)())
    monkeypatch.setattr(child, "_busy", KillFirst(child._process))
    drawn = preview(BARE, size=SIZE)
    assert drawn.renderer == "software" and "previews are drawn without OpenGL" in drawn.notice
    assert not child.alive()


# Messages


@pytest.mark.parametrize(
    "arguments, match",
    [
        ({"renderer": "vulkan"}, "renderer must be one of auto, gl, software, got 'vulkan'"),
        ({"size": (8, 100)}, r"size must be a width and a height of 16 to 8192 pixels, got \(8, 100\)"),
        ({"size": (100,)}, r"got \(100,\)"),
        ({"azimuth": np.nan}, "azimuth must be a finite angle in radians, got nan"),
        ({"elevation": 2.0}, "elevation must be -1.5 to 1.5 radians, got 2.0"),
        ({"path": "a.bmp"}, r"a preview is written to NAME\.png or NAME\.jpg, got 'a\.bmp'"),
        ({"scan": np.zeros((4, 2))}, r"scan must have shape \(n, 3\), got \(4, 2\)"),
        ({"scan": np.full((4, 3), np.nan)}, "scan must have at least one finite point"),
        (
            {"scan": (np.zeros((4, 3)), np.zeros((4, 3)))},
            r"scan colours must be uint8 of shape \(4, 3\), got float64",
        ),
    ],
)
def test_arguments_out_of_range_are_named(arguments, match):
    with pytest.raises(InputError, match=match):
        preview(BARE, **{"renderer": "software", **arguments})


@pytest.mark.parametrize(
    "path, arguments, match",
    [
        ("t.gif", {"frames": 0}, "frames must be 1 to 720, got 0"),
        ("t.gif", {"seconds": 0}, "seconds must be a time > 0, got 0"),
        ("t.mp4", {}, r"a turntable is written to NAME\.gif or to a folder, got 't\.mp4'"),
    ],
)
def test_turntable_arguments_are_named(path, arguments, match, tmp_path):
    with pytest.raises(InputError, match=match):
        turntable(BARE, tmp_path / path, renderer="software", **arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["all in one place", "only roots"])
def test_nothing_to_draw(name):
    with pytest.raises(InputError, match="there is nothing to draw"):
        preview(tree_of(TREES[name].replace(radius=np.zeros(TREES[name].n_nodes))), renderer="software")


def test_unknown_radii_are_an_error():
    with pytest.raises(TreeError, match="radius must be known at every node"):
        preview(tree_of(TREES["radii unknown"]), renderer="software")
