"""Clusters and cluster trees: rules, messages, copies."""

import copy
import pickle

import numpy as np
import numpy.testing as npt
import pytest

from tests.corpus import TREES, realistic_cluster_tree
from treegraph import DEFAULT_ALLOMETRY, Allometry, Cluster, ClusterTree, TreeError, TreeGraph

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
GRAPH = TreeGraph([-1, 0, 1], [(0, 0, 0), (0, 0, 1), (0, 0, 2)], [0.1, 0.1, 0.0])

DUPLICATE = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda thing: pickle.loads(pickle.dumps(thing)),
}


def cluster(**changes):
    return Cluster(
        **({"vertices": CORNERS, "faces": FACES, "seed": [2], "density": 90.0, "n_points": 15} | changes)
    )


def tree(**changes):
    parts = {
        "graph": GRAPH,
        "clusters": (cluster(),),
        "species": "Pine",
        "allometry": DEFAULT_ALLOMETRY,
        "origin": (4.5e5, 5.4e6, 231.75),
        "epsg": 32632,
    }
    return ClusterTree(**(parts | changes))


class TestCluster:
    def test_types(self):
        made = cluster(
            vertices=CORNERS.astype(np.float32), faces=FACES.astype(np.uint16), n_points=np.int64(15)
        )
        assert made.vertices.dtype == np.float64
        assert made.faces.dtype == made.seed.dtype == np.int32
        assert type(made.density) is float and type(made.n_points) is int

    def test_arrays_are_read_only_copies(self):
        vertices = CORNERS.copy()
        made = cluster(vertices=vertices)
        vertices[0] = 9.0
        npt.assert_array_equal(made.vertices, CORNERS)
        for array in (made.vertices, made.faces, made.seed):
            assert array.flags.c_contiguous
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0

    def test_an_empty_hull_and_an_unknown_density_are_allowed(self):
        empty = cluster(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), int), seed=[], density=np.nan)
        assert empty.vertices.shape == (0, 3) and np.isnan(empty.density)

    @pytest.mark.parametrize(
        "changes, match",
        [
            ({"vertices": CORNERS[:, :2]}, r"vertices must have shape \(v, 3\), got \(4, 2\)"),
            ({"vertices": CORNERS[0]}, r"vertices must have shape \(v, 3\), got \(3,\)"),
            ({"vertices": "hull"}, "vertices must be an array of numbers"),
            (
                {"vertices": np.where(np.eye(4, 3) > 0, np.nan, CORNERS)},
                r"vertices must be finite, but vertices\[0\] is \[nan",
            ),
            ({"faces": FACES[0]}, r"faces must have shape \(f, 3\), got \(3,\)"),
            ({"faces": FACES * 1.0}, "faces must hold integers, got dtype float64"),
            (
                {"faces": FACES + 1},
                r"faces must index the 4 vertices, but faces\[1\] is \[1 2 4\]; 3 of 4 faces break this",
            ),
            ({"faces": FACES - 1}, r"faces must index the 4 vertices, but faces\[0\] is \[-1  1  0\]"),
            ({"seed": [[2]]}, r"seed must have shape \(s,\), got \(1, 1\)"),
            ({"seed": [0.5]}, "seed must hold integers, got dtype float64"),
            ({"density": -1}, "density must be >= 0 points per cubic metre, or NaN, got -1.0"),
            ({"density": np.inf}, "density must be >= 0 points per cubic metre, or NaN, got inf"),
            ({"n_points": -1}, "n_points must be >= 0, got -1"),
        ],
    )
    def test_broken_rule_is_named(self, changes, match):
        with pytest.raises(TreeError, match=match):
            cluster(**changes)

    def test_moved_keeps_its_faces_and_is_checked(self):
        old = cluster()
        new = old.moved(CORNERS + 1.0, np.array([0, 3]), np.nan)
        npt.assert_array_equal(new.vertices, CORNERS + 1.0)
        assert new.seed.tolist() == [0, 3] and new.seed.dtype == np.int32 and np.isnan(new.density)
        assert new.faces is old.faces and new.n_points == old.n_points
        assert not new.vertices.flags.writeable and not new.seed.flags.writeable
        assert old.density == 90.0 and old.seed.tolist() != [0, 3]
        npt.assert_array_equal(old.vertices, CORNERS)

    @pytest.mark.parametrize(
        "changes, match",
        [
            ({"vertices": [[0, 0, 0], [1]]}, "vertices must be an array of numbers"),
            ({"vertices": CORNERS[:3]}, r"vertices must have shape \(4, 3\), got \(3, 3\)"),
            ({"vertices": np.full((4, 3), np.inf)}, "vertices must be finite"),
            ({"seed": [[0]]}, r"seed must have shape \(s,\), got \(1, 1\)"),
            ({"seed": [0.5]}, "seed must hold integers"),
            ({"density": -1.0}, "density must be >= 0"),
            ({"density": np.inf}, "density must be >= 0"),
        ],
    )
    def test_moved_names_what_is_wrong(self, changes, match):
        with pytest.raises(TreeError, match=match):
            cluster().moved(**{"vertices": CORNERS, "seed": [0], "density": 1.0, **changes})

    def test_repr(self):
        assert repr(cluster()) == "<Cluster 4 vertices, 4 faces, 1 seed>"
        assert repr(cluster(seed=[0, 1])) == "<Cluster 4 vertices, 4 faces, 2 seeds>"

    @pytest.mark.parametrize("duplicate", DUPLICATE.values(), ids=DUPLICATE)
    def test_copies_are_equal_and_read_only(self, duplicate):
        twin = duplicate(cluster())
        for name in ("vertices", "faces", "seed"):
            npt.assert_array_equal(getattr(twin, name), getattr(cluster(), name))
            assert not getattr(twin, name).flags.writeable
        assert (twin.density, twin.n_points) == (90.0, 15)


