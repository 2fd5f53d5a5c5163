"""What a repair does to a surface, and that projections of the result are exact."""

import numpy as np
import pytest
import trimesh

from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device
from legsim.phantom import surfaces
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import projector


def box() -> tuple[np.ndarray, np.ndarray]:
    """A cube of 0.1 m whose faces are 8 x 8 squares."""
    mesh = trimesh.creation.box((0.1, 0.1, 0.1)).subdivide().subdivide().subdivide()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def test_doubles_holes_and_turned_triangles_are_repaired_exactly(device: Device) -> None:
    vertices, triangles = box()
    turned = triangles.copy()
    turned[::7] = turned[::7, ::-1]
    inside_a_face = int(np.flatnonzero((np.ptp(vertices[triangles], axis=1) == 0).any(1))[200])
    holed = np.delete(turned, inside_a_face, 0)
    broken = np.concatenate([holed, holed[40:45], holed[100:103, ::-1]])
    corners = vertices[broken].reshape(-1, 3)
    points, faces, done = surfaces.repaired(corners, np.arange(len(corners)).reshape(-1, 3))
    assert len(surfaces.unpaired(faces)) == 0
    said = "; ".join(done)
    for words in ("doubled vertices", "8 doubled triangles", "turned to agree", "1 holes closed"):
        assert words in said
    assert abs(surfaces.volume(points, faces)) == pytest.approx(1e-3, rel=1e-9)
    geometry = ConeBeamGeometry.circular(
        times=np.zeros(1),
        angles=np.radians([0.0]),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(9, 9),
        pixel_pitch=5e-3,
    )
    if surfaces.volume(points, faces) < 0:
        faces = faces[:, ::-1]
    image = projector.project(Phantom((Part("box", "", 1.0, points, faces),)), geometry, device)
    rays = geometry.ray_directions(*np.meshgrid(np.arange(9), np.arange(9)))[0]
    lengths = 0.1 * np.linalg.norm(rays, axis=-1)
    np.testing.assert_allclose(image.line_integrals[0], lengths, atol=2e-5)


def test_a_lid_is_no_small_hole() -> None:
    vertices, triangles = box()
    lidless = triangles[(vertices[triangles][..., 2] < 0.0499).any(1)]
    _, faces, done = surfaces.repaired(vertices, lidless)
    assert not any("hole" in what for what in done)
    assert len(surfaces.unpaired(faces)) == 32


def test_a_flap_is_left_out_and_a_sound_surface_is_left_alone() -> None:
    vertices, triangles = box()
    with_flap = np.concatenate([triangles, [[*triangles[0, :2], len(vertices)]]])
    points, faces, done = surfaces.repaired(np.vstack([vertices, [[0.2, 0.2, 0.2]]]), with_flap)
    assert done == ["1 triangles at edges of three or more left out"]
    assert len(surfaces.unpaired(faces)) == 0
    points, faces, done = surfaces.repaired(vertices, triangles)
    assert (len(points), len(faces), done) == (len(vertices), len(triangles), [])
    assert surfaces.closed(vertices, triangles)[1] is triangles


def test_shells_share_no_edge() -> None:
    vertices, triangles = box()
    two = np.concatenate([triangles, triangles + len(vertices)])
    numbers = surfaces.shells(two)
    assert len(set(numbers[: len(triangles)])) == len(set(numbers[len(triangles) :])) == 1
    assert numbers[0] != numbers[-1]


