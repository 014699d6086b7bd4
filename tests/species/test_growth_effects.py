"""What each of the 24 parameters does to a tree, as the paper states it; several trees, fixed seeds."""

import math

import numpy as np
import pytest

from species import GrowthSettings, Site, grow_many, parameter_table
from tests.species.growing import FREE, grown, plain, preset, steps
from treegraph import Leaves, Occluders, Sky

TREES = 12
CERTAIN = 4.0  # standard errors between the means of two groups


# ---------------------------------------------------------------- what is measured


def height(tree):
    return tree.position[:, 2].max()


def nodes(tree):
    return float(tree.n_nodes)


def log_nodes(tree):
    return math.log(tree.n_nodes)


def spread(tree):
    """Mean distance from the trunk's axis over height."""
    return np.hypot(*tree.position[:, :2].T).mean() / height(tree)


def height_to_width(tree):
    x, y, z = np.ptp(tree.position, axis=0)
    return z / (0.5 * (x + y) + 0.1)


def branching(tree):
    """Side branches per node: how often the tree branches."""
    begins = tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]
    return begins.sum() / tree.n_nodes


def crookedness(tree):
    """Way along the trunk over its straight length."""
    trunk = tree.attribute["order"] == 0
    way = np.linalg.norm(steps(tree)[trunk[1:]], axis=1).sum()
    return way / np.linalg.norm(tree.position[trunk][-1])


def side_bearings(tree):
    """Of side branches' first segments: azimuth, and angle to the vertical, radians."""
    first = tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]
    step = steps(tree)[first]
    return np.arctan2(step[:, 1], step[:, 0]), np.arccos(step[:, 2] / np.linalg.norm(step, axis=1))


def angle_spread(tree):
    return side_bearings(tree)[1].std()


def resultant(tree):
    """Length of the mean of the turns from each side branch of a comb to the next, 0 to 1: no spread is 1."""
    turn = np.diff(side_bearings(tree)[0])
    return math.hypot(np.cos(turn).mean(), np.sin(turn).mean())


def turn_towards_a_third(tree):
    """Nearness of these turns to 120 degrees rather than 90."""
    turn = np.mod(np.diff(side_bearings(tree)[0]), 2 * math.pi)
    return np.abs(turn - math.radians(90)).mean() - np.abs(turn - math.radians(120)).mean()


def leaning(tree):
    return tree.position[:, 0].mean()


def rise(tree):
    """Mean height of the side branches' segments per metre."""
    side = tree.attribute["order"][1:] > 0
    step = steps(tree)[side]
    return (step[:, 2] / np.linalg.norm(step, axis=1)).mean()


def lowest_branch(tree):
    first = tree.attribute["order"] > 0
    return tree.position[first, 2].min() if first.any() else height(tree)


def living_buds(tree):
    return tree.attribute["lateral_buds"].sum() / tree.n_nodes


# ---------------------------------------------------------------- the table

COMB = {"NLB": 1, "AC": 20.0, "BAM": 60, "GR": 1.0, "IBL": 0.3}  # a trunk with one twig of one node at each
SHADE = Site(occluders=Occluders(Leaves(np.zeros((1, 3)), np.array([900.0]), np.array([0.5]))))
EVENING = Site(sky=Sky((1.0, 0.0, 0.4)))
BARE = GrowthSettings(foliage=0.0)

