"""From a scan to the cluster representation: the main job.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, sections 3.3 and 3.4 (after Livny et al., "Texture-lobes for tree modelling", 2011).

Departs from it in: what the stages say of themselves; without a species beta is 2.5, and f_s is 1 for
a tree that shows no leaves.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any

import numpy as np

from recon.cloud import Cloud
from recon.clusters import bough_groups, cluster_points, leafy_nodes, make_clusters, median_turn
from recon.dbh import BreastHeight, breast_height, hold_breast_height
from recon.neighbours import NeighbourGraph, bridge_gaps, neighbour_graph, trusted_graph
from recon.ordering import morton_order, thin
from recon.preparing import Prepared, PrepareSettings, prepare
from recon.radii import SMALLEST_RADIUS, carried_points, final_radii, limit_by_load
from recon.skeleton import Skeleton, base_points, merge_nodes, slice_tree
from recon.trimming import drop_spurs, drop_unsupported, fit_budget
from recon.tubes import absorb, coarsen, fit_circles, fit_tubes, polish, reattach
from treegraph.allometry import DEFAULT_ALLOMETRY, Allometry, find_allometry
from treegraph.clustertree import Cluster, ClusterTree
from treegraph.errors import InputError
from treegraph.graph import TreeGraph

TRUSTED_SPACINGS = 2.5  # edges up to this many point spacings are kept unasked
MIN_WOOD_SHARE = 0.03  # of the points that must be labelled wood for the label to be used ...
MIN_WOOD_POINTS = 200  # ... and how many
BARE_SHARE = 0.05  # a skeleton that reaches less far, in extents of the scan, is no tree
GUESSED_HEIGHT = 0.6  # a guessed stem ends at this share of the height
GUESSED_NODES = 6
GUESSED_SLENDERNESS = 80.0  # height over diameter at the foot
GUESSED_NOTE = "no wood stands out: the stem is a guess from the foot to the middle of the crown"
STEM_FLARE = 1.6  # no part of a tree is so much thicker than its stem near the foot ...
THICKEST_MARGIN = 0.03  # ... plus this, metres
STEMLESS_SHARE = 0.03  # radius over extent of the thickest branch where no stem stands out
STEM_ROUNDS = 8  # of smoothing a stem among leaves
STEM_SHARE = 0.4  # of all points: a node that carries so many is on the main stem
SPLIT_MARGIN = 3.0  # of `limit_by_load` where wood is told from leaves: bare boughs carry little
SHRUB_SHARE = 0.008  # ... and it is a leafy shrub, whose foot is no stem
SHRUB_SPREAD = 0.04  # of the height: what is wider near the foot, among leaves, is no stem
ABSORB_ROUNDS = 2
DEFAULT_BETA = 2.5  # of trees of no known species: only gaps feel it, and short ones are best
LEAFLESS_TURN = np.radians(18.0)  # chains that turn less at their median node show no leaves ...
LEAFLESS_LOST = 0.3  # ... if no larger share of the points than this fell out of the skeleton
LEAFLESS_F_S = 1.0


@dataclass(frozen=True)
class EncodeSettings:
    """What decides how a scan is encoded.

    Attributes
    ----------
    beta : float or None
        Exponent of the edge weights |u - v|^beta (thesis 3.3.1), >= 1; the species' if None.
    gamma : float or None
        Exponent of eq. 3.1, > 0; the species' if None.
    f_s : float or None
        Factor of eq. 3.2, 0 < f_s <= 1. 1 means a leafless tree: no clusters, all points show
        wood. If None: 1 for a tree whose chains are smooth (:func:`recon.clusters.median_turn`) and
        hold most points, else the species' value.
    n_neighbours : int
        Neighbours of each point in the graph, 4 to 64.
    max_points : int
        Points that the skeleton looks at; more are thinned to cell means, >= 1000.
    max_nodes : int
        Nodes of the skeleton, at most, >= 16.
    max_clusters : int
        Clusters that the leafy points are divided into, about, >= 1.
    max_faces : int
        Faces of each cluster's hull, at most, >= 12.
    prepare : PrepareSettings
        Units, ground, base, choice of the tree.
    """

    beta: float | None = None
    gamma: float | None = None
    f_s: float | None = None
    n_neighbours: int = 10
    max_points: int = 250_000
    max_nodes: int = 4000
    max_clusters: int = 40
    max_faces: int = 80
    prepare: PrepareSettings = field(default_factory=PrepareSettings)

    def __post_init__(self) -> None:
        for name, low, high in (("beta", 1.0, 10.0), ("gamma", 0.1, 10.0), ("f_s", 0.01, 1.0)):
            if getattr(self, name) is not None:
                _check(name, getattr(self, name), low, high)
        _check_whole("n_neighbours", self.n_neighbours, 4, 64)
        _check_whole("max_points", self.max_points, 1000, 5_000_000)
        _check_whole("max_nodes", self.max_nodes, 16, 1_000_000)
        _check_whole("max_clusters", self.max_clusters, 1, 1000)
        _check_whole("max_faces", self.max_faces, 12, 10_000)
        if not isinstance(self.prepare, PrepareSettings):
            raise InputError(f"prepare must be PrepareSettings, got {self.prepare!r}")


def _check(name: str, value: float, low: float, high: float) -> None:
    if not (isinstance(value, Real) and low <= value <= high):
        raise InputError(f"{name} must be between {low} and {high}, got {value!r}")


def _check_whole(name: str, value: int, low: int, high: int) -> None:
    _check(name, value, low, high)
    if not isinstance(value, Integral):
        raise InputError(f"{name} must be a whole number, got {value!r}")


@dataclass(frozen=True, eq=False)
class EncodeReport:
    """What the encoder saw and did.

    Attributes
    ----------
    dbh_m : float or None
        Diameter at breast height, metres; None with `dbh_reason`.
    dbh_method : str
        "circle" (points of the slice at 1.3 m), "tube" (the fitted trunk there) or "none".
    dbh_reason : str or None
        Why there is no diameter, or why it is not from a circle.
    dbh_arc : float
        Share of the round on which the circle has points.
    seconds : dict of str to float
        Wall time of each stage.
    notes : tuple of str
        One-line remarks for the user.
    n_points_used : int
        Points after preparing and thinning.
    ground_z : float or None
        Height of the ground at the trunk, metres, in the tree's frame.
    f_s : float
        The factor used.
    """

    dbh_m: float | None
    dbh_method: str
    dbh_reason: str | None
    dbh_arc: float
    seconds: dict[str, float]
    notes: tuple[str, ...]
    n_points_used: int
    ground_z: float | None
    f_s: float


@dataclass(frozen=True, eq=False)
class Encoding:
    """A tree and how it came about.

    Attributes
    ----------
    tree : ClusterTree
    report : EncodeReport
    cloud : Cloud
        The tree's own points, all of them, in the tree's frame.
    """

    tree: ClusterTree
    report: EncodeReport
    cloud: Cloud


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin


def encode(
    points: Any,
    *,
    species: str | None = None,
    allometry: Allometry | None = None,
    settings: EncodeSettings | None = None,
) -> ClusterTree:
    """Encode a scan of one tree.

    Parameters
    ----------
    points : Cloud or (n, 3) array_like
        Metres, z up, any order; in the world's coordinates.
    species : str, optional
        Its name, which is kept with the tree.
    allometry : Allometry, optional
        The species' parameters. By default those of thesis table 3.1 for the name, or without one
        those of no species.
    settings : EncodeSettings, optional

    Returns
    -------
    ClusterTree
        With its trunk base at the origin; ``origin`` is where that is in the world. Per node
        "measured" (bool: a circle across the branch stands behind the radius), "n_points" (int32)
        and "arc" (float32: share of the round with points).

    Raises
    ------
    InputError
        If the points are no single tree, or a setting is out of range.

    Notes
    -----
    About 3 times the time of a 16-nearest-neighbours search on the same points; see `benchmarks`.
    """
    return encode_with_report(points, species=species, allometry=allometry, settings=settings).tree


def encode_with_report(
    points: Any,
    *,
    species: str | None = None,
    allometry: Allometry | None = None,
    settings: EncodeSettings | None = None,
) -> Encoding:
    """As :func:`encode`, with measures, times and remarks."""
    return Encoder(points, settings).encode(species=species, allometry=allometry)


class Encoder:
    """A scan that is looked at once and encoded with the parameters of one species after another.

    Parameters
    ----------
    points : Cloud or (n, 3) array_like
        As of :func:`encode`.
    settings : EncodeSettings, optional

    Raises
    ------
    InputError
        If the points are no single tree.

    Notes
    -----
    What depends on the scan alone is made once, and so is the skeleton of two values of beta that lead over
    the same gaps. What is returned is, bit for bit, what :func:`encode_with_report` returns.
    """

    def __init__(self, points: Any, settings: EncodeSettings | None = None) -> None:
        self.settings = settings or EncodeSettings()
        self._clock = _Clock()
        with self._clock("prepare"):
            self._prepared = prepare(points, self.settings.prepare)
            _refuse_many(self._prepared, self.settings)
            self._xyz, self._n_wood = _points_to_encode(self._prepared.cloud, self.settings)
        self._graph: NeighbourGraph | None = None
        self._skeletons: list[tuple[NeighbourGraph, Skeleton]] = []

    def encode(self, *, species: str | None = None, allometry: Allometry | None = None) -> Encoding:
        """The tree of a species, or of none; the report's times are of what had not been made before."""
        if allometry is None:
            unknown = replace(DEFAULT_ALLOMETRY, beta=DEFAULT_BETA)
            allometry = unknown if species is None else find_allometry(species)
        beta = self.settings.beta or allometry.beta
        clock, self._clock = self._clock, _Clock()
        with clock("skeleton"):
            skeleton = self._skeleton(beta)
        used = replace(allometry, beta=beta, gamma=self.settings.gamma or allometry.gamma)
        return _encoding(self._prepared, self._xyz, skeleton, self.settings, species, used, clock)

    def _skeleton(self, beta: float) -> Skeleton:
        wood, foot = self._xyz[: self._n_wood], np.zeros(3)
        if self._graph is None:
            self._graph = joined_graph(wood, self.settings.n_neighbours)
        trusted, sources = shown_graph(wood, foot, self._graph, beta)
        for known, skeleton in self._skeletons:
            if np.array_equal(known.start, trusted.start) and np.array_equal(
                known.neighbour, trusted.neighbour
            ):
                return skeleton
        skeleton = grow_skeleton(wood, trusted, sources, _thickest(self._prepared, self._xyz))
        self._skeletons.append((trusted, skeleton))
        return skeleton


