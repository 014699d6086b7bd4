"""SWC files: round trips, the freedom that real files take, and what cannot be read."""

import math
import os
import sys

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corpus import TREES, make_tree, parents
from treegraph import (
    FormatError,
    InputError,
    TreeGraph,
    gravelius_order,
    read_swc,
    sort_topological,
    write_swc,
)


def read(tmp_path, text, name="tree.swc"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_swc(path)


def there_and_back(tree, folder):
    path = folder / "tree.swc"
    write_swc(tree, path)
    return read_swc(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("swc")


class TestRoundTrip:
    @pytest.mark.parametrize("tree", TREES.values(), ids=TREES)
    def test_corpus(self, tree, tmp_path):
        twin = there_and_back(tree, tmp_path)
        order = sort_topological(tree.parent)
        rank = np.append(np.argsort(order), -1)
        npt.assert_array_equal(twin.parent, rank[tree.parent[order]])
        npt.assert_allclose(twin.position, tree.position[order], rtol=0, atol=1e-6)
        npt.assert_allclose(twin.radius, tree.radius[order], rtol=0, atol=1e-6)
        assert twin.attribute["type"].dtype == np.int32
        npt.assert_array_equal(twin.attribute["type"], 0)

    @given(parents(), st.floats(-1e6, 1e6), st.floats(0, 100) | st.just(math.nan))
    @settings(deadline=None)
    def test_any_tree(self, folder, parent, shift, radius):
        tree = make_tree(parent)
        tree = tree.replace(position=tree.position + shift, radius=np.full(len(parent), radius))
        twin = there_and_back(tree, folder)
        order = sort_topological(tree.parent)
        npt.assert_allclose(twin.position, tree.position[order], rtol=0, atol=1e-6)
        npt.assert_allclose(twin.radius, tree.radius[order], rtol=1e-8, atol=1e-6)

    def test_twice_gives_the_same_bytes(self, tmp_path):
        write_swc(TREES["bush"], tmp_path / "a.swc")
        write_swc(read_swc(tmp_path / "a.swc"), tmp_path / "b.swc")
        write_swc(read_swc(tmp_path / "b.swc"), tmp_path / "c.swc")
        assert (tmp_path / "b.swc").read_bytes() == (tmp_path / "c.swc").read_bytes()

    def test_type_and_orders_survive(self, tmp_path):
        tree = TREES["comb"]
        tree = tree.replace(attribute={"type": gravelius_order(tree) + 2, "age": np.arange(25)})
        twin = there_and_back(tree, tmp_path)
        order = sort_topological(tree.parent)
        npt.assert_array_equal(twin.attribute["type"], tree.attribute["type"][order])
        npt.assert_array_equal(gravelius_order(twin), gravelius_order(tree)[order])
        assert list(twin.attribute) == ["type"]


class TestWriting:
    def test_the_text(self, tmp_path):
        tree = TreeGraph([-1, 0], [(0, 0, 0), (0.5, -1 / 3, 1e6)], [0.25, math.nan])
        write_swc(tree, tmp_path / "tree.swc")
        assert (tmp_path / "tree.swc").read_text().splitlines() == [
            "# id type x y z radius parent; metres",
            "1 0 0.0000000 0.0000000 0.0000000 0.25 -1",
            "2 0 0.5000000 -0.3333333 1000000.0000000 -1 1",
        ]

    def test_replaces_a_file_and_leaves_nothing_else(self, tmp_path):
        (tmp_path / "tree.swc").write_text("old")
        write_swc(TREES["comb"], tmp_path / "tree.swc")
        assert os.listdir(tmp_path) == ["tree.swc"]
        assert read_swc(str(tmp_path / "tree.swc")).n_nodes == 25

    def test_the_users_umask_counts(self, tmp_path):
        if sys.platform == "win32":
            pytest.skip("Windows has no umask")
        (tmp_path / "plain").write_text("")
        write_swc(TREES["comb"], tmp_path / "tree.swc")
        assert (tmp_path / "tree.swc").stat().st_mode == (tmp_path / "plain").stat().st_mode

    def test_failure_leaves_nothing(self, tmp_path):
        (tmp_path / "tree.swc").mkdir()
        with pytest.raises(OSError):
            write_swc(TREES["comb"], tmp_path / "tree.swc")
        assert os.listdir(tmp_path) == ["tree.swc"]
        with pytest.raises(FileNotFoundError):
            write_swc(TREES["comb"], tmp_path / "no folder" / "tree.swc")

    @pytest.mark.parametrize("kind", [[0.5, 1.0], [[1], [2]], ["a", "b"]])
    def test_type_must_be_an_integer_each(self, kind, tmp_path):
        tree = make_tree([-1, 0]).replace(attribute={"type": kind})
        with pytest.raises(InputError, match="attribute 'type' must hold one integer per node, got"):
            write_swc(tree, tmp_path / "tree.swc")


class TestReading:
    def test_nodes_in_any_order_with_any_ids(self, tmp_path):
        tree = read(tmp_path, "70 3 0 0 2 0.1 5\n900 4 1 0 3 0.05 70\n5 2 0 0 1 0.2 0\n0 1 0 0 0 0.3 -1\n")
        assert tree.parent.tolist() == [-1, 0, 1, 2]
        npt.assert_array_equal(tree.position, [(0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 3)])
        npt.assert_array_equal(tree.radius, [0.3, 0.2, 0.1, 0.05])
        assert tree.attribute["type"].tolist() == [1, 2, 3, 4]

    @pytest.mark.parametrize(
        "text",
        [
            b"1 0 0 0 0 1 -1\n2 0 0 0 1 1 1",  # no newline at the end
            b"\xef\xbb\xbf# made by hand\r\n\r\n1 0 0 0 0 1 -1\r\n   2 0 0 0 1 1 1   # tip\r\n",
            b"1\t0\t0\t0\t0\t1\t-1\n2\t0\t0\t0\t1\t1\t1\n",
            b"1,0,0,0,0,1,-1\n2,0,0,0,1,1,1\n",
            b"1, 0, 0, 0, 0, 1, -1\n2, 0, 0, 0, 1, 1, 1,\n",
            b"1 0 0 0 0 1 -1 extra columns\n2 0 0 0 1 1 1 7 8 9\n",
            b"1.0 0 0 0 0 1e0 -1\n2 0.0 0 0 +1.0 1 1.0\n",
            b"1 0 0 0 0 1 -7\r2 0 0 0 1 1 1\r",  # any negative parent; line ends of old
            b"1 0 0 0 0 1 1\n2 0 0 0 1 1 1\n",  # a root that is its own parent
            b"# caf\xe9\n1 0 0 0 0 1 -1\n2 0 0 0 1 1 1\n",  # not UTF-8
        ],
    )
    def test_what_real_files_look_like(self, text, tmp_path):
        tree = read(tmp_path, text)
        assert tree.parent.tolist() == [-1, 0]
        npt.assert_array_equal(tree.position, [(0, 0, 0), (0, 0, 1)])
        npt.assert_array_equal(tree.radius, [1, 1])

    def test_unknown_radii(self, tmp_path):
        assert np.isnan(read(tmp_path, "1 0 0 0 0 -1 -1\n2 0 0 0 1 nan 1\n").radius).all()

    def test_a_forest(self, tmp_path):
        tree = read(tmp_path, "1 0 0 0 0 1 -1\n2 0 9 0 0 1 -1\n3 0 0 0 1 1 1\n")
        assert tree.parent.tolist() == [-1, 0, -1]

    def test_a_long_chain_upside_down(self, tmp_path):
        n = 5000
        rows = [f"{i} 0 0 0 {i} 1 {i - 1 if i else -1}" for i in reversed(range(n))]
        tree = read(tmp_path, "\n".join(rows))
        npt.assert_array_equal(tree.parent, np.arange(-1, n - 1))
        npt.assert_array_equal(tree.position[:, 2], np.arange(n))

    @pytest.mark.parametrize(
        "text, match",
        [
            ("", "tree.swc has no rows; an SWC file has one 'id type x y z radius parent' per node"),
            ("# nothing\n\n", "tree.swc has no rows"),
            (
                "# a\n1 0 0 0 0 1\n",
                r"tree.swc, line 2: a row must have 7 columns \(id type x y z radius parent\), "
                "got 6: '1 0 0 0 0 1'",
            ),
            ("1 0 0 zero 0 1 -1", "tree.swc, line 1: could not convert string to float: 'zero'"),
            ("id type x y z radius parent\n", "tree.swc, line 1: could not convert string to float: 'id'"),
            ("1.5 0 0 0 0 1 -1", r"line 1: id must be an integer from 0 to \d+, got 1.5"),
            ("-1 0 0 0 0 1 -1", r"line 1: id must be an integer from 0 to \d+, got -1"),
            ("nan 0 0 0 0 1 -1", r"line 1: id must be an integer from 0 to \d+, got nan"),
            ("inf 0 0 0 0 1 -1", r"line 1: id must be an integer from 0 to \d+, got inf"),
            ("1e17 0 0 0 0 1 -1", r"line 1: id must be an integer from 0 to \d+, got 1e\+17"),
            ("1 0.5 0 0 0 1 -1", r"line 1: type must be an integer from -\d+ to 2147483647, got 0.5"),
            (
                "1 3000000000 0 0 0 1 -1",
                r"line 1: type must be an integer from -\d+ to 2147483647, got 3000000000",
            ),
            ("1 0 0 0 0 1 0.5", r"line 1: parent must be an integer from -\d+ to \d+, got 0.5"),
            ("1 0 0 0 0 1 nan", r"line 1: parent must be an integer from -\d+ to \d+, got nan"),
            ("1 0 0 nan 0 1 -1", r"line 1: x, y and z must be finite, got \[ 0. nan  0.\]"),
            ("1 0 0 inf 0 1 -1", "line 1: x, y and z must be finite, got"),
            ("1 0 0 0 0 inf -1", "line 1: radius must be finite, got inf"),
            ("1 0 0 0 0 1 -1\n\n1 0 0 0 1 1 1", "line 3: id 1 is already taken by line 1"),
            (
                "1 0 0 0 0 1 -1\n2 0 0 0 0 1 9",
                "line 2: parent 9 is not the id of any row; a root has the parent -1",
            ),
            ("1 0 0 0 0 1 0", "line 1: parent 0 is not the id of any row"),
            (
                "1 0 0 0 0 1 -1\n# x\n2 0 0 0 0 1 4\n3 0 0 0 0 1 2\n4 0 0 0 0 1 3\n5 0 0 0 0 1 4\n",
                "tree.swc, line 3: parents must lead to a root, but those of id 2 go round in a circle; "
                "4 of 5 rows hang on one",
            ),
            ("1 0 0 0 0 1 2\n2 0 0 0 0 1 1\n", "line 1: parents must lead to a root, .* 2 of 2 rows"),
            (
                "1 0 0,5 0 1,25 0,1 -1\n",
                "tree.swc, line 1: numbers must have a decimal point, got a comma: '1 0 0,5 0 1,25 0,1 -1'",
            ),
            (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "tree.swc, line 1: "),
        ],
    )
    def test_what_cannot_be_read(self, text, match, tmp_path):
        with pytest.raises(FormatError, match=match) as caught:
            read(tmp_path, text)
        assert "\n" not in str(caught.value)

    def test_missing_file(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            read_swc(tmp_path / "none.swc")

    @given(st.binary(max_size=200))
    @settings(deadline=None, max_examples=200)
    def test_any_bytes(self, folder, data):
        (folder / "junk.swc").write_bytes(data)
        try:
            read_swc(folder / "junk.swc")
        except FormatError as error:
            assert str(error).startswith("junk.swc")

    number = st.sampled_from(
        ["0", "1", "2", "3", "-1", "1.5", "nan", "1e400", "7,5", "#", "", "x", "99999999999999999999"]
    )

    @given(st.lists(st.lists(number, min_size=5, max_size=8), max_size=5))
    @settings(deadline=None, max_examples=300)
    def test_any_table(self, folder, rows):
        (folder / "junk.swc").write_text("\n".join(" ".join(row) for row in rows))
        try:
            assert read_swc(folder / "junk.swc").n_nodes <= len(rows)
        except FormatError as error:
            assert str(error).startswith("junk.swc")
