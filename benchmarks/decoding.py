"""Decoding: instances and flat meshes against copying the same bytes, levels of detail, memory, pictures.

A tree is made of twigs of chance at the tips of a grown skeleton; nothing is read. Each number is the least
of several runs, decoding and copying in turn, so that both see the same machine.
"""

from __future__ import annotations

import gc
import resource
import tracemalloc
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import report

REPEATS = 25
SEED = 0
N_PATCHES, LEAVES_PER_PATCH = 25, 120
TWIG_NODES = 8
TRIANGLES = (300_000, 1_000_000, 4_000_000)
SHARES = (1.0, 0.5, 0.2, 0.1)
TREES, WARM_TREES = 1000, 100
PICTURE_LEAVES, PICTURES = 150_000, 4
LIMITS = {"instances": 20.0, "flat": 4.0}  # times copying the same bytes


def make_patch(rng: np.random.Generator) -> Any:
    """A twig of half a metre with its leaves all along."""
    from species.foliage import LeafSet
    from species.patches import Patch
    from treegraph import TreeGraph

    z = np.linspace(0.0, 0.5, TWIG_NODES)
    position = np.column_stack([0.02 * np.sin(9.0 * z), 0.02 * np.sin(7.0 * z), z])
    graph = TreeGraph(np.arange(-1, TWIG_NODES - 1), position, np.linspace(0.005, 0.001, TWIG_NODES))
    m = LEAVES_PER_PATCH
    node = rng.integers(1, TWIG_NODES, m).astype(np.int32)
    along = rng.normal(size=(m, 3)) + [0.3, 0.0, 0.5]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.cross(along, rng.normal(size=(m, 3)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    size = rng.uniform(0.04, 0.09, m)
    return Patch(graph, LeafSet(position[node], along, normal, size, 0.6 * size, node))


def make_skeleton(rng: np.random.Generator, n_nodes: int = 2000) -> Any:
    """A trunk with branches of chance: each node hangs on an earlier one and is thinner."""
    from treegraph import TreeGraph, count_tips

    position, parent = np.zeros((n_nodes, 3)), np.full(n_nodes, -1)
    for k in range(1, n_nodes):
        parent[k] = k - 1 if k < 40 or rng.random() < 0.93 else rng.integers(15, k)
        way = rng.normal(size=3) + [0.0, 0.0, 2.0 if k < 40 else 0.3]
        position[k] = position[parent[k]] + 0.2 * way / np.linalg.norm(way)
    tree = TreeGraph(parent, position, np.zeros(n_nodes))
    return tree.replace(radius=np.maximum(0.25 * count_tips(tree) ** 0.5 / count_tips(tree)[0] ** 0.5, 0.002))


def make_instances(rng: np.random.Generator, graph: Any, n: int) -> Any:
    """So many patches at nodes of the graph, turned and scaled by chance."""
    from species.patches import Instances

    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    at = graph.position[rng.integers(graph.n_nodes // 2, graph.n_nodes, n)]
    patch = rng.integers(0, N_PATCHES, n).astype(np.int32)
    cluster = np.full(n, -1, np.int32)
    order = rng.permutation(n).astype(np.int32)
    return Instances(patch, at, rotation, rng.uniform(0.7, 1.3, n), cluster, order)


def mesh_arrays(mesh: Any) -> list[np.ndarray]:
    """All arrays of a mesh."""
    every = (mesh.vertices, mesh.faces, mesh.normals, mesh.uv, mesh.node, mesh.color)
    return [array for array in every if array is not None]


def decoded_arrays(tree: Any) -> list[np.ndarray]:
    """What decoding to instances has written: branches and tables."""
    return [*mesh_arrays(tree.wood), tree.start, tree.row, tree.position, tree.rotation, tree.scale]


def in_turn(work: Callable[[], Any], arrays: list[np.ndarray]) -> tuple[float, float, float]:
    """Least seconds of the work, of copying arrays into new memory, and into memory that is there."""
    there = [array.copy() for array in arrays]
    seconds = []
    for _ in range(REPEATS):
        start = perf_counter()
        made = work()
        middle = perf_counter()
        del made
        between = perf_counter()
        for array in arrays:
            np.copyto(np.empty_like(array), array)
        end = perf_counter()
        for out, array in zip(there, arrays, strict=True):
            np.copyto(out, array)
        seconds.append((middle - start, end - between, perf_counter() - end))
    return tuple(float(s) for s in np.min(seconds, axis=0))  # type: ignore[return-value]


def row_of(what: str, tree: Any, work: Callable[[], Any], arrays: list[np.ndarray]) -> dict[str, Any]:
    """Time one stage against copying what it wrote."""
    work()
    seconds, new, there = in_turn(work, arrays)
    return {
        "what": what,
        "triangles": tree.n_faces,
        "instances": tree.n_instances,
        "megabytes": sum(array.nbytes for array in arrays) / 1e6,
        "ms": seconds * 1e3,
        "copy_new_ms": new * 1e3,
        "copy_there_ms": there * 1e3,
        "times_copy_new": seconds / new,
        "times_copy_there": seconds / there,
        "limit": LIMITS[what],
    }


def measure_speed(graph: Any, foliage: Any, triangles: int) -> list[dict[str, Any]]:
    """Instances and flat mesh of a tree of about so many triangles."""
    from render import branch_mesh, decode_tree, flat_parts

    rng = np.random.default_rng(SEED)
    each = np.mean([mesh.n_faces for mesh in foliage.meshes])
    wood = len(branch_mesh(graph).faces)
    instances = make_instances(rng, graph, max(int((triangles - wood) / each), 1))

    def decode() -> Any:
        return decode_tree(graph, instances, foliage)

    tree = decode()
    flat = [array for part in flat_parts(tree) if part.name != "wood" for array in mesh_arrays(part.mesh)]
    return [
        row_of("instances", tree, decode, decoded_arrays(tree)),
        row_of("flat", tree, lambda: flat_parts(tree), flat),
    ]


def measure_levels(graph: Any, patches: list[Any], n: int) -> list[dict[str, Any]]:
    """What is left of leaves, triangles and leaf area at each level."""
    from render import decode_tree, flat_parts, make_foliage

    instances = make_instances(np.random.default_rng(SEED), graph, n)
    rows = []
    for share in SHARES:
        tree = decode_tree(graph, instances, make_foliage(patches, share=share))
        mesh = {part.name: part.mesh for part in flat_parts(tree)}["leaves"]
        corner = mesh.vertices[mesh.faces].astype(np.float64)
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        area = 0.5 * float(np.linalg.norm(cross, axis=1).sum())
        rows.append({"share": share, "leaves": tree.n_leaves, "triangles": tree.n_faces, "area_m2": area})
    for row in rows:
        row["area_error"] = row["area_m2"] / rows[0]["area_m2"] - 1.0
    return rows


def measure_memory(graph: Any, foliage: Any, n: int) -> dict[str, Any]:
    """Peak of the process, and what Python holds, after the first hundred trees and after a thousand."""
    from render import DETAIL, decode_tree, flat_parts

    rng = np.random.default_rng(SEED)
    held, peak = [], []
    tracemalloc.start()
    for k in range(TREES):
        tree = decode_tree(graph, make_instances(rng, graph, n), foliage, settings=DETAIL["coarse"])
        parts = flat_parts(tree)
        del tree, parts
        if k + 1 in (WARM_TREES, TREES):
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
            peak.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    tracemalloc.stop()
    return {
        "trees": TREES,
        "held_growth_kb": (held[1] - held[0]) / 1e3,
        "peak_mb": peak[1] / 1e3,
        "peak_growth_mb": (peak[1] - peak[0]) / 1e3,
    }


def leaf_look() -> Any:
    """A material with a leaf of 128 pixels as its texture."""
    from render import Material, Texture

    y, x = (np.mgrid[0:128, 0:128] + 0.5) / 128.0
    pixels = np.full((128, 128, 4), (80, 130, 45, 0), np.uint8)
    pixels[..., 3][np.abs(x - 0.5) < 0.46 * np.sin(np.pi * y) ** 0.7] = 255
    return Material("leaf", (1, 1, 1), double_sided=True, texture=Texture(pixels), alpha_cutoff=0.5)


def measure_pictures(graph: Any, patches: list[Any]) -> list[dict[str, Any]]:
    """Seconds for a picture of 1024 x 1024 pixels of a tree with so many leaves, and what drew it."""
    from render import decode_tree, find_gl, flat_parts, make_foliage, preview
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    tree = ClusterTree(graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3))
    foliage = make_foliage(patches, leaf=leaf_look())
    instances = make_instances(np.random.default_rng(SEED), graph, PICTURE_LEAVES // LEAVES_PER_PATCH)
    decoded = decode_tree(graph, instances, foliage)
    parts = flat_parts(decoded)
    rows = []
    for renderer in ("software", "gl") if find_gl().platform else ("software",):
        seconds = []
        for _ in range(PICTURES):
            start = perf_counter()
            drawn = preview(tree, size=(1024, 1024), renderer=renderer, parts=parts)
            seconds.append(perf_counter() - start)
        row = {"renderer": drawn.renderer, "leaves": decoded.n_leaves, "triangles": decoded.n_faces}
        rows.append(row | {"first_s": seconds[0], "best_s": min(seconds)})
    return rows


def print_rows(rows: list[dict[str, Any]]) -> None:
    """A table of all columns."""
    print("| " + " | ".join(rows[0]) + " |")
    print("|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()) + " |")
    print(flush=True)


def run(arguments: Namespace) -> None:
    """Print four tables."""
    from render import make_foliage

    rng = np.random.default_rng(SEED)
    patches = [make_patch(rng) for _ in range(N_PATCHES)]
    graph, foliage = make_skeleton(rng), make_foliage(patches)
    speed = [row for triangles in TRIANGLES for row in measure_speed(graph, foliage, triangles)]
    print_rows(speed)
    levels = measure_levels(graph, patches, 1000)
    print_rows(levels)
    memory = measure_memory(graph, foliage, 200)
    print_rows([memory])
    pictures = measure_pictures(graph, patches)
    print_rows(pictures)
    report.write_json(getattr(arguments, "json", None), "decoding", [*speed, *levels, memory, *pictures])


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.decoding", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
