import numpy as np
import numpy.testing as npt
import pytest
from scipy.spatial import cKDTree
from synthetic import axis_samples, crown, forked_tree, graph_samples

from recon import Encoder, EncodeSettings, encode, encode_with_report, encoding
from treegraph.errors import InputError

WOOD = EncodeSettings(f_s=1.0)


def same(a, b, atol=0.0):
    npt.assert_array_equal(a.graph.parent, b.graph.parent)
    npt.assert_allclose(a.graph.position, b.graph.position, atol=atol, rtol=0)
    npt.assert_allclose(a.graph.radius, b.graph.radius, atol=atol, rtol=0)
    assert len(a.clusters) == len(b.clusters)
    for x, y in zip(a.clusters, b.clusters, strict=True):
        npt.assert_allclose(x.vertices, y.vertices, atol=atol, rtol=0)
        npt.assert_array_equal(x.seed, y.seed)


def test_a_known_tree_comes_back(rng):
    xyz = forked_tree(rng)
    tree = encode(xyz, settings=WOOD)
    at, length, radius = graph_samples(tree.graph)
    truth, true_radius = axis_samples()
    to_model, nearest = cKDTree(at + tree.origin).query(truth)
    to_truth, _ = cKDTree(truth).query(at + tree.origin)
    assert np.mean(to_model < 0.02) > 0.97
    outside = to_truth < 0.02
    assert length[outside].sum() / length.sum() > 0.95  # the feet of branches run inside the stem
    error = np.abs(radius[nearest] - true_radius) / true_radius
    assert np.median(error[to_model < 0.02]) < 0.05
    assert tree.graph.attribute["measured"].mean() > 0.5


def test_order_of_the_points_does_not_matter(rng):
    xyz = np.concatenate([forked_tree(rng), crown(rng, 3000)])
    same(encode(xyz), encode(xyz[rng.permutation(len(xyz))]))


@pytest.mark.parametrize("shape", ["upside down", "noise", "sheet"])
def test_order_of_the_points_does_not_matter_without_a_clear_foot(rng, shape):
    xyz = forked_tree(rng, density=3000)
    if shape == "sheet":
        row, column = np.meshgrid(np.arange(20) * 0.05, np.arange(20) * 0.05)
        xyz = np.stack([row.ravel(), 0 * row.ravel(), column.ravel()], axis=1)
    xyz = xyz * [1, -1, -1] if shape == "upside down" else xyz
    xyz = xyz + 0.05 * rng.standard_normal(xyz.shape) if shape == "noise" else xyz
    for _ in range(3):
        same(encode(xyz), encode(xyz[rng.permutation(len(xyz))]))


def test_same_points_same_tree(rng):
    xyz = np.concatenate([forked_tree(rng), crown(rng, 3000)])
    same(encode(xyz), encode(xyz.copy()))


def test_map_coordinates_lose_nothing(rng):
    xyz = forked_tree(rng)
    near, far = encode(xyz, settings=WOOD), encode(xyz + [445_000.0, 5_410_000.0, 312.0], settings=WOOD)
    npt.assert_allclose(far.origin - near.origin, [445_000.0, 5_410_000.0, 312.0], atol=1e-3)
    a, b = graph_samples(near.graph)[0], graph_samples(far.graph)[0]
    assert np.quantile(cKDTree(a).query(b)[0], 0.99) < 0.01
    assert far.graph.position.max() < 100


def test_heading_does_not_matter(rng):
    xyz = forked_tree(rng)
    c, s = np.cos(1.1), np.sin(1.1)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    a, b = encode(xyz, settings=WOOD), encode(xyz @ turn.T, settings=WOOD)
    at = graph_samples(a.graph)[0] + a.origin
    turned = (graph_samples(b.graph)[0] + b.origin) @ turn
    assert np.quantile(cKDTree(at).query(turned)[0], 0.95) < 0.02


def test_thinned_points_give_the_same_tree(rng):
    xyz = forked_tree(rng, density=60_000)
    full, few = (
        encode_with_report(xyz, settings=WOOD),
        encode_with_report(xyz, settings=EncodeSettings(f_s=1.0, max_points=12_000)),
    )
    assert few.report.n_points_used <= 12_000 < full.report.n_points_used
    a, b = (graph_samples(e.tree.graph)[0] + e.tree.origin for e in (full, few))
    assert np.quantile(cKDTree(a).query(b)[0], 0.95) < 0.03
    assert few.report.dbh_m == pytest.approx(full.report.dbh_m, rel=0.03)


def test_doubled_points_do_no_harm(rng):
    xyz = forked_tree(rng)
    a, b = encode(xyz, settings=WOOD), encode(np.concatenate([xyz, xyz]), settings=WOOD)
    at = graph_samples(a.graph)[0] + a.origin
    assert np.quantile(cKDTree(at).query(graph_samples(b.graph)[0] + b.origin)[0], 0.95) < 0.02


