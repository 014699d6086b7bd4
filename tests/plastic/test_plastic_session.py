"""Scenes that change little by little, and trees that react to each other (thesis 4.4.3)."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plastic import AnalysisSettings, Neighbour, Scene, Session, adapt_stand, analyse
from tests.plastic.plastic_trees import (
    WALL,
    grown_state,
    grown_tree,
    mirrored_tree,
    palm,
    random_scene,
    same,
)
from tests.plastic.test_plastic_adapt import mean_tip, mesh_of
from treegraph import Ball, Box, HalfSpace, InputError, Sky, make_wall


def wall_at(x):
    return make_wall((x, 0, 0), (-1, 0, 0), width=6, height=4)


def counts(session):
    """Sites shaded by clusters, by obstacles, weighed; nodes turned in the last run."""
    return session._work.counts.tolist()


# ---------------------------------------------------------------- little by little


def check_path(state, scenes):
    session = Session(state)
    for k, scene in enumerate(scenes):
        assert same(session.adapt(scene), state.adapt(scene)), f"scene {k}"


@pytest.mark.parametrize("step", [0.002, 0.05, 0.5])
def test_a_wall_that_moves_gives_what_a_wall_that_stands_gives(step):
    check_path(grown_state(12), [Scene((wall_at(1.2 + step * (7 - k)),)) for k in range(8)])


def test_a_half_space_that_moves():
    check_path(grown_state(12), [Scene((HalfSpace((2.0 - 0.3 * k, 0, 0), (-1, 0, 0)),)) for k in range(6)])


def test_obstacles_come_and_go():
    ball, fence = Ball((1.0, 0.2, 3.0), 0.8), wall_at(1.0)
    things = [
        (),
        (ball,),
        (ball, fence),
        (fence,),
        (),
        (fence, ball),
        (WALL,),
        (mesh_of(fence),),
        (fence,),
        (),
    ]
    check_path(grown_state(12), [Scene(t) for t in things])


def test_light_and_strengths_change():
    fence = (wall_at(1.2),)
    check_path(
        grown_state(12),
        [
            Scene(fence),
            Scene(fence, bending=2.0),
            Scene(fence, bending=2.0, pruning=1.5),
            Scene(fence, sky=Sky((0.5, 0.2, 0.8))),
            Scene(fence, sky=Sky((0.5, 0.2, 0.8)), bending=0.0),
            Scene(sky=Sky((-0.5, 0.2, 0.8)), pruning=0.0),
            Scene(fence),
        ],
    )


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=25)
def test_any_path_of_scenes(seed):
    rng = np.random.default_rng(seed)
    states = [grown_state(8), grown_state(8, "F6e"), analyse(palm())]
    state = states[seed % 3]
    reach = float(np.abs(state.tree.graph.position).max())
    scenes = [random_scene(rng, reach) for _ in range(4)]
    check_path(state, [scenes[k] for k in rng.integers(4, size=7)])


def test_what_does_not_change_costs_nothing():
    session, scene = Session(grown_state(12)), Scene((wall_at(1.2),))
    first = session.adapt(scene)
    assert counts(session)[3] > 0
    assert same(session.adapt(scene), first)
    assert counts(session) == [0, 0, 0, 0]


def test_a_twig_dies_of_a_bead_that_takes_no_light():
    """No site sees it: only the way of the branch itself says that it is there."""
    state = grown_state(12)
    at = state.tree.graph.position[-1]
    scenes = [Scene((Ball(at + (way, 0.0, 0.0), 0.004),)) for way in (0.5, 0.0, 0.0, 0.5)]
    session = Session(state)
    alive = []
    for scene in scenes:
        adapted = session.adapt(scene)
        assert same(adapted, state.adapt(scene))
        alive.append(adapted.alive[-1])
    assert alive == [True, False, False, True]


def test_nodes_that_stay_are_not_copied():
    state, session = grown_state(12), Session(grown_state(12))
    for x in (6.0, 5.9999):
        adapted = session.adapt(Scene((wall_at(x),)))
    again = session.adapt(Scene((wall_at(5.9998),)))
    assert again.position is adapted.position
    assert not again.position.flags.writeable
    assert same(again, state.adapt(Scene((wall_at(5.9998),))))
    assert again.scene is not adapted.scene
    gone = session.adapt(Scene())
    assert gone.position is not adapted.position
    assert gone.tree is state.tree


def test_less_is_worked_out_anew_where_less_changes():
    """A ball beside the tips of one bough moves by a millimetre, and by a metre."""
    state = grown_state(14)
    top = state.tree.graph.position[np.argmax(state.tree.graph.position[:, 0])]
    ball = Ball(top + (0.8, 0, 0.5), 0.5)
    turned = []
    for move in (0.001, 1.0):
        session = Session(state)
        session.adapt(Scene((ball,)))
        whole = counts(session)
        session.adapt(Scene((Ball(ball.center + (0, move, 0), 0.5),)))
        turned.append(counts(session)[3])
        assert counts(session)[0] <= whole[0]
    assert turned[0] < 0.5 * turned[1]
    assert turned[0] < 0.25 * state.tree.graph.n_nodes


def test_a_session_goes_on_after_an_error():
    session = Session(grown_state())
    scene = Scene((wall_at(1.2),))
    first = session.adapt(scene)
    with pytest.raises(InputError, match="has its foot inside an obstacle"):
        session.adapt(Scene((Ball((0, 0, 0), 1.0),)))
    assert same(session.adapt(scene), first)


def test_a_session_without_a_tree():
    with pytest.raises(InputError, match="this session has no tree of its own"):
        Session().adapt(Scene())


# ---------------------------------------------------------------- trees among trees


def test_trees_far_apart_stay_as_they_are():
    state, other = grown_state(), analyse(palm())
    scene = Scene(neighbours=(Neighbour(other, (80.0, 0, 0)), Neighbour(state, (-90.0, 5.0, 1.0), 1.0)))
    adapted = state.adapt(scene)
    assert adapted.tree is state.tree
    assert [n.tree is n.state.tree for n in adapted.neighbours] == [True, True]


def test_a_turned_tree_alone_stays_as_it_is():
    """Whatever the cells of the sky make of it, it has its own light to compare with."""
    state = grown_state()
    for turn in (0.3, 1.0, 2.5, -4.0):
        (alone,) = adapt_stand((Neighbour(state, (3.0, 4.0, 5.0), turn),), Scene())
        assert alone.tree is state.tree


def test_a_turned_tree_sees_the_wall_from_another_side():
    """Turned by half, with the wall on its other side: the same to the cells of the sky."""
    state = grown_state()
    here = state.adapt(Scene((wall_at(1.2),)))
    there = adapt_stand(
        (Neighbour(state, (0, 0, 0), np.pi),),
        Scene((make_wall((-1.2, 0, 0), (1, 0, 0), width=6, height=4),)),
    )[0]
    assert (here.alive == there.alive).all()
    npt.assert_allclose(here.position, there.position, atol=0.02)


def test_a_moved_tree_in_moved_surroundings_is_the_same():
    state = grown_state()
    here = state.adapt(Scene((wall_at(1.2),)))
    move = np.array([10.0, -3.0, 2.0])
    wall = wall_at(1.2)
    there = adapt_stand(
        (Neighbour(state, move),), Scene((Box(wall.center + move, wall.size, wall.rotation),))
    )[0]
    assert (here.alive == there.alive).all()
    npt.assert_allclose(here.position, there.position, atol=1e-9)
    for one, two in zip(here.tree.clusters, there.tree.clusters, strict=True):  # cut hulls, in its own frame
        npt.assert_allclose(one.vertices, two.vertices, atol=1e-9)


def test_neighbours_bend_away_from_each_other():
    state = grown_state(14)
    scene = Scene(neighbours=(Neighbour(state, (2.0, 0, 0)),), pruning=0.0)
    one = state.adapt(scene)
    (two,) = one.neighbours
    before = mean_tip(state.adapt(Scene(pruning=0.0)))
    assert mean_tip(one)[0] < before[0] - 0.02
    assert mean_tip(two)[0] > before[0] + 0.02


def test_mirrored_neighbours_react_alike():
    """Two symmetric trees side by side: each is the other's mirror image, whichever is named first."""
    state = analyse(mirrored_tree())
    pair = [Neighbour(state, (x, 0, 0)) for x in (-1.8, 1.8)]
    graph = state.tree.graph
    mirror = np.argmin(np.linalg.norm(graph.position[:, None] - graph.position * (-1, 1, 1), axis=2), axis=1)
    for trees in (pair, pair[::-1]):
        left, right = adapt_stand(trees, Scene(pruning=0.0))
        assert left.touched
        npt.assert_allclose(left.position, right.position[mirror] * (-1, 1, 1), atol=0.02)


