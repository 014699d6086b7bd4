"""Text scans in whatever dialect people write, and the ones that cannot be told apart."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import recon
from recon.formats.columns import map_columns
from treegraph.errors import FormatError

NAMES = ("x", "y", "z", "intensity")


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def world(cloud):
    return (cloud.xyz + cloud.origin).round(9)


def spell(value, mark, style):
    word = {"plain": f"{value:.3f}", "exponent": f"{value:.9e}", "signed": f"{value:+.3f}"}[style]
    return word.replace(".", mark)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    seed=st.integers(0, 1000),
    dialect=st.sampled_from(
        [(d, m) for d in (" ", "  ", "\t", ";", "; ", "|") for m in ".,"] + [(",", "."), (", ", ".")]
    ),
    header=st.sampled_from(["none", "names", "quoted", "comment", "count"]),
    index=st.booleans(),
    quoted=st.booleans(),
    style=st.sampled_from(["plain", "exponent", "signed"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    last=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
)
def test_every_dialect(tmp_path, seed, dialect, header, index, quoted, style, newline, last, encoding):
    delimiter, mark = dialect
    rng = np.random.default_rng(seed)
    table = rng.uniform(-500, 500, (12, 4)).round(3)
    table[:, 3] = rng.integers(1, 4000, 12) + 0.5
    names = (["nr"] if index else []) + list(NAMES)
    lines = []
    if header == "names":
        lines.append(delimiter.join(names))
    elif header == "quoted":
        lines.append(delimiter.join(f'"{name}"' for name in names))
    elif header == "comment":
        lines += ["# made by hand", "// " + delimiter.join(names)]
    elif header == "count":
        lines.append(str(len(table)))
    for i, row in enumerate(table):
        words = ([str(i + 1)] if index else []) + [spell(value, mark, style) for value in row]
        lines.append(delimiter.join(f'"{word}"' if quoted else word for word in words))
    path = write(tmp_path / "scan.txt", newline.join(lines) + (newline if last else ""), encoding)
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), table[:, :3], atol=1e-8)
    assert cloud.n_read == 12
    if header in ("names", "quoted", "comment"):
        npt.assert_allclose(cloud.intensity, table[:, 3], rtol=1e-6)
    else:
        assert cloud.intensity is None
        assert any("has no name and was not used" in note for note in cloud.notes)


def body(rows=8, template="{0}.5 {1}.25 {2}.125"):
    return "".join(template.format(i, 2 * i, 3 * i) + "\n" for i in range(1, rows + 1))


EXPECTED = np.arange(1, 9)[:, None] * [1, 2, 3] + [0.5, 0.25, 0.125]


@pytest.mark.parametrize(
    "template",
    ["{0},5 {1},25 {2},125", "{0},5;{1},25;{2},125", "{0},5\t{1},25\t{2},125", "{0}.5,{1}.25,{2}.125",
     "{0}.5, {1}.25 ,{2}.125",
     "{0}.5e0 {1}.25E+0 {2}125e-3", "{0}.5|{1}.25|{2}.125"],
)  # fmt: skip
def test_spellings_of_the_same_numbers(tmp_path, template):
    if "125e-3" in template:
        template = template.replace("{2}125e-3", "{2}.125e+00")
    npt.assert_array_equal(world(recon.read_cloud(write(tmp_path / "a.csv", body(8, template)))), EXPECTED)


def test_names_choose_the_columns(tmp_path):
    text = "Z;tree_id;X;Y;is_wood;R;G;B;class\n" + "".join(
        f"{i},5;{i % 2};{10 * i};{-i};{i % 3 == 0:d};{i};{200 + i};9;4\n" for i in range(8)
    )
    cloud = recon.read_cloud(write(tmp_path / "a.csv", text))
    i = np.arange(8)
    npt.assert_array_equal(world(cloud), np.stack([10 * i, -i, i + 0.5], axis=1))
    npt.assert_array_equal(cloud.tree_id, i % 2)
    npt.assert_array_equal(cloud.is_wood, i % 3 == 0)
    npt.assert_array_equal(cloud.color, np.stack([i, 200 + i, np.full(8, 9)], axis=1))
    assert "column class was not used: its name does not say what it means" in cloud.notes
    assert any(note.startswith("is_wood was read as wood where it is above 0.5") for note in cloud.notes)


def test_labels_that_cannot_be_labels_are_left_alone(tmp_path):
    text = "x y z tree wood\n" + "".join(f"{i} {i * i} {i} {i}.5 {i}\n" for i in range(8))
    cloud = recon.read_cloud(write(tmp_path / "a.txt", text))
    assert cloud.tree_id is None and cloud.is_wood is None
    assert "tree does not hold whole numbers and was not used as a tree's number" in cloud.notes
    assert any(note.startswith("wood is not between 0 and 1 everywhere") for note in cloud.notes)
    text = "x y z leaf\n" + "".join(f"{i} {i * i} {i} 1\n" for i in range(8))
    cloud = recon.read_cloud(write(tmp_path / "a.txt", text))
    assert cloud.is_wood is None
    assert any(note.startswith("leaf is the same for all points") for note in cloud.notes)


def test_pts_with_intensity_and_colours(tmp_path):
    text = "8\n" + "".join(f"{i}.25 {i}.5 {i}.75 {-1000 + i} {i} {50 + i} 255\n" for i in range(8))
    cloud = recon.read_cloud(write(tmp_path / "a.pts", text))
    npt.assert_array_equal(cloud.color[:, 1], 50 + np.arange(8))
    npt.assert_array_equal(cloud.intensity, -1000 + np.arange(8))


@pytest.mark.parametrize("top, expected", [(1.0, [0, 128, 255]), (255, [0, 1, 255]), (65535, [0, 0, 255])])
def test_colours_of_any_range(tmp_path, top, expected):
    middle = 0.5 if top == 1.0 else 1
    text = "x,y,z,r,g,b\n" + "".join(f"{i}.5,{i},{i},0,{middle},{top}\n" for i in range(8))
    cloud = recon.read_cloud(write(tmp_path / "a.csv", text))
    assert cloud.color[0].tolist() == expected


def test_rows_without_numbers_are_dropped_and_told(tmp_path):
    text = body(8) + "nan nan nan\n" + "1.5 2.5 inf\n" + body(30) + "END OF SCAN\n"
    cloud = recon.read_cloud(write(tmp_path / "a.xyz", text))
    assert (cloud.n_points, cloud.n_read) == (38, 40)
    assert "2 of 40 points have no finite coordinates and were left out" in cloud.notes
    assert any(note.startswith("1 of 41 lines are not rows of numbers") for note in cloud.notes)


def test_a_comment_is_no_header_but_is_told(tmp_path):
    cloud = recon.read_cloud(write(tmp_path / "a.xyz", "# made by hand\n" + body()))
    npt.assert_array_equal(world(cloud), EXPECTED)
    assert any(
        note.startswith("the header (made, by, hand) does not name x, y and z") for note in cloud.notes
    )
    with pytest.raises(FormatError, match="the header names the columns stem, x, y, but none x, y and z"):
        recon.read_cloud(write(tmp_path / "b.csv", "# a map\nstem,x,y\n" + body(8, "{0},{1}.5,{2}.5")))


def test_decimal_mark_may_be_given(tmp_path):
    path = write(tmp_path / "a.csv", "1,5 2,5 3,5\n" * 3 + "4,5 5,5 6,5\n" * 3)
    assert recon.read_cloud(path, decimal=",").n_points == 6


REFUSED = {
    "whole or decimal": ("1,2,3,4,5,6\n" * 8, r"could be 6 whole numbers or 3 numbers with decimal commas"),
    "comma inside and between": ("1,5, 2,5, 3,5\n" * 8, "commas stand both inside numbers and between them"),
    "thousands": ("1,000.5;2,000.5;3,000.5\n" * 8, "numbers with both commas and points in them"),
    "other names": (
        "lon;lat;name\n" + "1;2;3\n" * 8,
        "the header names the columns lon, lat, name, but none x, y and z",
    ),
    "two columns": ("x y\n" + "1 2\n" * 8, "no line of three or more numbers"),
    "words": ("this is not a scan\nat all\n", "no line of three or more numbers in the first"),
    "mostly words": (body(8) + "oh no\n" * 4, "lines are not rows of numbers like the others"),
    "one line": ("1 2 3", "1 usable points are too few for a tree"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(tmp_path, case):
    text, message = REFUSED[case]
    path = write(tmp_path / "a.txt", text)
    with pytest.raises(ValueError, match=message) as error:
        recon.read_cloud(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


def test_comma_cannot_be_both(tmp_path):
    path = write(tmp_path / "a.csv", "1,2,3\n" * 8)
    with pytest.raises(FormatError, match="the comma cannot be both the decimal mark and the delimiter"):
        recon.read_cloud(path, decimal=",")


@given(st.lists(st.floats(-1e9, 1e9, allow_nan=False), min_size=3, max_size=3))
def test_numbers_are_those_of_python(values):
    from recon.formats._text_kernels import parse_lines

    line = np.frombuffer((" ".join(repr(value) for value in values) + "\n").encode(), np.uint8)
    out = np.empty((1, 3))
    rows, _ = parse_lines(line, len(line), 32, 46, np.arange(3), 3, 1, out, np.zeros(3, np.int64))
    assert rows == 1
    npt.assert_allclose(out[0], values, rtol=2e-15, atol=1e-290)


@pytest.mark.parametrize(
    "names",
    [("X", "Y", "Z"), ("//X", "Y", "Z"), ("x [m]", "y [m]", "z [m]"), ("Easting", "Northing", "Height"),
     ("Points:0", "Points:1", "Points:2")],
)  # fmt: skip
def test_names_of_coordinates(names):
    assert map_columns(names).xyz == (0, 1, 2)
