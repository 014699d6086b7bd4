"""A tree in its surroundings: against the slow reference, and what must hold of any (thesis 4.4)."""

import numpy as np
import numpy.testing as npt
import pytest

from plastic import BY_LIGHT, BY_OBSTACLE, AnalysisSettings, Neighbour, Scene, analyse, light_density
from tests.corpus import TREES
from tests.plastic.plastic_trees import (
    WALL,
    ball_cluster,
    grown_state,
    grown_tree,
    mirrored_tree,
    palm,
    random_scene,
    same,
)
from tests.plastic.reference_plastic import adapt_slowly
from treegraph import (
    DEFAULT_ALLOMETRY,
    Ball,
    Box,
    ClusterTree,
    HalfSpace,
    InputError,
    Occluders,
    Sky,
    TreeGraph,
    TriangleMesh,
    gather_light,
    make_leaves,
    make_wall,
)

FENCE = make_wall((1.5, 0, 0), (-1, 0, 0), width=8, height=3)
SCENES = {
    "wall": Scene((WALL,)),
    "fence": Scene((FENCE,)),
    "ball": Scene((Ball((1.0, 0.2, 3.0), 0.8),)),
    "glass": Scene((HalfSpace((0.8, 0, 0), (-1, 0, 0.1), 0.6),), pruning=1.0),
    "box above": Scene((Box((0, 0, 6.0), (3, 3, 0.5)),), bending=1.5),
    "low sun": Scene(sky=Sky((0.8, 0.3, 0.6)), pruning=1.0),
    "two": Scene((FENCE, Ball((-1.0, 0.5, 2.0), 0.6, 0.3)), pruning=1.3),
}


