"""What is written of a reconstruction: the tree, its mesh, its cylinders, its picture and its figures."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sapwood._version import SCHEMA_VERSION, __version__
from sapwood.cylinders import format_cylinders
from sapwood.outputs import Staging, check_free
from sapwood.pipeline import Clock
from sapwood.text import to_json
from treegraph.errors import InputError

if TYPE_CHECKING:
    from sapwood.dressing import Dressed
    from sapwood.pipeline import Reconstruction

__all__ = ["Saved", "make_report", "output_names", "save"]

LIBRARIES = ("numpy", "scipy", "numba", "laspy", "zstandard")
"""What the result may depend on; their versions go into the report."""

DECIMALS = {"_m": 4, "_m3": 6, "_arc": 3}
SECONDS_DECIMALS = 3


@dataclass(frozen=True)
class Saved:
    """What came of :func:`save`.

    Attributes
    ----------
    files : list of Path
        What was written; the report last.
    report : dict
        What is in ``NAME.json``.
    notices : tuple of str
        Remarks on this machine rather than on the scan, for instance that it has no OpenGL.
    """

    files: list[Path]
    report: dict[str, Any]
    notices: tuple[str, ...]


def output_names(name: str, *, preview: bool = True, turntable: bool = False) -> list[str]:
    """The files that :func:`save` writes for a tree of this name, in the order in which they appear."""
    suffixes = ["lobes", "glb", "cylinders.csv"]
    suffixes += ["png"] * preview + ["gif"] * turntable + ["json"]
    return [f"{name}.{suffix}" for suffix in suffixes]


def save(
    tree: Reconstruction,
    folder: str | os.PathLike[str],
    *,
    preview: bool = True,
    turntable: bool = False,
    force: bool = False,
    seed: int = 0,
    season: str = "summer",
    leaves: bool = True,
    library: str | os.PathLike[str] | None = None,
    staging: str | os.PathLike[str] | None = None,
) -> Saved:
    """Write ``NAME.lobes``, ``.glb``, ``.cylinders.csv``, ``.png`` and ``.json`` into `folder`.

    Every file appears whole or not at all, the report last: where there is a report, the rest is complete.

    Parameters
    ----------
    tree : Reconstruction
    folder : path
        Made if it is not there.
    preview : bool
        Whether to draw the scan beside the model.
    turntable : bool
        Whether to draw the model from all sides, ``NAME.gif``.
    force : bool
        Whether files that are there may be replaced.
    seed : int
        For the arrangement of twigs and leaves; recorded.
    season : str
        Of the leaves in mesh and pictures: "spring", "summer", "autumn" or "winter".
    leaves : bool
        Whether a tree whose species is known is dressed with its leaves; else clusters are hulls.
    library : path, optional
        A folder of species of one's own, which is looked into first.
    staging : path, optional
        Where files are made before they appear, on the same disk; in `folder` by default.

    Raises
    ------
    InputError
        If a file exists and `force` is not set, or `folder` cannot be written to.
    """
    names = output_names(tree.name, preview=preview, turntable=turntable)
    check_free([Path(folder) / name for name in names], force=force)
    with Staging(folder, inside=staging) as stage:
        clock = Clock()
        dressed, leaf_notes = _dress(tree, clock, season, seed, library) if leaves else (None, [])
        _write_tree(tree, stage.path, clock, dressed)
        renderer: str | None = None
        notices: list[str] = []
        if preview or turntable:
            with clock.stage("preview"):
                renderer, notices = _draw(tree, stage.path, preview, turntable, dressed)
        made = [name for name in names if (stage.path / name).exists()]
        n_bytes = (stage.path / f"{tree.name}.lobes").stat().st_size
        report = make_report(
            tree,
            bytes=n_bytes,
            files=[*made, f"{tree.name}.json"],
            preview=renderer,
            seed=seed,
            leaf_area_m2=None if dressed is None else dressed.figures()["leaf_area_m2"],
            leaves=None if dressed is None else dressed.figures(),
            seconds={**tree.seconds, **clock.seconds},
            more_notes=leaf_notes,
        )
        (stage.path / f"{tree.name}.json").write_text(to_json(report), encoding="utf-8")
        files = stage.publish(report["files"])
    return Saved(files, report, tuple(notices))


def make_report(
    tree: Reconstruction, *, seconds: dict[str, float], more_notes: Sequence[str] = (), **more: Any
) -> dict[str, Any]:
    """The report of a reconstruction, as JSON takes it; docs/commands.md says what each field is."""
    measures = {key: _rounded(key, value) for key, value in tree.measures.items()}
    report = {
        "schema_version": SCHEMA_VERSION,
        "name": tree.name,
        "source": tree.source,
        "sha256": tree.sha256,
        "n_points_read": tree.cloud.n_read,
        "n_points_used": tree.report.n_points_used,
        **measures,
        "origin": [round(value, 4) for value in tree.tree.origin.tolist()],
        "epsg": tree.tree.epsg,
        "recognised": tree.recognised,
        **more,
        "notes": [*tree.notes, *more_notes],
        "seconds": {key: round(value, SECONDS_DECIMALS) for key, value in seconds.items()},
        "settings": tree.settings,
        "versions": _versions(),
    }
    return _plain(report)


def _dress(
    tree: Reconstruction,
    clock: Clock,
    season: str,
    seed: int,
    library: str | os.PathLike[str] | None,
) -> tuple[Dressed | None, list[str]]:
    """The tree with its species' leaves, and remarks on them; None if it has no species or none is known.

    A species that the library cannot derive is an error only where somebody named it.
    """
    from sapwood.dressing import dress, find_kind, unknown_kind

    if tree.tree.species is None:
        return None, []
    with clock.stage("leaves"):
        try:
            kind = find_kind(tree.tree, None, library)
        except InputError as error:
            if tree.recognised is None:
                raise
            return None, [f"it gets no leaves: {error}"]
        if kind is None:
            return None, [unknown_kind(tree.tree)]
        dressed = dress(tree.tree, kind, season=season, seed=seed)
    return dressed, [] if dressed.remark is None else [dressed.remark]


def _write_tree(tree: Reconstruction, folder: Path, clock: Clock, dressed: Dressed | None) -> None:
    import render
    import treegraph

    with clock.stage("write"):
        treegraph.write_lobes(tree.tree, folder / f"{tree.name}.lobes")
        (folder / f"{tree.name}.cylinders.csv").write_text(format_cylinders(tree.cylinders), encoding="ascii")
    with clock.stage("mesh"):
        extras = {"name": tree.name, "origin": tree.tree.origin.tolist(), "epsg": tree.tree.epsg}
        path = folder / f"{tree.name}.glb"
        if dressed is None:
            render.write_glb(path, render.tree_parts(tree.tree), extras=extras)
        else:
            render.write_instanced_glb(path, dressed.decoded, name=tree.name, extras=extras)


def _draw(
    tree: Reconstruction, folder: Path, preview: bool, turntable: bool, dressed: Dressed | None
) -> tuple[str | None, list[str]]:
    """Draw the pictures; return what drew them (None if nothing could) and what is to be said."""
    import render

    renderer, notices = None, []
    parts = None if dressed is None else dressed.parts()
    try:
        if preview:
            scan = (tree.cloud.xyz, tree.cloud.color)
            drawn = render.preview(tree.tree, folder / f"{tree.name}.png", scan=scan, parts=parts)
            renderer, notices = drawn.renderer, [drawn.notice]
        if turntable:
            drawn = render.turntable(tree.tree, folder / f"{tree.name}.gif", parts=parts)
            renderer, notices = drawn.renderer, [*notices, drawn.notice]
    except (ImportError, render.NoPreviewError) as error:
        notices.append(f"no picture can be drawn on this machine ({error}); all other files are made")
    return renderer, [notice for notice in notices if notice]


def _rounded(key: str, value: Any) -> Any:
    decimals = next((n for suffix, n in DECIMALS.items() if key.endswith(suffix)), None)
    return round(value, decimals) if isinstance(value, float) and decimals is not None else value


@cache
def _versions() -> dict[str, str]:
    return {
        "sapwood": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in LIBRARIES},
    }


def _plain(value: Any) -> Any:
    """The same with NumPy's scalars, tuples and NaN as JSON has them."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
