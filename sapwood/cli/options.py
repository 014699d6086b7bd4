"""Options that several commands share, and how their values are read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from sapwood._version import __version__

SCAN, TREE, LEAVES, OUTPUT, RUN = "The scan", "The tree", "Its leaves", "The outputs", "Running"


class Units(StrEnum):
    """Units of length."""

    m = "m"
    cm = "cm"
    mm = "mm"
    ft = "ft"


class Up(StrEnum):
    """Axes that can point up."""

    z = "z"
    y = "y"
    x = "x"
    minus_z = "-z"
    minus_y = "-y"
    minus_x = "-x"


class Decimal(StrEnum):
    """Decimal marks."""

    point = "."
    comma = ","


class Detail(StrEnum):
    """Levels of detail of a mesh."""

    fine = "fine"
    normal = "normal"
    coarse = "coarse"


class Season(StrEnum):
    """Seasons of the year."""

    spring = "spring"
    summer = "summer"
    autumn = "autumn"
    winter = "winter"


class Renderer(StrEnum):
    """What draws."""

    auto = "auto"
    gl = "gl"
    software = "software"


def parse_point(text: str) -> tuple[float, float, float]:
    """Three numbers from ``X,Y,Z``."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(abs(number) < float("inf") for number in numbers):
        raise typer.BadParameter(f"{text!r} is not three numbers X,Y,Z, as in 455012.3,5428007.1,231.8")
    return numbers


