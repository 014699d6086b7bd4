"""Plastic trees: adaptation beside regrowth, small moves beside whole runs, a box among trees."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from functools import cache
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.report import seconds_of

REPEATS = 15
SEED = 3
KIND = "F6b"
#: Cycles with about 530, 2541 and 9134 nodes, and what the thesis gives for these (table 4.2): nodes,
#: milliseconds of growth and of transformation on the computer of its time.
SIZES = (
    (12, (530, 216.3, 3.82)),
    (18, (2541, 8855.6, 50.5)),
    (27, (9134, 61843.9, 222.8)),
)
STEPS = (0.001, 0.01, 0.1)  # metres by which a wall moves
MOVES = 30
TREES = (4, 5)  # rows and columns of a plantation
SPACING = 6.0  # metres


def fence(x: float = 3.0) -> Any:
    """A wall of 8 m by 3 m, 3 m from the trunk: it shades the tree while it is young."""
    from treegraph import make_wall

    return make_wall((x, 0.0, 0.0), (-1.0, 0.0, 0.0), width=8.0, height=3.0)


def house(x: float = 1.5) -> Any:
    """A wall of 20 m by 8 m, 1.5 m from the trunk: boughs meet it."""
    from treegraph import make_wall

    return make_wall((x, 0.0, 0.0), (-1.0, 0.0, 0.0), width=20.0, height=8.0)


def cliff(x: float = 1.5) -> Any:
    """An endless wall 1.5 m from the trunk, which takes half of the sky for life."""
    from treegraph import HalfSpace

    return HalfSpace((x, 0.0, 0.0), (-1.0, 0.0, 0.0))  # type: ignore[arg-type]


OBSTACLES = {"fence": fence, "house": house, "cliff": cliff}


@cache
def grown_tree(age: int) -> Any:
    """A grown tree with its leaves in clusters."""
    from species import find_preset, gather_clusters, grow, place_leaves
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    tree = grow(find_preset(KIND).parameters, age, rng=np.random.default_rng(SEED)).tree
    leaves = place_leaves(tree, rng=np.random.default_rng(SEED))
    return ClusterTree(tree, gather_clusters(tree, leaves), None, DEFAULT_ALLOMETRY, np.zeros(3))


@cache
def analysed(age: int) -> Any:
    """Its analysis, with the growth model's own strengths as weights of Eq. 4.6."""
    from plastic import AnalysisSettings, analyse
    from species import find_preset

    kind = find_preset(KIND).parameters
    whole = 1.0 + kind.phototropism + kind.gravitropism
    settings = AnalysisSettings(
        phototropism=kind.phototropism / whole, gravitropism=kind.gravitropism / whole
    )
    return analyse(grown_tree(age), settings=settings)


def regrow(age: int, obstacle: Any) -> Any:
    """The same tree grown beside the obstacle."""
    from species import Site, find_preset, grow
    from treegraph import Occluders

    site = Site(occluders=Occluders(obstacles=(obstacle,)))
    return grow(find_preset(KIND).parameters, age, rng=np.random.default_rng(SEED), site=site).tree


def beside_regrowth(
    sizes: tuple[tuple[int, Any], ...] = SIZES, repeats: int = REPEATS
) -> list[dict[str, Any]]:
    """One obstacle, one run: growing the tree anew beside it, and adapting the one that is there.

    ``adapt_ms`` ends with positions, what lives, and the light of the clusters; ``with_tree_ms`` also makes
    the checked tree with its cut hulls.
    """
    from plastic import Scene

    rows = []
    for name, make in OBSTACLES.items():
        for age, (published_nodes, published_growth, published_ms) in sizes:
            state, obstacle = analysed(age), make()
            scene = Scene((obstacle,))
            adapted = state.adapt(scene)
            regrown = regrow(age, obstacle).n_nodes
            growth_s = seconds_of(lambda age=age, obstacle=obstacle: regrow(age, obstacle), repeats)[0]
            adapt_s = seconds_of(lambda state=state, scene=scene: state.adapt(scene), 4 * repeats)[0]
            tree_s = seconds_of(lambda state=state, scene=scene: state.adapt(scene).tree, repeats)[0]
            rows.append(
                {
                    "obstacle": name,
                    "nodes": len(adapted.alive),
                    "adapted_nodes": int(adapted.alive.sum()),
                    "regrown_nodes": regrown,
                    "regrow_ms": growth_s * 1e3,
                    "adapt_ms": adapt_s * 1e3,
                    "with_tree_ms": tree_s * 1e3,
                    "times_faster": growth_s / adapt_s,
                    "published_nodes": published_nodes,
                    "published_growth_ms": published_growth,
                    "published_ms": published_ms,
                    "published_times": published_growth / published_ms,
                }
            )
    return rows


def analysis(sizes: tuple[tuple[int, Any], ...] = SIZES) -> list[dict[str, Any]]:
    """What is done once per tree."""
    from plastic import analyse

    rows = []
    for age, _ in sizes:
        tree = grown_tree(age)
        state = analyse(tree)
        rows.append(
            {
                "nodes": tree.graph.n_nodes,
                "clusters": len(tree.clusters),
                "seasons": state.seasons.count,
                "clusters_in_all_seasons": len(state.crown.radius) - 1,
                "analyse_ms": seconds_of(lambda tree=tree: analyse(tree), 3)[0] * 1e3,
            }
        )
    return rows