def test_a_scan_looked_at_once_gives_every_species_its_own_tree(rng, monkeypatch):
    xyz = np.concatenate([forked_tree(rng), crown(rng)])
    made = {name: 0 for name in ("prepare", "joined_graph", "grow_skeleton")}

    def counted(name, real):
        def run(*given, **named):
            made[name] += 1
            return real(*given, **named)

        return run

    for name in made:
        monkeypatch.setattr(encoding, name, counted(name, getattr(encoding, name)))
    encoder = Encoder(xyz)
    found = {name: encoder.encode(species=name) for name in (None, "Pine", "Terminalia")}
    assert made["prepare"] == made["joined_graph"] == 1
    assert encoder.encode().tree.clusters
    assert made["grow_skeleton"] <= 3
    for name, again in found.items():
        alone = encode_with_report(xyz, species=name)
        same(again.tree, alone.tree)
        assert again.tree.allometry == alone.tree.allometry
        assert again.tree.species == name
        assert again.report.dbh_m == alone.report.dbh_m
    assert "prepare" in found[None].report.seconds and "prepare" not in found["Terminalia"].report.seconds


def test_report_and_attributes(rng):
    result = encode_with_report(forked_tree(rng), species="Pine", settings=WOOD)
    graph = result.tree.graph
    assert result.tree.species == "Pine"
    assert result.tree.allometry.gamma == 1.2 and result.tree.allometry.beta == 1.3
    assert result.tree.allometry.d_root == pytest.approx(2 * graph.radius[0])
    assert set(graph.attribute) == {"measured", "n_points", "arc"}
    assert graph.attribute["n_points"].sum() > 0.9 * result.report.n_points_used
    assert (graph.attribute["arc"] >= 0).all() and (graph.attribute["arc"] <= 1).all()
    assert sorted(result.report.seconds) == ["clusters", "hulls", "prepare", "radii", "skeleton"]
    assert graph.position[0] == pytest.approx(0, abs=0.15)
    assert (graph.radius[1:] <= graph.radius[graph.parent[1:]] + 1e-12).all()


@pytest.mark.parametrize(
    "name, value",
    [
        ("beta", 0.5),
        ("gamma", 0.0),
        ("f_s", 0.0),
        ("f_s", 1.5),
        ("f_s", float("nan")),
        ("n_neighbours", 2),
        ("max_points", 10),
        ("max_nodes", 1),
        ("max_clusters", 0),
        ("max_faces", 4),
        ("f_s", "x"),
        ("max_nodes", None),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(InputError, match=f"{name} must be between .* and .*, got {value!r}"):
        EncodeSettings(**{name: value})


@pytest.mark.parametrize("name", ["n_neighbours", "max_points", "max_nodes", "max_clusters", "max_faces"])
def test_counts_are_whole(name):
    with pytest.raises(InputError, match=f"{name} must be a whole number, got"):
        EncodeSettings(**{name: getattr(EncodeSettings(), name) + 0.5})


def test_prepare_settings_are_such():
    with pytest.raises(InputError, match="prepare must be PrepareSettings, got None"):
        EncodeSettings(prepare=None)


def test_beta_and_gamma_are_those_asked_for(rng):
    xyz = np.concatenate([forked_tree(rng, density=3000), crown(rng, 3000)])
    tree = encode(xyz, species="Pine", settings=EncodeSettings(f_s=1.0, beta=3.5, gamma=2.5))
    assert (tree.allometry.beta, tree.allometry.gamma) == (3.5, 2.5)
    thin, thick = (encode(xyz, settings=EncodeSettings(f_s=1.0, gamma=g)).graph for g in (4.0, 0.6))
    mean_radius = [g.radius[~g.attribute["measured"]].mean() for g in (thin, thick)]
    assert mean_radius[0] < 0.9 * mean_radius[1]
    near, far = (encode(xyz, settings=EncodeSettings(f_s=1.0, beta=b)).graph for b in (1.0, 4.0))
    assert near.n_nodes != far.n_nodes or (near.parent != far.parent).any()


def test_unknown_species_is_named(rng):
    for name in ("Triffid", ""):
        with pytest.raises(InputError, match=f"species must be one of .*Pine.*, got {name!r}"):
            encode(forked_tree(rng), species=name)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_points(n):
    with pytest.raises(InputError, match="point"):
        encode(np.zeros((n, 3)))


@pytest.mark.parametrize("max_nodes", [16, 100])
def test_budget_of_nodes(rng, max_nodes):
    assert (
        encode(forked_tree(rng), settings=EncodeSettings(f_s=1.0, max_nodes=max_nodes)).graph.n_nodes
        <= max_nodes
    )


def test_a_leafy_foot_is_no_stem():
    rng = np.random.default_rng(5)
    turn, height = rng.uniform(0, 2 * np.pi, 6000), 3.0 * rng.random(6000)
    out = (0.55 + 0.25 * rng.random(6000)) * np.sqrt(1.0 - (height / 3.6) ** 2)
    shrub = np.column_stack([out * np.cos(turn), out * np.sin(turn), height])
    made = encode_with_report(shrub, settings=EncodeSettings(f_s=0.97))
    assert 0.0 < made.tree.graph.radius.max() <= 0.03 + 1e-9
    assert made.report.dbh_m is None and made.report.dbh_reason
