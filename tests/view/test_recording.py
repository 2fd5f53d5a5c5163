"""Recordings say what was logged: read back entity by entity, verified and compared by rerun's own
tools.
"""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from legsim import view
from legsim.core.errors import LegsimError
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.view import recording
from tests.examples import scene as example_scene
from tests.examples.recordings import read, rrd


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


def test_one_pixel_of_a_slice_makes_another_identity(scene):
    last = scene.slices[-1]
    thigh = last.thigh.copy()
    thigh[20, 20] += 1e-3
    other = replace(last, thigh=thigh)
    assert recording.content_id(scene) != recording.content_id(
        replace(scene, slices=(*scene.slices[:-1], other))
    )


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


def test_a_full_disk_leaves_no_half_recording(scene, tmp_path):
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # no file may grow further, as on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, before[1]))
    try:
        with pytest.raises(LegsimError, match=r"recording\.rrd: cannot be written"):
            view.write_replay(tmp_path / "recording.rrd", scene.replay)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted on Linux")
def test_a_recordings_stream_is_given_back(scene, tmp_path):
    """Each stream has two threads; rerun keeps the one that it makes of the layout itself."""
    view.write_replay(tmp_path / "first.rrd", scene.replay)
    before = len(os.listdir("/proc/self/task"))
    for number in range(4):
        view.write_replay(tmp_path / f"{number}.rrd", scene.replay)
    assert len(os.listdir("/proc/self/task")) <= before + 4 * 2
