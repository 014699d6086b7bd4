"""Write docs/commands.md from the commands themselves.

``python docs/make_commands.py`` writes the page, ``--check`` only says whether it is current.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator
from enum import EnumType
from pathlib import Path
from typing import Any, get_args, get_type_hints

sys.path.insert(0, str(Path(__file__).parent.parent))

from sapwood._version import SCHEMA_VERSION
from sapwood.cli.main import COMMANDS

PAGE = Path(__file__).with_name("commands.md")

HEAD = """\
<!-- Written by docs/make_commands.py from the commands themselves; do not edit. -->
# The commands

`reconstruct` is the main job; it is installed as a command of its own and as `sapwood reconstruct`.
Where neither is on the path, `python -m sapwood` is the same as `sapwood`.

Results go to stdout, everything else (remarks, progress, errors) to stderr. With a terminal there is a
progress bar, else one line for each scan of several. Files appear whole or not at all, and none that is
there is replaced without `--force`. The same scan and options give the same bytes, whatever `--jobs` is;
only the `seconds` in a report differ.

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | a fault of Sapwood; `-v` shows where |
| 2 | the input or the arguments are at fault: one line on stderr says where, what is wrong and what to do |
| 3 | some of several scans failed and the rest is done; the failures are listed at the end |
| 130 | interrupted; what was not finished has been removed |
"""

#: What is in NAME.json, in order; a test compares it with a real one.
REPORT = {
    "schema_version": f"of this object: {SCHEMA_VERSION}",
    "name": "name of the outputs",
    "source": "path of the scan as it was given",
    "sha256": "of the scan's bytes",
    "n_points_read": "points in the file",
    "n_points_used": "points that the skeleton was made from, after preparing and thinning",
    "height_m": "highest point of the tree above the foot of its trunk",
    "dbh_m": "diameter of the trunk 1.3 m above its foot; null with a reason",
    "dbh_method": "`circle` (fitted to the points there), `tube` (the modelled trunk) or `none`",
    "dbh_reason": "why there is no diameter, or why it is not from a circle; else null",
    "dbh_arc": "share of the trunk's round on which the circle has points, 0 to 1",
    "crown_width_m": "mean horizontal extent, over all directions, of the points above the crown's base",
    "crown_base_m": "height at which the crown begins: the bottom of the lowest leaf cluster (those below "
    "it hold less than 2% of the leaf points), or without leaves the lowest branch that carries 2% of all "
    "wood's length; null without a crown",
    "wood_volume_m3": "volume of the cylinders: trunk and branches as far as they are modelled",
    "total_length_m": "length of the cylinders",
    "n_nodes": "nodes of the skeletal graph",
    "n_tips": "its tips",
    "n_clusters": "leaf clusters",
    "origin": "foot of the trunk in the scan's coordinates, metres",
    "epsg": "EPSG code of those coordinates, or null",
    "recognised": "`species` (null: none of these), `probability` of the most probable one, `probabilities` "
    "of all, `features` that spoke for it, `taken`: whether it was believed, `model`: which one was asked; "
    "null unless --species is auto",
    "bytes": "size of NAME.lobes",
    "files": "what was written",
    "preview": "what drew the picture: `egl`, `osmesa`, `software`; null if nothing did",
    "seed": "as given",
    "leaf_area_m2": "one side of all leaves that the tree is dressed with; null without a species",
    "leaves": "`species`, `season`, `leaf_area_m2`, `cluster_volume_m3`, `leaf_area_density` (m2/m3; "
    "volume times density is the leaf area in summer), `n_leaves`, `n_twigs`; null without a species",
    "notes": "remarks on the scan, one line each; also on stderr",
    "seconds": "wall-clock time of each stage",
    "settings": "every setting in force",
    "versions": "of Sapwood, Python and the libraries that the result may depend on",
}

FILES = """\
### What it writes

