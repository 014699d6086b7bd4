r"""What a tree would do elsewhere: its life, its light and its shape, analysed once.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.3 (Eq. 4.1 to 4.12).
Departs from it in: the light of a season is looked at once in every leaf cluster; segments grow in that of
the cluster they set out from, as it was at the end of the season before. A cluster's resources (Eq. 4.11) are
spread evenly over its nodes. Local pruning factors without any resources take no part in psi_ref.
docs/plastic.md has each with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plastic import _plans
from plastic.crowns import TAPER, Crown, grow_crown
from plastic.seasons import Seasons, seasons_of
from plastic.tropism import Tropisms, invert_tropism, lean_of
from treegraph import DEFAULT_ALLOMETRY, NO_PARENT, ClusterTree, InputError, Sky, TreeGraph
from treegraph.light import UNIT_TRANSLUCENCY

if TYPE_CHECKING:
    from plastic.adapted import Adapted
    from plastic.scene import Scene

__all__ = ["AnalysisSettings", "PlasticState", "analyse"]

REFERENCE_PERCENT = 5.0
"""psi_ref is this percentile of all local pruning factors (thesis 4.3.4)."""


def _range(low: float, high: float, default: float) -> Any:
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class AnalysisSettings:
    """How a tree is analysed.

    Attributes
    ----------
    phototropism, gravitropism : float
        Weights of the light's direction and of up, per internode (Eq. 4.6); see :class:`Tropisms`.
    internode : float or None
        l_i, metres; by default from the tree (section 4.3.1).
    unit_translucency : float, default 0.5
        gamma_c0 of Eq. 4.4, per metre of a cluster's radius, 0.01 to 1.
    taper : float, default 3
        Exponent of the ratios of distances in Eq. 4.5, 0 to 6; 1 as printed.
    fewest_seasons, most_seasons : int, default 8 and 24
        Into how many seasons the tree's life is divided, 1 to 100.
    rings : int, default 6
        Fineness of the sky, 4 to 64, as in :func:`treegraph.gather_light`.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    phototropism: float = Tropisms.phototropism
    gravitropism: float = Tropisms.gravitropism
    internode: float | None = None
    unit_translucency: float = _range(0.01, 1.0, UNIT_TRANSLUCENCY)
    taper: float = _range(0.0, 6.0, TAPER)
    fewest_seasons: int = _range(1, 100, 8)
    most_seasons: int = _range(1, 100, 24)
    rings: int = _range(4, 64, 6)

    def __post_init__(self) -> None:
        for name, entry in self.__dataclass_fields__.items():
            about, value = entry.metadata, getattr(self, name)
            if not about:
                continue
            whole = isinstance(entry.default, int)
            if isinstance(value, bool) or not isinstance(value, int | float | np.number):
                raise InputError(f"{name} must be a number, got {value!r}")
            if not about["low"] <= value <= about["high"] or (whole and value != int(value)):
                kind = "a whole number " if whole else ""
                raise InputError(
                    f"{name} must be {kind}from {about['low']} to {about['high']}, got {value!r}"
                )
            object.__setattr__(self, name, int(value) if whole else float(value))
        if self.fewest_seasons > self.most_seasons:
            raise InputError(
                f"fewest_seasons must not be more than most_seasons, got {self.fewest_seasons} and "
                f"{self.most_seasons}"
            )
        if self.internode is not None and not 0.0 < self.internode < math.inf:
            raise InputError(f"internode must be a positive finite number of metres, got {self.internode!r}")
        Tropisms(self.phototropism, self.gravitropism)

    @property
    def tropisms(self) -> Tropisms:
        """The strengths of the tropisms."""
        return Tropisms(self.phototropism, self.gravitropism)


