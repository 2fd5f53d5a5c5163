"""What is cut off at a plane is closed, and has the volume of what is left."""

import numpy as np
import pytest
import trimesh

from legsim.phantom import clipping
from legsim.phantom.meshes import Part
from legsim.phantom.raster import require_closed


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def cut(mesh: trimesh.Trimesh, normal, nearest: float) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.asarray(mesh.vertices)
    return clipping.in_front(vertices, np.asarray(mesh.faces), vertices @ normal, nearest)


@pytest.mark.parametrize("height", [-0.9, -0.2, 0.0, 0.31, 0.9])
def test_a_ball_is_cut_to_its_cap(height):
    vertices, triangles = cut(trimesh.creation.icosphere(5, 1.0), [0, 0.6, 0.8], height)
    require_closed(Part("ball", "water", 1.0, vertices, triangles))
    assert (vertices[np.unique(triangles)] @ [0, 0.6, 0.8]).min() > height - 1e-12
    cap = np.pi * (1 - height) ** 2 * (2 + height) / 3
    sag = 2e-4 * 2 * np.pi * (1 - height)  # of flat triangles, times the area
    assert volume(vertices, triangles) == pytest.approx(cap, abs=sag)


def test_a_cut_of_several_rings_is_closed_by_one_fan():
    """Two legs and a hollow between them: three rings, and one that faces inwards."""
    legs = [trimesh.creation.box((0.2, 0.2, 1.0)).apply_translation([x, 0, 0]) for x in (-1, 1)]
    shell = trimesh.creation.icosphere(3, 0.5)
    hollow = trimesh.creation.icosphere(3, 0.4)
    hollow.invert()
    mesh = trimesh.util.concatenate([*legs, shell, hollow])
    vertices, triangles = cut(mesh, [0, 0, 1.0], 0.0)
    require_closed(Part("legs", "water", 1.0, vertices, triangles))
    assert volume(vertices, triangles) == pytest.approx(0.5 * mesh.volume, rel=1e-9)
    for point, inside in (
        ((-1, 0, 0.2), True),
        ((1.05, 0.05, 0.4), True),
        ((0, 0, 0.2), False),
        ((0, 0, 0.45), True),
        ((0.7, 0, 0.01), False),
        ((-1, 0, -0.2), False),
    ):
        assert clipping.winds_around(vertices, triangles, np.array(point)) == inside


def test_a_plane_through_vertices_leaves_no_hole():
    box = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide()
    for height in (0.0, -0.5):
        vertices, triangles = cut(box, [0, 0, 1.0], height)
        require_closed(Part("box", "water", 1.0, vertices, triangles))
        assert volume(vertices, triangles) == pytest.approx(0.5 - height, abs=1e-12)


def test_all_or_nothing_is_left_where_the_plane_is_beside():
    ball = trimesh.creation.icosphere(2, 1.0)
    assert len(cut(ball, [1.0, 0, 0], -2.0)[1]) == len(ball.faces)
    assert len(cut(ball, [1.0, 0, 0], 2.0)[1]) == 0


def test_a_mesh_winds_around_what_is_inside_in_either_direction():
    ball = trimesh.creation.icosphere(2, 1.0)
    for triangles in (ball.faces, ball.faces[:, ::-1]):
        found = [
            clipping.winds_around(np.asarray(ball.vertices), triangles, np.array([x, 0.1, 0.2]))
            for x in (0.0, 0.8, 1.1, 5.0)
        ]
        assert found == [True, True, False, False]