def mesh_of(box):
    """The surface of a box."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2 * box.size
    faces = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return TriangleMesh(corner @ np.asarray(box.rotation).T + box.center, np.array(faces))


def mean_tip(adapted):
    """Mean position of the living tips."""
    parent = adapted.state.tree.graph.parent
    tips = np.setdiff1d(np.arange(len(parent)), parent[adapted.alive])
    return adapted.position[tips[adapted.alive[tips]]].mean(axis=0)


# ---------------------------------------------------------------- against the reference


@pytest.mark.parametrize("name", SCENES)
def test_matches_the_reference(name):
    state, scene = grown_state(), SCENES[name]
    fast, slow = state.adapt(scene), adapt_slowly(state, scene)
    assert fast.touched
    assert fast.cause.tolist() == slow.cause.tolist()
    npt.assert_allclose(fast.position, slow.position, atol=1e-8)
    npt.assert_allclose(fast.light, slow.light, atol=1e-6)


def test_boxes_shade_as_in_the_light_model():
    from plastic import _site_kernels as sites
    from plastic.analysis import make_sky
    from plastic.stand import pack_solids
    from treegraph._light_kernels import _shade_box

    fine = make_sky(6, Sky()).fine
    walls = (Box((1.0, 0.4, 2.0), (0.3, 4.0, 3.0)), make_wall((0, 1.5, 0), (0.6, -0.8, 0), width=5, height=2))
    boxes = pack_solids(walls)[0].boxes
    slopes = sites._box_slopes(boxes, fine)
    for box, slope in zip(boxes, slopes, strict=True):
        for point in ((0.0, 0.0, 0.1), (-2.0, 1.0, 3.0), (1.0, 0.4, 2.0), (5.0, 5.0, 9.0)):
            one, other = (np.ones(fine.shape[1], np.float32) for _ in range(2))
            _shade_box(one, fine[0], fine[1], fine[2], box, *point)
            sites._shade_box(other, slope[0], slope[1], slope[2], box, *point)
            npt.assert_array_equal(other, one)


@pytest.mark.parametrize("kind, age", [("F6e", 8), ("F6c", 9)])
def test_other_kinds_match_the_reference(kind, age):
    state = grown_state(age, kind)
    scene = Scene((FENCE,), pruning=1.0)
    fast, slow = state.adapt(scene), adapt_slowly(state, scene)
    assert fast.cause.tolist() == slow.cause.tolist()
    npt.assert_allclose(fast.position, slow.position, atol=1e-8)


def test_light_of_the_analysis_is_that_of_the_light_model():
    """Eq. 4.3 among the clusters of each season."""
    state = grown_state()
    crown = state.crown
    for g in (3, 6, state.seasons.count):
        rows = slice(crown.first[g], crown.first[g + 1])
        leaves = make_leaves(crown.center[rows], crown.radius[rows])
        found = gather_light(
            crown.center[rows], Occluders(leaves), own=np.arange(len(leaves.radius)), rings=6
        )
        npt.assert_allclose(state.light[rows], found.amount, atol=1e-6)
        npt.assert_allclose(state.toward[rows], found.direction, atol=1e-5)


def test_pruning_factors_by_hand():
    """One branch with one cluster: psi = 2 pi r^2 i / l, least when it is longest; trunks have none."""
    graph = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [0, 0, 4], [2, 0, 2]], [0.2, 0.2, 0.1, 0.1])
    clusters = (ball_cluster((0, 0, 4), 0.5, 2), ball_cluster((2, 0, 2), 0.5, 3))
    tree = ClusterTree(graph, clusters, None, DEFAULT_ALLOMETRY, np.zeros(3))
    state = analyse(tree, settings=AnalysisSettings(internode=1.0, taper=0.0))
    light = state.light[-1]
    assert 0.9 < light < 1.0
    assert state.pruning_least[:3].tolist() == [0.0, 0.0, 0.0]
    assert state.pruning_least[3] == pytest.approx(
        min(state.pruning_reference, 2 * np.pi * 0.25 * light / 2), rel=1e-9
    )


def test_reference_factor_is_the_fifth_percentile():
    """Recomputed from the sites: all psi_s(t) above 0, of every season."""
    state = grown_state()
    graph, crown, birth = state.tree.graph, state.crown, state.seasons.birth
    length = np.linalg.norm(graph.position - graph.position[graph.parent], axis=1)
    values = []
    for t in range(state.seasons.count):
        zeta, total = np.zeros(graph.n_nodes), np.where(birth <= t, length, 0.0)
        for s in range(crown.first[t + 1], crown.first[t + 2]):
            seats = crown.seat[crown.seat_first[s] : crown.seat_first[s + 1]]
            zeta[seats] += 2 * np.pi * crown.radius[s] ** 2 * state.light[s] / len(seats)
        for i in range(graph.n_nodes - 1, 0, -1):
            zeta[graph.parent[i]] += zeta[i]
            total[graph.parent[i]] += total[i]
        grown = (birth <= t) & (graph.parent >= 0) & (zeta > 0)
        values.append(zeta[grown] / total[grown])
    npt.assert_allclose(state.pruning_reference, np.percentile(np.concatenate(values), 5), rtol=1e-9)


# ---------------------------------------------------------------- nothing changes


@pytest.mark.parametrize("bending", [0.0, 1.0, 3.0])
def test_untouched_surroundings_give_the_tree_back(bending):
    for state in (grown_state(), grown_state(8, "F6e"), analyse(palm()), analyse(mirrored_tree())):
        adapted = state.adapt(Scene(bending=bending))
        assert adapted.tree is state.tree
        assert adapted.position.tobytes() == state.tree.graph.position.tobytes()
        assert not adapted.touched
        assert adapted.n_pruned == 0
        assert adapted.mean_shift == 0.0
        assert (adapted.density == 1.0).all()


@pytest.mark.parametrize(
    "obstacle",
    [
        Ball((500.0, 0, 2.0), 1.0),
        Box((0, 0, -3.0), (9, 9, 5.9)),
        HalfSpace((0, 0, -5.0), (0, 0, 1)),
        make_wall((-80, 0, 0), (1, 0, 0), width=2, height=2),
    ],
    ids=["far ball", "floor", "ground", "far wall"],
)
def test_what_takes_no_light_changes_nothing(obstacle):
    state = grown_state()
    assert state.adapt(Scene((obstacle,))).tree is state.tree


@pytest.mark.parametrize("name", TREES)
def test_named_trees_come_back(name):
    state = analyse(TREES[name])
    assert state.adapt(Scene()).tree is state.tree
    position, roots = TREES[name].position, TREES[name].parent < 0
    east = position[roots, 0].max() + 0.3 * np.ptp(position, axis=0).max() + 0.01
    beside = state.adapt(Scene((HalfSpace((east, 0, 0), (-1, 0, 0)),)))
    assert np.isfinite(beside.position).all()
    assert beside.tree.graph.n_nodes == beside.alive.sum()


def test_no_pruning_at_a_strength_of_one():
    state = grown_state()
    assert state.adapt(Scene(pruning=1.0)).tree is state.tree


# ---------------------------------------------------------------- what surroundings do


@pytest.mark.parametrize("side", [(-1.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
def test_light_from_one_side_moves_the_tips_there(side):
    state = grown_state()
    before = mean_tip(state.adapt(Scene()))
    after = mean_tip(state.adapt(Scene(sky=Sky((*side, 0.6)), pruning=0.0)))
    assert (after - before)[:2] @ side > 0.3


def test_a_wall_on_the_right_moves_the_tips_left():
    state = grown_state()
    before = mean_tip(state.adapt(Scene()))
    assert mean_tip(state.adapt(Scene((WALL,), pruning=0.0)))[0] < before[0] - 0.3


def test_bending_grows_with_its_strength_and_stops_at_zero():
    state = grown_state()
    shift = [state.adapt(Scene((FENCE,), bending=c, pruning=0.0)).mean_shift for c in (0.0, 0.5, 1.0, 2.0)]
    assert shift[0] == 0.0
    assert (np.diff(shift) > 0.0).all()


def test_lengths_and_radii_stay():
    state = grown_state()
    graph, adapted = state.tree.graph, state.adapt(SCENES["two"])
    new = adapted.tree.graph
    old = np.flatnonzero(adapted.alive)
    npt.assert_array_equal(new.radius, graph.radius[old])
    npt.assert_array_equal(new.attribute["birth"], graph.attribute["birth"][old])

    def lengths(tree):
        return np.linalg.norm(tree.position - tree.position[np.maximum(tree.parent, 0)], axis=1)

    npt.assert_allclose(lengths(new), lengths(graph)[old], atol=1e-12)


def test_a_bough_keeps_its_shape_where_the_light_is_the_same():
    """A turn is handed on whole: angles between the twigs of a turned bough hardly change."""
    state = grown_state(14)
    graph, adapted = state.tree.graph, state.adapt(Scene((WALL,), pruning=0.0, bending=0.3))
    inner = np.flatnonzero((graph.parent > 0) & adapted.alive)
    one, two = (p[inner] - p[graph.parent[inner]] for p in (graph.position, adapted.position))
    before = graph.position[graph.parent[inner]] - graph.position[graph.parent[graph.parent[inner]]]
    after = adapted.position[graph.parent[inner]] - adapted.position[graph.parent[graph.parent[inner]]]

    def angle(a, b):
        return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))

    assert adapted.mean_shift > 0.3
    assert np.abs(angle(one, before) - angle(two, after)).max() < 0.15


@pytest.mark.parametrize("name", ["wall", "fence", "ball", "two"])
def test_no_branch_crosses_an_obstacle(name):
    """No axis does, exactly; a branch that runs along a wall may reach into it by its own radius."""
    for state in (grown_state(), grown_state(14), analyse(palm())):
        adapted = state.adapt(SCENES[name])
        graph = adapted.tree.graph
        inner = np.flatnonzero(graph.parent >= 0)
        share = np.linspace(0.0, 1.0, 20)[:, None, None]
        points = graph.position[graph.parent[inner]] * (1 - share) + graph.position[inner] * share
        for thing in SCENES[name].obstacles:
            if isinstance(thing, HalfSpace):
                depth = (points - thing.point) @ thing.normal
            elif isinstance(thing, Ball):
                depth = np.linalg.norm(points - thing.center, axis=2) - thing.radius
            else:
                local = np.abs((points - thing.center) @ np.asarray(thing.rotation)) - thing.size / 2
                depth = local.max(axis=2)
            assert depth.min() >= -1e-9


def test_branches_die_of_light_only_where_light_fell():
    """A roof over the branches of one side, which touches none of them: only there branches fall."""
    state = analyse(mirrored_tree())
    graph = state.tree.graph
    adapted = state.adapt(Scene((Box((3.5, 0.5, 6.5), (5, 4, 0.3)),), bending=0.0, pruning=1.2))
    assert not (adapted.cause == BY_OBSTACLE).any()
    dead = np.flatnonzero(~adapted.alive)
    calm = state.adapt(Scene(bending=0.0, pruning=1.2))  # above 1 some fall by themselves
    fell = np.setdiff1d(dead, np.flatnonzero(~calm.alive))
    assert len(fell) > 2
    assert (graph.position[fell, 0] > 0.0).all()


def test_dead_branches_hang_on_dead_ones_or_on_their_bearers():
    state = grown_state(12)
    adapted = state.adapt(Scene((make_wall((0.9, 0, 0), (-1, 0, 0), width=20, height=5),), pruning=1.0))
    parent = state.tree.graph.parent
    by_light, by_wall = adapted.cause == BY_LIGHT, adapted.cause == BY_OBSTACLE
    assert by_light.sum() > 10
    assert by_wall.sum() > 2
    assert (adapted.alive == (adapted.cause == 0)).all()
    below = adapted.cause[np.maximum(parent, 0)]
    assert (adapted.cause[below > 0] == below[below > 0]).all()


def test_stronger_pruning_prunes_more():
    for name in ("wall", "fence", "low sun"):
        scene = SCENES[name]
        alive = [
            grown_state(12).adapt(Scene(scene.obstacles, sky=scene.sky, bending=0.0, pruning=c)).alive
            for c in (0.0, 0.4, 0.6, 0.8, 1.0, 1.5, 4.0)
        ]
        count = [int(a.sum()) for a in alive]
        assert count == sorted(count, reverse=True)
        assert count[-1] < count[0]


def test_the_trunk_never_dies_of_dark():
    state = grown_state()
    adapted = state.adapt(Scene(sky=Sky((1.0, 0.0, 0.05)), pruning=100.0))
    tree = adapted.tree.graph
    assert tree.n_nodes > 3
    assert (np.bincount(tree.parent[1:], minlength=tree.n_nodes) <= 1).all()


def test_symmetric_surroundings_keep_a_tree_symmetric():
    tree = mirrored_tree()
    walls = [HalfSpace((x, 0, 0), (-x, 0, 0)) for x in (2.5, -2.5)]
    adapted = analyse(tree).adapt(Scene(tuple(walls), pruning=0.7))
    assert adapted.touched
    assert not adapted.alive.all()
    mirror = np.argmin(
        np.linalg.norm(tree.graph.position[:, None] - tree.graph.position * (-1, 1, 1), axis=2), axis=1
    )
    assert (adapted.alive == adapted.alive[mirror]).all()
    live = adapted.alive
    npt.assert_allclose(adapted.position[live], adapted.position[mirror][live] * (-1, 1, 1), atol=0.01)


def test_mirrored_surroundings_give_the_mirrored_tree():
    tree = mirrored_tree()
    state = analyse(tree)
    mirror = np.argmin(
        np.linalg.norm(tree.graph.position[:, None] - tree.graph.position * (-1, 1, 1), axis=2), axis=1
    )
    right, left = (
        state.adapt(Scene((make_wall((x, 0, 0), (-x, 0, 0), width=6, height=5),), pruning=1.2))
        for x in (1.2, -1.2)
    )
    assert not right.alive.all()
    assert (right.alive == left.alive[mirror]).all()
    npt.assert_allclose(right.position, left.position[mirror] * (-1, 1, 1), atol=0.01)


def test_the_order_of_obstacles_does_not_matter():
    things = (FENCE, Ball((-1.0, 0.5, 2.0), 0.6, 0.3), WALL, Box((0, 2, 2), (1, 1, 1)), Ball((0, -2, 3), 0.7))
    state = grown_state()
    first = state.adapt(Scene(things))
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(len(things))
        assert same(first, state.adapt(Scene(tuple(things[k] for k in order))))


def test_same_input_same_bytes():
    one, two = (analyse(grown_tree()).adapt(SCENES["two"]) for _ in range(2))
    assert same(one, two)


def test_earlier_runs_leave_nothing_behind():
    state = grown_state()
    fresh = analyse(grown_tree())
    for name in (*SCENES, "wall"):
        assert same(state.adapt(SCENES[name]), fresh.adapt(SCENES[name]))


def test_turned_about_by_a_quarter_it_is_the_same():
    """Tree and wall together by 90 degrees, which the cells of the sky allow."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tree = grown_tree()
    graph = tree.graph.replace(position=tree.graph.position @ quarter.T)
    clusters = tuple(
        type(c)(c.vertices @ quarter.T, c.faces, c.seed, c.density, c.n_points) for c in tree.clusters
    )
    one = grown_state().adapt(Scene((WALL,)))
    two = analyse(tree.replace(graph=graph, clusters=clusters)).adapt(
        Scene((HalfSpace((0, 1.0, 0), (0, -1.0, 0)),))
    )
    assert (one.alive == two.alive).all()
    npt.assert_allclose(two.position, one.position @ quarter.T, atol=0.02)