def test_the_order_of_neighbours_hardly_matters():
    """Products of the same shadows in another order differ by rounding."""
    states = [grown_state(), grown_state(8, "F6e"), grown_state(9, seed=5)]
    trees = [Neighbour(s, p) for s, p in zip(states, [(0, 0, 0), (1.5, 0.5, 0), (-0.5, 1.6, 0)], strict=True)]
    scene = Scene((WALL,))
    one = adapt_stand([trees[1], trees[0], trees[2]], Scene(pruning=0.0))
    two = adapt_stand(trees, Scene(pruning=0.0))
    npt.assert_allclose(one[1].position, two[0].position, atol=0.01)
    assert scene.obstacles == (WALL,)


def test_a_young_tree_suffers_more_than_an_old_one():
    """Aligned at the end: the old tree has grown up before the young one sprouts."""
    old, young = grown_state(14), grown_state(7)
    assert old.seasons.years > 1.5 * young.seasons.years
    a, b = adapt_stand((Neighbour(old), Neighbour(young, (0.8, 0, 0))), Scene(pruning=0.0))
    share = [t.mean_shift / np.ptp(t.state.tree.graph.position[:, 2]) for t in (a, b)]
    assert share[1] > 2 * share[0]


def test_a_seedling_grows_in_the_shade_of_what_stands():
    """Its very first segments see the old crown above them."""
    old, young = grown_state(14), grown_state(7)
    crown = old.crown
    heavy = np.argmax(crown.radius[crown.first[-2] :]) + crown.first[-2]
    x, y, _ = crown.center[heavy]
    place = (x * 1.3, y * 1.3, 0.0)
    _, b = adapt_stand((Neighbour(old), Neighbour(young, place)), Scene(pruning=0.0))
    first = np.flatnonzero(young.seasons.birth == 0)[1:]
    assert (b.displacement[first] > 0.0).any()


