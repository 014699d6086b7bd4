"""Every format read back, every bad file refused in one line."""

import numpy as np
import numpy.testing as npt
import pytest

import recon
from treegraph.errors import InputError


def points(n=200, seed=0):
    return np.random.default_rng(seed).uniform([0, 0, 0], [3, 3, 9], (n, 3)).round(3)


def test_text_round_trip(tmp_path):
    path = tmp_path / "scan.xyz"
    np.savetxt(path, points(), fmt="%.3f")
    cloud = recon.read_cloud(path)
    npt.assert_array_equal(cloud.xyz + cloud.origin, points())


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        recon.read_cloud(tmp_path / "no.xyz")