#: symbol, low, high, what is measured, which way it goes, kind of tree, cycles, where, settings
EFFECTS = [
    ("AAV", 4, 200, crookedness, +1, plain(NLB=0, IBL=0.3), 20, Site(), FREE),
    ("NLB", 1, 3, branching, +1, preset("F6b"), 11, Site(), None),
    ("BAM", 25, 65, spread, +1, preset("F6b"), 14, Site(), None),
    ("BAV", 1, 200, angle_spread, +1, plain(**COMB), 30, Site(), FREE),
    ("RAM", 90, 120, turn_towards_a_third, +1, plain(**COMB, RAV=9), 30, Site(), FREE),
    ("RAV", 4, 900, resultant, -1, plain(**COMB), 40, Site(), FREE),
    ("AB_D", 0.02, 0.2, height, -1, preset("F6d", LF_A=0.0), 20, Site(), None),
    ("LB_D", 0.02, 0.6, branching, -1, preset("F6b"), 12, Site(), None),
    ("LF_A", 0.2, 2.0, height, -1, preset("F6d"), 18, SHADE, None),
    ("LF_L", 0.2, 2.0, branching, -1, preset("F6d"), 14, SHADE, None),
    ("AD_BF", 0.3, 6.0, branching, -1, preset("F6b"), 14, Site(), None),
    ("AD_DF", 0.1, 0.9, branching, -1, preset("F6b", AD_BF=3), 14, Site(), None),
    ("AD_AF", 0.7, 1.0, branching, -1, preset("F6b", AD_BF=2), 14, Site(), None),
    ("GR", 1.0, 3.0, height, +1, preset("F6e"), 9, Site(), None),
    ("IBL", 0.2, 0.6, height, +1, preset("F6b"), 12, Site(), None),
    ("IL_AF", 0.85, 0.99, height, +1, preset("F6d"), 16, Site(), None),
    ("AC", 1.5, 6.0, height_to_width, +1, preset("F6e", AC_AF=1), 10, Site(), None),
    ("AC_AF", 0.8, 1.0, nodes, -1, preset("F6d"), 16, Site(), None),
    ("PT", -0.1, 0.3, leaning, +1, preset("F6b"), 12, EVENING, None),
    ("GT", -0.1, 0.3, rise, +1, preset("F6b", GBS=0), 11, Site(), None),
    ("PF", 0.2, 3.0, log_nodes, -1, preset("F6b", LB_PF=0), 16, Site(), None),
    ("LB_PF", 0.5, 4.0, lowest_branch, +1, preset("F6b"), 16, Site(), None),
    ("GBS", 0.0, 2.0, rise, -1, preset("F6d"), 18, Site(), None),
    ("GBA", 0.05, 0.9, rise, -1, preset("F6d", GBS=1), 18, Site(), None),
]


def group(kind, symbol, value, age, site, settings):
    jobs = [(kind.replace(**{symbol: value}), age)] * TREES
    return [
        g.tree for g in grow_many(jobs, seed=5, workers=1, site=site, settings=settings or GrowthSettings())
    ]


def separation(one, two):
    """Welch's t: how many standard errors lie between the means."""
    return (np.mean(two) - np.mean(one)) / math.sqrt(
        (np.var(one, ddof=1) + np.var(two, ddof=1)) / TREES + 1e-12
    )


@pytest.mark.parametrize("effect", EFFECTS, ids=[effect[0] for effect in EFFECTS])
def test_effect_of_a_parameter(effect):
    symbol, low, high, measure, way, kind, age, site, settings = effect
    values = [
        [measure(tree) for tree in group(kind, symbol, value, age, site, settings)] for value in (low, high)
    ]
    assert way * separation(*values) > CERTAIN, (np.mean(values[0]), np.mean(values[1]))


def test_all_parameters_have_their_effect_tested():
    assert [effect[0] for effect in EFFECTS] == [row["symbol"] for row in parameter_table()]


def test_shading_and_pruning_clear_the_bole():
    """Not only fewer branches: the ones in deep shade, low on the trunk."""
    kept, pruned = (group(preset("F6b", LB_PF=0), "PF", value, 16, Site(), None) for value in (0.0, 3.0))
    deep = [[(t.attribute["light"] < 0.15).mean() for t in trees] for trees in (kept, pruned)]
    assert separation(*deep) < -CERTAIN
    lowest = [np.mean([lowest_branch(t) for t in trees]) for trees in (kept, pruned)]
    assert lowest[1] > lowest[0]


def test_low_branches_leave_their_bearer_above_the_limit():
    for tree in group(preset("F6b"), "LB_PF", 3.0, 14, Site(), None):
        first = np.flatnonzero(tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]) + 1
        assert tree.position[tree.parent[first], 2].min() >= 3.0 - 1e-9


def test_dominance_makes_fewer_and_larger_branches():
    """Figure 3c: with strong dominance certain branches become dominant."""
    weak, strong = (group(preset("F6b"), "AD_BF", value, 14, Site(), None) for value in (0.2, 6.0))
    assert np.mean([nodes(t) for t in weak]) > 2 * np.mean([nodes(t) for t in strong])
    assert separation([branching(t) for t in weak], [branching(t) for t in strong]) < -CERTAIN


def test_low_apical_control_makes_a_round_crown():
    """Figure 3b: under 1 the branches outgrow the trunk, well above 1 the trunk rules."""
    round_, pointed = (group(preset("F6b", AC_AF=1), "AC", value, 12, Site(), None) for value in (0.27, 4.0))
    assert separation([height_to_width(t) for t in round_], [height_to_width(t) for t in pointed]) > CERTAIN