def test_sessions_of_several_trees():
    state, other = grown_state(), grown_state(8, "F6e")
    session = Session(state)
    for x, y in ((3.0, 0.0), (2.9, 0.0), (2.9, 0.4), (2.0, 0.4), (3.0, 0.0)):
        trees = (Neighbour(other, (x, 0, 0), 0.4), Neighbour(state, (0, -2.5, 0)))
        for wall in (2.5, 2.4):
            scene = Scene((make_wall((0, wall + y, 0), (0, -1, 0), width=6, height=4),), trees)
            one, two = session.adapt(scene), state.adapt(scene)
            assert same(one, two)
            assert all(same(a, b) for a, b in zip(one.neighbours, two.neighbours, strict=True))


def test_a_box_that_moves_through_trees():
    """With the same trees all that is far from it stays as it was."""
    state = grown_state()
    trees = tuple(Neighbour(state, (6.0 * i, 6.0 * j, 0)) for i in range(3) for j in range(2))
    session = Session()
    work = []
    for k in range(6):
        scene = Scene((Box((-1.5 + 0.3 * k, 1.5, 2.0), (1, 1, 4)),))
        found = session.adapt_stand(trees, scene)
        work.append(counts(session)[3])
        wanted = adapt_stand(trees, scene)
        assert all(same(a, b) for a, b in zip(found, wanted, strict=True))
    assert max(work[1:]) < 0.7 * 6 * state.tree.graph.n_nodes


# ---------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    "position, turn, match",
    [
        ((0, 0), 0.0, r"position must have shape \(3,\), got \(2,\)"),
        ((0, 0, np.nan), 0.0, "position must be finite"),
        ((0, 0, 0), np.inf, "turn must be a finite angle in radians, got inf"),
    ],
)
def test_bad_neighbours(position, turn, match):
    with pytest.raises(InputError, match=match):
        Neighbour(grown_state(), position, turn)


def test_bad_stands():
    with pytest.raises(InputError, match="trees must have at least one tree"):
        adapt_stand((), Scene())
    fine = analyse(grown_tree(), settings=AnalysisSettings(rings=8))
    with pytest.raises(InputError, match=r"all trees must be analysed with the same rings, got \[6, 8\]"):
        adapt_stand((Neighbour(grown_state()), Neighbour(fine)), Scene())
    with pytest.raises(
        InputError, match=r"tree 1, at \[5.0, 0.0, 0.0\], has its foot inside an obstacle; .*1 of 2"
    ):
        adapt_stand(
            (Neighbour(grown_state()), Neighbour(grown_state(), (5, 0, 0))), Scene((Ball((5, 0, 0), 1),))
        )
