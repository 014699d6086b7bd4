r"""A tree that grows from 24 numbers: the developmental model of Stava et al., alone or in company.

Based on: O. Stava, S. Pirk, J. Kratt, B. Chen, R. Mech, O. Deussen, B. Benes, "Inverse Procedural Modeling
of Trees", Computer Graphics Forum 33(6), 2014, section 4 (Eq. 1 to 3) and appendix A; S. Pirk, "Efficient
Processing of Plant Life in Computer Graphics", dissertation, University of Konstanz, 2013, section 4.3.2
(light) and Eq. 5.6 (exponent of the pipe model).
Departs from it in, or reads it as (docs/growth.md has each with its reason):

- the age factors carry the age as exponent, the distance factor of Eq. 3 the way along the branch in metres;
- the level in Eq. 1 is that of the branch that bears the bud; the number of internodes is rounded to nearest;
- the bending angle of appendix A saturates with the load instead of falling with it;
- light comes from ``treegraph.light``, with leaves gathered into clusters that grow with the crown;
- shedding compares the light on a branch's leaves with its number of internodes; the unit of PF is ours;
- the pipe model counts the leaves of every internode that ever grew, so that no radius ever shrinks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from species.parameters import GrowthParameters, check_age, parameter_table
from treegraph import InputError, TreeGraph
from treegraph.obstacles import stands_inside

if TYPE_CHECKING:
    from treegraph.light import Occluders, Sky

__all__ = [
    "GROWN",
    "NODE_LIMIT",
    "GrowthSettings",
    "GrownTree",
    "History",
    "Plant",
    "Site",
    "grow",
    "grow_many",
    "grow_stand",
]

GROWN = "grown"
NODE_LIMIT = "node limit"
"""What :attr:`GrownTree.status` can be."""

FIRST_ROOM = 512  # nodes for which there is room at first
HISTORY_ROOM = 16  # dead and living nodes of a kept history, as a multiple of max_nodes
MOST_CLUSTERS = 1024
GRID_SHIFT = 0.3  # of a cell, from the grid's corner to the first foot: no upright trunk along a cell's edge
ANGLES = {"BAM": 1, "RAM": 1, "AAV": 2, "BAV": 2, "RAV": 2}  # 1: an angle, 2: a variance


def _range(low: float, high: float, unit: str, default: float) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


@dataclass(frozen=True)
class GrowthSettings:
    """What the model needs beside the 24 parameters; the paper gives no values.

    Attributes
    ----------
    foliage : float, default 0.8
        Leaf area of a leafy internode as a multiple of its length times IBL, m2/m2, 0 to 20.
    leaf_cycles : int, default 2
        Cycles for which an internode bears leaves, 1 to 20; tips with a living bud always do.
    tip_share : float, default 0.01
        Radius of a tip as a share of the internode length IBL, 0.0005 to 0.2.
    pipe_exponent : float, default 2.49
        Exponent of the pipe model, 1.5 to 4 (thesis, Eq. 5.6).
    wood_density, leaf_density : float, default 800 and 0.25
        Fresh wood in kg/m3, 1 to 2000, and leaves in kg/m2, 0 to 10: the loads that bend.
    shed_unit : float, default 0.1
        A branch falls whose light per internode is below this times PF, 0 to 10.
    bend_unit : float, default 0.01
        Radians by which a load of 1 kg m bends at GBS = 1, before saturation; 0 to 10.
    max_clusters : int, default 192
        Most leaf clusters per tree in the light model, 8 to 1024.
    max_nodes : int, default 1000000
        Most nodes of all trees together, 2 to 20000000; growth stops before a cycle that would pass it. With
        a history, which keeps the dead, also where about 16 times as many have ever grown.
    rings : int, default 6
        Fineness of the sky, 4 to 64, as in :func:`treegraph.gather_light`.
    ground : bool, default True
        Whether nothing grows or bends below the height of the plant's base.

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    foliage: float = _range(0, 20, "m2/m2", 0.8)
    leaf_cycles: int = _range(1, 20, "cycles", 2)
    tip_share: float = _range(0.0005, 0.2, "of IBL", 0.01)
    pipe_exponent: float = _range(1.5, 4, "", 2.49)
    wood_density: float = _range(1, 2000, "kg/m3", 800.0)
    leaf_density: float = _range(0, 10, "kg/m2", 0.25)
    shed_unit: float = _range(0, 10, "", 0.1)
    bend_unit: float = _range(0, 10, "rad/(kg m)", 0.01)
    max_clusters: int = _range(8, MOST_CLUSTERS, "clusters", 192)
    max_nodes: int = _range(2, 20_000_000, "nodes", 1_000_000)
    rings: int = _range(4, 64, "rings", 6)
    ground: bool = True

    def __post_init__(self) -> None:
        for name, entry in self.__dataclass_fields__.items():
            about = entry.metadata
            if not about:
                continue
            value = getattr(self, name)
            whole = isinstance(entry.default, int)
            if isinstance(value, bool) or not isinstance(value, int | float | np.number):
                raise InputError(f"{name} must be a number, got {value!r}")
            if not about["low"] <= value <= about["high"] or (whole and value != int(value)):
                kind = "a whole number " if whole else ""
                raise InputError(
                    f"{name} must be {kind}from {about['low']} to {about['high']} {about['unit']}".rstrip()
                    + f", got {value!r}"
                )
            object.__setattr__(self, name, int(value) if whole else float(value))


