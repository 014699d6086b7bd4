"""Similarity: trees compared per second by size, what its parts take, and how near resampled trees are."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import report
from benchmarks.growth import grown
from benchmarks.report import seconds_of

REPEATS = 7
#: Kind, age and seeds of two trees with about 300, 600 and 2300 nodes.
SIZES = (("F6b", 12, (1, 2)), ("F6b", 14, (1, 2)), ("F6b", 18, (1, 3)))
#: Table 4 of Stava et al.: nodes of the input, and evaluations (grow and compare) per second in their time.
PUBLISHED = ((298, 83.0), (587, 11.8), (2307, 3.7))
SPACINGS = (0.3, 0.1, 0.03)


def by_size() -> list[dict[str, Any]]:
    """One core: growing, describing and the parts of comparing; evaluations are all of it but the mapping."""
    from inverse import compare_trees, constrained_edit_distance, describe_tree
    from inverse.structure import distance_of

    rows = []
    for (kind, age, seeds), (nodes, per_second) in zip(SIZES, PUBLISHED, strict=True):
        one, two = (grown(kind, age, seed).tree for seed in seeds)
        a, b = describe_tree(one), describe_tree(two)
        again = (kind, age, seeds[1])
        grow_s = seconds_of(lambda again=again: grown(*again), REPEATS)[0]
        describe_s = seconds_of(lambda tree=two: describe_tree(tree), REPEATS)[0]
        structure_s = seconds_of(lambda a=a, b=b: distance_of(a.edit, b.edit), REPEATS)[0]
        without_s = seconds_of(lambda a=a, b=b: distance_of(a.edit, b.edit, joins=False), REPEATS)[0]
        compare_s = seconds_of(lambda a=a, b=b: compare_trees(a, b), REPEATS)[0]
        zhang_s = seconds_of(lambda a=a, b=b: constrained_edit_distance(a.pieces, b.pieces), REPEATS)[0]
        rows.append(
            {
                "nodes": f"{one.n_nodes} x {two.n_nodes}",
                "pieces": f"{a.pieces.n_pieces} x {b.pieces.n_pieces}",
                "grow_ms": grow_s * 1e3,
                "describe_ms": describe_s * 1e3,
                "structure_ms": structure_s * 1e3,
                "without_joins_ms": without_s * 1e3,
                "compare_ms": compare_s * 1e3,
                "constrained_ms": zhang_s * 1e3,
                "ns_per_pair": structure_s / a.pieces.n_pieces / b.pieces.n_pieces * 1e9,
                "evaluations_per_s": 1.0 / (grow_s + describe_s + structure_s),
                "published_nodes": nodes,
                "published_per_s": per_second,
            }
        )
    return rows


def resampled() -> list[dict[str, Any]]:
    """How far a tree is from itself with its nodes elsewhere; also with every segment a piece."""
    from inverse import compare_trees, cut_into_pieces, structural_distance
    from treegraph import resample

    kind, age, seeds = SIZES[0]
    tree = grown(kind, age, seeds[0]).tree
    rows = []
    for spacing in SPACINGS:
        other = resample(tree, spacing)
        found = compare_trees(tree, other)
        one, two = (cut_into_pieces(t, every_segment=True) for t in (tree, other))
        rows.append(
            {
                "spacing_m": spacing,
                "nodes": f"{tree.n_nodes} x {other.n_nodes}",
                "distance": found.distance,
                "shape": found.shape,
                "geometry": found.geometry,
                "structure": found.structure,
                "by_segments": structural_distance(one, two),
                "by_segments_without_joins": structural_distance(one, two, joins=False),
            }
        )
    return rows


def run(arguments: Namespace) -> None:
    """Print one table per question."""
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "Time on one core, and the published evaluations (table 4)": by_size,
        "A tree and itself resampled": resampled,
    }
    found = {}
    for title, part in parts.items():
        found[title] = part()
        print(f"### {title}\n\n{report.table(found[title])}\n", flush=True)
    rows = [{"question": title, **row} for title, part in found.items() for row in part]
    report.write_json(getattr(arguments, "json", None), "similarity", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.similarity", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
