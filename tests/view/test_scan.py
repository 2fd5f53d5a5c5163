"""C-arm, projections, skin and slices of a recording."""

from dataclasses import replace

import numpy as np
import pytest

from legsim import view
from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.view import scan
from tests.examples import scene as example_scene
from tests.examples.recordings import read


def camera_pixels(intrinsics, world_from_camera, points):
    camera = transforms.apply(transforms.inverse(world_from_camera), points)
    pixels = np.einsum("vij,vpj->vpi", intrinsics, camera)
    return pixels[..., :2] / pixels[..., 2:], camera[..., 2]


def test_projections_stand_upright(scene, written):
    _, buffers = read(written, "/world/c_arm/detector/projection", "Image:buffer")
    images = scene.projections.line_integrals
    picture = np.array(buffers[3], np.uint8).reshape(images.shape[1:])
    top = np.percentile(images, 99.9)
    expected = np.clip(images[3, ::-1] / top * 255, 0, 255)
    np.testing.assert_allclose(picture, expected, atol=1)


def test_a_recording_keeps_a_coarser_detectors_pictures(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(scan, "IMAGE_COLUMNS", 20)
    view.write_scan(tmp_path / "r.rrd", replace(scene, surfaces=()))
    _, buffers = read(tmp_path / "r.rrd", "/world/c_arm/detector/projection", "Image:buffer")
    binned = scene.projections.coarser(scene.projections.geometry.shape_vu[1] // 20)
    shown = np.array(buffers[3], np.uint8).reshape(binned.geometry.shape_vu)
    expected = np.clip(
        binned.line_integrals[3, ::-1] / np.percentile(binned.line_integrals, 99.9) * 255, 0, 255
    )
    np.testing.assert_allclose(shown, expected, atol=1)


def test_a_scan_that_begins_within_the_motion_waits_at_its_first_view(scene, tmp_path):
    geometry = scene.projections.geometry
    later = replace(geometry, times=0.5 + 0.4 * geometry.times)
    path = tmp_path / "recording.rrd"
    view.write_scan(
        path, replace(scene, projections=replace(scene.projections, geometry=later), surfaces=())
    )
    for entity, component in (
        ("/world/c_arm", "Transform3D:translation"),
        ("/world/c_arm/detector/projection", "Image:buffer"),
    ):
        times, values = read(path, entity, component)
        assert times is not None
        np.testing.assert_allclose(times, [0, *later.times], atol=1e-9)
        np.testing.assert_array_equal(values[0], values[1])


@pytest.mark.parametrize("mirrored", [False, True])
def test_cameras_see_points_where_the_matrices_put_them(mirrored, rng):
    geometry = example_scene.scan_scene(views=6).projections.geometry
    if mirrored:
        flip = np.array([[-1, 0, geometry.shape_vu[1] - 1], [0, 1, 0], [0, 0, 1.0]])
        geometry = ConeBeamGeometry(
            geometry.times, flip @ geometry.matrices, geometry.shape_vu, geometry.pixel_pitch
        )
    rows, columns = geometry.shape_vu
    intrinsics, poses, turned = scan.cameras(geometry)
    points = geometry.rotation_center() + rng.uniform(-0.05, 0.05, (7, 3))
    pixels, depth = camera_pixels(intrinsics, poses, points)
    expected, expected_depth = geometry.project(points)
    assert turned == mirrored
    u = columns - 1 - expected[..., 0] if mirrored else expected[..., 0]
    np.testing.assert_allclose(pixels[..., 0], u + 0.5, atol=1e-6)
    np.testing.assert_allclose(pixels[..., 1], rows - 1 - expected[..., 1] + 0.5, atol=1e-6)
    np.testing.assert_allclose(depth, expected_depth, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)


def test_skin_is_thinned_in_space_and_time_and_follows(scene, written):
    surface = scene.surfaces[0]
    times, vertices = read(written, "/world/surfaces/skin_r", "Mesh3D:vertex_positions")
    assert len(times) == len(surface.times)
    np.testing.assert_allclose(np.stack(vertices), surface.vertices, atol=1e-6)
    kept, triangles = scan.thinned(surface.vertices[0], surface.triangles, 300)
    assert 100 < len(kept) <= 300
    assert triangles.max() < len(kept)
    assert len(np.unique(triangles)) > 0.9 * len(kept)


def test_slices_show_every_method_in_one_grey_window(scene, written):
    _, buffers = read(written, "/slices/picture", "Image:buffer")
    _, names = read(written, "/slices/names", "Points2D:labels")
    assert list(names[0]) == ["motion-free", "uncorrected", "rigid"]
    count, gap = 48, 6
    canvas = np.array(buffers[0], np.uint8).reshape(3 * count + 2 * gap, 3 * count + 2 * gap)
    assert {0, 255} <= set(np.unique(canvas[:count, :count]))
    assert (canvas[:count, :count] != canvas[:count, count + gap : 2 * count + gap]).any()