class PackedHulls(NamedTuple):
    """Hulls of k clusters, one after the other, for the kernels.

    vertex (v, 3); those of hull c begin at first[c]; its seats, nodes of the tree, at seat[seat_first[c]].
    """

    vertex: NDArray[np.float64]
    first: NDArray[np.int64]
    seat: NDArray[np.int32]
    seat_first: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PlasticState:
    """A tree that can be put elsewhere; made by :func:`analyse`.

    Attributes
    ----------
    tree : ClusterTree
        As it came in.
    settings : AnalysisSettings
    sky : Sky
        Under which it grew.
    seasons : Seasons
        Ages and growth rates of its segments.
    crown : Crown
        Its leaf clusters in every season.
    has_leaves : bool
        Whether the clusters are its own; else they are virtual.
    light : (s,) float64
        Light at the sites of the crown, 0 to 1, as the tree grew.
    toward : (s, 3) float64
        Its mean direction there, unit vectors; 0 without light.
    rest : (n, 3) float64
        w_s d_o of Eq. 4.8 for each segment; (0, 0, 1) at a root.
    pruning_reference : float
        psi_ref, metres.
    pruning_least : (n,) float64
        min(psi_ref, min over t of psi_s(t)) for each segment, metres; 0 where light never prunes.
    """

    tree: ClusterTree
    settings: AnalysisSettings
    sky: Sky
    seasons: Seasons
    crown: Crown
    has_leaves: bool
    light: NDArray[np.float64]
    toward: NDArray[np.float64]
    rest: NDArray[np.float64]
    pruning_reference: float
    pruning_least: NDArray[np.float64]
    _order: NDArray[np.int32] = field(repr=False)  # node k of the plan is node order[k] of the tree
    _plan: Any = field(repr=False)
    _spare: list[Any] = field(default_factory=list, repr=False)  # scratch of runs that are over

    def __repr__(self) -> str:
        kind = "" if self.has_leaves else "virtual "
        sites = len(self.crown.radius) - int(self.crown.first[1])
        return (
            f"<PlasticState {self.tree.graph.n_nodes} nodes, {self.seasons.count} seasons, "
            f"{sites} {kind}clusters in all of them>"
        )

    @cached_property
    def _hulls(self) -> PackedHulls:
        """Its own clusters in one piece."""
        clusters = self.tree.clusters if self.has_leaves else ()
        sizes = [len(cluster.vertices) for cluster in clusters]
        vertex = [np.empty((0, 3)), *(cluster.vertices for cluster in clusters)]
        crown = self.crown
        seat_first = (
            crown.seat_first[crown.first[-2] : crown.first[-1] + 1] if clusters else np.zeros(1, np.int32)
        )
        return PackedHulls(
            np.concatenate(vertex),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
            crown.seat,
            seat_first.astype(np.int64),
        )

    def adapt(self, scene: Scene) -> Adapted:
        """The tree as it would have grown in a scene, with its foot where it is; the neighbours react too.

        Parameters
        ----------
        scene : Scene
            In the frame of this tree.

        Returns
        -------
        adapted : Adapted
            Its ``neighbours`` are those of the scene, as they react.

        Raises
        ------
        InputError
            If the foot of a tree lies in an obstacle.

        See Also
        --------
        plastic.Session : the same for scenes that change little by little.
        """
        from plastic.stand import adapt_once

        return adapt_once(self, scene)


def analyse(
    tree: ClusterTree | TreeGraph,
    *,
    settings: AnalysisSettings = AnalysisSettings(),
    sky: Sky | None = None,
) -> PlasticState:
    """Analyse a tree that grew in the open, once (thesis 4.3).

    Parameters
    ----------
    tree : ClusterTree or TreeGraph
        Without leaf clusters it gets virtual ones.
    settings : AnalysisSettings
    sky : Sky, optional
        Under which it grew; by default brightest in the zenith.

    Returns
    -------
    state : PlasticState

    Raises
    ------
    InputError
        If `tree` is something else.

    Notes
    -----
    Time grows with the nodes times the seasons, and with the square of the clusters times the seasons.

    Examples
    --------
    >>> z = [[0, 0, 0], [0, 0, 1], [0.5, 0, 2], [-0.5, 0, 2]]
    >>> analyse(TreeGraph([-1, 0, 1, 1], z, [0.1, 0.05, 0.02, 0.02]))
    <PlasticState 4 nodes, 8 seasons, 8 virtual clusters in all of them>
    """
    if isinstance(tree, TreeGraph):
        tree = ClusterTree(tree, (), None, DEFAULT_ALLOMETRY, np.zeros(3))
    if not isinstance(tree, ClusterTree):
        raise InputError(f"tree must be a ClusterTree or a TreeGraph, got {type(tree).__name__}")
    seasons = seasons_of(
        tree.graph,
        internode=settings.internode,
        fewest=settings.fewest_seasons,
        most=settings.most_seasons,
    )
    light = Sky() if sky is None else sky
    return make_state(tree, settings, light, seasons, grow_crown(tree, seasons, taper=settings.taper))


