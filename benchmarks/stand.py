"""A stand of trees: bytes of the trees and their species beside Draco, and memory while all are decoded.

Each tree is grown with its species' own parameters, scanned virtually from four sides and reconstructed
with its species. Draco (the package DracoPy; left out if it is not installed) compresses the flat meshes of
the same decoded trees at 14 bits for positions, 10 for texture coordinates and 8 for normals, at level 7 of
10, four trees of each species, whose mean stands for all; the pictures of the species are added once.
Wanted: .lobes and species together under 2 MB for 100 trees of 5 species, each species under 200 kB, and
memory that does not grow while a thousand trees are decoded.

    python -m benchmarks.stand
    python -m benchmarks.stand --trees 20
"""

from __future__ import annotations

import resource
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.grown_truth import scan_case

SPECIES = ("Oak", "Beech", "Birch", "Spruce", "Pine")
N_TREES = 100
N_DECODED = 1000
STEP_DEG = 0.2
DRACO_EACH = 4  # trees of each species that Draco compresses; it takes its time
AGES = (0.3, 0.7)  # of the age at which its species is grown up
WANTED, WANTED_SPECIES = 2_000_000, 200_000
LEVEL = 7
BITS = {"quantization_bits": 14, "tex_coord_quantization_bits": 10, "normal_quantization_bits": 8}


def make_tree(species: str, seed: int) -> Any:
    """A tree of a species, of some age, as it is reconstructed from a virtual scan."""
    from dataclasses import replace

    import sapwood
    from sapwood.growing import Request, grow_group
    from species.library import builtin_library

    growth = builtin_library().find(species).growth
    assert growth is not None
    share = np.random.default_rng(seed).uniform(*AGES)
    kind = replace(growth, age=max(4, round(share * growth.age)))
    points = scan_case(grow_group(Request(kind, seed)), seed, STEP_DEG)
    return sapwood.reconstruct(points, species=species, name=f"{species} {seed}", base=(0.0, 0.0, 0.0)).tree


def draco_bytes(parts: Any) -> int | None:
    """Bytes of all parts' meshes as Draco writes them; None without the package."""
    try:
        import DracoPy
    except ImportError:
        return None
    total = 0
    for part in parts:
        mesh = part.mesh
        more = {"normals": np.ascontiguousarray(mesh.normals, np.float64), "compression_level": LEVEL}
        uv = None if mesh.uv is None else np.ascontiguousarray(mesh.uv, np.float64)
        points = np.ascontiguousarray(mesh.vertices, np.float32)
        faces = np.ascontiguousarray(mesh.faces, np.uint32)
        total += len(DracoPy.encode(points, faces, tex_coord=uv, **more, **BITS))
    return total


def decode_all(blobs: list[tuple[str, bytes]], n: int) -> tuple[float, float, float]:
    """Decode n trees to flat meshes in a row: peak memory after a tenth and at the end (MB), seconds each."""
    from time import perf_counter

    import treegraph
    from sapwood.dressing import dress
    from species.library import find_species

    early = start = 0.0
    for k in range(n):
        name, blob = blobs[k % len(blobs)]
        parts = dress(treegraph.decode_lobes(blob), find_species(name), seed=k).parts()
        del parts
        if k == n // 10:
            early, start = _peak_mb(), perf_counter()
    return early, _peak_mb(), (perf_counter() - start) / max(n - n // 10 - 1, 1)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """One row for each species, and the sums."""
    import treegraph
    from sapwood.dressing import dress
    from species.library import find_species

    n = getattr(arguments, "trees", N_TREES)
    rows: list[dict[str, Any]] = []
    blobs: list[tuple[str, bytes]] = []
    for index, name in enumerate(SPECIES):
        kind = find_species(name)
        sizes, draco, faces = [], [], []
        for k in range(index, n, len(SPECIES)):
            print(f"{name} {k}", file=sys.stderr)
            tree = make_tree(name, k)
            blob = treegraph.encode_lobes(tree)
            blobs.append((name, blob))
            dressed = dress(treegraph.decode_lobes(blob), kind)
            sizes.append(len(blob))
            faces.append(dressed.decoded.n_faces)
            size = draco_bytes(dressed.parts()) if len(draco) < DRACO_EACH else None
            draco += [] if size is None else [size]
        pictures = sum(len(picture) for picture in kind.pictures.values())
        rows.append(
            {
                "species": name,
                "trees": len(sizes),
                "lobes_kB": sum(sizes) / 1000.0,
                "largest_kB": max(sizes) / 1000.0,
                "species_kB": kind.n_bytes / 1000.0,
                "triangles": int(np.sum(faces)),
                "draco_kB": (np.mean(draco) * len(sizes) + pictures) / 1000.0 if draco else None,
            }
        )
    print(report.table(rows))
    ours = sum(row["lobes_kB"] + row["species_kB"] for row in rows)
    theirs = sum(row["draco_kB"] or 0.0 for row in rows)
    print(f"{len(blobs)} trees and their species: {ours:.0f} kB (wanted under {WANTED / 1000:.0f})", end="")
    print(f"; Draco {theirs:.0f} kB, {theirs / ours:.0f} times as much" if theirs else "")
    many = getattr(arguments, "decoded", N_DECODED)
    early, late, seconds = decode_all(blobs, many)
    print(
        f"{many} trees decoded to flat meshes: peak memory {early:.0f} MB after a tenth, {late:.0f} MB "
        f"at the end; {1000.0 * seconds:.0f} ms a tree"
    )
    report.write_json(arguments.json, "stand", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.stand", description=__doc__.splitlines()[0])
    parser.add_argument("--trees", type=int, default=N_TREES, help="how many in all")
    parser.add_argument("--decoded", type=int, default=N_DECODED, help="how many are decoded in a row")
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
