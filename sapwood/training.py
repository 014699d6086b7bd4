"""Scans with the name of their species: found in folders or a table, and what training made of them."""

from __future__ import annotations

import csv
import platform
from collections.abc import Hashable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sapwood._version import SCHEMA_VERSION, __version__
from sapwood.naming import find_scans
from treegraph.errors import InputError

if TYPE_CHECKING:
    from classify import Training

__all__ = ["Labelled", "check_enough", "find_labelled", "report_training", "report_path", "versions"]

LEAST = 2
"""Fewest scans of a species: one to train with while the other is held out."""

LIBRARIES = ("numpy", "numba", "scipy")


@dataclass(frozen=True)
class Labelled:
    """A scan whose species is known.

    Attributes
    ----------
    path : Path
    species : str
    tree : hashable
        Which tree it shows; scans of one tree are held out together.
    """

    path: Path
    species: str
    tree: Hashable


def find_labelled(source: Path, skipped: list[Path] | None = None) -> list[Labelled]:
    """List the scans of a folder with one sub-folder per species, or of a table.

    Parameters
    ----------
    source : path
        The folder, or a CSV file with the columns ``path`` (relative to the file's folder), ``species`` and,
        if there are several scans of a tree, ``tree``: any text that is the same for these. A row without it
        is a tree of its own.
    skipped : list of Path, optional
        Text files without points in the sub-folders are added to it.

    Returns
    -------
    list of Labelled
        In alphabetical order of folders and files, or in that of the table.

    Raises
    ------
    InputError
        If the source is missing, has no species or no scans, a row of the table is incomplete, or a tree is
        of two species.
    """
    if source.is_dir():
        found = _of_folder(source, skipped if skipped is not None else [])
    elif source.exists():
        found = _of_table(source)
    else:
        raise InputError(f"{source}: there is no such folder or table.")
    from classify.model import MOST_NAME, MOST_NAME_BYTES

    for each in found:
        if len(each.species) > MOST_NAME or not each.species.isprintable():
            raise InputError(
                f"{source}: the name of a species must be at most {MOST_NAME} printable characters, "
                f"got {each.species[:50]!r}."
            )
        if len(each.species.encode()) > MOST_NAME_BYTES:
            raise InputError(
                f"{source}: the name of a species must take at most {MOST_NAME_BYTES} bytes in UTF-8, "
                f"got {each.species[:50]!r}."
            )
    owner: dict[Hashable, str] = {}
    for each in found:
        if owner.setdefault(each.tree, each.species) != each.species:
            assert isinstance(each.tree, tuple)
            raise InputError(
                f"{source}: tree {each.tree[1]!r} is of two species, {owner[each.tree]} and {each.species}."
            )
    return found


def _of_folder(source: Path, skipped: list[Path]) -> list[Labelled]:
    folders = sorted(p for p in source.iterdir() if p.is_dir() and not p.name.startswith("."))
    if not folders:
        raise InputError(f"{source}: there must be one sub-folder per species with its scans; there is none.")
    found: list[Labelled] = []
    for folder in folders:
        scans = find_scans([str(folder)], skipped, [])
        if not scans:
            raise InputError(f"{folder}: no scan in this folder; every sub-folder must be of a species.")
        found += [Labelled(path, folder.name, ("scan", str(path))) for path in scans]
    return found


def _of_table(source: Path) -> list[Labelled]:
    found: dict[str, Labelled] = {}
    for number, row in enumerate(_rows(source), 2):
        path, species, tree = ((row.get(key) or "").strip() for key in ("path", "species", "tree"))
        if not path or not species:
            raise InputError(f"{source}: line {number}: path and species must not be empty.")
        where = str(source.parent / path)
        if where in found:
            raise InputError(f"{source}: line {number}: {path} is named twice.")
        found[where] = Labelled(Path(where), species, ("tree", tree) if tree else ("scan", where))
    if not found:
        raise InputError(f"{source}: there is no scan in this table.")
    return list(found.values())