def make_state(
    tree: ClusterTree, settings: AnalysisSettings, sky: Sky, seasons: Seasons, crown: Crown
) -> PlasticState:
    """Light, inverse tropism and pruning factors of a tree whose life is known."""
    from plastic import _plastic_kernels as kernels

    order = np.argsort(seasons.birth, kind="stable").astype(np.int32)
    plan = _empty_plan(tree.graph, settings, seasons, crown, order)
    plan, work = _first_light(plan, settings, sky)
    plan = _take_tropism(plan, settings, seasons.internode)
    least, slack = np.empty(len(order)), np.empty((1, seasons.count))
    reference = float(kernels.least_factors(plan, work, 0, seasons.count, REFERENCE_PERCENT, least, slack[0]))
    least[_on_trunk(tree.graph)[order]] = 0.0
    plan = plan._replace(least=least, slack=slack)
    back = np.empty(len(order), np.int64)
    back[order] = np.arange(len(order))
    return PlasticState(
        tree,
        settings,
        sky,
        seasons,
        crown,
        bool(tree.clusters),
        plan.amount,
        plan.toward,
        plan.rest[back],
        reference,
        least[back],
        order,
        plan,
    )


def _empty_plan(
    graph: TreeGraph,
    settings: AnalysisSettings,
    seasons: Seasons,
    crown: Crown,
    order: NDArray[np.int32],
) -> Any:
    """What the geometry gives; light and what follows from it are still 0."""
    from plastic import _analysis_kernels as analysis

    n, s = len(order), len(crown.radius)
    back = np.empty(n + 1, np.int32)
    back[order] = np.arange(n, dtype=np.int32)
    back[n] = NO_PARENT  # parent -1 reads the last entry
    heading, length = analysis.headings(graph.parent, graph.position)
    n_seats = np.diff(crown.seat_first)
    node_first = np.searchsorted(seasons.birth[order], np.arange(seasons.count + 1)).astype(np.int32)
    site_first = crown.first
    return _plans.Plan(
        node_first=node_first[None],
        site_first=site_first[None],
        parent=back[graph.parent[order]],
        position=np.ascontiguousarray(graph.position[order]),
        heading=heading[order],
        length=length[order],
        rest=np.zeros((n, 3)),
        lean=np.zeros((n, 3)),
        pull=np.zeros(n),
        look=crown.look[order],
        least=np.zeros(n),
        slack=np.zeros((1, seasons.count)),
        center=crown.center,
        radius=crown.radius,
        translucency=settings.unit_translucency**crown.radius,
        gain=2.0 * math.pi * crown.radius**2 / np.maximum(n_seats, 1),
        seat_first=crown.seat_first,
        seat=back[crown.seat],
        amount=np.zeros(s),
        toward=np.zeros((s, 3)),
        passed=np.zeros((0, 0), np.float32),
        around=np.ones(s),
    )


@lru_cache(maxsize=64)
def make_sky(rings: int, sky: Sky) -> Any:
    """The sky's cells as the kernels want them."""
    from treegraph import light

    cells = light._sky_cells(rings)
    weight = light._cell_weight(rings, sky)
    reach = np.array([light.BLUR * cells.width, light.TENT * cells.width])
    area = 2.0 * math.pi / int(cells.per_ring.sum())
    bright = np.array([*sky.brightest, float(weight[0].max()) / area])
    return _plans.Sky(cells.grid, cells.fine, weight, reach, bright)


@lru_cache(maxsize=128)
def single_events(seasons: int) -> Any:
    """One tree: an event for each of its seasons."""

    count = np.arange(seasons, dtype=np.int32)
    return _plans.Events(
        first=np.arange(seasons + 1, dtype=np.int32),
        tree=np.zeros(seasons, np.int32),
        season=count,
        group=(count + 1)[:, None],
        near_first=np.zeros(2, np.int32),
        near=np.empty(0, np.int32),
    )