@dataclass(frozen=True, eq=False)
class Site:
    """Where trees grow: the sky, and what stands there and does not grow.

    Attributes
    ----------
    sky : Sky, optional
        Default: brightest in the zenith.
    occluders : Occluders, optional
        Obstacles shade, and nothing grows into them; leaves and branches of standing trees only shade.
    """

    sky: Sky | None = None
    occluders: Occluders | None = None


@dataclass(frozen=True, eq=False)
class Plant:
    """One of several trees that grow together.

    Attributes
    ----------
    parameters : GrowthParameters
    position : (float, float, float)
        Foot of the trunk, metres.
    planted : int
        Year in which it begins to grow, counted from the beginning of the stand; 0 or more.
    """

    parameters: GrowthParameters
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    planted: int = 0

    def __post_init__(self) -> None:
        place = tuple(float(x) for x in self.position)
        if len(place) != 3 or not all(map(math.isfinite, place)):
            raise InputError(f"position must be three finite numbers in metres, got {self.position!r}")
        object.__setattr__(self, "position", place)
        object.__setattr__(self, "planted", check_age(self.planted))


@dataclass(frozen=True, eq=False)
class GrownTree:
    """A tree as it came out of the growth model.

    Attributes
    ----------
    tree : TreeGraph
        Its node 0 is the foot of the trunk; segment i is an internode. Attributes of the nodes: ``birth``
        (int32, the year of growth, from 0), ``order`` (int32, level of the branch, 0 on the trunk),
        ``bud`` (uint8, the apical bud: 0 it grew on, 1 living, 2 dead), ``lateral_buds`` (uint8,
        how many live), ``mass`` (float64, kg, of the segment and all it carries), ``light`` (float64, 0 to 1,
        in the last cycle), ``leaf_area`` (float64, m2 on the segment).
    parameters : GrowthParameters
    age : int
        Cycles it has grown for.
    status : str
        ``"grown"``, or ``"node limit"`` if growth was stopped before it reached the age asked for.
    history : History or None
        Its earlier years, if they were to be kept.
    """

    tree: TreeGraph
    parameters: GrowthParameters
    age: int
    status: str
    history: History | None = None

    @property
    def height(self) -> float:
        """Height of the highest node above the foot, metres."""
        z = self.tree.position[:, 2]
        return float(z.max() - z[0])

    def __repr__(self) -> str:
        state = "" if self.status == GROWN else f", stopped: {self.status}"
        return f"<GrownTree {self.age} cycles, {self.tree.n_nodes} nodes, {self.height:.1f} m high{state}>"


