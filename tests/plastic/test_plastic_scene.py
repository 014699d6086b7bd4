"""Scenes and their files."""

import math
import re

import numpy as np
import numpy.testing as npt
import pytest

from plastic import Neighbour, Scene, parse_scene, read_scene
from tests.plastic.plastic_trees import grown_state
from treegraph import Ball, Box, FormatError, HalfSpace, InputError, Sky, TriangleMesh

WHOLE = """
[light]
latitude_deg = 48.0
north_deg = 30.0

[strength]
bending = 1.5
pruning = 0.6

[[obstacle]]
kind = "wall"
x = -1.2

[[obstacle]]
kind = "box"
center = [2, 0, 1.5]
size = [0.2, 6, 3]
turn_deg = 90

[[obstacle]]
kind = "sphere"
center = [0, 3, 2]
radius = 0.5
translucency = 0.25

[[obstacle]]
kind = "half-space"
point = [0, 0, 8]
normal = [0, 0, -1]

[[obstacle]]
kind = "mesh"
file = "house.obj"

[[tree]]
file = "oak.lobes"

[[tree]]
file = "more/ash.lobes"
position = [4, -1]
turn_deg = 180
phototropism = 0.2

[[tree]]
file = "oak.lobes"
position = [8, 0, 0.5]
gravitropism = -0.1
"""


def triangle(path):
    return TriangleMesh(np.eye(3), [[0, 1, 2]])


