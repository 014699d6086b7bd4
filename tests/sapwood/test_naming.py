"""Which scans an argument means, and that no two of them share a name."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sapwood.naming import find_scans, name_scans
from treegraph.errors import InputError


@pytest.fixture
def plots(tmp_path):
    for name in (
        "a/tree.laz",
        "a/notes.md",
        "a/Birch.PLY",
        "a/deep/oak.laz",
        "b/tree.laz",
        "empty/readme.md",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def test_a_folder_means_the_scans_in_it(plots):
    assert [p.name for p in find_scans([str(plots / "a")])] == ["Birch.PLY", "tree.laz"]


def test_a_pattern_means_what_it_matches(plots):
    found = find_scans([str(plots / "**" / "*.laz")])
    assert [p.relative_to(plots).as_posix() for p in found] == ["a/deep/oak.laz", "a/tree.laz", "b/tree.laz"]


def test_a_scan_named_twice_is_taken_once(plots, monkeypatch):
    monkeypatch.chdir(plots)
    found = find_scans(["a/tree.laz", "b", str(plots / "a" / "tree.laz"), "./a/../b/tree.laz"])
    assert [p.as_posix() for p in found] == ["a/tree.laz", "b/tree.laz"]


def test_a_file_is_taken_whatever_it_is_called(plots):
    """The reader tells the kind by content; a file that is not there is that scan's own failure."""
    names = [str(plots / "a" / "notes.md"), str(plots / "missing.laz")]
    assert [str(p) for p in find_scans(names)] == names


def test_a_file_with_brackets_in_its_name_is_no_pattern(tmp_path):
    path = tmp_path / "tree[1].laz"
    path.write_bytes(b"x")
    assert find_scans([str(path)]) == [path]


@pytest.mark.parametrize(
    "argument, match",
    [("empty", "no scan in this folder; looked for"), ("*.e57", r"\*\.e57: no file matches this pattern")],
)
def test_nothing_found_is_said(plots, monkeypatch, argument, match):
    monkeypatch.chdir(plots)
    with pytest.raises(InputError, match=match):
        find_scans([argument])


def test_no_argument():
    with pytest.raises(InputError, match="no scan was named"):
        find_scans([])


@pytest.mark.parametrize(
    "scans, names",
    [
        (["one/tree.laz"], ["tree"]),
        (["north/tree.laz", "south/tree.laz"], ["north-tree", "south-tree"]),
        (["x/north/tree.laz", "y/north/tree.laz"], ["x-north-tree", "y-north-tree"]),
        (["a/tree.laz", "a/tree.ply"], ["tree-laz", "tree-ply"]),
        (["a/tree.laz", "a/TREE.ply", "b/oak.laz"], ["tree-laz", "TREE-ply", "oak"]),
        (["a/tree.laz", "b/Tree.laz"], ["a-tree", "b-Tree"]),
        (["a/tree.v1.laz", "a/tree.v2.laz"], ["tree.v1", "tree.v2"]),
        (["/tree.laz", "/a/tree.laz"], ["tree", "a-tree"]),
    ],
)
def test_names(scans, names):
    assert name_scans([Path(s) for s in scans]) == names


part = st.text("aAb-2", min_size=1, max_size=3)


@given(st.lists(st.tuples(part, part, part, st.sampled_from(["laz", "ply"])), max_size=12, unique=True))
def test_names_are_unique_and_safe(pieces):
    scans = [Path("/", a, b, f"{c}.{suffix}") for a, b, c, suffix in pieces]
    names = name_scans(scans)
    assert len({name.casefold() for name in names}) == len(scans)
    assert not any("/" in name for name in names)
