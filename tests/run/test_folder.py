import json

import numpy as np
import pytest

from legsim.core import files as core_files
from legsim.core.errors import LegsimError
from legsim.core.files import PREFIX, write_text
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import SegmentPoses
from legsim.run import folder as run_folder
from legsim.run.files import load_imu, load_poses, save_imu, save_poses
from legsim.run.folder import RunFolder


def test_a_stage_is_done_only_while_key_and_files_are_as_recorded(tmp_path):
    folder = RunFolder(tmp_path, {"version": "x"})
    assert not folder.done("one", "k")
    with folder.stage("one", "k", ["a.txt"]):
        write_text(tmp_path / "a.txt", "hello")
    again = RunFolder(tmp_path, {"version": "x"})
    assert again.done("one", "k")
    assert not again.done("one", "other key")
    (tmp_path / "a.txt").write_text("tampered")
    assert not again.done("one", "k")


def test_a_stage_that_fails_leaves_no_file_and_no_entry(tmp_path):
    folder = RunFolder(tmp_path, {})
    with (
        pytest.raises(RuntimeError),
        folder.stage("one", "k", ["a.txt"]),
        core_files.whole(tmp_path / "a.txt") as partial,
    ):
        partial.write_text("half")
        raise RuntimeError
    assert sorted(p.name for p in tmp_path.iterdir()) == []
    assert not folder.done("one", "k")


def test_what_killed_processes_left_goes_and_what_others_are_writing_stays(tmp_path, monkeypatch):
    partial = tmp_path / f"{PREFIX}4711-a.txt"
    partial.write_text("half")
    RunFolder(tmp_path, {})
    assert partial.exists(), "another process may be writing it"
    monkeypatch.setattr(run_folder, "_ABANDONED_S", -1)
    RunFolder(tmp_path, {})
    assert list(tmp_path.iterdir()) == []


def test_manifest_tells_hash_size_and_seconds(tmp_path):
    folder = RunFolder(tmp_path, {"seed": 3})
    with folder.stage("one", "k", ["a.txt"]):
        write_text(tmp_path / "a.txt", "hello")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seed"] == 3
    assert manifest["stages"]["one"]["files"]["a.txt"] == {
        "sha256": core_files.sha256(tmp_path / "a.txt"),
        "bytes": 5,
    }


def test_an_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LegsimError, match=r"cannot be written to .*--out"):
        RunFolder(tmp_path / "file" / "below", {})


def test_a_broken_manifest_is_named(tmp_path):
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(LegsimError, match=r"manifest\.json: is not a manifest"):
        RunFolder(tmp_path, {})


def test_imu_signals_survive_the_file_to_the_last_bit(tmp_path, rng):
    signals = ImuSignals(
        np.sort(rng.random(20)),
        ("shank_l", "thigh_l"),
        rng.normal(size=(20, 2, 3)),
        rng.normal(size=(20, 2, 3)),
    )
    save_imu(tmp_path / "imu.csv", signals)
    loaded = load_imu(tmp_path / "imu.csv")
    assert loaded.sensor_names == signals.sensor_names
    for name in ("times", "angular_velocity", "specific_force"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(signals, name))


def test_imu_table_has_the_columns_that_were_promised(tmp_path):
    signals = ImuSignals(np.arange(2.0), ("s",), np.zeros((2, 1, 3)), np.ones((2, 1, 3)))
    save_imu(tmp_path / "imu.csv", signals)
    first, second, _ = (tmp_path / "imu.csv").read_text().splitlines()
    assert first == "time_s,s_ax_m_s2,s_ay_m_s2,s_az_m_s2,s_gx_rad_s,s_gy_rad_s,s_gz_rad_s"
    assert second == "0.0,1.0,1.0,1.0,0.0,0.0,0.0"


def test_poses_and_motion_survive_the_file(tmp_path, rng):
    poses = SegmentPoses(np.arange(3.0), ("a", "b"), rng.normal(size=(3, 2, 4, 4)))
    save_poses(tmp_path / "p.npz", poses)
    np.testing.assert_array_equal(
        load_poses(tmp_path / "p.npz").world_from_segment, poses.world_from_segment
    )
    motion = RigidMotion(np.arange(3.0), rng.normal(size=(3, 4, 4)))
    save_motion(tmp_path / "m.npz", motion)
    loaded = load_motion(tmp_path / "m.npz")
    assert isinstance(loaded, RigidMotion)
    np.testing.assert_array_equal(loaded.moved_from_reference, motion.moved_from_reference)


def test_every_kind_of_motion_survives_the_file(tmp_path, rng):
    points = ControlPointMotion(np.arange(3.0), rng.normal(size=(4, 3)), rng.normal(size=(3, 4, 3)))
    save_motion(tmp_path / "p.npz", points)
    loaded = load_motion(tmp_path / "p.npz")
    assert isinstance(loaded, ControlPointMotion)
    np.testing.assert_array_equal(loaded.moved, points.moved)
    np.testing.assert_array_equal(loaded.reference, points.reference)
    field = FieldMotion(
        np.arange(3.0),
        VolumeGrid((2, 3, 4), (0.1, 0.2, 0.3), (1, 2, 3)),
        rng.normal(size=(3, 2, 3, 4, 3)),
    )
    save_motion(tmp_path / "f.npz", field)
    loaded = load_motion(tmp_path / "f.npz")
    assert isinstance(loaded, FieldMotion)
    assert loaded.grid == field.grid
    np.testing.assert_array_equal(loaded.displacements, field.displacements)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_what_is_no_motion_file_is_refused(tmp_path, content):
    (tmp_path / "m.npz").write_bytes(content)
    with pytest.raises(LegsimError, match=r"m\.npz: is not a motion file"):
        load_motion(tmp_path / "m.npz")
