"""From a scan to everything that is written of it: read, prepare, encode, measure, save."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sapwood.cylinders import cylinder_table, move_cylinders
from sapwood.measures import Measures, measure
from treegraph.errors import FitError, FormatError, InputError

if TYPE_CHECKING:
    from recon import Cloud, EncodeReport, EncodeSettings, PrepareSettings
    from treegraph import ClusterTree

__all__ = ["Reconstruction", "reconstruct"]


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
    measures : Measures
        Its figures.
    cylinders : (m,) structured ndarray
        The :func:`sapwood.cylinder_table` in the scan's own coordinates, metres.
    report : EncodeReport
        How the trunk's diameter was measured, what was used and noticed.
    notes : tuple of str
        One-line remarks on the scan, for the user.
    seconds : mapping of str to float
        Wall-clock time of each stage.
    settings : mapping of str to object
        Every setting in force, as JSON takes it.
    source : str
        Path of the scan, "" for points from memory.
    sha256 : str
        Of the file's bytes; of the points' bytes for points from memory.
    """

    name: str
    tree: ClusterTree
    cloud: Cloud
    measures: Measures
    cylinders: NDArray[np.void]
    report: EncodeReport
    notes: tuple[str, ...]
    seconds: Mapping[str, float]
    settings: Mapping[str, Any]
    source: str
    sha256: str

    def __repr__(self) -> str:
        m = self.measures
        dbh = f"DBH {m.dbh_m * 100:.1f} cm" if m.dbh_m is not None else "no DBH"
        size = f"{m.height_m:.1f} m high, {dbh}"
        return f"<Reconstruction {self.name}: {size}, {m.n_nodes} nodes, {m.n_clusters} clusters>"

    def save(self, folder: str | os.PathLike[str], **options: Any) -> list[Path]:
        """Write the tree's files into `folder`; see :func:`sapwood.saving.save` for the options."""
        from sapwood.saving import save

        return save(self, folder, **options)


def reconstruct(
    scan: str | os.PathLike[str] | ArrayLike,
    *,
    species: str | None = None,
    f_s: float | None = None,
    prepare: PrepareSettings | None = None,
    encode: EncodeSettings | None = None,
    max_points: int | None = None,
    as_points: bool = False,
    decimal: str | None = None,
    name: str | None = None,
) -> Reconstruction:
    """Reconstruct the tree in a scan.

    Parameters
    ----------
    scan : path or (n, 3) array_like
        A file of any kind that :func:`recon.read_cloud` knows, or points: metres, z up.
    species : str, optional
        A species of :data:`treegraph.SPECIES_ALLOMETRY`; gives the branches' allometry.
    f_s : float, optional
        Share of the diameter kept per step where wood gives way to leaf clusters, 0 < f_s <= 1; 1 makes no
        clusters. The species' own if left out.
    prepare : PrepareSettings, optional
        What is known of the scan: units, up axis, base of the trunk, which tree.
    encode : EncodeSettings, optional
        How the tree is made.
    max_points, as_points, decimal
        As :func:`recon.read_cloud` takes them; for files only.
    name : str, optional
        Name of the outputs; the file's name without suffix if left out.

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
    import recon
    import treegraph
    from recon.reading import MAX_POINTS

    prepare = prepare if prepare is not None else recon.PrepareSettings()
    encode = encode if encode is not None else recon.EncodeSettings()
    if f_s is not None:
        encode = replace(encode, f_s=f_s)
    treegraph.find_allometry(species)  # a misspelt species is said before a long file is read
    clock = Clock()
    reading = {"max_points": max_points or MAX_POINTS, "as_points": as_points, "decimal": decimal}
    cloud, source, sha256 = _read(scan, reading, clock)
    with _about(source):
        with clock.stage("prepare"):
            prepared = recon.prepare(cloud, prepare)
            _refuse_plot(prepared.looks_like_many, prepare)
        with clock.stage("encode"):
            encoding = recon.encode_with_report(prepared.cloud, species=species, settings=encode)
    with clock.stage("measure"):
        measures, table = _measure(encoding.tree, encoding.report, prepared.cloud.xyz)
    return Reconstruction(
        name=name or Path(source).stem or "tree",
        tree=encoding.tree,
        cloud=prepared.cloud,
        measures=measures,
        cylinders=table,
        report=encoding.report,
        notes=tuple(dict.fromkeys((*cloud.notes, *prepared.notes, *encoding.report.notes))),
        seconds=clock.seconds,
        settings={"species": species, **reading, "prepare": asdict(prepare), "encode": asdict(encode)},
        source=source,
        sha256=sha256,
    )


class Clock:
    """Wall-clock seconds of named stages, in the order in which they were first entered."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the stage `name`."""
        start = perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - start


def _read(scan: Any, reading: Mapping[str, Any], clock: Clock) -> tuple[Cloud, str, str]:
    """Read a file, or wrap points; return the cloud, its path and the hash of what came in."""
    import recon

    if isinstance(scan, str | os.PathLike):
        path = os.fspath(scan)
        with clock.stage("read"):
            cloud = recon.read_cloud(path, **reading)
        with clock.stage("hash"):
            digest = _hash_file(path)
        return cloud, path, digest
    with clock.stage("read"):
        cloud = recon.as_cloud(scan)
    with clock.stage("hash"):
        points = np.ascontiguousarray(cloud.xyz + cloud.origin)
        digest = hashlib.sha256(points.tobytes()).hexdigest()
    return cloud, cloud.source, digest


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


def _refuse_plot(n_trees: int, settings: PrepareSettings) -> None:
    if n_trees > 1 and not settings.largest and settings.tree_id is None and settings.base is None:
        raise InputError(
            f"this looks like {n_trees} trees, not one. Take the largest with --largest "
            "(largest=True), or one of them by its foot with --base X,Y,Z."
        )


def _measure(
    tree: ClusterTree, report: EncodeReport, xyz: NDArray[np.float64]
) -> tuple[Measures, NDArray[np.void]]:
    """Return the tree's measures and its cylinder table in the scan's own coordinates."""
    table = cylinder_table(tree.graph)
    measures = measure(
        tree.graph,
        table,
        xyz,
        n_clusters=len(tree.clusters),
        dbh_m=report.dbh_m,
        dbh_method=report.dbh_method,
        dbh_reason=report.dbh_reason,
    )
    return measures, move_cylinders(table, tree.origin)