def _encoding(
    prepared: Prepared,
    xyz: np.ndarray,
    skeleton: Skeleton,
    settings: EncodeSettings,
    species: str | None,
    allometry: Allometry,
    clock: _Clock,
) -> Encoding:
    """From the skeleton of the first points, those that may be wood, to the tree."""
    beta, gamma = allometry.beta, allometry.gamma
    n_wood = skeleton.label.size
    with clock("clusters"):
        if n_wood < len(xyz):
            skeleton, f_s, group = _hang_leaves(xyz, skeleton, settings, allometry.f_s)
        else:
            skeleton, f_s, group = _split_off_leaves(xyz, skeleton, gamma, settings, allometry.f_s)
        has_stem = prepared.stem_spread is not None
        if f_s < LEAFLESS_F_S and _is_shrub(xyz, prepared):
            skeleton, has_stem = _thin_shrub(xyz, skeleton), False
        guessed = _is_bare_foot(xyz, skeleton) and f_s < LEAFLESS_F_S
        if guessed:
            skeleton = guessed_stem(xyz, skeleton)
    with clock("radii"):
        skeleton = skeleton if guessed else polish(xyz, fit_budget(xyz, skeleton, gamma, settings.max_nodes))
        radius, measured = final_radii(skeleton, gamma)
        if f_s < LEAFLESS_F_S and not guessed:
            limited = limit_by_load(skeleton, radius)
            radius, measured = limited, measured & (limited >= radius)
        skeleton = replace(skeleton, radius=radius)
        dbh = breast_height(xyz, skeleton, measured, has_stem)
        radius = hold_breast_height(skeleton, radius, dbh)
    with clock("hulls"):
        clusters: tuple[Cluster, ...] = ()
        if f_s < LEAFLESS_F_S:
            groups = cluster_points(xyz, skeleton, group, settings.max_clusters)
            clusters = make_clusters(xyz, groups, settings.max_faces)
    graph = TreeGraph(
        skeleton.parent,
        skeleton.position,
        radius,
        {
            "measured": measured,
            "n_points": skeleton.n_points.astype(np.int32),
            "arc": skeleton.arc.astype(np.float32),
        },
    )
    used = Allometry(beta=beta, gamma=gamma, f_s=f_s, d_root=float(2 * radius[0]))
    cloud = prepared.cloud
    tree = ClusterTree(graph, clusters, species, used, cloud.origin, cloud.epsg)
    report = _report(dbh, clock, prepared, xyz, f_s)
    if guessed:
        report = replace(report, notes=(*report.notes, GUESSED_NOTE))
    return Encoding(tree, report, cloud)