def many_shells(count: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """A cube and small balls in it, in rows; the triangles of each."""
    vertices, triangles = box()
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.002)
    corners, faces, groups = [vertices], [triangles], [np.arange(len(triangles))]
    for k in range(count):
        place = np.array([k % 9, k // 9 % 9, k // 81]) * 0.01 - 0.04
        groups.append(sum(map(len, faces)) + np.arange(len(ball.faces)))
        faces.append(ball.faces + sum(map(len, corners)))
        corners.append(ball.vertices + place)
    return np.concatenate(corners), np.concatenate(faces), groups


def test_hollows_stay_and_shells_beside_are_turned_also_where_there_are_many() -> None:
    vertices, triangles, groups = many_shells(300)
    for group in groups[1:]:
        triangles[group] = triangles[group][:, ::-1]
    numbers = surfaces.shells(triangles)
    assert surfaces.inverted_shells(vertices, triangles, numbers) == ([], [])
    for k in (1, 2):
        vertices[np.unique(triangles[groups[k]])] += [0.3 + 0.1 * k, 0, 0]
    alone, overlapping = surfaces.inverted_shells(vertices, triangles, numbers)
    assert [sorted(group) for group in alone] == [list(groups[1]), list(groups[2])]
    assert overlapping == []


def test_a_shell_that_reaches_out_of_another_overlaps_it() -> None:
    vertices, triangles, groups = many_shells(1)
    triangles[groups[1]] = triangles[groups[1]][:, ::-1]
    ball = np.unique(triangles[groups[1]])
    numbers = surfaces.shells(triangles)
    vertices[ball] += [-0.01, 0, 0]  # its middle is on a face of the cube
    assert len(surfaces.inverted_shells(vertices, triangles, numbers)[1]) == 1
    # a ball around the cube, with all of its own vertices outside
    vertices[ball] = (vertices[ball] + [0.05, 0.04, 0.04]) * 100
    assert len(surfaces.inverted_shells(vertices, triangles, numbers)[1]) == 1


def test_shells_behind_one_another_are_only_compared_where_their_boxes_meet() -> None:
    """Of 400 balls in a row each sample's ray along x meets half of all others."""
    ball = trimesh.creation.icosphere(2)
    row = np.stack([np.arange(400.0), 0 * np.arange(400), 0 * np.arange(400)], -1)
    vertices = (0.4 * ball.vertices + row[:, None]).reshape(-1, 3)
    ends = len(ball.vertices) * np.arange(400)[:, None, None]
    triangles = (ball.faces[:, ::-1] + ends).reshape(-1, 3)
    alone, overlapping = surfaces.inverted_shells(vertices, triangles, surfaces.shells(triangles))
    assert (len(alone), overlapping) == (400, [])


def test_inverted_boxes_are_those_that_comparing_each_pair_finds(rng: np.random.Generator) -> None:
    count, box = 120, trimesh.creation.box((2, 2, 2))
    middles, halves = rng.uniform(0, 8, (count, 3)), rng.uniform(0.1, 1.5, (count, 3))
    corners = middles[:, None] + halves[:, None] * box.vertices
    inward = rng.random(count) < 0.5
    faces = [box.faces[:, ::-1] if inward[k] else box.faces for k in range(count)]
    triangles = np.concatenate([face + 8 * k for k, face in enumerate(faces)])
    # (k, j): share of the corners of box k in box j
    beside = np.abs(corners[:, None] - middles[None, :, None]) / halves[None, :, None]
    shares = (beside < 1).all(axis=-1).mean(axis=-1) * (1 - np.eye(count))
    reached = inward & (shares.max(axis=1) < 1)
    touched = (shares > 0).any(axis=1) | (shares > 0).any(axis=0)
    found = surfaces.inverted_shells(corners.reshape(-1, 3), triangles, surfaces.shells(triangles))
    for groups, expected in zip(found, (reached & ~touched, reached & touched), strict=True):
        assert [int(g[0]) // 12 for g in groups] == list(np.flatnonzero(expected))
        assert expected.any()


def test_outward_shells_inside_another_are_covered_but_not_in_a_hollow() -> None:
    """A ball in a ball changes nothing; turned inward it is a hollow, and a ball in that counts."""
    balls = [trimesh.creation.icosphere(2, radius=radius) for radius in (3, 2, 1)]
    balls.append(trimesh.creation.icosphere(2, radius=1.0).apply_translation((9, 0, 0)))
    vertices = np.concatenate([ball.vertices for ball in balls])
    for inward, covered in ((False, [1, 2]), (True, [])):
        faces = [ball.faces + 162 * k for k, ball in enumerate(balls)]
        faces[1] = faces[1][:, ::-1] if inward else faces[1]
        triangles = np.concatenate(faces)
        found = surfaces.covered_shells(vertices, triangles, surfaces.shells(triangles))
        assert [int(group[0]) // 320 for group in found] == covered


def test_a_shell_with_one_spike_that_sticks_out_is_not_covered() -> None:
    outer, inner = (trimesh.creation.icosphere(4, radius=radius) for radius in (5, 3))
    vertices = np.concatenate([outer.vertices, inner.vertices])
    triangles = np.concatenate([outer.faces, inner.faces + len(outer.vertices)])
    numbers = surfaces.shells(triangles)
    assert len(surfaces.covered_shells(vertices, triangles, numbers)) == 1
    for spike in (100, 101, 1500):
        with_spike = vertices.copy()
        with_spike[len(outer.vertices) + spike] *= 2.5
        assert surfaces.covered_shells(with_spike, triangles, numbers) == []


def test_a_moebius_strip_stays_as_it_is() -> None:
    around = np.linspace(0, np.pi, 13)[:-1]
    side = np.stack([np.cos(2 * around), np.sin(2 * around), 0 * around], -1)
    across = 0.3 * (np.cos(around)[:, None] * side + np.sin(around)[:, None] * [0, 0, 1])
    vertices = np.concatenate([side - across, side + across])
    triangles = []
    for k in range(12):
        a, b = k, k + 12
        c, d = (k + 1, k + 13) if k < 11 else (12, 0)
        triangles += [(a, c, b), (c, d, b)]
    _, faces, done = surfaces.repaired(vertices, np.array(triangles))
    assert not any("turned" in what for what in done)
    assert len(surfaces.unpaired(faces))


def test_rows_are_alike_where_all_of_them_is(rng) -> None:
    rows = rng.integers(-2, 3, (500, 3)) / 7.0
    rows[::5] *= -0.0
    first, numbers = surfaces._alike(rows)
    np.testing.assert_array_equal(rows[first][numbers], rows)
    assert len(first) == len(np.unique(rows + 0.0, axis=0))
    assert (np.diff(first) > 0).all()


def test_rows_whose_hashes_are_equal_are_told_apart(rng, monkeypatch) -> None:
    rows = rng.integers(-2, 3, (500, 3)) / 7.0
    expected = surfaces._alike(rows)
    monkeypatch.setattr(surfaces, "_mixed", lambda keys: 0 * keys)
    for found, one in zip(surfaces._alike(rows), expected, strict=True):
        np.testing.assert_array_equal(found, one)


def test_sums_of_hashes_overflow_in_silence():
    """Triangles of one vertex have edges from it to itself, which open nothing."""
    for k in range(50):
        mesh = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2], [k, k, k]])
        assert surfaces.is_closed(mesh)
        assert not surfaces.is_closed(mesh[1:])
