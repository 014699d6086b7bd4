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


def test_a_scan_behind_two_links_is_taken_once(plots):
    (plots / "b" / "again.laz").symlink_to(plots / "b" / "tree.laz")
    assert [p.name for p in find_scans([str(plots / "b")])] == ["again.laz"]


def test_an_empty_text_file_of_a_folder_fails_rather_than_being_passed_over(tmp_path):
    """It was to be a scan; a letter was not."""
    (tmp_path / "empty.xyz").write_text("")
    (tmp_path / "letter.txt").write_text("Dear forester,\nthis is no scan.\n")
    (tmp_path / "scan.csv").write_text("x;y;z\n1,5;2,5;3,5\n")
    (tmp_path / "oak.cylinders.csv").write_text("1,2,3\n")
    skipped = []
    assert [p.name for p in find_scans([str(tmp_path)], skipped)] == ["empty.xyz", "scan.csv"]
    assert [p.name for p in skipped] == ["letter.txt", "oak.cylinders.csv"]


def test_a_file_is_taken_whatever_it_is_called(plots):
    """The reader tells the kind by content; a file that is not there is that scan's own failure."""
    names = [str(plots / "a" / "notes.md"), str(plots / "missing.laz")]
    assert [str(p) for p in find_scans(names)] == names


def test_a_file_with_brackets_in_its_name_is_no_pattern(tmp_path):
    path = tmp_path / "tree[1].laz"
    path.write_bytes(b"x")
    assert find_scans([str(path)]) == [path]


def test_hidden_files_of_a_folder_are_left_out_and_broken_links_are_not(tmp_path):
    """macOS puts ._oak.laz beside oak.laz; a link to a disk that is not there must not be passed over."""
    for name in ("oak.laz", "._oak.laz", ".hidden.xyz"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "link.laz").symlink_to(tmp_path / "unmounted" / "link.laz")
    (tmp_path / "folder.laz").mkdir()
    assert [p.name for p in find_scans([str(tmp_path)])] == ["link.laz", "oak.laz"]
    hidden = tmp_path / ".hidden.xyz"
    assert find_scans([str(hidden)]) == [hidden]  # named, it is taken


def test_what_means_no_scan_can_be_collected(plots, monkeypatch):
    monkeypatch.chdir(plots)
    refused = []
    assert [p.name for p in find_scans(["empty", "a", "*.e57"], None, refused)] == ["Birch.PLY", "tree.laz"]
    assert [argument for argument, _ in refused] == ["empty", "*.e57"]
    assert refused[1][1] == "*.e57: no file matches this pattern."
    refused.clear()
    assert find_scans(["empty"], None, refused) == []


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


def test_a_long_name_leaves_room_for_suffixes():
    long = ["a" * 251, "樹" * 83, "a" * 240 + "b"]
    found = name_scans([Path(f"{name}.xyz") for name in long])
    assert found == ["a" * 220, "樹" * 73, "a" * 220 + "-2"]


part = st.text("aAb-2", min_size=1, max_size=3)


@given(st.lists(st.tuples(part, part, part, st.sampled_from(["laz", "ply"])), max_size=12, unique=True))
def test_names_are_unique_and_safe(pieces):
    scans = [Path("/", a, b, f"{c}.{suffix}") for a, b, c, suffix in pieces]
    names = name_scans(scans)
    assert len({name.casefold() for name in names}) == len(scans)
    assert not any("/" in name for name in names)
