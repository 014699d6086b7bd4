"""Every species that comes along, whichever there are: it parses, it is small, its branchlets are sound."""

import numpy as np
import pytest

from species.library import (
    build_species,
    builtin_library,
    cut_branchlet,
    derive_branchlets,
    open_species,
    read_definition,
)
from species.library.branchlets import CUT_LEAVES
from species.library.building import MOST_SPECIES_BYTES, derived_key
from species.library.catalog import BUILTIN, DERIVED
from species.library.packing import PICTURES, pack_species, unpack_species
from treegraph import SPECIES_ALLOMETRY, path_length

FILES = sorted(BUILTIN.glob("*.toml"))
TABLE = {"".join(name.lower().split()): name for name in SPECIES_ALLOMETRY}
ONE_LEAF = ("frond", "fan")  # of palms: a patch is one leaf
FEWEST, MOST = 20, 30  # branchlets of a species (thesis, section 3.4)

pytestmark = pytest.mark.skipif(not FILES, reason="no species come along")


@pytest.fixture(scope="module", params=FILES, ids=[path.stem for path in FILES])
def path(request):
    return request.param


@pytest.fixture(scope="module")
def kind(path):
    return read_definition(path)


@pytest.fixture(scope="module")
def made(kind):
    return derive_branchlets(kind)


# ---------------------------------------------------------------- the files


def test_every_file_is_in_the_library_and_none_is_at_fault():
    library = builtin_library()
    assert library.faults == []
    assert len(library.names) == len(FILES)


def test_every_name_means_one_species():
    library = builtin_library()
    names = {}
    for name in library.names:
        for other in {n.casefold().replace("-", " ") for n in library.find(name).names}:
            assert other not in names, f"{other}: {name} and {names.get(other)}"
            names[other] = name
    for other, name in names.items():
        assert library.find(other).name == name


def test_parameters_are_those_of_table_3_1(kind):
    for name in kind.names:
        known = TABLE.get("".join(name.lower().split()))
        if known is not None:
            wanted = SPECIES_ALLOMETRY[known]
            found = kind.allometry
            assert (found.beta, found.gamma, found.f_s) == (wanted.beta, wanted.gamma, wanted.f_s), name


def test_growth_is_there_and_says_an_age(kind):
    assert kind.growth is not None and kind.growth.age >= 1
    assert kind.growth.name == kind.name
    assert kind.what


def test_what_is_kept_beside_is_of_this_file(path, kind):
    """If not: python tools/make_species.py."""
    assert unpack_species(path.with_suffix(DERIVED).read_bytes()).key == derived_key(kind)


# ---------------------------------------------------------------- branchlets


def tips(branchlet):
    """Ends of wood and leaves."""
    leaves = branchlet.leaves
    return np.concatenate([branchlet.graph.position, leaves.base + leaves.length[:, None] * leaves.along])


def test_twenty_to_thirty_branchlets_of_different_size_and_slope(made):
    assert FEWEST <= len(made) <= MOST
    reach = np.array([np.linalg.norm(tips(each), axis=1).max() for each in made])
    radius = np.array([each.graph.radius[0] for each in made])
    slope = np.array([each.slope_deg for each in made])
    assert reach.max() > 1.3 * reach.min()
    assert radius.max() > 1.2 * radius.min()
    assert np.ptp(slope) > 20.0
    for number in (reach, radius, slope):  # and all of the range is used
        third = np.digitize(number, number.min() + np.ptp(number) * np.array([1 / 3, 2 / 3]))
        assert (np.bincount(third, minlength=3) >= 3).all()


def test_they_set_off_at_their_slope(made):
    for each in made:
        first = np.flatnonzero(np.linalg.norm(each.graph.position, axis=1) > 1e-9)[0]
        way = each.graph.position[first] / np.linalg.norm(each.graph.position[first])
        assert np.degrees(np.arcsin(way[2])) == pytest.approx(each.slope_deg, abs=25.0)


def test_wood_thins_out_towards_the_tips(made):
    for each in made:
        graph = each.graph
        assert graph.radius.min() > 1e-4 and graph.radius.max() < 0.2
        way = path_length(graph)
        assert way.max() < 12.0
        ends = np.setdiff1d(np.arange(graph.n_nodes), graph.parent[1:])
        assert graph.radius[ends].mean() < graph.radius[0] * 1.001
        parent = graph.parent[1:]
        steps = graph.radius[1:] <= 1.05 * graph.radius[parent]
        assert steps.mean() > 0.9  # on the whole: a bud or a node may be thicker


def test_leaves_stand_on_their_wood(made):
    for each in made:
        graph, leaves = each.graph, each.leaves
        end = graph.position[leaves.node]
        start = graph.position[np.maximum(graph.parent[leaves.node], 0)]
        way = end - start
        square = np.maximum(np.einsum("ij,ij->i", way, way), 1e-18)
        at = np.clip(np.einsum("ij,ij->i", leaves.base - start, way) / square, 0.0, 1.0)
        gap = np.linalg.norm(leaves.base - (start + at[:, None] * way), axis=1)
        assert gap.max() <= 0.005 + 1.01 * graph.radius.max(), each
        assert (np.einsum("ij,ij->i", leaves.along, leaves.normal) < 1e-6).all()