def test_positive_phototropism_turns_to_the_light_and_negative_away():
    towards, away = (
        np.mean([leaning(t) for t in group(preset("F6b", GT=0.3), "PT", pt, 12, EVENING, None)])
        for pt in (0.2, -0.2)
    )
    assert away < -0.2 < 0.2 < towards


# ---------------------------------------------------------------- distributions


def angles_between(tree, of):
    """Angles (k,) between the segments of the nodes `of` and their parents' segments; up at the root."""
    step = np.vstack([(0.0, 0.0, 1.0), steps(tree)])
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    before = step[tree.parent[of]]
    return np.arctan2(
        np.linalg.norm(np.cross(before, step[of]), axis=1), np.einsum("ij,ij->i", before, step[of])
    )


def test_apical_angle_is_half_normal_of_its_variance():
    from scipy import stats

    found = []
    for seed in range(20, 36):
        tree = grown(plain(NLB=0, AAV=100), 100, seed, settings=FREE).tree
        found.append(angles_between(tree, np.arange(1, tree.n_nodes)))
    angle = np.degrees(np.concatenate(found))
    assert angle.size == 1600
    assert stats.kstest(angle, "halfnorm", args=(0, 10)).pvalue > 0.01
    assert (angle**2).mean() == pytest.approx(100, rel=4 * math.sqrt(2 / 1600))


def test_apical_azimuth_is_uniform():
    from scipy import stats

    first = [grown(plain(NLB=0, AAV=100), 1, seed, settings=FREE).tree.position[1] for seed in range(400)]
    x, y, _ = np.array(first).T
    azimuth = np.mod(np.arctan2(y, x), math.pi)  # the angle has either sign: over half a turn
    assert stats.kstest(azimuth / math.pi, "uniform").pvalue > 0.01
    assert abs((x > 0).sum() - 200) < 4 * 10


def test_internodes_of_one_shoot_share_the_apical_angle():
    """The bud leans, not each internode: without tropisms a shoot is straight."""
    tree = grown(plain(NLB=0, AAV=400, GR=4), 6, 1, settings=FREE).tree
    turn = angles_between(tree, np.arange(1, tree.n_nodes)).reshape(6, 4)
    assert (turn[:, 0] > 1e-3).all()
    assert turn[:, 1:].max() < 1e-7


def test_branching_angle_has_its_mean_and_variance():
    from scipy import stats

    found = []
    for seed in range(6):
        tree = grown(plain(BAM=50, BAV=64, NLB=2), 7, seed, settings=FREE).tree
        first = np.flatnonzero(tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]) + 1
        found.append(angles_between(tree, first))
    angle = np.degrees(np.concatenate(found))
    assert angle.size > 1500
    assert angle.mean() == pytest.approx(50, abs=4 * 8 / math.sqrt(angle.size))
    assert angle.var() == pytest.approx(64, rel=4 * math.sqrt(2 / angle.size))
    assert stats.kstest(angle, "norm", args=(50, 8)).pvalue > 0.01


def test_branching_angles_stay_within_half_a_turn():
    for mean in (0, 180):
        tree = grown(plain(BAM=mean, BAV=3600, NLB=2), 6, 3, settings=FREE).tree
        first = np.flatnonzero(tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]) + 1
        angle = angles_between(tree, first)
        edge = np.abs(angle - math.radians(mean)) < 1e-7
        assert 0.4 < edge.mean() < 0.6  # half of a symmetric distribution is cut off


def combs(seeds, years=60, **values):
    return [grown(plain(**COMB | values), years, seed, settings=FREE).tree for seed in seeds]


def test_roll_between_nodes_has_its_mean_and_variance():
    from scipy import stats

    turns = []
    for tree in combs(range(8), RAM=137, RAV=100):
        azimuth, _ = side_bearings(tree)
        assert azimuth.size == 59
        turns.append(np.diff(azimuth))
    turn = np.degrees(np.concatenate(turns)) - 137
    turn = (turn + 180) % 360 - 180
    assert turn.mean() == pytest.approx(0, abs=4 * 10 / math.sqrt(turn.size))
    assert turn.var() == pytest.approx(100, rel=4 * math.sqrt(2 / turn.size))
    assert stats.kstest(turn, "norm", args=(0, 10)).pvalue > 0.01


