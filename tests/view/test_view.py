"""Recordings say what was logged: read back entity by entity, verified and compared by rerun's own
tools.
"""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
import rerun.chunk as rc

from legsim import view
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.view import recording, scan
from tests.examples import scene as example_scene


@pytest.fixture(autouse=True)
def _strict():
    """Bad input to rerun raises instead of warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def scene():
    return example_scene.scan_scene()


@pytest.fixture(scope="module")
def written(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "recording.rrd"
    view.write_scan(path, scene)
    return path


def read(path, entity, component, timeline="time"):
    """(times (n,) in s or frames, one array a row) of a logged component, in the order of the
    timeline.
    """
    times, values = [], []
    for chunk in rc.RrdReader(path).store().stream().filter(content=entity).to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        values += batch.column(component).to_pylist()
        if not chunk.is_static:
            times.append(batch.column(timeline).to_numpy(zero_copy_only=False))
    if not times:
        return None, [np.array(v) for v in values]
    times = np.concatenate(times)
    order = np.argsort(times, kind="stable")
    seconds = times[order] / np.timedelta64(1, "s") if timeline == "time" else times[order]
    return seconds, [np.array(values[i]) for i in order]


def rrd(*arguments):
    """Runs rerun's file tool."""
    return subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


def test_rerun_verifies_the_file(written):
    assert rrd("verify", written).returncode == 0


def test_the_same_scene_gives_an_equal_recording(scene, written, tmp_path):
    again = tmp_path / "again.rrd"
    view.write_scan(again, example_scene.scan_scene())
    outcome = rrd("compare", "--unordered", written, again)
    assert outcome.returncode == 0, outcome.stderr
    assert recording.content_id(scene) == recording.content_id(example_scene.scan_scene())


def test_another_scene_gets_another_identity(scene):
    other = replace(scene, replay=replace(scene.replay, floor_height=0.01))
    assert recording.content_id(scene) != recording.content_id(other)


def test_one_voxel_makes_another_identity(scene):
    last = scene.volumes[-1]
    attenuation = last.volume.attenuation.copy()
    attenuation[20, 20, 20] += 1e-3
    other = replace(last, volume=replace(last.volume, attenuation=attenuation))
    assert recording.content_id(scene) != recording.content_id(
        replace(scene, volumes=(*scene.volumes[:-1], other))
    )


def test_joint_centers_on_both_timelines(scene, written):
    centers = scene.replay.joint_centers
    times, positions = read(written, "/world/joints", "Points3D:positions")
    np.testing.assert_allclose(times, centers.times, atol=1e-9)
    np.testing.assert_allclose(np.stack(positions), centers.positions_world, atol=1e-6)
    frames, _ = read(written, "/world/joints", "Points3D:positions", "frame")
    np.testing.assert_array_equal(frames, np.arange(len(centers.times)))


def test_bones_join_the_joints_they_name(scene, written):
    centers = scene.replay.joint_centers
    _, strips = read(written, "/world/bones", "LineStrips3D:strips")
    expected = np.stack([centers.of("hip_r"), centers.of("knee_r")], 1)
    assert len(strips) == len(centers.times)
    for k in (0, 60):
        assert min(np.abs(bone - expected[k]).max() for bone in strips[k]) < 1e-6