def no_solids() -> Any:
    """No obstacles."""

    return _plans.Solids(np.empty((0, 7)), np.empty((0, 5)), np.empty((0, 16)), np.empty((0, 4)))


def fresh_work(plan: Any, *, cells: int) -> Any:
    """Trees as they came in; with `cells` > 0 what their clusters let through is kept."""

    n, s, k = len(plan.parent), len(plan.radius), plan.node_first.shape[0]
    seasons = plan.node_first.shape[1] - 1
    rows = s if cells else 0
    known = rows and plan.passed.shape == (rows, cells)
    passed = plan.passed.copy() if known else np.zeros((rows, cells), np.float32)
    return _plans.Work(
        position=plan.position.copy(),
        turn=np.empty((n, 9)),
        turned=np.zeros(n, bool),
        valid=np.ones(n, bool),
        dirty=np.zeros(n, bool),
        death=np.full(n, _plans.ALIVE, np.int32),
        cause=np.zeros(n, np.uint8),
        offset=np.empty((s, 3)),
        center=plan.center.copy(),
        local=plan.center.copy(),
        living=np.diff(plan.seat_first),
        translucency=plan.translucency.copy(),
        changed=np.zeros(s, bool),
        moved=np.zeros(s, bool),
        former=plan.center.copy(),
        earlier=plan.center.copy(),
        amount=plan.amount.copy(),
        shift=np.zeros((s, 3)),
        shifted=np.zeros(s, bool),
        lit=np.zeros(s, bool),
        passed=passed,
        around=plan.around.copy(),
        beyond=np.ones((s if k > 1 else 0, cells), np.float32),
        outside=np.ones(s),
        gathered=np.empty(n),
        carried=np.empty(n),
        affected=np.zeros(k, bool),
        fallen=np.zeros(k, bool),
        news=np.zeros(k, bool),
        bent=np.zeros((k, seasons), bool),
        stirred=np.ones((k, seasons), bool),
        boxed=np.zeros((k, seasons), bool),
        box=np.zeros((k, seasons, 7)),
        buried=np.zeros(k, bool),
        counts=np.zeros(4, np.int64),
    )


def _first_light(plan: Any, settings: AnalysisSettings, sky: Sky) -> tuple[Any, Any]:
    """The temporal light of the tree as it is (thesis 4.3.2)."""
    from plastic import _plastic_kernels as kernels

    cells = make_sky(settings.rings, sky)
    work = fresh_work(plan, cells=len(cells.grid[0]))
    rules = _plans.Rules(1.0, 0.0, False, True, True, True, True)
    seasons = plan.node_first.shape[1] - 1
    kernels.run(plan, work, single_events(seasons), cells, no_solids(), rules, False)
    known = {"amount": work.amount, "toward": work.shift, "passed": work.passed, "around": work.around}
    return plan._replace(**known), work


def _take_tropism(plan: Any, settings: AnalysisSettings, internode: float) -> Any:
    """Inverse tropism (Eq. 4.6 to 4.10) in the light that each segment grew in."""
    toward = np.where(plan.look[:, None] >= 0, plan.toward[np.maximum(plan.look, 0)], 0.0)
    keep, lean = lean_of(settings.tropisms, toward, plan.length, internode)
    pull = settings.tropisms.light_share * (1.0 - keep)
    return plan._replace(rest=invert_tropism(plan.heading, keep, lean), lean=lean, pull=pull)


def _on_trunk(graph: TreeGraph) -> NDArray[np.bool_]:
    """Nodes on the chain that begins at a root: no lack of light prunes a trunk."""
    from treegraph import chains

    first, node = chains(graph)
    trunk = np.zeros(graph.n_nodes, bool)
    roots = graph.parent[node[first[:-1]]] == NO_PARENT
    taken: set[int] = set()
    for c in np.flatnonzero(roots):
        root = int(node[first[c]])
        if root not in taken:  # its first chain; others leave from it
            taken.add(root)
            trunk[node[first[c] : first[c + 1]]] = True
    return trunk


def bounding_ball(points: NDArray[np.float64], reach: Sequence[float] = (0.0,)) -> NDArray[np.float64]:
    """Centre and radius (4,) of a ball around points with some room."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(points - middle, axis=1).max()) + max(reach)
    return np.array([*middle, radius])
