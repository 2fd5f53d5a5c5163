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