def test_a_mesh_does_what_its_box_does():
    """Its surface shades and stops branches as the box does, but for rays in single precision."""
    box = Box((1.6, 0, 2.0), (0.6, 4, 4))
    state = grown_state()
    solid, surface = state.adapt(Scene((box,))), state.adapt(Scene((mesh_of(box),)))
    assert solid.touched
    assert (solid.alive == surface.alive).mean() > 0.98
    both = solid.alive & surface.alive
    npt.assert_allclose(surface.position[both], solid.position[both], atol=0.02)


@pytest.mark.parametrize(
    "obstacle",
    [HalfSpace((-0.5, 0, 0), (-1, 0, 0)), Ball((0.1, 0, 0), 0.5), Box((0, 0, 0.4), (1, 1, 1))],
    ids=["half-space", "ball", "box"],
)
def test_a_tree_cannot_stand_in_an_obstacle(obstacle):
    with pytest.raises(InputError, match=r"tree 0, at \[0.0, 0.0, 0.0\], has its foot inside an obstacle"):
        grown_state().adapt(Scene((obstacle,)))


# ---------------------------------------------------------------- leaves


def test_density_by_hand():
    """rho(i) = i / (i + 1/4): from full light to a third of it 0.8 becomes 4/7."""
    npt.assert_allclose(light_density(np.array([1.0, 1 / 3])), [0.8, 4 / 7])


