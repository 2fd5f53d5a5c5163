"""Winding numbers by crossed triangles are those of solid angles, and entries pair with exits."""

import numpy as np
import pytest
import trimesh

from legsim.phantom import winding


def by_solid_angles(vertices, triangles, point) -> float:
    """Van Oosterom and Strackee (IEEE Trans Biomed Eng 30, 1983)."""
    a, b, c = np.moveaxis(vertices[triangles] - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    ab, bc, ca = (np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a)))
    volumes = np.einsum("ti,ti->t", a, np.cross(b, c))
    return np.arctan2(volumes, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)


def torus_with_a_hollow_and_a_double() -> tuple[np.ndarray, np.ndarray]:
    torus = trimesh.creation.torus(0.05, 0.02)
    hollow = trimesh.creation.torus(0.05, 0.01)
    other = trimesh.creation.icosphere(radius=0.03).apply_translation([0.06, 0, 0])
    vertices = np.concatenate([torus.vertices, hollow.vertices, other.vertices])
    first = len(torus.vertices)
    second = first + len(hollow.vertices)
    faces = [torus.faces, first + hollow.faces[:, ::-1], second + other.faces]
    return vertices, np.concatenate(faces)


def test_they_are_those_of_solid_angles(rng):
    vertices, triangles = torus_with_a_hollow_and_a_double()
    points = rng.uniform(-0.1, 0.1, (400, 3)) * [1, 1, 0.3]
    expected = [round(by_solid_angles(vertices, triangles, point)) for point in points]
    assert set(expected) == {0, 1, 2}
    assert winding.numbers(vertices, triangles, points).tolist() == expected
    turned = winding.numbers(vertices, triangles[:, ::-1], points)
    assert turned.tolist() == [-n for n in expected]


def test_rays_through_edges_and_vertices_count_once():
    """Points of a grid whose rays meet vertices, edges and faces that lie along them."""
    box = trimesh.creation.box((2, 2, 2)).subdivide().subdivide()
    steps = np.arange(-1.5, 1.51, 0.25)
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    points = points[(np.abs(np.abs(points) - 1) > 0.01).all(axis=1)]
    found = winding.numbers(np.asarray(box.vertices), np.asarray(box.faces), points)
    np.testing.assert_array_equal(found, (np.abs(points) < 1).all(axis=1))


def test_few_large_triangles_among_many_small_ones(rng):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1).apply_translation([9, 9, 9])
    box = trimesh.creation.box((20, 20, 20))
    vertices = np.concatenate([ball.vertices, box.vertices])
    triangles = np.concatenate([ball.faces, len(ball.vertices) + box.faces])
    points = np.concatenate([rng.uniform(-12, 12, (200, 3)), rng.uniform(8.9, 9.1, (200, 3))])
    expected = (np.abs(points) < 10).all(axis=1).astype(int)
    expected += np.linalg.norm(points - 9, axis=1) < 0.1
    found = winding.numbers(vertices, triangles, points)
    # the ball's flat triangles are up to 0.03 % of its radius nearer
    sure = np.abs(np.linalg.norm(points - 9, axis=1) - 0.1) > 0.001
    np.testing.assert_array_equal(found[sure], expected[sure])


@pytest.mark.parametrize("count", [0, 3])
def test_points_beside_the_mesh_meet_nothing(count):
    ball = trimesh.creation.icosphere(radius=0.1)
    points = np.full((count, 3), 5.0)
    found = winding.numbers(np.asarray(ball.vertices), np.asarray(ball.faces), points)
    assert found.tolist() == [0] * count