def _rows(source: Path) -> list[dict[str, Any]]:
    """The rows of a table by its header's names, separated by commas or semicolons."""
    try:
        lines = source.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(
            f"{source}: a table must be text in UTF-8, with path,species as its header."
        ) from None
    mark = ";" if lines and ";" in lines[0] and "," not in lines[0] else ","
    header = [name.strip() for name in lines[0].split(mark)] if lines else []
    if not {"path", "species"} <= set(header):
        raise InputError(
            f"{source}: the first line of a table must name the columns path,species (and tree, if some "
            f"scans show the same), got {', '.join(header)[:60]!r}."
        )
    try:
        return list(csv.DictReader(lines[1:], fieldnames=header, delimiter=mark, strict=True))
    except csv.Error as error:
        raise InputError(f"{source}: the table cannot be read ({error}).") from None


def check_enough(scans: Sequence[Labelled], source: Path, what: str = "scans") -> None:
    """Raise InputError unless there are two species, and two trees of each.

    >>> check_enough([Labelled(Path("a.laz"), "oak", 1)], Path("kinds"))
    Traceback (most recent call last):
    ...
    treegraph.errors.InputError: kinds: there must be scans of at least 2 species, got 1: oak.
    """
    trees = {species: {s.tree for s in scans if s.species == species} for species in _names(scans)}
    if len(trees) < 2:
        raise InputError(
            f"{source}: there must be {what} of at least 2 species, got {len(trees)}: "
            f"{', '.join(trees) or 'none'}."
        )
    few = [species for species, mine in trees.items() if len(mine) < LEAST]
    if few:
        raise InputError(
            f"{source}: there must be {what} of at least {LEAST} trees of each species, "
            f"got {len(trees[few[0]])} of {few[0]}."
        )


def _names(scans: Sequence[Labelled]) -> list[str]:
    return sorted({scan.species for scan in scans})


def report_path(model: Path) -> Path:
    """Where the report on a model's training goes: beside it, with the suffix .json.

    Raises
    ------
    InputError
        If the model has that suffix itself.
    """
    if model.suffix.lower() == ".json":
        raise InputError(f"{model}: the report takes the suffix .json; name the model otherwise, .model say.")
    return model.with_suffix(".json")


def versions() -> dict[str, str]:
    """Of Sapwood, Python and the libraries that a model may depend on."""
    return {
        "sapwood": __version__,
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in LIBRARIES},
    }


def report_training(
    training: Training, scans: Sequence[Labelled], failed: Sequence[dict[str, str]], seed: int
) -> dict[str, Any]:
    """What is to be known of a model: with what it was trained, and how it does on scans held out.

    Parameters
    ----------
    training : Training
    scans : n Labelled
        The scans that it was trained with.
    failed : sequence of dict
        The scans that could not be described.
    seed : int

    Returns
    -------
    dict
        As docs/classify.md lists it; ready for JSON.
    """
    from classify import SPECIES_SETTINGS, calibration_error, log_loss, reliability

    model, label, probability = training.model, training.label, training.probability
    said = probability.argmax(axis=1)
    confusion = np.zeros((len(model.classes),) * 2, np.int64)
    np.add.at(confusion, (label, said), 1)
    table = reliability(probability, label)
    rejection = model.rejection
    return {
        "schema_version": SCHEMA_VERSION,
        "classes": list(model.classes),
        "scans": {name: sum(s.species == name for s in scans) for name in model.classes},
        "trees": {name: len({s.tree for s in scans if s.species == name}) for name in model.classes},
        "folds": int(training.fold.max()) + 1,
        "accuracy": float((said == label).mean()),
        "accuracy_by_class": {
            name: float(confusion[k, k] / confusion[k].sum()) for k, name in enumerate(model.classes)
        },
        "confusion": confusion.tolist(),
        "calibration_error": calibration_error(probability, label),
        "calibration_error_before": calibration_error(training.uncalibrated, label),
        "log_loss": log_loss(probability, label),
        "reliability": {key: np.asarray(value).tolist() for key, value in vars(table).items()},
        "false_rejections": rejection.measured,
        "false_rejections_asked": rejection.asked,
        "n_features": len(model.features),
        "n_features_used": int(np.unique(model.stumps.feature).size),
        "settings": asdict(SPECIES_SETTINGS),
        "seed": seed,
        "failed": list(failed),
        "versions": versions(),
    }