class History:
    """The whole life of a tree: every node that ever grew, once, with the years of its birth and death.

    The tree of a year is found by repeating the mechanical part of growth (radii, bending) up to it, which
    gives the same tree, to the bit, as growing it only that far.
    """

    def __init__(self, nodes: Any, n: int, stand: Any, years: int, plant: int) -> None:
        self._nodes, self._n, self._stand = nodes, n, stand
        self.years = years
        self._plant = plant

    @property
    def n_nodes(self) -> int:
        """Number of nodes that ever grew, of all trees of the stand."""
        return self._n

    def at(self, year: int) -> TreeGraph:
        """The tree after so many cycles, 0 to :attr:`years`; its attributes are ``birth`` and ``order``.

        Raises
        ------
        InputError
            If there is no such year.
        """
        if not 0 <= year <= self.years:
            raise InputError(f"year must be from 0 to {self.years}, got {year!r}")
        *_, tree = self._trees(year)
        return tree

    def trees(self) -> Iterator[TreeGraph]:
        """The tree after each cycle, from the seed (year 0) to the last; one pass."""
        return self._trees(self.years)

    def _trees(self, years: int) -> Iterator[TreeGraph]:
        from species import _growth_kernels as kernels

        nodes = kernels.Nodes(*(array[: self._n].copy() for array in self._nodes))
        death = nodes.death.copy()
        nodes.spent[:] = 0.0
        nodes.bend[:] = 0.0
        nodes.radius[:] = nodes.pipe[:] = 0.0
        roots = nodes.parent < 0
        _start_roots(nodes, roots, self._stand)
        yield _graph(nodes, np.flatnonzero(roots & (nodes.plant == self._plant)))
        for year in range(years):
            alive = kernels.replay_year(nodes, self._n, self._stand, death, year)
            yield _graph(nodes, np.flatnonzero(alive & (nodes.plant == self._plant)))


def grow(
    parameters: GrowthParameters,
    age: int,
    *,
    rng: np.random.Generator,
    site: Site = Site(),
    settings: GrowthSettings = GrowthSettings(),
    history: bool = False,
) -> GrownTree:
    r"""Grow one tree.

    In each cycle buds die by chance; the living ones flush with probability :math:`I^{LF_A}` (apical, Eq. 2
    of [1]_) or :math:`I^{LF_L} \exp(-\sum_j \delta_j AD_{BF} AD_{AF}^t AD_{DF}^{d_j})` (lateral, Eq. 3); a
    shoot has :math:`GR / AC^{\zeta}` or :math:`GR / AC^{\zeta - \zeta_{max}}` internodes, rounded (Eq. 1),
    which lean towards light and away from gravity; shaded and low branches fall; radii follow the pipe model;
    branches bend under what they carry (appendix A).

    Parameters
    ----------
    parameters : GrowthParameters
    age : int
        Growth cycles, 0 to 200. At 0 the tree is one node.
    rng : numpy.random.Generator
        One number is drawn from it. Everything random follows from that number and from each bud's place in
        the tree, so that trees of one seed in different surroundings are the same tree.
    site : Site
        Sky, obstacles, standing trees.
    settings : GrowthSettings
    history : bool
        Whether to keep every year.

    Returns
    -------
    grown : GrownTree
        Its foot is at the origin. Every radius is positive.

    Raises
    ------
    InputError
        If an argument is out of its range, or the foot of the tree lies in an obstacle.

    Notes
    -----
    Time is about linear in the nodes of all years; docs/growth.md has the figures. Same input, same
    seed, same bytes.

    References
    ----------
    .. [1] O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014.

    Examples
    --------
    >>> from species import find_preset
    >>> kind = find_preset("F6b")
    >>> tree = grow(kind.parameters, 10, rng=np.random.default_rng(3)).tree
    >>> int(tree.attribute["birth"].max())
    9
    """
    return grow_stand([Plant(parameters)], age, rng=rng, site=site, settings=settings, history=history)[0]


def grow_stand(
    plants: Sequence[Plant],
    years: int,
    *,
    rng: np.random.Generator,
    site: Site = Site(),
    settings: GrowthSettings = GrowthSettings(),
    history: bool = False,
) -> list[GrownTree]:
    """Grow several trees together, which take each other's light.

    Parameters
    ----------
    plants : sequence of Plant
        At least one.
    years : int
        Growth cycles of the stand, 0 to 200; a plant that is planted in year k grows for ``years - k``.
    rng, site, settings, history
        As in :func:`grow`; `max_nodes` is for all together.

    Returns
    -------
    grown : list of GrownTree
        In the order of the plants, each at its position.

    Raises
    ------
    InputError
        As :func:`grow`.
    """
    from species import _growth_kernels as kernels

    plants, years = list(plants), check_age(years)
    if not plants:
        raise InputError("plants must have at least one plant")
    stand, meshes = _make_stand(plants, site, settings, history)
    _check_feet(plants, site)
    seed = int(rng.integers(2**63))
    n_buds = 1 + max(plant.parameters.n_lateral_buds for plant in plants)
    nodes = _seedlings(plants, n_buds, seed, stand, history)
    nodes, n, year, status = _run(nodes, len(plants), stand, meshes, settings, years)
    state = NODE_LIMIT if status == kernels.NODE_LIMIT else GROWN
    alive = nodes.death[:n] == kernels.ALIVE
    tip = np.empty(n, bool)
    kernels.mark_tips(nodes, n, tip)
    out = []
    for k, plant in enumerate(plants):
        kept = np.flatnonzero(alive & (nodes.plant[:n] == k))
        past = History(nodes, n, stand, year, k) if history else None
        more = _attributes(nodes, kept, tip, stand, year, settings)
        out.append(
            GrownTree(
                _graph(nodes, kept, **more), plant.parameters, max(0, year - plant.planted), state, past
            )
        )
    return out