def _is_shrub(xyz: np.ndarray, prepared: Prepared) -> bool:
    """Whether what stands at the foot is too wide for a stem, so that it is leaves and twigs."""
    spread = prepared.stem_spread
    return spread is not None and spread > SHRUB_SPREAD * float(np.ptp(xyz[:, 2]))


def _thin_shrub(xyz: np.ndarray, skeleton: Skeleton) -> Skeleton:
    """Narrower limits for the wood of a leafy shrub."""
    size = float(np.linalg.norm(np.ptp(xyz, axis=0)))
    thickest = min(skeleton.thickest, max(SHRUB_SHARE * size, THICKEST_MARGIN))
    return replace(skeleton, thickest=thickest, radius=np.minimum(skeleton.radius, thickest))


def _is_bare_foot(xyz: np.ndarray, skeleton: Skeleton) -> bool:
    """Whether hardly anything is left of a skeleton without its leafy nodes."""
    reach = float(np.linalg.norm(skeleton.position - skeleton.position[0], axis=1).max())
    return reach < BARE_SHARE * float(np.linalg.norm(np.ptp(xyz, axis=0)))


def guessed_stem(xyz: np.ndarray, skeleton: Skeleton) -> Skeleton:
    """A straight stem from the foot to the middle of the crown, for scans that hardly hit any wood.

    Its diameter at the foot is the height over 80; no node of it counts as measured and all points
    are left to the clusters.

    Parameters
    ----------
    xyz : (n, 3) float64
    skeleton : Skeleton
        What is left of the skeleton; only its widths are used.

    Returns
    -------
    Skeleton
    """
    from scipy.spatial import cKDTree

    low, high = np.quantile(xyz[:, 2], [0.002, 0.998])
    upper = xyz[xyz[:, 2] >= 0.5 * (low + high), :2]
    end = np.array([*np.median(upper, axis=0), low + GUESSED_HEIGHT * (high - low)])
    foot = np.array([0.0, 0.0, min(0.0, float(end[2]))])
    n = GUESSED_NODES
    position = foot + np.linspace(0, 1, n)[:, None] * (end - foot)
    radius = np.full(n, max(0.5 * float(high - low) / GUESSED_SLENDERNESS, SMALLEST_RADIUS))
    return replace(
        skeleton,
        parent=np.arange(-1, n - 1, dtype=np.int32),
        position=position,
        radius=radius,
        label=np.full(len(xyz), -1, np.int32),
        home=cKDTree(position).query(xyz)[1].astype(np.int32),
        is_tube=np.zeros(n, bool),
        arc=np.zeros(n),
    )