class TestClusterTree:
    def test_parts(self):
        made = tree(clusters=[cluster(), cluster(seed=[0])], epsg=np.int32(32632))
        assert isinstance(made.clusters, tuple) and len(made.clusters) == 2
        assert made.origin.dtype == np.float64 and not made.origin.flags.writeable
        npt.assert_array_equal(made.origin, [4.5e5, 5.4e6, 231.75])
        assert type(made.epsg) is int

    def test_unknown_place_and_species(self):
        bare = ClusterTree(GRAPH, (), None, DEFAULT_ALLOMETRY, np.zeros(3))
        assert (bare.species, bare.epsg, bare.clusters) == (None, None, ())

    @pytest.mark.parametrize(
        "changes, match",
        [
            ({"graph": None}, "graph must be of type TreeGraph, got NoneType"),
            ({"allometry": 1.5}, "allometry must be of type Allometry, got float"),
            ({"clusters": [cluster(), GRAPH]}, r"clusters\[1\] must be of type Cluster, got TreeGraph"),
            (
                {"clusters": [cluster(), cluster(seed=[0, 3])]},
                r"seeds must be nodes of the graph \(0 to 2\), but clusters\[1\].seed\[1\] is 3",
            ),
            ({"clusters": [cluster(seed=[-1])]}, r"clusters\[0\].seed\[0\] is -1"),
            ({"species": ""}, "species must be a name or None, got ''"),
            ({"species": 7}, "species must be a name or None, got 7"),
            ({"epsg": 0}, "epsg must be a positive code or None, got 0"),
            ({"epsg": 2**31}, "epsg must be a positive code or None, got 2147483648"),
            ({"epsg": 32632.5}, "epsg must be a positive code or None, got 32632.5"),
            ({"epsg": "EPSG:32632"}, "epsg must be a positive code or None, got 'EPSG:32632'"),
            ({"origin": (0, 0)}, r"origin must be three finite numbers, got \(0, 0\)"),
            ({"origin": (0, 0, np.nan)}, "origin must be three finite numbers, got"),
            ({"origin": "here"}, "origin must be an array of numbers"),
        ],
    )
    def test_broken_rule_is_named(self, changes, match):
        with pytest.raises(TreeError, match=match):
            tree(**changes)

    def test_replace_checks_again(self):
        assert tree().replace(species=None).species is None
        assert tree().replace(allometry=Allometry(1.5, 1.5, 1.0)).allometry.f_s == 1.0
        with pytest.raises(TreeError, match="seeds must be nodes of the graph"):
            tree().replace(graph=TREES["one node"])

    def test_repr(self):
        assert repr(tree()) == "<ClusterTree 3 nodes, 1 cluster, Pine>"
        assert repr(tree(clusters=(), species=None)) == "<ClusterTree 3 nodes, 0 clusters>"

    @pytest.mark.parametrize("duplicate", DUPLICATE.values(), ids=DUPLICATE)
    def test_copies_are_equal_and_read_only(self, duplicate):
        made = realistic_cluster_tree(TREES["bush"], 5)
        twin = duplicate(made)
        npt.assert_array_equal(twin.graph.position, made.graph.position)
        npt.assert_array_equal(twin.origin, made.origin)
        assert (twin.species, twin.epsg, twin.allometry) == (made.species, made.epsg, made.allometry)
        for one, other in zip(twin.clusters, made.clusters, strict=True):
            npt.assert_array_equal(one.vertices, other.vertices)
            assert not one.vertices.flags.writeable
        assert not twin.origin.flags.writeable
        assert not twin.graph.position.flags.writeable