def test_segment_poses_come_back_as_transforms(scene, written):
    _, translations = read(written, "/world/segments/tibia_r", "Transform3D:translation")
    _, quaternions = read(written, "/world/segments/tibia_r", "Transform3D:quaternion")
    poses = scene.replay.poses.of("tibia_r")
    xyzw = np.stack(quaternions)[:, 0]
    np.testing.assert_allclose(np.stack(translations)[:, 0], poses[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(
        transforms.rotation_from_quaternion(xyzw[:, [3, 0, 1, 2]]), poses[:, :3, :3], atol=1e-6
    )


def test_only_seen_markers_are_drawn_and_keep_their_names(scene, written):
    measured = scene.replay.measured
    _, positions = read(written, "/world/markers/measured", "Points3D:positions")
    _, labels = read(written, "/world/markers/measured", "Points3D:labels")
    seen = np.isfinite(measured.positions_world).all(-1)
    assert seen.sum() < seen.size
    for k in (0, 15, 40):
        np.testing.assert_allclose(positions[k], measured.positions_world[k, seen[k]], atol=1e-6)
        assert list(labels[k]) == [
            n for n, s in zip(measured.marker_names, seen[k], strict=True) if s
        ]


def test_residual_arrows_lead_from_measured_to_model(scene, written):
    _, vectors = read(written, "/world/markers/residual", "Arrows3D:vectors")
    _, origins = read(written, "/world/markers/residual", "Arrows3D:origins")
    seen = np.isfinite(scene.replay.measured.positions_world[20]).all(-1)
    np.testing.assert_allclose(
        origins[20] + vectors[20], scene.replay.modelled.positions_world[20, seen], atol=1e-6
    )


def test_curves_hold_the_values_exactly(scene, written):
    replay = scene.replay
    _, knee = read(written, "/angles/knee_angle_r", "Scalars:scalars")
    np.testing.assert_array_equal(
        np.stack(knee)[:, 0], np.rad2deg(replay.trajectories.coordinate("knee_angle_r"))
    )
    _, height = read(written, "/translations/pelvis_ty", "Scalars:scalars")
    np.testing.assert_allclose(
        np.stack(height)[:, 0],
        1e3 * (replay.trajectories.coordinate("pelvis_ty") - replay.trajectories.values[0, 2]),
    )
    _, force = read(written, "/imu/shank_r/specific_force", "Scalars:scalars")
    np.testing.assert_array_equal(np.stack(force), replay.imu.sensor("shank_r")[1])
    _, rms = read(written, "/residuals/rms", "Scalars:scalars")
    expected = 1e3 * np.sqrt(np.nanmean(replay.marker_residuals() ** 2, -1))
    np.testing.assert_allclose(np.stack(rms)[:, 0], expected)


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
        np.testing.assert_allclose(times, [0, *later.times], atol=1e-9)
        np.testing.assert_array_equal(values[0], values[1])


def camera_pixels(intrinsics, world_from_camera, points):
    camera = transforms.apply(transforms.inverse(world_from_camera), points)
    pixels = np.einsum("vij,vpj->vpi", intrinsics, camera)
    return pixels[..., :2] / pixels[..., 2:], camera[..., 2]


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


def test_a_replay_of_twenty_seconds_stays_small(tmp_path):
    path = tmp_path / "recording.rrd"
    view.write_replay(path, example_scene.replay_scene(20.0))
    assert path.stat().st_size < 20e6


def test_a_replay_without_markers_or_sensors_is_written_too(scene, tmp_path):
    path = tmp_path / "recording.rrd"
    view.write_replay(
        path,
        replace(
            scene.replay,
            measured=None,
            modelled=None,
            imu=None,
            sensor_poses=None,
            segment_meshes=(),
        ),
    )
    assert rrd("verify", path).returncode == 0


def test_a_frame_in_which_nothing_is_seen_is_written_too(scene, tmp_path):
    measured = scene.replay.measured
    hidden = measured.positions_world.copy()
    hidden[5] = np.nan
    path = tmp_path / "recording.rrd"
    view.write_replay(
        path,
        replace(
            scene.replay, measured=MarkerTrajectories(measured.times, measured.marker_names, hidden)
        ),
    )
    _, positions = read(path, "/world/markers/measured", "Points3D:positions")
    assert len(positions[5]) == 0
    times, _ = read(path, "/residuals/rms", "Scalars:scalars")
    assert len(times) == len(measured.times) - 1


def test_nothing_is_left_behind_when_writing_fails(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(recording.curves, "log_coordinates", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        view.write_replay(tmp_path / "recording.rrd", scene.replay)
    assert list(tmp_path.iterdir()) == []


def test_the_viewer_refuses_a_file_that_is_not_there(tmp_path):
    with pytest.raises(LegsimError, match="no such recording"):
        view.open_viewer(tmp_path / "recording.rrd")
    with pytest.raises(LegsimError, match="no such recording"):
        view.screenshot(tmp_path / "recording.rrd", tmp_path / "picture.png", time_s=0.0)