def test_a_whole_file(tmp_path):
    path = tmp_path / "yard.toml"
    path.write_text(WHOLE)
    seen = []

    def reader(name):
        seen.append(name)
        return triangle(name)

    file = read_scene(path, read_mesh=reader)
    wall, box, ball, roof, mesh = file.scene.obstacles
    assert isinstance(wall, HalfSpace)
    assert (wall.point.tolist(), wall.normal.tolist()) == ([-1.2, 0, 0], [1, 0, 0])
    assert isinstance(box, Box)
    npt.assert_allclose(box.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert isinstance(ball, Ball)
    assert (ball.radius, ball.translucency) == (0.5, 0.25)
    assert isinstance(roof, HalfSpace)
    assert roof.normal.tolist() == [0, 0, -1]
    assert isinstance(mesh, TriangleMesh)
    assert seen == [tmp_path / "house.obj"]
    assert file.scene.sky == Sky.at_latitude(math.radians(48), math.radians(30))
    assert (file.scene.bending, file.scene.pruning) == (1.5, 0.6)
    assert [t.file for t in file.trees] == [
        tmp_path / "oak.lobes",
        tmp_path / "more" / "ash.lobes",
        tmp_path / "oak.lobes",
    ]
    assert [t.position.tolist() for t in file.trees] == [[0, 0, 0], [4, -1, 0], [8, 0, 0.5]]
    assert file.trees[1].turn == pytest.approx(math.pi)
    assert [(t.phototropism, t.gravitropism) for t in file.trees] == [(None, None), (0.2, None), (None, -0.1)]


def test_an_empty_file_is_the_open():
    file = parse_scene({})
    assert file.trees == ()
    assert file.scene.obstacles == ()
    assert (file.scene.sky, file.scene.bending, file.scene.pruning) == (None, 1.0, 0.8)


@pytest.mark.parametrize(
    "light, sky",
    [
        ({"brightest": [0, 3, 4]}, Sky((0, 0.6, 0.8))),
        ({"latitude_deg": -30}, Sky.at_latitude(-math.pi / 6)),
        ({"elevation_deg": 45, "bearing_deg": 90}, Sky.from_angles(math.pi / 4, math.pi / 2)),
        ({}, None),
    ],
)
def test_light(light, sky):
    assert parse_scene({"light": light}).scene.sky == sky


@pytest.mark.parametrize(
    "values, match",
    [
        ({"trees": []}, "the file: there is no 'trees'; there are tree, obstacle, light, strength"),
        ({"tree": {}}, r"tree must be tables \[\[tree\]\], with two brackets"),
        ({"light": 3}, r"light must be a table \[light\], got 3"),
        ({"tree": [{}]}, r"\[\[tree\]\] 1: file must be a text, got None"),
        (
            {"tree": [{"file": "a"}, {"file": "b", "x": 1}]},
            r"\[\[tree\]\] 2: there is no 'x'; there are file, ",
        ),
        (
            {"tree": [{"file": "a", "position": [1]}]},
            r"\[\[tree\]\] 1: position must be 3 finite numbers, got \[1\]",
        ),
        (
            {"tree": [{"file": "a", "position": [1, "b"]}]},
            r"position must be 2 finite numbers, got \[1, 'b'\]",
        ),
        ({"tree": [{"file": "a", "turn_deg": True}]}, "turn_deg must be a finite number, got True"),
        ({"obstacle": [{}]}, r"\[\[obstacle\]\] 1: kind must be a text, got None"),
        (
            {"obstacle": [{"kind": "cone"}]},
            r"\[\[obstacle\]\] 1: kind must be wall, half-space, box, sphere, mesh, got 'cone'",
        ),
        ({"obstacle": [{"kind": "wall"}]}, "a wall has either x or y, where it stands"),
        ({"obstacle": [{"kind": "wall", "x": 1, "y": 2}]}, "a wall has either x or y, where it stands"),
        ({"obstacle": [{"kind": "wall", "x": 0}]}, "a wall at x = 0 has no side; name a half-space"),
        ({"obstacle": [{"kind": "box", "size": [1, 1, 1]}]}, r"\[\[obstacle\]\] 1: center is missing"),
        (
            {"obstacle": [{"kind": "box", "center": [0, 0, 9], "size": [1, 0, 1]}]},
            r"\[\[obstacle\]\] 1: size must be three positive lengths",
        ),
        (
            {"obstacle": [{"kind": "sphere", "center": [0, 0, 9]}]},
            r"\[\[obstacle\]\] 1: radius is missing",
        ),
        (
            {"obstacle": [{"kind": "sphere", "center": [0, 0, 9], "radius": -1}]},
            r"\[\[obstacle\]\] 1: radius must be a positive finite number of metres, got -1.0",
        ),
        (
            {"obstacle": [{"kind": "wall", "x": 1, "translucency": 2}]},
            r"\[\[obstacle\]\] 1: translucency must be from 0 \(opaque\) to 1 \(clear\), got 2.0",
        ),
        (
            {"obstacle": [{"kind": "mesh", "file": "a.obj"}]},
            r"\[\[obstacle\]\] 1: meshes cannot be read here",
        ),
        ({"light": {"sun": 1}}, r"\[light\]: there is no 'sun'"),
        (
            {"light": {"brightest": [0, 0, 1], "latitude_deg": 3}},
            r"\[light\]: name one of brightest, latitude_deg, not several",
        ),
        ({"light": {"north_deg": 3}}, r"\[light\]: north_deg goes with latitude_deg, which is missing"),
        ({"light": {"brightest": [0, 0, -1]}}, r"\[light\]: brightest must not point below the horizon"),
        ({"light": {"elevation_deg": 100}}, r"^\[light\]: elevation_deg must be from 0 to 90, got 100"),
        ({"light": {"latitude_deg": -91}}, r"^\[light\]: latitude_deg must be from -90 to 90, got -91"),
        ({"strength": {"pruning": -1}}, r"\[strength\]: pruning must be from 0 to 100, got -1"),
        ({"strength": {"bending": "x"}}, r"\[strength\]: bending must be a number, got 'x'"),
        (
            {"strength": {"bending": 10**5000}},
            r"^\[strength\]: bending must be from -1e\+09 to 1e\+09, got som",
        ),
        ({"light": {"brightest": [0, 0, -1]}}, r"^\[light\]: brightest"),
        (
            {"tree": [{"file": "a", "position": [10**400, 0]}]},
            r"\[\[tree\]\] 1: position must be from -1e\+09 to 1e\+09, got 1000000000.{60,70} \.\.\.$",
        ),
        (
            {"obstacle": [{"kind": "half-space", "point": [0, 0, 6], "normal": [1e200, 1e200, 0]}]},
            r"\[\[obstacle\]\] 1: normal must be from -1e\+09 to 1e\+09, got 1e\+200",
        ),
        ({"tree": [{"file": "a\0b"}]}, r"\[\[tree\]\] 1: file must be a text, got 'a\\x00b'"),
        ({"strength": {"wind": 1}}, r"\[strength\]: there is no 'wind'; there are bending, pruning"),
    ],
)
def test_what_is_wrong_is_named(values, match):
    with pytest.raises(InputError, match=match):
        parse_scene(values)


def test_faults_of_meshes_say_which_obstacle():
    table = {"kind": "mesh", "file": "a.obj", "translucency": 3}
    with pytest.raises(InputError, match=r"^\[\[obstacle\]\] 1: translucency must be from 0"):
        parse_scene({"obstacle": [table]}, read_mesh=triangle)

    def fail(path):
        raise InputError(f"{path}: there is no such file.")

    with pytest.raises(InputError, match=r"^\[\[obstacle\]\] 1: a.obj: there is no such file"):
        parse_scene({"obstacle": [table]}, read_mesh=fail)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=re.escape("nothing.toml: the file cannot be read (No such file")):
        read_scene(tmp_path / "nothing.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[[tree]\n")
    with pytest.raises(FormatError, match=r"bad.toml: this is no TOML file: .*line 1"):
        read_scene(bad)
    bad.write_bytes(b"\xff\xfe")
    with pytest.raises(FormatError, match=r"bad.toml: this is no TOML file"):
        read_scene(bad)
    bad.write_text("[[tree]]\nfile = 3\n")
    with pytest.raises(FormatError, match=r"bad.toml: \[\[tree\]\] 1: file must be a text, got 3"):
        read_scene(bad)
    bad.write_text("a = " + "1" * 5000)
    with pytest.raises(FormatError, match="bad.toml: a number in it has too many digits to be read"):
        read_scene(bad)
    bad.write_text("a = " + "[" * 50_000)
    with pytest.raises(FormatError, match="bad.toml: its brackets are too deep to be read"):
        read_scene(bad)
    with pytest.raises(FormatError, match="/dev/zero: a scene file has at most 1000000 bytes"):
        read_scene("/dev/zero")  # of no length, and without end
    bad.write_text("# " + "x" * 1_000_001)
    with pytest.raises(FormatError, match="a scene file has at most 1000000 bytes"):
        read_scene(bad)


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"obstacles": ("wall",)}, r"obstacles must be HalfSpace, .* but obstacles\[0\] is a str"),
        ({"neighbours": (3,)}, r"neighbours must be Neighbour, but neighbours\[0\] is a int"),
        ({"sky": "blue"}, "sky must be a Sky or None, got str"),
        ({"bending": -0.1}, "bending must be from 0 to 100, got -0.1"),
        ({"pruning": math.nan}, "pruning must be from 0 to 100, got nan"),
        ({"pruning": True}, "pruning must be a number, got True"),
    ],
)
def test_bad_scenes(changes, match):
    with pytest.raises(InputError, match=match):
        Scene(**changes)


def test_scenes_keep_tuples():
    scene = Scene([Ball((1, 1, 1), 0.2)], [Neighbour(grown_state())], pruning=1)
    assert isinstance(scene.obstacles, tuple)
    assert isinstance(scene.neighbours, tuple)
    assert isinstance(scene.pruning, float)