def grow_many(
    jobs: Sequence[tuple[GrowthParameters, int]],
    *,
    seed: int,
    workers: int | None = None,
    site: Site = Site(),
    settings: GrowthSettings = GrowthSettings(),
) -> list[GrownTree]:
    """Grow many trees, each alone, side by side.

    Parameters
    ----------
    jobs : sequence of (GrowthParameters, age)
    seed : int
        Tree k grows with the k-th generator spawned from it.
    workers : int, optional
        Threads, 1 or more; by default one per core. The result does not depend on it.
    site, settings
        As in :func:`grow`.

    Returns
    -------
    grown : list of GrownTree
        In the order of the jobs.

    Raises
    ------
    InputError
        As :func:`grow`; the message begins with the number of the job.
    """
    import os
    from concurrent.futures import ThreadPoolExecutor

    jobs = list(jobs)
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers!r}")
    seeds = np.random.SeedSequence(seed).spawn(len(jobs))

    def work(k: int) -> GrownTree:
        parameters, age = jobs[k]
        try:
            return grow(parameters, age, rng=np.random.default_rng(seeds[k]), site=site, settings=settings)
        except InputError as error:
            raise InputError(f"job {k}: {error}") from None

    with ThreadPoolExecutor(workers) as pool:  # the kernels let go of the interpreter's lock
        return list(pool.map(work, range(len(jobs))))


def _run(nodes: Any, n: int, stand: Any, meshes: list[Any], settings: GrowthSettings, years: int) -> Any:
    """Grow up to `years`, with more room when it is needed."""
    from species import _growth_kernels as kernels

    year, status = 0, kernels.GROWN
    size = _first_cell(stand.parameter)
    run = _run_among_meshes if meshes else _run_compiled
    while year < years:
        n, year, size, status = run(nodes, n, stand, meshes, size, year, years)
        if status != kernels.FULL:
            break
        room = len(nodes.parent) * 2
        if room > HISTORY_ROOM * settings.max_nodes + FIRST_ROOM:
            status = kernels.NODE_LIMIT
            break
        nodes = kernels.Nodes(*(_more_room(array, n, room) for array in nodes))
    return nodes, n, year, status


def _first_cell(parameter: NDArray[np.float64]) -> float:
    """Edge of a leaf cluster's cell at first, metres."""
    from species import _growth_kernels as kernels

    return kernels.CELLS_PER_INTERNODE * float(parameter[:, kernels.IBL].max())


def _run_compiled(
    nodes: Any, n: int, stand: Any, meshes: list[Any], size: float, first: int, last: int
) -> tuple[int, int, float, int]:
    from species import _growth_kernels as kernels

    return kernels.run(nodes, n, stand, size, first, last)


def _run_among_meshes(
    nodes: Any, n: int, stand: Any, meshes: list[Any], size: float, first: int, last: int
) -> tuple[int, int, float, int]:
    """The same cycle by cycle: rays against meshes cannot be compiled."""
    from species import _growth_kernels as kernels
    from treegraph.light import _seen_past

    count = np.zeros((len(nodes.parent), nodes.buds.shape[1]), np.int32)
    for year in range(first, last):
        buds, light = nodes.buds[:n].copy(), nodes.light[:n].copy()
        kernels.kill_buds(nodes, n, stand, year)
        probes, area_of = kernels.find_probes(nodes, n, stand, size, year)
        size = probes.size
        amount, vector = np.empty(len(probes.point)), np.empty((len(probes.point), 3))
        kernels.look(probes, stand, _seen_past(meshes, probes.point, stand.fine), amount, vector)
        n, status = kernels.grow_cycle(nodes, n, stand, year, count, probes, area_of, amount, vector)
        if status != kernels.GROWN:
            nodes.buds[:n], nodes.light[:n] = buds, light
            return n, year, size, status
        _cut_at_meshes(nodes, n, meshes, 2 * year + kernels.EARLY)
        n = kernels.finish_cycle(nodes, n, stand, year)
        _cut_at_meshes(nodes, n, meshes, 2 * year + kernels.LATE)
    return n, last, size, kernels.GROWN


