"""From a scan to a measured tree: read, prepare, encode, measure."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from inspect import signature
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sapwood.classifying import find_model, recognise
from sapwood.cylinders import cylinder_table, move_cylinders
from sapwood.measures import measure
from treegraph.errors import FitError, FormatError, InputError

if TYPE_CHECKING:
    from classify import SpeciesModel
    from recon import Cloud, Encoder, EncodeReport, EncodeSettings, Encoding
    from species import library as species_library
    from treegraph import ClusterTree

__all__ = [
    "AUTO",
    "Clock",
    "Reconstruction",
    "asked_species",
    "find_judge",
    "known_species",
    "make_settings",
    "reconstruct",
]

AUTO, NONE = "auto", "none"
"""Instead of a species: the one that the tree is recognised as, and none at all."""

DEFAULT_NAME = "tree"
"""Name of the outputs of points from memory."""

PREPARE_OPTIONS = ("base", "units", "up", "keep_ground", "largest", "tree_id")
READ_OPTIONS = ("max_points", "as_points", "decimal")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A tree made from a scan, with what is known of how it was made.

    Attributes
    ----------
    name : str
        Name of its outputs.
    tree : ClusterTree
        The tree itself, in the local frame: foot of the trunk at the origin, z up, metres.
    cloud : Cloud
        The points it was made from: the tree's own, in the same frame.
    measures : dict of str to float, int, str or None
        Its figures, the fields of :class:`sapwood.Measures`: ``height_m``, ``dbh_m`` and so on.
    cylinders : (m,) structured ndarray
        The :func:`sapwood.cylinder_table` in the scan's own coordinates, metres.
    report : EncodeReport
        How the trunk's diameter was measured, what was used and noticed.
    notes : tuple of str
        One-line remarks on the scan, for the user.
    seconds : dict of str to float
        Wall-clock time of each stage.
    settings : dict of str to object
        Every setting in force, as JSON takes it.
    source : str
        Path of the scan, "" for points from memory.
    sha256 : str
        Of the file's bytes; of the points' bytes for points from memory.
    recognised : dict or None
        What the model said if it was asked for the species: :func:`sapwood.classifying.say_species`, with
        ``taken``, whether it was believed.
    """

    name: str
    tree: ClusterTree
    cloud: Cloud
    measures: dict[str, Any]
    cylinders: NDArray[np.void]
    report: EncodeReport
    notes: tuple[str, ...]
    seconds: dict[str, float]
    settings: dict[str, Any]
    source: str
    sha256: str
    recognised: dict[str, Any] | None = None

    def __repr__(self) -> str:
        m = self.measures
        dbh = f"DBH {m['dbh_m'] * 100:.1f} cm" if m["dbh_m"] is not None else "no DBH"
        size = f"{m['height_m']:.1f} m high, {dbh}"
        return f"<Reconstruction {self.name}: {size}, {m['n_nodes']} nodes, {m['n_clusters']} clusters>"

    def save(self, folder: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write the tree's files into `folder`; :func:`sapwood.saving.save` has the options."""
        from sapwood.saving import save

        return save(self, folder, **options).files


def reconstruct(
    scan: str | os.PathLike[str] | ArrayLike,
    *,
    species: str | None = AUTO,
    library: str | os.PathLike[str] | None = None,
    model: str | os.PathLike[str] | SpeciesModel | None = None,
    f_s: float | None = None,
    settings: EncodeSettings | None = None,
    name: str | None = None,
    progress: Callable[[str], object] | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct the tree in a scan.

    Parameters
    ----------
    scan : path or (n, 3) array_like
        A file of any kind that :func:`recon.read_cloud` knows, or points: metres, z up.
    species : str, optional
        A species of the library, by any of its names: gives the branches' allometry, and the leaves
        with which the tree is dressed when it is saved. "auto": the one that the tree is recognised as; of
        a tree that is not recognised, and with "none" or None, the default allometry, and no leaves.
    library : path, optional
        A folder of species of one's own, which is looked into first.
    model : path or SpeciesModel, optional
        What recognises species, made by ``sapwood species train``; the one that comes along if left out. It
        is asked about the tree that the default settings make, as those of its training were.
    f_s : float, optional
        Factor by which the diameters are reduced where wood gives way to leaf clusters, 0 < f_s <= 1;
        1 makes no clusters (a leafless tree). The species' own, or what the scan shows, if left out.
    settings : EncodeSettings, optional
        How the tree is made, in full; the other arguments take the place of the same in it.
    name : str, optional
        Name of the outputs, without any folder; the file's name without suffix if left out.
    progress : callable, optional
        Called with the name of each stage when it begins.
    **options
        Single fields of :class:`recon.EncodeSettings` (``beta``, ``gamma``, ``max_nodes`` ...), of
        :class:`recon.PrepareSettings` (``units``, ``up``, ``base``, ``largest``, ``tree_id``,
        ``keep_ground``), and ``max_points``, ``as_points`` and ``decimal`` of :func:`recon.read_cloud`.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InputError, FormatError
        If the scan or an argument is at fault; the message is one line.

    Notes
    -----
    The same scan and settings give the same tree, bit for bit.

    Examples
    --------
    >>> import sapwood
    >>> tree = sapwood.reconstruct("samples/orange_wood.laz")  # doctest: +SKIP
    >>> tree.save("out")  # doctest: +SKIP
    """
    species = asked_species(species)
    reading = {key: options.pop(key) for key in READ_OPTIONS if key in options}
    if name is not None and Path(name).name != name:
        raise InputError(f"name must be a file name without suffix and folder, got {name!r}.")
    known = known_species(species, library)  # a misspelt name is said before a long file is read
    judge = find_judge(species, model)
    settings = make_settings(settings, f_s=f_s, **options)
    clock = Clock(progress)
    cloud, source, sha256 = _read(scan, reading, clock)
    with clock.stage("encode"), _about(source):
        encoder = _encoder(cloud, settings)
        encoding = _encode(encoder, known)
    recognised = None
    if judge is not None:
        with clock.stage("classify"):
            recognised = recognise(_by_default(encoding, cloud, settings), judge)
        encoding = _as_recognised(encoding, recognised, encoder, library, clock)
    report = encoding.report
    with clock.stage("measure"):
        table = cylinder_table(encoding.tree.graph)
        _check_wood(source, table)
        dbh = {key: getattr(report, key) for key in ("dbh_m", "dbh_method", "dbh_reason", "dbh_arc")}
        measures = measure(encoding.tree, table, encoding.cloud.xyz, **dbh)
    return Reconstruction(
        name=name or Path(source).stem or DEFAULT_NAME,
        tree=encoding.tree,
        cloud=encoding.cloud,
        measures=asdict(measures),
        cylinders=move_cylinders(table, encoding.tree.origin),
        report=report,
        notes=tuple(
            dict.fromkeys((*cloud.notes, *encoding.cloud.notes, *report.notes, *_said(recognised, encoding)))
        ),
        seconds=_merged(clock.seconds, report.seconds),
        settings={
            "species": encoding.tree.species,
            **asdict(settings),
            **_used(encoding.tree),
            "read": _in_force(scan, reading),
        },
        source=source,
        sha256=sha256,
        recognised=recognised,
    )


def _encoder(cloud: Cloud, settings: EncodeSettings) -> Encoder:
    import recon

    return recon.Encoder(cloud, settings)


def _encode(encoder: Encoder, kind: species_library.Definition | None) -> Encoding:
    name, allometry = (None, None) if kind is None else (kind.name, kind.allometry)
    return encoder.encode(species=name, allometry=allometry)


def _by_default(encoding: Encoding, cloud: Cloud, settings: EncodeSettings) -> Encoding:
    """The tree as the default settings make it, which is what a model learnt from."""
    import recon

    plain = recon.EncodeSettings(prepare=settings.prepare)
    return encoding if settings == plain else recon.encode_with_report(cloud, settings=plain)


def _as_recognised(
    encoding: Encoding,
    recognised: dict[str, Any],
    encoder: Encoder,
    library: str | os.PathLike[str] | None,
    clock: Clock,
) -> Encoding:
    """The tree with the parameters of its species, if that is taken for known and is in the library.

    A tree without clusters is found to be bare: it keeps its branches, whatever its species' share of wood.
    One that has clusters keeps them if the species' parameters would leave none.
    """
    if not recognised["taken"]:
        return encoding
    try:
        kind = known_species(recognised["species"], library)
    except InputError:  # a model of other species
        kind = None
    name = recognised["species"] if kind is None else kind.name
    named = replace(encoding, tree=replace(encoding.tree, species=name))
    if kind is None or not encoding.tree.clusters:
        return named
    with clock.stage("again"):
        again = _encode(encoder, kind)
    report = replace(again.report, seconds=encoding.report.seconds)
    return replace(again, report=report) if again.tree.clusters else named


def _said(recognised: dict[str, Any] | None, encoding: Encoding) -> list[str]:
    if recognised is None or not recognised["taken"]:
        return []
    name, share = recognised["species"], recognised["probability"]
    bare = "" if encoding.tree.clusters else " and bare"
    shape = f"by its shape (probability {share:.2f})"
    return [f"taken for {name}{bare} {shape}; --species names another, or none"]


def make_settings(settings: EncodeSettings | None = None, **options: Any) -> EncodeSettings:
    """Return `settings` (the defaults if None) with the fields named in `options` changed, None excepted.

    Raises
    ------
    InputError
        If a value is out of its range, or there is no such field.
    """
    import recon

    settings = settings if settings is not None else recon.EncodeSettings()
    known = {*PREPARE_OPTIONS, *(key for key in asdict(settings) if key != "prepare")}
    for key in options:
        if key not in known:
            raise InputError(f"there is no option {key!r}; the options are {', '.join(sorted(known))}.")
    given = {key: value for key, value in options.items() if value is not None}
    changed = {key: given.pop(key) for key in PREPARE_OPTIONS if key in given}
    return replace(settings, **given, prepare=replace(settings.prepare, **changed))


class Clock:
    """Wall-clock seconds of named stages, in the order in which they were first entered."""

    def __init__(self, progress: Callable[[str], object] | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the stage `name`."""
        if self._progress is not None:
            self._progress(name)
        start = perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - start


def asked_species(word: str | None) -> str | None:
    """None for "none", and "auto", in capitals or not; any other name of a species as it is."""
    if word is None or word.lower() == NONE:
        return None
    return AUTO if word.lower() == AUTO else word


def find_judge(
    species: str | None, model: str | os.PathLike[str] | SpeciesModel | None
) -> SpeciesModel | None:
    """The model that is asked for the species; None if the species is given.

    Raises
    ------
    InputError, FormatError, OSError
        As :func:`sapwood.classifying.find_model`; or if a model is given that is not asked.
    """
    if species == AUTO:
        return find_model(model)
    if model is not None:
        raise InputError(
            "a model recognises species, and with a species named, or none, it is not asked: "
            "leave out --model or --species."
        )
    return None


def known_species(
    species: str | None, library: str | os.PathLike[str] | None
) -> species_library.Definition | None:
    """The species' definition; InputError if the library has none of that name. Of "auto" None."""
    from sapwood.dressing import open_library

    if species in (None, AUTO) and library is None:
        return None
    found = open_library(library)
    return None if species in (None, AUTO) else found.find(str(species))


def _check_wood(source: str, table: NDArray[np.void]) -> None:
    if not table.size:
        about = f"{source}: " if source else ""
        raise InputError(
            f"{about}no tree can be made out in these points; look whether it is the right file."
        )


def _used(tree: ClusterTree) -> dict[str, float]:
    """The allometry in force, in place of the settings that were left open."""
    return {key: getattr(tree.allometry, key) for key in ("beta", "gamma", "f_s")}


def _merged(outer: Mapping[str, float], inner: Mapping[str, float]) -> dict[str, float]:
    """The stages of encoding in place of "encode" as a whole, and what it spent between them."""
    rest = outer["encode"] - sum(inner.values())
    seconds = {"read": outer["read"], **inner, "other": max(rest, 0.0), "measure": outer["measure"]}
    return {**seconds, **{key: value for key, value in outer.items() if key not in (*seconds, "encode")}}


def _read(scan: Any, reading: Mapping[str, Any], clock: Clock) -> tuple[Cloud, str, str]:
    """Read a file, or wrap points; return the cloud, its path and the hash of what came in."""
    import recon

    if isinstance(scan, str | os.PathLike):
        path = os.fspath(scan)
        given = {key: value for key, value in reading.items() if value is not None}
        with clock.stage("read"), _about(path):
            cloud = recon.read_cloud(path, **given)
            digest = _hash_file(path)
        return cloud, path, digest
    if reading:
        raise InputError(f"{', '.join(reading)}: only a file is read; leave it out for points.")
    with clock.stage("read"):
        cloud = recon.as_cloud(scan)
        digest = hashlib.sha256(np.ascontiguousarray(cloud.xyz + cloud.origin).tobytes()).hexdigest()
    return cloud, cloud.source, digest


def _in_force(scan: Any, reading: Mapping[str, Any]) -> dict[str, Any]:
    """Every option with which a file was read; none for points."""
    import recon

    if not isinstance(scan, str | os.PathLike):
        return {}
    default = {key: value.default for key, value in signature(recon.read_cloud).parameters.items()}
    given = {key: value for key, value in reading.items() if value is not None}
    return {key: given.get(key, default[key]) for key in READ_OPTIONS}


def _hash_file(path: str) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def _about(source: str) -> Iterator[None]:
    """Put the scan's path in front of messages from stages that do not know it."""
    try:
        yield
    except (InputError, FormatError, FitError) as error:
        if not source or str(error).startswith(source):
            raise
        raise type(error)(f"{source}: {error}") from error