def _ball_beside_a_bough(state: Any) -> Any:
    """A ball beside the tips of the bough that reaches farthest east."""
    from treegraph import Ball

    position = state.tree.graph.position
    return Ball(position[np.argmax(position[:, 0])] + (0.9, 0.0, 0.6), 0.5)


def small_moves(age: int = SIZES[-1][0], moves: int = MOVES) -> list[dict[str, Any]]:
    """Obstacles that move a little: the median of a session's runs beside whole ones of the same scenes."""
    from plastic import Scene, Session
    from treegraph import Ball

    state = analysed(age)
    ball = _ball_beside_a_bough(state)
    things: dict[str, Callable[[float], Any]] = {
        "fence": lambda way: fence(3.0 - way),
        "ball beside a bough": lambda way: Ball(ball.center + (0.0, way, 0.0), ball.radius),
    }
    rows = []
    for name, place in things.items():
        for step in STEPS:
            session = Session(state)
            session.adapt(Scene((place(0.0),)))
            seconds: dict[str, list[float]] = {"session": [], "whole": []}
            turned = []
            for k in range(1, moves + 1):
                scene = Scene((place(step * k if step * k < 1.0 else 1.0 - step * (k % 10)),))
                for kind, run in (("session", session.adapt), ("whole", state.adapt)):
                    start = process_time()
                    run(scene)
                    seconds[kind].append(process_time() - start)
                turned.append(int(session._work.counts[3]))
            one, other = median(seconds["session"]), median(seconds["whole"])
            rows.append(
                {
                    "obstacle": name,
                    "step_mm": step * 1e3,
                    "nodes": len(state.seasons.birth),
                    "turned_nodes": int(median(turned)),
                    "session_ms": one * 1e3,
                    "whole_ms": other * 1e3,
                    "times_faster": other / one,
                }
            )
    return rows


def box_through_trees(age: int = SIZES[1][0], moves: int = MOVES) -> list[dict[str, Any]]:
    """Twenty trees that react to each other and to a box that moves through them (figure 4.16)."""
    from plastic import Neighbour, Scene, Session
    from treegraph import Box

    state = analysed(age)
    rng = np.random.default_rng(SEED)
    rows, columns = TREES
    trees = tuple(
        Neighbour(state, (SPACING * i, SPACING * j, 0.0), rng.uniform(0.0, 2.0 * np.pi))
        for i in range(rows)
        for j in range(columns)
    )
    out = []
    for name, edge in (("a box of 1 m", 1.0), ("a box of 3 m", 3.0)):
        session = Session()
        start = process_time()
        session.adapt_stand(trees, Scene((Box((-3.0, 0.5 * SPACING, 0.5 * edge), (edge,) * 3),)))
        first = process_time() - start
        seconds, touched = [], []
        for k in range(moves):
            x = -2.0 + (SPACING * rows) * k / moves
            scene = Scene((Box((x, 0.5 * SPACING, 0.5 * edge), (edge,) * 3),))
            start = process_time()
            session.adapt_stand(trees, scene)
            seconds.append(process_time() - start)
            dirty = session._work.dirty.reshape(len(trees), -1).any(axis=1)
            touched.append(int(dirty.sum()))
        slope = np.polyfit(touched, seconds, 1) if len(set(touched)) > 1 else (np.nan, np.nan)
        out.append(
            {
                "obstacle": name,
                "trees": len(trees),
                "nodes": len(trees) * len(state.seasons.birth),
                "first_ms": first * 1e3,
                "frame_ms": median(seconds) * 1e3,
                "worst_ms": max(seconds) * 1e3,
                "frames_per_s": 1.0 / median(seconds),
                "trees_affected": f"{min(touched)} to {max(touched)}",
                "ms_per_affected_tree": slope[0] * 1e3,
                "ms_else": slope[1] * 1e3,
            }
        )
    return out


def trees_apart(age: int = SIZES[1][0], n: int = 20) -> list[dict[str, Any]]:
    """Trees too far from each other to matter, and a ball that moves beside some of them."""
    from plastic import Neighbour, Scene, Session
    from treegraph import Ball

    state = analysed(age)
    far = 60.0
    trees = tuple(Neighbour(state, (far * k, 0.0, 0.0)) for k in range(n))
    rows = []
    for touched in (0, 1, 2, 5, 10, 20):
        session = Session()
        seconds = []
        for k in range(MOVES):
            balls = tuple(Ball((far * t + 2.0, 0.1 * (k % 2), 3.0), 1.5) for t in range(touched))
            start = process_time()
            session.adapt_stand(trees, Scene(balls))
            seconds.append(process_time() - start)
        rows.append({"trees": n, "trees_affected": touched, "frame_ms": median(seconds[1:]) * 1e3})
    return rows


def run(arguments: Namespace) -> None:
    """Print one table per question."""
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "Adaptation beside regrowth, and the published times (thesis, table 4.2)": beside_regrowth,
        "Analysis, once per tree": analysis,
        "Small moves": small_moves,
        "A box that moves through twenty trees (thesis, figure 4.16)": box_through_trees,
        "Balls beside some of twenty trees that stand apart": trees_apart,
    }
    found = {}
    for title, part in parts.items():
        found[title] = part()
        print(f"### {title}\n\n{report.table(found[title])}\n", flush=True)
    rows = [{"question": title, **row} for title, part in found.items() for row in part]
    report.write_json(getattr(arguments, "json", None), "plastic", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.plastic", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