def _cut_at_meshes(nodes: Any, n: int, meshes: list[Any], stamp: int) -> None:
    """Let fall what leads through a surface."""
    from species import _growth_kernels as kernels

    fallen = np.zeros(n, bool)
    living = np.flatnonzero((nodes.death[:n] == kernels.ALIVE) & (nodes.parent[:n] >= 0))
    start, end = nodes.position[nodes.parent[living]], nodes.position[living]
    for mesh in meshes:
        fallen[living] |= mesh.crosses(start, end)
    if fallen.any():
        if stamp % 2 == kernels.EARLY:  # shoots stop before it
            nodes.buds[nodes.parent[:n][fallen], nodes.bud_of[:n][fallen]] = kernels.DEAD
        kernels.let_fall(nodes, n, fallen, stamp)


def _make_stand(
    plants: list[Plant], site: Site, settings: GrowthSettings, history: bool
) -> tuple[Any, list[Any]]:
    """Everything that does not change as the kernels want it, and the meshes, which they cannot take."""
    from species import _growth_kernels as kernels
    from treegraph import light

    occluders = site.occluders if site.occluders is not None else light.Occluders()
    sky = site.sky if site.sky is not None else light.Sky()
    cells = light._sky_cells(settings.rings)
    _, branches, packed, meshes = light._pack(occluders)
    leaves = occluders.leaves
    numbers = np.zeros(kernels.N_SETTINGS)
    for name, column in _SETTING_COLUMNS.items():
        numbers[getattr(kernels, column)] = getattr(settings, name)
    numbers[kernels.MAX_CLUSTERS] = min(settings.max_clusters * len(plants), MOST_CLUSTERS)
    numbers[kernels.UNIT_TRANSLUCENCY] = light.UNIT_TRANSLUCENCY
    numbers[kernels.UNIT_LEAF_DENSITY] = UNIT_LEAF_DENSITY
    numbers[kernels.KEEP_ALL] = history
    parameter = np.array([_si(plant.parameters) for plant in plants])
    stand = kernels.Stand(
        parameter=parameter,
        planted=np.array([plant.planted for plant in plants], np.int32),
        base_z=np.array([plant.position[2] for plant in plants]),
        corner=np.array(plants[0].position) - GRID_SHIFT * _first_cell(parameter),
        settings=numbers,
        static_leaves=np.column_stack([leaves.center, leaves.radius, leaves.translucency]),
        branches=branches,
        planes=packed[0],
        balls=packed[1],
        boxes=packed[2],
        grid=cells.grid,
        fine=cells.fine,
        weight=light._cell_weight(settings.rings, sky),
        reach=np.array([light.BLUR * cells.width, light.TENT * cells.width]),
    )
    return stand, meshes


UNIT_LEAF_DENSITY = 1.0
"""Leaf area per volume, m2/m3, of a cluster whose translucency is 0.5 per metre of radius (Eq. 4.4). With
leaves at random angles (half of their area faces any ray) the law of Beer and Lambert gives 1.04."""

_SETTING_COLUMNS = {
    "foliage": "FOLIAGE",
    "leaf_cycles": "LEAF_CYCLES",
    "tip_share": "TIP_SHARE",
    "pipe_exponent": "PIPE_EXPONENT",
    "wood_density": "WOOD_DENSITY",
    "leaf_density": "LEAF_DENSITY",
    "shed_unit": "SHED_UNIT",
    "bend_unit": "BEND_UNIT",
    "max_nodes": "MAX_NODES",
    "ground": "GROUND",
}


def _si(parameters: GrowthParameters) -> list[float]:
    """The 24 numbers as the kernels want them: radians, and standard deviations for variances."""
    out = []
    for row in parameter_table():
        value = float(getattr(parameters, row["name"]))
        kind = ANGLES.get(row["symbol"], 0)
        out.append(math.radians(math.sqrt(value) if kind == 2 else value) if kind else value)
    return out