| file | what |
|---|---|
| `NAME.lobes` | the tree: graph, leaf clusters, species, place; see `docs/lobes-format.md` |
| `NAME.glb` | its mesh, metres, y up, the foot of the trunk at the origin |
| `NAME.png` | the scan beside the model |
| `NAME.cylinders.csv` | `id,parent,x0,y0,z0,x1,y1,z1,r0,r1,order,measured`: metres, the scan's own \
coordinates; parents come first: the cylinder that this one continues or comes out of, -1 at the root; \
order 0 is the trunk; measured is 1 if the radius was measured, else 0 |
| `NAME.json` | its measures and how it was made; written last, so where it is the rest is complete |

The scan's own coordinates are metres: of a scan in another unit (`--units`) they are its numbers
converted, and with `--up` they are turned so that z is up. `origin` in the report is in the same
coordinates.

A folder means the scans in it by their suffix, without sub-folders and hidden files; text files without
numbers are left out, with a note. NAME is the scan's file name without suffix, cut at 220 bytes. Scans of
one name get their folder in front (`north-tree`, `south-tree`), or their suffix behind (`tree-laz`,
`tree-ply`).

If an output is there already nothing is done. `--force` replaces it; after an interruption `--resume`
goes on with the scans that have no `NAME.json` yet.

`NAME.json`:

