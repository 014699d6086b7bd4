r"""Trees react to a scene: once, or again and again while it changes.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, sections 4.4.1 and 4.4.3.
Departs from it in: trees of different ages are aligned at their ends, that is, a younger tree sprouts later
("the processing time for the branches of the younger trees is changed in order to end up at the same
completion time"); trees whose crowns take less than 1/64 of the light from each other do not shade each
other. A branch that would enter an obstacle ends before it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plastic import _plans
from plastic.adapted import Adapted
from plastic.analysis import (
    PlasticState,
    bounding_ball,
    fresh_work,
    make_sky,
    make_state,
    single_events,
)
from plastic.scene import Neighbour, Scene
from treegraph import Ball, Box, HalfSpace, InputError, Sky, TriangleMesh

if TYPE_CHECKING:
    from treegraph.obstacles import Obstacle

__all__ = ["Session", "adapt_once", "adapt_stand"]

LEAST_SHADE = 1.0 / 64.0
"""Share of the light that a whole crown, were it opaque, must be able to take from another tree."""

SAME_TIME = 1e-9  # of the longest life
MOST_SPARE = 4  # scratch of finished runs that a state keeps


@dataclass(frozen=True, eq=False)
class _Stand:
    """Trees that react together, as the kernels want them."""

    trees: tuple[Neighbour, ...]
    plan: Any
    events: Any
    node_first: NDArray[np.int64]  # (k + 1,)
    site_first: NDArray[np.int64]  # (k + 1,)


def adapt_once(state: PlasticState, scene: Scene) -> Adapted:
    """The tree in a scene; see :meth:`PlasticState.adapt`."""
    if not scene.neighbours:
        return _run_alone(state, scene)
    own = Neighbour(state)
    first, *others = adapt_stand((own, *scene.neighbours), scene)
    return first.with_neighbours(tuple(others))


def adapt_stand(trees: Sequence[Neighbour], scene: Scene) -> tuple[Adapted, ...]:
    """Several trees in a scene, all of which react.

    Parameters
    ----------
    trees : sequence of Neighbour
        At least one.
    scene : Scene
        Its neighbours are left out.

    Returns
    -------
    adapted : tuple of Adapted
        In the order of the trees, each in its own frame.

    Raises
    ------
    InputError
        If there is no tree, or the foot of one lies in an obstacle.
    """
    return Session().adapt_stand(trees, scene)


class Session:
    """Trees that react again and again; only what a change of the scene affects is worked out anew.

    What comes out is what :meth:`PlasticState.adapt` gives for the same scene, to the bit.

    Parameters
    ----------
    state : PlasticState, optional
        The tree of :meth:`adapt`.
    """

    def __init__(self, state: PlasticState | None = None) -> None:
        self.state = state
        self._stand: _Stand | None = None
        self._work: Any = None
        self._last: tuple[Any, ...] = ()
        self._results: tuple[Adapted, ...] = ()

    def adapt(self, scene: Scene) -> Adapted:
        """The tree in a scene; as :meth:`PlasticState.adapt`.

        Raises
        ------
        InputError
            If the session has no tree, or the foot of a tree lies in an obstacle.
        """
        if self.state is None:
            raise InputError("this session has no tree of its own; give it one, or call adapt_stand")
        own = self._stand.trees[0] if self._stand and self._stand.trees else None
        if own is None or own.state is not self.state or own.turn or own.position.any():
            own = Neighbour(self.state)
        first, *others = self.adapt_stand((own, *scene.neighbours), scene)
        return first.with_neighbours(tuple(others)) if others else first

    def adapt_stand(self, trees: Sequence[Neighbour], scene: Scene) -> tuple[Adapted, ...]:
        """Several trees in a scene; as :func:`adapt_stand`. Trees that move are worked out anew.

        Raises
        ------
        InputError
            As :func:`adapt_stand`.
        """
        trees = tuple(trees)
        if not trees:
            raise InputError("trees must have at least one tree")
        rings = {tree.state.settings.rings for tree in trees}
        if len(rings) > 1:
            raise InputError(f"all trees must be analysed with the same rings, got {sorted(rings)}")
        fresh = self._stand is None or not _same_trees(self._stand.trees, trees)
        if fresh:
            self._stand = _make_stand(trees)
        assert self._stand is not None
        stand = self._stand
        sky = scene.sky if scene.sky is not None else trees[0].state.sky
        cells = make_sky(rings.pop(), sky)
        solids, meshes = pack_solids(scene.obstacles)
        now = (_key(solids), tuple(id(mesh) for mesh in meshes), sky, scene.bending)
        if fresh:
            self._work = fresh_work(stand.plan, cells=len(cells.grid[0]))
            rules = _rules(scene, reshade=len(trees) > 1, relight=True, reweigh=True, rebend=False)
        else:
            before = self._last
            rules = _rules(
                scene,
                reshade=False,
                relight=before[:2] != now[:2],
                reweigh=before[2] != sky,
                rebend=before[3] != scene.bending,
            )
        self._last = now + (meshes,)  # kept alive, so that no other mesh gets its id
        try:
            _run(stand.plan, self._work, stand.events, cells, solids, rules, meshes)
            _check_feet(self._work, trees)
        except BaseException:
            self._stand = None  # half a run is nothing to go on from
            raise
        before_it = (None,) * len(trees) if fresh else self._results
        self._results = tuple(_result(stand, self._work, k, scene, before_it[k]) for k in range(len(trees)))
        return self._results


def _same_trees(one: tuple[Neighbour, ...], two: tuple[Neighbour, ...]) -> bool:
    return len(one) == len(two) and all(
        a is b or (a.state is b.state and a.turn == b.turn and (a.position == b.position).all())
        for a, b in zip(one, two, strict=True)
    )


def _rules(scene: Scene, *, reshade: bool, relight: bool, reweigh: bool, rebend: bool) -> Any:

    relight = relight or reweigh
    return _plans.Rules(scene.bending, scene.pruning, rebend, reshade, relight, reweigh, False)


def _run_alone(state: PlasticState, scene: Scene) -> Adapted:
    """One tree, once, with scratch that earlier runs have left."""

    sky = scene.sky if scene.sky is not None else state.sky
    cells = make_sky(state.settings.rings, sky)
    solids, meshes = pack_solids(scene.obstacles)
    try:
        work = state._spare.pop()
    except IndexError:
        work = fresh_work(state._plan, cells=0)
    other = sky != state.sky
    rules = _rules(scene, reshade=False, relight=bool(scene.obstacles), reweigh=other, rebend=False)
    _run(state._plan, work, single_events(state.seasons.count), cells, solids, rules, meshes, anew=True)
    if work.buried[0]:
        _check_feet(work, (Neighbour(state),))
    last = slice(int(state.crown.first[-2]), int(state.crown.first[-1]))
    adapted = Adapted.of_run(
        state,
        work.position,
        work.death,
        work.cause,
        work.amount[last],
        state.light[last],
        scene,
        bool(work.affected[0]),
    )
    if len(state._spare) < MOST_SPARE:
        state._spare.append(work)
    return adapted


def _run(
    plan: Any,
    work: Any,
    events: Any,
    cells: Any,
    solids: Any,
    rules: Any,
    meshes: list[TriangleMesh],
    *,
    anew: bool = False,
) -> None:
    from plastic import _plastic_kernels as kernels
    from plastic import _site_kernels as sites

    if not meshes:
        kernels.run(plan, work, events, cells, solids, rules, anew)
        return
    if anew:
        kernels.reset(plan, work)
    kernels.begin(plan, work, solids)
    room = sites.make_room(cells, solids, len(plan.radius))
    nothing = np.empty((0, 0), np.float32)

    def look(e: int, tree: int, group: int) -> None:
        a, b = plan.site_first[tree, group], plan.site_first[tree, group + 1]
        seen = _seen_past(meshes, work.center[a:b], cells.fine) if rules.relight or b > a else nothing
        more = rules._replace(relight=True, reweigh=True)
        sites.light(plan, work, events, cells, solids, more, seen, tree, group, e, room)

    for e in range(len(events.first) - 1):
        acting = range(events.first[e], events.first[e + 1])
        for a in acting:
            tree, season = int(events.tree[a]), int(events.season[a])
            if season == 0:
                look(e, tree, 0)
            _bend_among_meshes(plan, work, solids, rules, tree, season, e, meshes)
            sites.place(plan, work, tree, season + 1)
        for a in acting:
            look(e, int(events.tree[a]), int(events.season[a]) + 1)
        for a in acting:
            kernels.prune(plan, work, rules, int(events.tree[a]), int(events.season[a]), e)


def _bend_among_meshes(
    plan: Any, work: Any, solids: Any, rules: Any, tree: int, season: int, e: int, meshes: list[TriangleMesh]
) -> None:
    """The same for a season of one tree; what leads through a surface dies with all it carries."""
    from plastic import _plastic_kernels as kernels

    kernels.bend(plan, work, solids, rules, tree, season, e)
    new = np.arange(plan.node_first[tree, season], plan.node_first[tree, season + 1])
    new = new[(plan.parent[new] >= 0) & (work.death[new] == _plans.ALIVE)]
    if not new.size:
        return
    crossing = np.zeros(len(new), bool)
    start, end = work.position[plan.parent[new]], work.position[new]
    for mesh in meshes:
        crossing |= mesh.crosses(start, end)
    if crossing.any():
        kernels.let_die(plan, work, tree, season, new[crossing], e)


def _seen_past(
    meshes: list[TriangleMesh], points: NDArray[np.float64], fine: NDArray[np.float32]
) -> NDArray[np.float32]:
    """What the meshes let through, (points, 4 N) float32."""
    from treegraph import light

    return light._seen_past(meshes, points, fine)


def pack_solids(obstacles: Sequence[Obstacle]) -> tuple[Any, list[TriangleMesh]]:
    """Obstacles as the kernels want them, in an order of their own; and the meshes."""

    planes: list[tuple[float, ...]] = []
    balls: list[tuple[float, ...]] = []
    boxes: list[tuple[float, ...]] = []
    meshes = []
    for thing in obstacles:
        if isinstance(thing, HalfSpace):
            planes.append((*thing.point.tolist(), *thing.normal.tolist(), thing.translucency))
        elif isinstance(thing, Ball):
            balls.append((*thing.center.tolist(), thing.radius, thing.translucency))
        elif isinstance(thing, Box):
            turn = np.asarray(thing.rotation).T.ravel().tolist()
            half = [0.5 * edge for edge in thing.size.tolist()]
            boxes.append((*thing.center.tolist(), *turn, *half, thing.translucency))
        else:
            meshes.append(thing)
    balls.sort()
    boxes.sort()
    bounds = [row[:4] for row in balls]
    bounds += [(*row[:3], math.sqrt(sum(half * half for half in row[12:15]))) for row in boxes]
    rows = ((sorted(planes), 7), (balls, 5), (boxes, 16), (bounds, 4))
    return _plans.Solids(*(np.array(r) if r else _no_rows(width) for r, width in rows)), meshes


@lru_cache(maxsize=8)
def _no_rows(width: int) -> NDArray[np.float64]:
    return np.empty((0, width))


def _key(solids: Any) -> tuple[bytes, ...]:
    return tuple(array.tobytes() for array in solids)


def _check_feet(work: Any, trees: Sequence[Neighbour]) -> None:
    """No tree may stand inside an obstacle, which shades a point inside from all sides."""
    standing = np.flatnonzero(work.buried)
    if standing.size:
        where = trees[int(standing[0])].position
        raise InputError(
            f"tree {standing[0]}, at {where.tolist()}, has its foot inside an obstacle; "
            f"move one of them ({standing.size} of {len(trees)} trees stand in one)"
        )


# ---------------------------------------------------------------- several trees


def _make_stand(trees: tuple[Neighbour, ...]) -> _Stand:
    """The plans of all trees, where they stand, one after the other."""
    plans = [_placed_plan(tree) for tree in trees]
    nodes = np.concatenate([[0], np.cumsum([len(p.parent) for p in plans])])
    sites = np.concatenate([[0], np.cumsum([len(p.radius) for p in plans])])
    seats = np.concatenate([[0], np.cumsum([len(p.seat) for p in plans])])
    if len(plans) == 1:
        return _Stand(trees, plans[0], single_events(trees[0].state.seasons.count), nodes, sites)
    width = max(p.node_first.shape[1] for p in plans)
    joined: dict[str, NDArray[Any]] = {
        name: np.concatenate([getattr(p, name) for p in plans])
        for name in plans[0]._fields
        if name not in ("node_first", "site_first", "slack", "parent", "look", "seat", "seat_first", "passed")
    }
    shift = {"parent": nodes, "seat": nodes, "look": sites}
    for name, first in shift.items():
        parts = [getattr(p, name) for p in plans]
        joined[name] = np.concatenate(
            [np.where(part < 0, -1, part + first[k]) for k, part in enumerate(parts)]
        ).astype(np.int32)
    joined["seat_first"] = np.concatenate(
        [p.seat_first[:-1] + seats[k] for k, p in enumerate(plans)] + [seats[-1:]]
    ).astype(np.int32)
    for name, begin, size in (("node_first", nodes, width), ("site_first", sites, width + 1)):
        rows = [getattr(p, name)[0] for p in plans]
        padded = [np.pad(row, (0, size - len(row)), mode="edge") for row in rows]
        joined[name] = (np.array(padded) + begin[:-1, None]).astype(np.int32)
    joined["slack"] = np.array([np.pad(p.slack[0], (0, width - 1 - p.slack.shape[1])) for p in plans])
    joined["passed"] = np.zeros((0, 0), np.float32)
    plan = plans[0]._replace(**joined)
    return _Stand(trees, plan, _align(trees, plans), nodes, sites)


def _placed_plan(tree: Neighbour) -> Any:
    """The plan of a tree where it stands; a turned one is looked at in its own light again."""
    state = tree.state
    if not tree.turn and not tree.position.any():
        return state._plan
    plan = state._plan
    if tree.turn:
        matrix = turn_matrix(tree.turn)
        graph = state.tree.graph.replace(position=state.tree.graph.position @ matrix.T)
        turned = state.tree.replace(graph=graph)
        from dataclasses import replace

        crown = replace(state.crown, center=state.crown.center @ matrix.T)
        x, y, z = (matrix @ np.array(state.sky.brightest)).tolist()
        sky = state.sky if state.sky == Sky() else Sky((x, y, max(z, 0.0)))
        plan = make_state(turned, state.settings, sky, state.seasons, crown)._plan
    return plan._replace(position=plan.position + tree.position, center=plan.center + tree.position)


def turn_matrix(turn: float) -> NDArray[np.float64]:
    """Rotation about the vertical."""
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _align(trees: tuple[Neighbour, ...], plans: list[Any]) -> Any:
    """Events of trees of different ages, which all end at the same time."""

    lives = [tree.state.seasons.season * tree.state.seasons.count for tree in trees]
    longest = max(lives)
    acts = []
    for k, tree in enumerate(trees):
        seasons = tree.state.seasons
        for s in range(seasons.count):
            left = (seasons.count - 1 - s) * seasons.season / longest  # till the end
            acts.append((-round(left / SAME_TIME) if left else 0, k, s))
    acts.sort()
    time = np.array([act[0] for act in acts])
    begins = np.r_[True, np.diff(time) > 1]
    first = np.r_[np.flatnonzero(begins), len(acts)].astype(np.int32)
    group = np.full((len(first) - 1, len(trees)), -1, np.int32)
    for e in range(len(first) - 1):
        if e:
            group[e] = group[e - 1]
        for _, k, s in acts[first[e] : first[e + 1]]:
            group[e, k] = s + 1
    near_first, near = _pairs(plans)
    return _plans.Events(
        first,
        np.array([act[1] for act in acts], np.int32),
        np.array([act[2] for act in acts], np.int32),
        group,
        near_first,
        near,
    )


def _pairs(plans: list[Any]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Which trees' crowns can take light from which."""
    balls = np.array([bounding_ball(p.center, p.radius) for p in plans])
    low = np.array([p.center[:, 2].min() for p in plans])
    lists = []
    for k in range(len(plans)):
        away = np.linalg.norm(balls[:, :2] - balls[k, :2], axis=1) - balls[k, 3]
        rise = balls[:, 2] + balls[:, 3] - low[k]
        sine = np.minimum(rise / np.hypot(rise, np.maximum(away, 1e-9)), 1.0)
        ratio = balls[:, 3] / np.maximum(away, balls[:, 3])
        takes = 1.5 * ratio**2 * np.maximum(sine, 0.0) ** 2
        lists.append(np.flatnonzero((takes > LEAST_SHADE) & (np.arange(len(plans)) != k)))
    first = np.concatenate([[0], np.cumsum([len(row) for row in lists])]).astype(np.int32)
    return first, np.concatenate(lists).astype(np.int32)


def _result(stand: _Stand, work: Any, k: int, scene: Scene, last: Adapted | None) -> Adapted:
    """What has become of one tree, in its own frame; nodes that are as in the last run are not copied."""
    tree = stand.trees[k]
    nodes = slice(int(stand.node_first[k]), int(stand.node_first[k + 1]))
    crown = tree.state.crown
    now = slice(int(stand.site_first[k] + crown.first[-2]), int(stand.site_first[k] + crown.first[-1]))
    if last is not None and not work.news[k]:
        return last.in_light(scene, work.amount[now])
    position = work.position[nodes]
    if tree.turn or tree.position.any():
        back = (position - tree.position) @ turn_matrix(tree.turn)
        still = ~work.turned[nodes]
        back[still] = tree.state._plan.position[still]
        position = back
    result = Adapted.of_run(
        tree.state,
        position,
        work.death[nodes],
        work.cause[nodes],
        work.amount[now],
        stand.plan.amount[now],
        scene,
        bool(work.affected[k]),
        tree,
    )
    for array in (result.position, result.alive, result.cause):
        array.setflags(write=False)  # later results may share them
    return result