def test_leaves_are_about_as_large_as_the_definition_says(kind, made):
    length = np.concatenate([each.leaves.length for each in made])
    assert 0.4 < np.median(length) / kind.leaf.length < 1.6


def test_a_branchlet_is_neither_bare_nor_a_tree(kind, made):
    few = 1 if kind.leaf.kind in ONE_LEAF else 3
    for each in made:
        assert few <= each.leaves.n_leaves <= 1500
        assert 3 <= each.graph.n_nodes <= 2000


# ---------------------------------------------------------------- patches


def count_beyond(graph, leaves, twigs):
    """Leaves on each of some nodes and all beyond it."""
    carried = np.bincount(leaves.node, minlength=graph.n_nodes)
    for i in range(graph.n_nodes - 1, 0, -1):
        carried[graph.parent[i]] += carried[i]
    return carried[twigs]


def test_patches_are_sound_and_no_leaf_is_lost(kind, made):
    n_docks = 0
    for number, each in enumerate(made):
        patches = cut_branchlet(each, number)
        first = patches[0]
        for patch in patches:
            assert patch.branchlet == number
            assert (patch.graph.position[0] == 0.0).all() and (patch.graph.parent[1:] >= 0).all()
            assert patch.radius == patch.graph.radius[0]
            if patch.graph.n_nodes > 1:
                kids = np.flatnonzero(patch.graph.parent == 0)
                ways = patch.graph.position[kids]
                ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
                assert ways[:, 2].max() > 1.0 - 1e-9  # one of them sets off along +z
            gap = np.linalg.norm(patch.dock_position[:, None] - patch.graph.position[None], axis=2)
            assert not patch.n_docks or gap.min(axis=1).max() < 1e-9
            assert np.allclose(np.linalg.norm(patch.dock_direction, axis=1), 1.0)
            assert patch.n_docks == 0 or patch.dock_radius.max() <= 1.05 * patch.radius
        assert first.radius == each.graph.radius[0]
        order = each.graph.attribute["order"].copy()
        order[0] = order[1:].min()
        carried = count_beyond(each.graph, each.leaves, np.arange(each.graph.n_nodes))
        cut, whole = [], np.zeros(each.graph.n_nodes, bool)
        whole[0] = True
        if each.leaves.n_leaves > 16:
            for i in range(1, each.graph.n_nodes):
                above = each.graph.parent[i]
                deeper = whole[above] and order[i] > order[above]
                if deeper and carried[i] >= CUT_LEAVES:
                    cut.append(i)
                else:
                    whole[i] = whole[above]
        assert first.n_docks == len(cut)
        assert first.leaves.n_leaves + carried[cut].sum() == each.leaves.n_leaves
        n_docks += first.n_docks
    if kind.leaf.kind not in ONE_LEAF:
        assert n_docks > len(made)  # twigs branch: clusters are filled from docking point to docking point


def test_there_are_small_patches_to_end_with(made):
    patches = [patch for number, each in enumerate(made) for patch in cut_branchlet(each, number)]
    ends = [patch for patch in patches if patch.n_docks == 0]
    assert ends and all(patch.leaves.n_leaves for patch in ends)
    assert min(patch.leaves.n_leaves for patch in ends) <= 40


def test_what_is_kept_of_it_is_what_was_derived(kind, made):
    pictures = {name: b"x" for name in PICTURES}
    data = pack_species("00" * 32, made, pictures, (-1, -1, 1, 1), 0.3)
    assert len(data) + len(kind.text.encode()) < MOST_SPECIES_BYTES / 2  # room for the pictures
    for before, after in zip(made, unpack_species(data).branchlets, strict=True):
        assert (before.graph.parent == after.graph.parent).all()
        assert np.abs(before.graph.position - after.graph.position).max() < 0.001
        assert np.abs(before.leaves.base - after.leaves.base).max() < 0.001
        for a, b in zip(cut_branchlet(before), cut_branchlet(after), strict=True):
            assert (a.n_docks, a.leaves.n_leaves) == (b.n_docks, b.leaves.n_leaves)


@pytest.mark.slow
def test_all_of_it_is_built_and_small(kind):
    data = build_species(kind)
    species = open_species(kind, data)
    assert species.n_bytes <= MOST_SPECIES_BYTES
    assert FEWEST <= len(species.branchlets) <= MOST
    assert len(species.patches) >= len(species.branchlets)
    assert 0.05 < species.leaf_share < 1.0
    for season in ("spring", "summer", "autumn", "winter"):
        if kind.is_bare(season):
            assert f"leaf_{season}" not in species.pictures
            continue
        there = species.picture(f"leaf_{season}")[..., 3] >= 128
        assert there.mean() == pytest.approx(
            (species.picture("leaf_summer")[..., 3] >= 128).mean(), rel=0.002
        )
    assert build_species(kind) == data