| field | meaning |
|---|---|
"""

JSON = """\
With `--json`: `schema_version`, `command`, `version`, and """

JSON_FIELDS = {
    "reconstruct": "`output` (the folder), `trees` (the reports, as in NAME.json), `failed` (`scan`, `name`, "
    "`kind`: `input`, `internal` or `died`, `message`), `seconds`.",
    "decode": "`input`, `output`, `bytes`, `lod`, `leaves` (as in NAME.json), `seed`.",
    "preview": "`input`, `output`, `renderer`, `width`, `height`, `seed`, `leaves` (as in NAME.json).",
    "info": "`input`, `kind` (`tree` or `scan`), and the facts that are printed, `notes` among them. "
    "Of a tree they are taken from the file alone, to its precision: `height_m` is that of wood and hulls, "
    "where the report of `reconstruct` has that of the points.",
    "grow": "`kind`, `age` (cycles grown), `status` (`grown` or `node limit`), `nodes`, `height_m` and "
    "`leaf_area_m2` of the tree, `trees` (it and its neighbours), `seed`, `files`, `seconds`. Of a .toml "
    "only `kind`, `age` and `files`.",
    "adapt": "`nodes_before`, `nodes_after`, `pruned`, `mean_shift_m` (of living nodes) of all trees "
    "together, of "
    "the last frame of a path; `trees`, the same for each with `name`, `pruned_by_light`, "
    "`pruned_by_obstacles`, "
    "`clusters_before` and `clusters_after`; `files`, `seed`, `analyse_s` (reading and analysis, once per "
    "tree), "
    "`adapt_s` (all adaptations), `seconds` (the whole command).",
    "scan": "`input`, `output`, `points`, `rays`, `stations` (strips, tracks), `faces` of the scene, "
    "`n_wood`, `n_leaf`, `n_ground`, `n_other`, `n_mixed` (points whose beam hit surfaces more than "
    "a third of the separation apart), `bytes`, `seed`, `notes`, `seconds`. The columns of the file are in "
    "[scanning.md](scanning.md).",
    "compare": "`input` (both), `distance`, `shape`, `geometry`, `structure` (0 to 1), `weights`, `parts` "
    "(the "
    "difference of every descriptor, by `shape` and `geometry`), `matched` (share of each tree's length "
    "that has "
    "a counterpart), `pairs` (`a` and `b`: nodes at which the two runs of branches begin and end, "
    "`a_length_m`, "
    "`b_length_m`, `cost_m2`; most wood first), `picture`, `renderer`. Nodes are counted from 0, of an .swc "
    "depth-first. What the numbers mean is in [similarity.md](similarity.md).",
    "fit": "`input` (all trees), `output`, `distance`, `shape`, `geometry`, `structure` (means over 16 new "
    "trees and the given ones), `age`, `parameters` (by symbol), `distances` (of each run), `runs` "
    "(parameters of each), `spread` (their standard deviation; null of a single run), `curves` (of each run: "
    "evaluations, distance), `evaluations`, `grown`, `compared`, `status` (`done` or `stopped`), `seconds`.",
    "classify": "`model`, `scans` (`file`, `species`: null if it is none of the model's, `probability`: of "
    "the most probable, `probabilities`: of all, the most probable first, `features`: at most five that "
    "spoke for it, with `name`, `unit`, `value` and `part`, in log-odds against the runner-up), `failed` "
    "(`file`, `kind`, `message`), `seconds`. What they mean is in [classify.md](classify.md).",
    "species list": "`species` (`name`, `latin`, `bytes` of definition and derived file together, "
    "`branchlets`, `patches`, `leaf` (its kind), `builtin`), `faults` (a line for each file that could not "
    "be read).",
    "species show": "the facts that are printed, `output`.",
    "species build": "as `species show`, and `files`.",
    "species train": "what is in the report beside the model ([classify.md](classify.md) lists it), `files`, "
    "`seconds`.",
    "doctor": "`ok`, `checks` (`name`, `state`: `ok`, `missing` or `broken`, `found`, `fix`).",
}


def page() -> str:
    """The whole page."""
    parts = [HEAD, *(section(name, command) for name, command in COMMANDS.items())]
    fault = (
        "If a command fails with code 1 or 2 before there is a result, the object holds `error` "
        "(`message`, `exit_code`)."
    )
    return "\n".join([*parts, fault]) + "\n"


def section(name: str, command: Callable[..., int]) -> str:
    """One command: what it does, an example, its options, its JSON."""
    lines = [f"## {name}", ""]
    for paragraph in inspect.cleandoc(command.__doc__ or "").split("\n\n"):
        if paragraph.startswith("\b"):
            block = paragraph.removeprefix("\b\n").removeprefix("Example:")
            language = "sh" if "Example:" in paragraph else "text"
            lines += [f"```{language}", *(line.strip() for line in block.splitlines()), "```", ""]
        else:
            lines += [" ".join(paragraph.split()), ""]
    lines += ["| option | default | |", "|---|---|---|", *rows(command), ""]
    if name == "reconstruct":
        lines += [FILES + "\n".join(f"| `{key}` | {text} |" for key, text in REPORT.items()), ""]
    return "\n".join([*lines, JSON + JSON_FIELDS[name], ""])


def rows(command: Callable[..., int]) -> Iterator[str]:
    """The table of options."""
    hints = get_type_hints(command, include_extras=True)
    for parameter in inspect.signature(command).parameters.values():
        kind, option = get_args(hints[parameter.name])
        given = (
            option.default,
            *(getattr(option, "param_decls", None) or ()),
        )  # typer takes the first for one
        names = ", ".join(f"`{name}`" for name in given if isinstance(name, str) and name.startswith("-"))
        value = escape(option.metavar or choices(kind))
        shown = f"{names} `{value}`" if names and value else names or f"`{value}`"
        yield f"| {shown} | {default(parameter)} | {escape(option.help)} |"


def choices(kind: Any) -> str:
    """The values of an enumeration, "" of any other type."""
    for part in (kind, *get_args(kind)):
        if isinstance(part, EnumType):
            return "|".join(member.value for member in part)
    return ""


def default(parameter: inspect.Parameter) -> str:
    """What an option is if it is left out."""
    if parameter.default is inspect.Parameter.empty:
        return "required"
    if parameter.default is None or parameter.default is False:
        return ""
    return str(parameter.default)


def escape(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> int:
    text = page()
    if "--check" in sys.argv[1:]:
        return int(not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
