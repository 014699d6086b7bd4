import numpy as np
import numpy.testing as npt
import pytest

from recon.ordering import morton_order, thin


def slow_code(cell):
    """Interleave the bits of three integers, one by one."""
    return sum(((int(cell[a]) >> b) & 1) << (3 * b + a) for b in range(21) for a in range(3))


def test_codes_interleave_the_bits(rng):
    xyz = rng.random((50, 3))
    order, code, cell = morton_order(xyz)
    low = xyz.min(axis=0)
    wanted = [slow_code(np.floor((p - low) / cell)) for p in xyz[order]]
    assert wanted == code.tolist()
    assert wanted == sorted(wanted)


def test_order_does_not_depend_on_the_input(rng):
    xyz = rng.random((500, 3)) * [3, 4, 20] + 1e5
    shuffled = xyz[rng.permutation(500)]
    npt.assert_array_equal(xyz[morton_order(xyz)[0]], shuffled[morton_order(shuffled)[0]])


def test_one_point():
    order, code, _ = morton_order(np.zeros((1, 3)))
    assert order.tolist() == [0] and code.tolist() == [0]


@pytest.mark.parametrize("max_points", [1, 7, 40, 200, 1000])
def test_thinning_takes_means_of_cells(rng, max_points):
    xyz = rng.random((600, 3)) * [1, 1, 5]
    order, code, _ = morton_order(xyz)
    xyz = xyz[order]
    thinned, cell_of = thin(xyz, code, max_points)
    assert len(thinned) <= max_points
    assert cell_of.max() + 1 == len(thinned)
    for k in range(len(thinned)):
        npt.assert_allclose(thinned[k], xyz[cell_of == k].mean(axis=0), atol=1e-12)


def test_thinning_uses_the_finest_cells_that_do(rng):
    xyz = rng.random((600, 3))
    order, code, _ = morton_order(xyz)
    thinned, _ = thin(xyz[order], code, 100)
    counts = [len(np.unique(code >> shift)) for shift in range(63)]
    assert len(thinned) == max(c for c in counts if c <= 100)


def test_few_points_stay(rng):
    xyz = rng.random((30, 3))
    order, code, _ = morton_order(xyz)
    thinned, cell_of = thin(xyz[order], code, 30)
    npt.assert_array_equal(thinned, xyz[order])
    npt.assert_array_equal(cell_of, np.arange(30))
