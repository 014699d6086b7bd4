"""docs/data-model.md against the classes it describes: the same names, order and types."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import treegraph
from recon import encode
from recon.cloud import Cloud
from sapwood.cylinders import CYLINDER_DTYPE
from tests.corpus import TREES, realistic_cluster_tree
from treegraph import Cluster, ClusterTree, TreeGraph

PAGE = (Path(__file__).parents[1] / "docs" / "data-model.md").read_text(encoding="utf-8")


def table(heading):
    """Rows of the first table after a heading: first column to the other columns."""
    after = re.split(rf"^#+ {heading}$", PAGE, flags=re.MULTILINE)[1]
    lines = re.search(r"^\|.*?(?:\n\n|\Z)", after, flags=re.MULTILINE | re.DOTALL)[0].strip().splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0].strip("`"): row[1:] for row in rows[2:]}


def cloud():
    xyz = np.zeros((4, 3), np.float32)
    return Cloud(xyz, [1, 2, 3], xyz, xyz[:, 0], [1, 2, 3, -1], [1, 0, 1, 0], epsg=32632, unit="m")


TREE = realistic_cluster_tree(TREES["comb"], 2)
OBJECTS = {
    "TreeGraph": (TreeGraph, TREES["comb"]),
    "Cluster": (Cluster, TREE.clusters[0]),
    "ClusterTree": (ClusterTree, TREE),
    "Cloud": (Cloud, cloud()),
}


@pytest.mark.parametrize("heading", OBJECTS)
def test_every_field_with_its_type_and_shape(heading):
    kind, example = OBJECTS[heading]
    rows = table(heading)
    assert list(rows) == [field.name for field in dataclasses.fields(kind)]
    for name, (dtype, shape, *_) in rows.items():
        value = getattr(example, name)
        if isinstance(value, np.ndarray):
            assert dtype == value.dtype.name
            columns = re.fullmatch(r"\((?:\w+, ?)?(\d+)?\)", shape)[1]
            assert value.shape[-1:] == (int(columns),) if columns else value.ndim == 1
        elif dtype not in ("mapping of name to array", "tuple of Cluster", "tuple of str"):
            assert dtype == type(value).__name__


def test_cylinder_columns():
    rows = table("The cylinder table")
    assert list(rows) == list(CYLINDER_DTYPE.names)
    for name, (dtype, *_) in rows.items():
        assert dtype == CYLINDER_DTYPE[name].name


def test_derived_arrays():
    tree = TREES["comb"]
    n, c = tree.n_nodes, treegraph.chains(tree)[0].size - 1
    sizes = {"n": n, "n + 1": n + 1, "n - roots": n - 1, "c + 1": c + 1, "n - roots + c": n - 1 + c}
    for name, (dtype, shape, *_) in table("What is derived from it").items():
        more = (0.4, 1.5) if name == "allometric_radii" else ()
        got = getattr(treegraph, name)(tree, *more)
        arrays = got if isinstance(got, tuple) else (got,)
        assert dtype == ", ".join(array.dtype.name for array in arrays)
        assert [sizes[size] for size in re.findall(r"\(([^,]+),\)", shape)] == [a.size for a in arrays]


def test_attributes_of_a_reconstruction():
    rng = np.random.default_rng(0)
    turn, height = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0, 4, 8000)
    radius = 0.15 - 0.02 * height
    trunk = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    graph = encode(trunk).graph
    rows = table("Attributes that `recon` sets")
    assert set(rows) == set(graph.attribute)
    for name, (dtype, *_) in rows.items():
        assert graph.attribute[name].dtype.name == dtype
        assert graph.attribute[name].shape == (graph.n_nodes,)
    assert (graph.attribute["arc"] >= 0).all() and (graph.attribute["arc"] <= 1).all()
    assert graph.attribute["arc"][graph.attribute["measured"]].max() > 0.8  # points all around
    assert (graph.attribute["n_points"] >= 0).all()