def test_density_follows_the_light():
    state = grown_state(12)
    adapted = state.adapt(Scene((HalfSpace((3.0, 0, 0), (-1, 0, 0)),), pruning=0.0))
    before = state.light[state.crown.first[-2] :]
    wanted = light_density(adapted.light) / light_density(before)
    npt.assert_allclose(adapted.density, wanted)
    assert adapted.density.min() < 0.9
    for old, new, factor in zip(state.tree.clusters, adapted.tree.clusters, adapted.density, strict=True):
        npt.assert_equal(new.density, old.density * factor)


def test_bare_trees_have_no_density():
    adapted = analyse(palm()).adapt(Scene((WALL,)))
    assert adapted.density.shape == (0,)
    assert adapted.tree.clusters == ()


def test_clusters_move_with_their_nodes():
    state = grown_state(12)
    adapted = state.adapt(Scene((FENCE,), pruning=0.0))
    crown, first = state.crown, state.crown.seat_first
    moved = adapted.position - state.tree.graph.position
    for k, s in enumerate(range(crown.first[-2], crown.first[-1])):
        seats = crown.seat[first[s] : first[s + 1]]
        new, old = adapted.tree.clusters[k].vertices, state.tree.clusters[k].vertices
        if not (new - old - moved[seats].mean(axis=0)).any():
            continue
        still = np.abs(new - old - moved[seats].mean(axis=0)).max(axis=1) < 1e-12
        assert still.any() or (old[:, 0] > 1.0).all()  # the rest was cut by the fence