def _points_to_encode(cloud: Cloud, settings: EncodeSettings) -> tuple[np.ndarray, int]:
    """Points in Z-order, thinned; and how many, the first ones, may be wood.

    Where the scan labels wood and leaves, and leaves are wanted, the wood comes first.
    """
    wood = np.ones(len(cloud.xyz), bool) if cloud.is_wood is None else cloud.is_wood
    labelled = MIN_WOOD_SHARE < wood.mean() < 1.0 and wood.sum() >= MIN_WOOD_POINTS
    if not labelled or (settings.f_s is not None and settings.f_s >= LEAFLESS_F_S):
        order, code, _ = morton_order(cloud.xyz)
        xyz, _ = thin(cloud.xyz[order], code, settings.max_points)
        return xyz, len(xyz)
    parts = []
    for mine in (wood, ~wood):
        part = cloud.xyz[mine]
        order, code, _ = morton_order(part)
        parts.append(thin(part[order], code, settings.max_points // 2)[0])
    return np.concatenate(parts), len(parts[0])


def _hang_leaves(
    xyz: np.ndarray, skeleton: Skeleton, settings: EncodeSettings, species_f_s: float
) -> tuple[Skeleton, float, np.ndarray]:
    """The skeleton of the labelled wood with the leaf points behind it hung on their nearest nodes."""
    from scipy.spatial import cKDTree

    n_wood = skeleton.label.size
    _, nearest = cKDTree(skeleton.position).query(xyz[n_wood:])
    whole = replace(
        skeleton,
        label=np.concatenate([skeleton.label, np.full(len(nearest), -1, np.int32)]),
        home=np.concatenate([skeleton.home, nearest.astype(np.int32)]),
    )
    group = bough_groups(whole, np.zeros(whole.n_nodes, bool), settings.max_clusters)
    return whole, species_f_s if settings.f_s is None else settings.f_s, group


def _report(
    dbh: BreastHeight, clock: _Clock, prepared: Prepared, xyz: np.ndarray, f_s: float
) -> EncodeReport:
    return EncodeReport(
        dbh.diameter,
        dbh.method,
        dbh.reason,
        dbh.arc,
        clock.seconds,
        prepared.notes,
        len(xyz),
        prepared.ground_z,
        f_s,
    )


def _refuse_many(prepared: Prepared, settings: EncodeSettings) -> None:
    chosen = (
        settings.prepare.largest or settings.prepare.tree_id is not None or settings.prepare.base is not None
    )
    if prepared.looks_like_many > 1 and not chosen:
        raise InputError(
            f"this looks like {prepared.looks_like_many} trees, not one: pass largest=True (--largest) to "
            "take the largest, give the base of one (--base), or split the scan first"
        )


def _thickest(prepared: Prepared, xyz: np.ndarray) -> float:
    """Radius that no part of the tree exceeds, metres: foliage is not to be taken for a trunk."""
    size = float(np.linalg.norm(np.ptp(xyz, axis=0)))
    if prepared.stem_spread is None:
        return max(STEMLESS_SHARE * size, THICKEST_MARGIN)
    return STEM_FLARE * prepared.stem_spread + THICKEST_MARGIN


def build_skeleton(
    xyz: np.ndarray,
    base: np.ndarray,
    *,
    beta: float,
    n_neighbours: int = 10,
    thickest: float = np.inf,
) -> Skeleton:
    """A fine skeleton with fitted tubes from the points of one tree.

    Parameters
    ----------
    xyz : (n, 3) float64
        Points, metres, in :func:`recon.ordering.morton_order`.
    base : (3,) float64
        Foot of the trunk, metres.
    beta : float
        Exponent of the edge weights |u - v|^beta (thesis 3.3.1), >= 1.
    n_neighbours : int
        Nearest neighbours that a point is connected with.
    thickest : float
        No branch has a larger radius than this, metres.

    Returns
    -------
    Skeleton
    """
    trusted, sources = shown_graph(xyz, base, joined_graph(xyz, n_neighbours), beta)
    return grow_skeleton(xyz, trusted, sources, thickest)


def joined_graph(xyz: np.ndarray, n_neighbours: int) -> NeighbourGraph:
    """All points (n, 3), metres, connected with their neighbours and over gaps."""
    return bridge_gaps(xyz, neighbour_graph(xyz, n_neighbours))


def shown_graph(
    xyz: np.ndarray, base: np.ndarray, graph: NeighbourGraph, beta: float
) -> tuple[NeighbourGraph, np.ndarray]:
    """The links that shortest paths under |u - v|^beta use, and the points at the foot they start from."""
    sources = base_points(xyz, base, graph.spacing)
    return trusted_graph(graph, sources, beta, reach=TRUSTED_SPACINGS * graph.spacing), sources


def grow_skeleton(xyz: np.ndarray, trusted: NeighbourGraph, sources: np.ndarray, thickest: float) -> Skeleton:
    """The skeleton along a graph, from its sources on, with fitted tubes."""
    skeleton = replace(slice_tree(xyz, trusted, sources), thickest=thickest)
    for _ in range(ABSORB_ROUNDS):
        tube, centre, _, extent = fit_circles(xyz, skeleton)
        skeleton = absorb(skeleton, tube, centre, extent)
    tube, _, _, _ = fit_circles(xyz, skeleton)
    skeleton = fit_tubes(xyz, coarsen(skeleton, tube))
    skeleton = drop_spurs(xyz, drop_unsupported(skeleton))
    return reattach(fit_tubes(xyz, skeleton))


def _main_stem(skeleton: Skeleton) -> np.ndarray:
    """The nodes (n,) bool that a large part of all points hang beyond: wood must be there, seen or not."""
    carried = carried_points(skeleton)
    stem = carried >= STEM_SHARE * carried[0]
    stem[0] = True
    return stem


def _hidden_stem(xyz: np.ndarray, skeleton: Skeleton, node: np.ndarray) -> Skeleton:
    """The skeleton with some nodes (n,) bool, a stem among leaves, in the middle of these, not of tubes.

    Their points hang on them as leaves do and shape nothing any more.
    """
    theirs = (skeleton.label >= 0) & node[skeleton.label]
    label = np.where(theirs, -1, skeleton.label).astype(np.int32)
    home = skeleton.label[theirs]
    count = np.bincount(home, minlength=skeleton.n_nodes)
    total = np.stack([np.bincount(home, x, skeleton.n_nodes) for x in xyz[: theirs.size][theirs].T], axis=1)
    position, parent = skeleton.position.copy(), skeleton.parent
    mine = np.flatnonzero(node & (parent >= 0))
    for i in mine:  # those without points go on from the one before
        position[i] = total[i] / count[i] if count[i] else position[parent[i]]
    after = np.full(skeleton.n_nodes, -1)
    after[parent[mine]] = mine
    for _ in range(STEM_ROUNDS):
        for i in mine[after[mine] >= 0]:
            position[i] = 0.5 * position[i] + 0.25 * (position[parent[i]] + position[after[i]])
    return replace(skeleton, position=position, label=label, is_tube=skeleton.is_tube & ~node)


def _split_off_leaves(
    xyz: np.ndarray, skeleton: Skeleton, gamma: float, settings: EncodeSettings, species_f_s: float
) -> tuple[Skeleton, float, np.ndarray]:
    """The main branches only, where the tree has leaves; the f_s used; the bough of each point."""
    no_group = np.zeros(0, np.int64)
    if settings.f_s is None:
        is_bare = median_turn(skeleton) < LEAFLESS_TURN and (skeleton.label < 0).mean() < LEAFLESS_LOST
        factor = LEAFLESS_F_S if is_bare else species_f_s
    else:
        factor = settings.f_s
    if factor >= LEAFLESS_F_S:
        return skeleton, LEAFLESS_F_S, no_group
    radius, _ = final_radii(skeleton, gamma, leafy=True)
    skeleton = replace(skeleton, radius=limit_by_load(skeleton, radius, margin=SPLIT_MARGIN))
    leafy, stem = leafy_nodes(xyz, skeleton, factor), _main_stem(skeleton)
    low = leafy & ~stem
    skeleton = _hidden_stem(xyz, skeleton, leafy & stem)
    group = bough_groups(skeleton, low, settings.max_clusters)
    into = np.arange(skeleton.n_nodes)
    into[low] = skeleton.parent[low]
    return merge_nodes(skeleton, into, lose=True), factor, group