@pytest.mark.parametrize("roll", [-90, 0, 30, 137.5])
def test_roll_without_variance_is_exact(roll):
    """From the x axis on: the first node has turned once."""
    (tree,) = combs([0], 20, RAM=roll)
    azimuth = np.unwrap(side_bearings(tree)[0])
    wanted = np.radians(roll) * np.arange(1, azimuth.size + 1)
    assert np.abs(np.exp(1j * azimuth) - np.exp(1j * wanted)).max() < 1e-9


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_lateral_buds_stand_around_the_node_at_equal_angles(n):
    tree = grown(plain(**COMB | {"NLB": n}), 4, 0, settings=FREE).tree
    first = np.flatnonzero(tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]) + 1
    assert len(first) == 3 * n
    for node in np.unique(tree.parent[first]):
        step = tree.position[first[tree.parent[first] == node]] - tree.position[node]
        turn = np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))) if n > 1 else np.zeros(0)
        assert turn == pytest.approx(np.full(n - 1, 2 * math.pi / n) if n != 2 else [math.pi], abs=1e-9) or (
            n == 2 and turn == pytest.approx([-math.pi], abs=1e-9)
        )


@pytest.mark.parametrize("name", ["F6a", "F6b", "F6c", "F6d", "F6e", "F6f"])
def test_internodes_have_the_length_of_their_year(name):
    p = preset(name)
    tree = grown(p, 12, 4).tree
    wanted = p.internode_length * p.internode_age ** tree.attribute["birth"][1:]
    assert np.linalg.norm(steps(tree), axis=1) == pytest.approx(wanted, rel=1e-10)


def test_lateral_buds_die_at_their_rate():
    """A pole whose lateral buds never flush: of a node's buds (1 - LB_D)^years are left."""
    rate, years = 0.15, 30
    p = plain(NLB=4, AD_BF=100, AD_DF=1, LB_D=rate, IBL=0.2)
    living, expected, variance = 0, 0.0, 0.0
    per_age = np.zeros((years, 2))
    for seed in range(25):
        tree = grown(p, years, seed, settings=FREE).tree
        assert tree.n_nodes == years + 1
        for i in range(1, tree.n_nodes):
            at_risk = years - 1 - tree.attribute["birth"][i]
            left = (1 - rate) ** at_risk
            living += int(tree.attribute["lateral_buds"][i])
            expected += 4 * left
            variance += 4 * left * (1 - left)
            per_age[at_risk] += tree.attribute["lateral_buds"][i], 4
    assert abs(living - expected) < 4 * math.sqrt(variance)
    share = per_age[:, 0] / per_age[:, 1]
    left = (1 - rate) ** np.arange(years)
    assert share[0] == 1.0
    z = (share - left) / np.sqrt(left * (1 - left) / per_age[:, 1] + 1e-12)
    assert np.abs(z[1:]).max() < 4.0
    assert (z[1:] ** 2).sum() < years - 1 + 4 * math.sqrt(2 * years)


def test_apical_buds_die_at_their_rate():
    rate, years, trees = 0.12, 8, 400
    alive = np.zeros(years + 1)
    for seed in range(trees):
        tree = grown(plain(NLB=0, AB_D=rate), years, seed, settings=FREE).tree
        grew = tree.n_nodes - 1
        alive[: grew + 1] += 1
        assert tree.attribute["bud"][-1] == (1 if grew == years else 2)
    share = alive / trees
    left = (1 - rate) ** np.arange(years + 1)
    assert np.abs((share - left)[1:] / np.sqrt(left * (1 - left) / trees + 1e-12)[1:]).max() < 4.0


def test_shoot_lengths_follow_apical_control():
    """Eq. 1 on a tree: internodes per cycle of trunk, boughs and twigs."""
    p = plain(GR=6, AC=2.2, BAM=60, NLB=1)
    tree = grown(p, 3, settings=FREE).tree
    first = tree.attribute["order"][1:] > tree.attribute["order"][tree.parent[1:]]
    last = tree.attribute["birth"] == 2
    trunk = (tree.attribute["order"] == 0) & last
    assert trunk.sum() == 6
    begun = np.flatnonzero(first & last[1:]) + 1
    for node in begun:
        bearer = tree.attribute["order"][tree.parent[node]]
        length, at = 1, node
        while True:
            follows = np.flatnonzero((tree.parent == at) & (tree.attribute["order"] == bearer + 1))
            if not follows.size:
                break
            at, length = follows[0], length + 1
        assert length == math.floor(6 / 2.2**bearer + 0.5)
    assert {int(tree.attribute["order"][tree.parent[node]]) for node in begun} == {0, 1}
