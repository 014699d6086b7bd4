"""Trees that a wall transformed beside trees that grew at it (thesis, section 4.5.4).

Set O grew in the open, set G beside a wall, set T grew in the open and was put there by ``plastic``. Each
group of distances (constrained edit distance, Eq. 4.17 to 4.26; nodes are the pieces between forks) is of
pairs of trees of which none is used twice, no two from one seed. T-G should not differ from G-G, T-O should
differ from T-T. The thesis: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation,
University of Konstanz, 2013.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report

PAIRS = 50
SEED = 0
KIND = "F6a"  # what the types have in common beside their tropisms
DISTANCE, WIDTH, HEIGHT = 1.0, 30.0, 12.0  # metres; the trees are 7 to 8 m high
GROUPS = ("T-G", "G-G", "T-O", "T-T")
ALPHA_SAME, ALPHA_OTHER = 0.05, 0.001


@dataclass(frozen=True)
class TreeType:
    """A type of trees: what it takes from the thesis, and what table 4.1 has for it.

    The text gives the tropisms of B and C as (0.45, 0.44) and (0.03, 0.23), the appendix, whose tables hold
    the distances, as (0.45, 0.03) and (0.44, 0.23): the same four numbers, by columns. Both are measured.
    ``published`` are the means of the four groups and the p-value of T-G against G-G.
    """

    name: str
    phototropism: float
    gravitropism: float
    age: int
    pruning_factor: float
    published: tuple[float, ...]


TYPES = (
    TreeType("A", 0.25, 0.12, 9, 0.05, (236.29, 229.65, 347.19, 225.38, 0.46)),
    TreeType("B", 0.45, 0.44, 9, 0.05, (431.73, 396.81, 471.63, 413.64, 0.06)),
    TreeType("C", 0.03, 0.23, 10, 0.025, (756.27, 841.79, 927.64, 550.63, 0.13)),
    TreeType("B, appendix", 0.45, 0.03, 9, 0.05, (431.73, 396.81, 471.63, 413.64, 0.06)),
    TreeType("C, appendix", 0.44, 0.23, 10, 0.025, (756.27, 841.79, 927.64, 550.63, 0.13)),
)


def make_obstacle() -> Any:
    """The wall: higher than the trees, at 1 m from their trunks."""
    from treegraph import make_wall

    return make_wall((DISTANCE, 0.0, 0.0), (-1.0, 0.0, 0.0), width=WIDTH, height=HEIGHT)


def grow_one(kind: TreeType, seed: int, obstacle: Any = None) -> Any:
    """A tree of sets O (without an obstacle) and G."""
    from species import Site, find_preset, grow
    from treegraph import Occluders

    parameters = find_preset(KIND).parameters.replace(
        PT=kind.phototropism, GT=kind.gravitropism, PF=kind.pruning_factor
    )
    site = Site() if obstacle is None else Site(occluders=Occluders(obstacles=(obstacle,)))
    return grow(parameters, kind.age, rng=np.random.default_rng(seed), site=site).tree


def transform_one(kind: TreeType, seed: int, obstacle: Any) -> Any:
    """A tree of set T: one of set O, with its leaves in clusters, as the wall leaves it."""
    from plastic import AnalysisSettings, Scene, analyse
    from species import gather_clusters, place_leaves
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    tree = grow_one(kind, seed)
    leaves = place_leaves(tree, rng=np.random.default_rng(seed))
    whole = 1.0 + kind.phototropism + kind.gravitropism  # the growth model's strengths as weights of Eq. 4.6
    settings = AnalysisSettings(
        phototropism=kind.phototropism / whole, gravitropism=kind.gravitropism / whole
    )
    clusters = gather_clusters(tree, leaves)
    state = analyse(ClusterTree(tree, clusters, None, DEFAULT_ALLOMETRY, np.zeros(3)), settings=settings)
    return state.adapt(Scene((obstacle,))).tree.graph


def measure_groups(kind: TreeType, pairs: int, seed: int = SEED) -> tuple[dict[str, Any], dict[str, Any]]:
    """Distances of the four groups, and the mean numbers of nodes of the three sets."""
    from inverse import constrained_edit_distance, cut_into_pieces

    seeds: Iterator[int] = count(seed)
    wall = make_obstacle()
    make = {
        "O": lambda: grow_one(kind, next(seeds)),
        "G": lambda: grow_one(kind, next(seeds), wall),
        "T": lambda: transform_one(kind, next(seeds), wall),
    }
    distances = {}
    nodes: dict[str, list[int]] = {name: [] for name in make}
    for group in GROUPS:
        found = []
        for _ in range(pairs):
            trees = [(name, make[name]()) for name in group.split("-")]
            for name, tree in trees:
                nodes[name].append(tree.n_nodes)
            one, two = (cut_into_pieces(tree) for _, tree in trees)
            found.append(constrained_edit_distance(one, two))
        distances[group] = np.array(found)
    return distances, {f"nodes_{name}": float(np.mean(n)) for name, n in nodes.items()}


def evaluate(kind: TreeType, pairs: int = PAIRS, seed: int = SEED) -> dict[str, Any]:
    """One row of the table: means, deviations and the two two-tailed t-tests, beside the published ones."""
    from scipy.stats import ttest_ind

    distances, nodes = measure_groups(kind, pairs, seed)
    same = float(ttest_ind(distances["T-G"], distances["G-G"]).pvalue)
    other = float(ttest_ind(distances["T-O"], distances["T-T"]).pvalue)
    row: dict[str, Any] = {"type": kind.name, **nodes}
    for k, group in enumerate(GROUPS):
        row[group] = float(distances[group].mean())
        row[f"{group} sd"] = float(distances[group].std(ddof=1))
        row[f"{group} published"] = kind.published[k]
    return row | {
        "p T-G, G-G": same,
        "published p": kind.published[-1],
        "p T-O, T-T": other,
        "as published": same > ALPHA_SAME and other < ALPHA_OTHER,
    }


def run(arguments: Namespace) -> None:
    """Print the table."""
    pairs, seed = getattr(arguments, "pairs", PAIRS), getattr(arguments, "seed", SEED)
    rows = [evaluate(kind, pairs, seed) for kind in TYPES]
    print(f"### Distances of {pairs} pairs a group, and the published ones (thesis, table 4.1)\n")
    print(report.table(rows), flush=True)
    report.write_json(getattr(arguments, "json", None), "plasticity", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(
        prog="python -m benchmarks.plasticity", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--pairs", type=int, default=PAIRS, help="pairs of trees a group")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first tree")
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