def parse_size(text: str) -> tuple[int, int]:
    """Width and height from ``WxH``."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise typer.BadParameter(f"{text!r} is not a width and a height in pixels, as in 1600x1000")
    return int(width), int(height)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sapwood {__version__}")
        raise typer.Exit(0)


def option(panel: str, *names: str, **more: Any) -> Any:
    """An option of a command, shown in a panel of its help."""
    return typer.Option(*names, rich_help_panel=panel, **more)


def argument(metavar: str, text: str) -> Any:
    """An argument of a command."""
    return typer.Argument(metavar=metavar, help=text, show_default=False)


Scans = Annotated[list[str], argument("SCAN", "Files, folders, or patterns in quotes; several.")]
Lobes = Annotated[Path, argument("X.lobes", "A tree.")]
LobesOrScan = Annotated[Path, argument("X.lobes|SCAN", "A tree, or a scan of one.")]

Json = Annotated[bool, option(RUN, "--json", help="Print one JSON object and nothing else.")]
Quiet = Annotated[bool, option(RUN, "--quiet", "-q", help="Say nothing but errors.")]
Verbose = Annotated[bool, option(RUN, "--verbose", "-v", help="On a fault of the program show where.")]
Version = Annotated[
    bool, option(RUN, "--version", help="Print the version.", is_eager=True, callback=_show_version)
]
Seed = Annotated[
    int, option(RUN, "--seed", min=0, metavar="N", help="For whatever is random; recorded in the report.")
]
Force = Annotated[bool, option(OUTPUT, "--force", help="Replace files that are there already.")]

Species = Annotated[
    str,
    option(
        TREE,
        "--species",
        metavar="NAME",
        help="Its allometry and leaves; `sapwood species list`. auto: as it is recognised; none: no leaves.",
    ),
]
ModelFile = Annotated[
    Path | None,
    option(
        TREE,
        "--model",
        metavar="FILE",
        help="Recognises species; made by `sapwood species train`. (default: the one that comes along)",
        show_default=False,
    ),
]
DressedAs = Annotated[
    str | None,
    option(LEAVES, "--species", metavar="NAME", help="Whose leaves it bears. (default: the tree's own)"),
]
LibraryFolder = Annotated[
    Path | None,
    option(LEAVES, "--library", metavar="DIR", help="Species of your own, looked for there first."),
]
SeasonOption = Annotated[Season, option(LEAVES, "--season", help="Of the leaves.")]
Hulls = Annotated[bool, option(LEAVES, "--hulls", help="Leaf clusters as plain hulls, without leaves.")]
Lod = Annotated[
    float,
    option(
        LEAVES,
        "--lod",
        metavar="X",
        min=1e-4,
        max=1.0,
        help="Part of the leaves and branches that is kept; leaf area stays.",
    ),
]
FS = Annotated[
    float | None,
    option(
        TREE,
        "--f-s",
        metavar="X",
        min=0.01,
        max=1.0,
        help="Where wood gives way to leaf clusters; 1: leafless, no clusters. (default: the species')",
    ),
]
Beta = Annotated[
    float | None,
    option(TREE, "--beta", metavar="X", min=1.0, max=10.0, help="How much paths avoid gaps."),
]
Gamma = Annotated[
    float | None,
    option(TREE, "--gamma", metavar="X", min=0.1, max=10.0, help="How fast branches thin out."),
]
MaxNodes = Annotated[
    int | None,
    option(
        TREE,
        "--max-nodes",
        metavar="N",
        min=16,
        max=1_000_000,
        help="Most nodes of the skeleton. (default: 4000)",
    ),
]
UnitsOption = Annotated[Units | None, option(SCAN, "--units", help="Unit of the scan. (default: metres)")]
UpOption = Annotated[Up, option(SCAN, "--up", help="Axis of the scan that points up.")]
Base = Annotated[
    str | None,
    option(
        SCAN,
        "--base",
        metavar="X,Y,Z",
        help="Foot of the trunk in the scan's coordinates. (default: found)",
    ),
]
Largest = Annotated[bool, option(SCAN, "--largest", help="Of several trees take the largest.")]
TreeId = Annotated[int | None, option(SCAN, "--tree-id", metavar="N", help="Take the tree of this number.")]
KeepGround = Annotated[bool, option(SCAN, "--keep-ground", help="Do not look for ground to remove.")]
MaxPoints = Annotated[
    int | None,
    option(
        SCAN,
        "--max-points",
        metavar="N",
        min=1000,
        help="Thin larger scans while reading. (default: 20000000)",
    ),
]
AsPoints = Annotated[bool, option(SCAN, "--as-points", help="Read the vertices of a mesh as points.")]
DecimalOption = Annotated[
    Decimal | None, option(SCAN, "--decimal", help="Decimal mark of a text file. (default: found)")
]

Folder = Annotated[
    Path,
    option(OUTPUT, "--output", "-o", metavar="DIR", help="Where the files go.", show_default=False),
]
NoPreview = Annotated[bool, option(OUTPUT, "--no-preview", help="Do not draw NAME.png.")]
Turntable = Annotated[bool, option(OUTPUT, "--turntable", help="Draw NAME.gif, the tree from all sides.")]
Resume = Annotated[
    bool, option(OUTPUT, "--resume", help="Leave out scans that are done: their NAME.json is there.")
]
Jobs = Annotated[int, option(RUN, "--jobs", "-j", metavar="N", min=1, help="Scans done side by side.")]

Picture = Annotated[
    Path,
    option(
        OUTPUT,
        "--output",
        "-o",
        metavar="FILE",
        help="Ends in .png or .jpg; with --turntable in .gif.",
        show_default=False,
    ),
]
Beside = Annotated[
    Path | None, option(OUTPUT, "--scan", metavar="SCAN", help="Draw this scan beside X.lobes.")
]
Turning = Annotated[bool, option(OUTPUT, "--turntable", help="Draw the tree from all sides.")]
Frames = Annotated[int, option(OUTPUT, "--frames", metavar="N", min=1, max=720, help="Pictures in a turn.")]
Size = Annotated[str | None, option(OUTPUT, "--size", metavar="WxH", help="In pixels. (default: 1024 high)")]
Azimuth = Annotated[
    float | None,
    option(
        OUTPUT,
        "--azimuth",
        metavar="DEG",
        help="Where the camera stands, from +x towards +y. (default: before the broad side)",
    ),
]
RendererOption = Annotated[Renderer, option(OUTPUT, "--renderer", help="What draws.")]