@pytest.mark.parametrize("name", ["wall", "fence", "ball"])
def test_clusters_are_cut_by_obstacles(name):
    """No vertex is inside or behind; hulls stay closed."""
    scene = SCENES[name]
    adapted = grown_state(12).adapt(Scene(scene.obstacles, pruning=0.0))
    tree = adapted.tree
    thing = scene.obstacles[0]
    assert tree.clusters
    for cluster in tree.clusters:
        if isinstance(thing, HalfSpace):
            assert ((cluster.vertices - thing.point) @ thing.normal).min() > -1e-9
        else:
            inside = [
                thing.blocks(v, np.concatenate([np.eye(3), -np.eye(3)])).all() for v in cluster.vertices
            ]
            assert not any(inside)
        edges = np.sort(
            np.concatenate([cluster.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1
        )
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_leaves_do_not_stay_behind_a_wall():
    """A thin wall through the middle of a hull: what it hides from the seed moves to its near side."""
    graph = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 3]], [0.1, 0.1])
    tree = ClusterTree(graph, (ball_cluster((0.2, 0, 3), 1.0, 1),), None, DEFAULT_ALLOMETRY, np.zeros(3))
    wall = make_wall((0.5, 0, 0), (-1, 0, 0), width=10, height=10, thickness=0.05)
    adapted = analyse(tree).adapt(Scene((wall,), bending=0.0, pruning=0.0))
    x = adapted.tree.clusters[0].vertices[:, 0]
    assert x.max() <= 0.5
    assert x.min() == tree.clusters[0].vertices[:, 0].min()


