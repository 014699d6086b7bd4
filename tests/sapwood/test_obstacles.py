"""Obstacles as the command line names them."""

import numpy as np
import numpy.testing as npt
import pytest

from sapwood.obstacles import parse_obstacle
from treegraph import Ball, Box, HalfSpace, InputError, TriangleMesh

ORIGIN = np.zeros(3)


@pytest.mark.parametrize(
    "text, point, normal",
    [
        ("wall:x=1.5", (1.5, 0, 0), (-1, 0, 0)),
        ("wall:x=-1.5", (-1.5, 0, 0), (1, 0, 0)),
        ("wall:y=2", (0, 2, 0), (0, -1, 0)),
        ("WALL: Y = -2e0", (0, -2, 0), (0, 1, 0)),
    ],
)
def test_wall_is_solid_on_the_side_away_from_the_tree(text, point, normal):
    wall = parse_obstacle(text)
    assert isinstance(wall, HalfSpace)
    npt.assert_array_equal(wall.point, point)
    npt.assert_array_equal(wall.normal, normal)
    assert wall.blocks(ORIGIN, -np.array([normal], float))[0]  # towards the wall
    assert not wall.blocks(ORIGIN, np.array([normal], float))[0]


def test_box_is_its_low_corner_and_its_edges():
    box = parse_obstacle("box:2,-1,0,0.5,2,3")
    assert isinstance(box, Box)
    npt.assert_allclose(box.center - box.size / 2, [2, -1, 0])
    npt.assert_allclose(box.center + box.size / 2, [2.5, 1, 3])


def test_sphere_is_its_middle_and_its_radius():
    ball = parse_obstacle("sphere:1,2,3,0.5")
    assert isinstance(ball, Ball)
    npt.assert_array_equal(ball.center, [1, 2, 3])
    assert ball.radius == 0.5


def test_mesh_is_read_from_its_file(tmp_path):
    path = tmp_path / "plate.obj"
    path.write_text("v 2 -1 -1\nv 2 1 -1\nv 2 0 1\nusemtl brick\nf 1 2 3\n")
    mesh = parse_obstacle(f"mesh:{path}")
    assert isinstance(mesh, TriangleMesh)
    npt.assert_array_equal(mesh.blocks(ORIGIN, np.array([[1.0, 0, 0], [0, 1.0, 0]])), [True, False])


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "an obstacle must be wall:x=1.5, box:x,y,z,dx,dy,dz, sphere:x,y,z,r or mesh:FILE, got ''"),
        ("tower:1", "an obstacle must be wall:x=1.5, .* got 'tower:1'"),
        ("wall", "an obstacle must be wall:x=1.5, .* got 'wall'"),
        ("wall:1.5", "'wall:1.5' must say where the wall stands, as in wall:x=1.5 or wall:y=-2"),
        ("wall:z=3", "'wall:z=3' must say where"),
        ("wall:x=", "'wall:x=' must have 1 finite numbers x"),
        ("wall:x=inf", "must have 1 finite numbers x"),
        ("wall:x=0", "'wall:x=0' runs through the foot of the tree"),
        ("box:1,2,3", "'box:1,2,3' must have 6 finite numbers x,y,z,dx,dy,dz"),
        ("box:1,2,3,4,5,nan", "must have 6 finite numbers"),
        ("box:1,2,3,4,0,6", "must have edges dx,dy,dz > 0"),
        ("sphere:1,2,3", "must have 4 finite numbers x,y,z,r"),
        ("sphere:1,2,3,x", "must have 4 finite numbers x,y,z,r"),
        ("sphere:1,2,3,-1", "must have a radius r > 0"),
        ("mesh:", "'mesh:' must name a file, as in mesh:house.obj"),
        ("mesh:none.obj", "none.obj: there is no such file"),
        ("mesh:none.txt", "none.txt: a mesh must end in one of .glb .obj .ply"),
    ],
)
def test_what_is_refused(text, said):
    with pytest.raises(InputError, match=said) as caught:
        parse_obstacle(text)
    assert "\n" not in str(caught.value)