def _check_feet(plants: list[Plant], site: Site) -> None:
    """No plant may stand inside an obstacle, which shades a point inside from all sides."""
    if site.occluders is None:
        return
    for k, plant in enumerate(plants):
        for obstacle in site.occluders.obstacles:
            if stands_inside(obstacle, plant.position):
                raise InputError(
                    f"plant {k} stands at {plant.position}, inside a {type(obstacle).__name__} obstacle"
                )


def _seedlings(plants: list[Plant], n_buds: int, seed: int, stand: Any, history: bool) -> Any:
    """One node per plant, with room for more."""
    from species import _growth_kernels as kernels

    room = max(FIRST_ROOM, 2 * len(plants))
    row: dict[str, tuple[tuple[int, ...], Any]] = {
        name: ((), np.int32) for name in ("parent", "plant", "birth", "death", "order")
    }
    row |= {"bud_of": ((), np.uint8), "key": ((), np.uint64), "buds": ((n_buds,), np.uint8)}
    row |= {name: ((3,), np.float64) for name in ("position", "direction", "side")}
    nodes = kernels.Nodes(
        **{
            name: np.zeros((room, *row.get(name, ((), None))[0]), row.get(name, ((), np.float64))[1])
            for name in kernels.Nodes._fields
            if name != "first_direction"
        },
        first_direction=np.zeros((room if history else 0, 3)),
    )
    n = len(plants)
    nodes.parent[:n] = -1
    nodes.plant[:n] = np.arange(n)
    nodes.birth[:n] = stand.planted
    nodes.death[:n] = kernels.ALIVE
    nodes.key[:n] = [kernels.mix(np.uint64(seed) ^ kernels.mix(np.uint64(k))) for k in range(n)]
    nodes.position[:n] = [plant.position for plant in plants]
    nodes.light[:n] = 1.0
    nodes.buds[:n, 0] = kernels.DORMANT
    _start_roots(nodes, np.arange(n), stand)
    return nodes


def _start_roots(nodes: Any, roots: NDArray[Any], stand: Any) -> None:
    """Seeds point up; their first lateral buds look along the x axis."""
    from species import _growth_kernels as kernels

    nodes.direction[roots] = (0.0, 0.0, 1.0)
    nodes.side[roots] = (1.0, 0.0, 0.0)
    tip = stand.settings[kernels.TIP_SHARE] * stand.parameter[nodes.plant[roots], kernels.IBL]
    nodes.radius[roots] = tip
    nodes.pipe[roots] = tip ** stand.settings[kernels.PIPE_EXPONENT]


def _more_room(array: NDArray[Any], n: int, room: int) -> NDArray[Any]:
    if not len(array):
        return array
    out = np.zeros((room, *array.shape[1:]), array.dtype)
    out[:n] = array[:n]
    return out


def _graph(nodes: Any, kept: NDArray[np.int64], **more: NDArray[Any]) -> TreeGraph:
    """The kept nodes of one plant, whose parents are kept, as a tree."""
    parent = nodes.parent[kept]
    place = np.searchsorted(kept, parent)
    return TreeGraph(
        np.where(parent < 0, -1, place).astype(np.int32),
        nodes.position[kept],
        nodes.radius[kept],
        {"birth": nodes.birth[kept], "order": nodes.order[kept], **more},
    )


def _attributes(
    nodes: Any, kept: NDArray[Any], tip: NDArray[Any], stand: Any, year: int, settings: GrowthSettings
) -> dict[str, NDArray[Any]]:
    from species import _growth_kernels as kernels

    apical = np.where(nodes.buds[kept, 0] == kernels.SPENT, 0, nodes.buds[kept, 0]).astype(np.uint8)
    living = (nodes.buds[kept, 1:] == kernels.DORMANT).sum(axis=1).astype(np.uint8)
    young = nodes.birth[kept] > year - 1 - settings.leaf_cycles
    full_length = stand.parameter[nodes.plant[kept], kernels.IBL]
    leafy = (nodes.parent[kept] >= 0) & (young | (tip[kept] & (apical == kernels.DORMANT)))
    return {
        "bud": apical,
        "lateral_buds": living,
        "mass": nodes.mass[kept],
        "light": nodes.light[kept],
        "leaf_area": np.where(leafy, settings.foliage * nodes.length[kept] * full_length, 0.0),
    }