def test_a_cluster_without_nodes_is_gone():
    state = grown_state(12)
    adapted = state.adapt(Scene((make_wall((0.9, 0, 0), (-1, 0, 0), width=20, height=6),)))
    assert 0 < len(adapted.tree.clusters) < len(state.tree.clusters)
    kept = adapted.kept_clusters
    assert len(kept) == len(adapted.tree.clusters)
    place = np.cumsum(adapted.alive) - 1
    for k, cluster in zip(kept, adapted.tree.clusters, strict=True):
        old = state.tree.clusters[k].seed
        assert cluster.seed.tolist() == place[old[adapted.alive[old]]].tolist()
    assert (adapted.density[np.setdiff1d(np.arange(len(state.tree.clusters)), kept)] == 0.0).all()


def is_inside(thing, places):
    """Whether places (..., 3) are in a solid."""
    if isinstance(thing, HalfSpace):
        return (places - thing.point) @ thing.normal < 0.0
    if isinstance(thing, Ball):
        return np.linalg.norm(places - thing.center, axis=-1) < thing.radius
    return (np.abs((places - thing.center) @ np.asarray(thing.rotation)) < 0.5 * thing.size).all(axis=-1)


def volume_of(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return (a * np.cross(b, c)).sum() / 6.0


def check_hulls(adapted, to_scene, n_steps=4000):
    """Each hull beside one that is carried along, and cut by small steps from the nearest seat."""
    state, crown, first = adapted.state, adapted.state.crown, adapted.state.crown.seat_first
    kept = adapted.kept_clusters.tolist()
    n_cut = n_whole = n_gone = 0
    steps = np.linspace(0.0, 1.0, n_steps)[:, None]
    for k, s in enumerate(range(crown.first[-2], crown.first[-1])):
        old = state.tree.clusters[k]
        seats = crown.seat[first[s] : first[s + 1]]
        seats = seats[adapted.alive[seats]]
        if not seats.size:
            assert k not in kept
            continue
        wanted = old.vertices + (adapted.position[seats] - state.tree.graph.position[seats]).mean(axis=0)
        whole = volume_of(wanted, old.faces)
        for v, end in enumerate(wanted):
            start = min(adapted.position[seats], key=lambda p, end=end: ((p - end) ** 2).sum())
            way = to_scene(start + steps * (end - start))
            hit = np.any([is_inside(thing, way) for thing in adapted.scene.obstacles], axis=0)
            if hit.any():
                wanted[v] = start + steps[hit.argmax()] * (end - start)
        if k not in kept:
            assert volume_of(wanted, old.faces) < 0.03 * whole
            n_gone += 1
            continue
        got = adapted.tree.clusters[kept.index(k)].vertices
        reach = np.linalg.norm(old.vertices - old.vertices.mean(axis=0), axis=1).max()
        npt.assert_allclose(got, wanted, rtol=0, atol=(2.0 / n_steps + 1.1e-3) * 3.0 * reach)
        n_cut += (wanted != old.vertices).any()
        n_whole += 1
    return n_cut, n_whole, n_gone


HIDING = {
    "fence": (FENCE,),
    "half-space": (HalfSpace((1.3, 0, 0), (-1, 0, 0.2)),),
    "ball": (Ball((1.6, 0.4, 4.0), 1.2),),
    "box and ball": (Box((-1.5, 0.3, 3.5), (1.0, 4.0, 3.0)), Ball((1.6, 0.4, 4.0), 1.0)),
}


@pytest.mark.parametrize("name", HIDING)
def test_hulls_are_cut_as_by_small_steps(name):
    adapted = grown_state(12).adapt(Scene(HIDING[name], pruning=0.3))
    n_cut, n_whole, _ = check_hulls(adapted, lambda places: places)
    assert n_cut >= 3 and n_whole >= 5


def test_hulls_of_a_turned_neighbour_are_cut_as_by_small_steps():
    state, turn, place = grown_state(12), 0.8, np.array([2.5, 1.0, 0.2])
    scene = Scene((FENCE,), neighbours=(Neighbour(state, place, turn),), pruning=0.3)
    (other,) = state.adapt(scene).neighbours
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    n_cut, n_whole, _ = check_hulls(other, lambda places: places @ rotation.T + place)
    assert n_cut >= 3 and n_whole >= 5


# ---------------------------------------------------------------- chance


def check_scenes(n, seed, states):
    """Random scenes: everything finite, lengths kept, a whole tree."""
    rng = np.random.default_rng(seed)
    pruned = moved = 0
    for k in range(n):
        state = states[k % len(states)]
        graph = state.tree.graph
        reach = float(np.abs(graph.position).max())
        adapted = state.adapt(random_scene(rng, reach))
        assert np.isfinite(adapted.position).all()
        assert np.isfinite(adapted.light).all()
        assert (adapted.light >= 0.0).all()
        assert np.isfinite(adapted.density).all()
        inner = (graph.parent >= 0) & adapted.alive
        assert adapted.alive[graph.parent[inner]].all()
        segment = [
            np.linalg.norm(p[inner] - p[graph.parent[inner]], axis=1)
            for p in (graph.position, adapted.position)
        ]
        npt.assert_allclose(*segment, rtol=1e-9, atol=1e-12)
        pruned += adapted.n_pruned > 0
        moved += adapted.touched
        if k % 10 == 0:
            assert adapted.tree.graph.n_nodes == adapted.alive.sum()
    assert moved > 0.5 * n
    assert pruned > 0.2 * n


def fuzz_states():
    return [grown_state(8, seed=s) for s in range(3)] + [
        grown_state(8, "F6e"),
        analyse(palm()),
        analyse(mirrored_tree()),
    ]


def test_random_scenes():
    check_scenes(200, 1, fuzz_states())


@pytest.mark.slow
def test_many_random_scenes():
    check_scenes(10_000, 2, fuzz_states())


# ---------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"most_seasons": 0}, "most_seasons must be a whole number from 1 to 100, got 0"),
        ({"most_seasons": 2.5}, "most_seasons must be a whole number from 1 to 100, got 2.5"),
        ({"rings": 3}, "rings must be a whole number from 4 to 64, got 3"),
        ({"rings": True}, "rings must be a number, got True"),
        ({"taper": "x"}, "taper must be a number, got 'x'"),
        ({"unit_translucency": 0.0}, "unit_translucency must be from 0.01 to 1.0, got 0.0"),
        (
            {"fewest_seasons": 9, "most_seasons": 8},
            "fewest_seasons must not be more than most_seasons, got 9 and 8",
        ),
        ({"internode": 0.0}, "internode must be a positive finite number of metres, got 0.0"),
        ({"phototropism": 1.0}, "phototropism must be from 0 to below 1"),
    ],
)
def test_bad_settings(changes, match):
    with pytest.raises(InputError, match=match):
        AnalysisSettings(**changes)


def test_only_trees_are_analysed():
    with pytest.raises(InputError, match="tree must be a ClusterTree or a TreeGraph, got str"):
        analyse("oak")
