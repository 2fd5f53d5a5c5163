import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.deformation.files import load_motion
from legsim.deformation.models import RigidMotion
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.imu.catalogue import load_sensor
from legsim.kinematics.from_recording import solve_kinematics
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories
from legsim.opencl.device import Device
from legsim.run import pipeline
from legsim.run.folder import RunFolder

pytestmark = [
    pytest.mark.end_to_end,
    pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning"),
]
PROMISED = {
    *(
        "manifest.json",
        "config.toml",
        "coordinates.mot",
        "joint_centres.csv",
        "poses.npz",
        "imu.csv",
        "geometry.json",
        "geometry_rtk.xml",
        "scan.toml",
    ),
    *(
        "projections.mha",
        "motion-oracle.npz",
        "motion-rigid.npz",
        "volume-static.mha",
        "volume-uncorrected.mha",
        "volume-oracle.mha",
    ),
    *("volume-rigid.mha", "metrics.json", "recording.rrd", "report.html"),
}


def quiet(*_: object) -> None:
    """No progress."""


def test_a_run_leaves_what_was_promised(tiny_run):
    assert {p.name for p in tiny_run.folder.iterdir()} >= PROMISED
    assert not list(tiny_run.folder.glob(".*"))


def test_rigid_imu_correction_is_clearly_better_than_none_and_as_good_as_the_truth(tiny_run):
    ssim = {m.method: m.metrics.of("leg").ssim for m in tiny_run.methods}
    rmse = {m.method: m.metrics.of("leg").rmse for m in tiny_run.methods}
    assert ssim["static"] == pytest.approx(1)
    # 3 mm voxels and every other view leave less to see than the presets do; there RMSE falls to a
    # quarter
    assert 1 - ssim["rigid"] < 0.7 * (1 - ssim["uncorrected"])
    assert rmse["rigid"] < 0.7 * rmse["uncorrected"]
    assert abs(ssim["rigid"] - ssim["oracle"]) < 2e-3
    assert abs(rmse["rigid"] - rmse["oracle"]) < 1e-3


def test_noise_free_sensors_find_the_shanks_true_motion(tiny_run):
    truth, found = (
        load_motion(tiny_run.folder / f"motion-{name}.npz") for name in ("oracle", "rigid")
    )
    assert isinstance(truth, RigidMotion)
    assert isinstance(found, RigidMotion)
    knee = geometry_files.load_geometry(tiny_run.folder / "geometry.json").rotation_center()
    at_knee = np.array([*knee, 1.0])
    assert (
        np.abs((truth.moved_from_reference - found.moved_from_reference) @ at_knee).max() < 0.05e-3
    )


def test_the_resting_scan_repeats_its_first_pose(tiny_run):
    geometry = geometry_files.load_geometry(tiny_run.folder / "geometry.json")
    moving, still = (
        image_files.load_projections(tiny_run.folder / f"{name}.mha", geometry)
        for name in ("projections", "projections-static")
    )
    np.testing.assert_array_equal(moving.line_integrals[0], still.line_integrals[0])
    assert np.abs(moving.line_integrals[-1] - still.line_integrals[-1]).max() > 0.05


def test_files_hold_the_units_and_names_that_were_promised(tiny_run):
    header = (tiny_run.folder / "joint_centres.csv").read_text().splitlines()[0].split(",")
    assert header[:4] == ["time_s", "hip_l_x_m", "hip_l_y_m", "hip_l_z_m"]
    assert "knee_angle_l" in opensim.load(tiny_run.folder / "coordinates.mot").coordinate_names
    content = json.loads((tiny_run.folder / "geometry.json").read_text())
    assert (content["unit"], content["columns"], content["rows"], len(content["matrices"][0])) == (
        "mm",
        124,
        96,
        12,
    )
    assert config.load_settings(tiny_run.folder / "config.toml").scan.views == 124


def test_both_geometry_files_say_the_same(tiny_run):
    ours = geometry_files.load_geometry(tiny_run.folder / "geometry.json")
    rtk = geometry_files.load_geometry(tiny_run.folder / "geometry_rtk.xml")
    points = ours.rotation_center() + 0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(rtk.project(points)[0], ours.project(points)[0], atol=1e-5)


def test_the_recording_is_whole(tiny_run):
    verified = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(tiny_run.folder / "recording.rrd")],
        check=False,
    )
    assert verified.returncode == 0


def test_a_second_run_computes_nothing_again(tiny_run, tiny_settings):
    before = {
        p: p.stat().st_mtime_ns
        for p in tiny_run.folder.iterdir()
        if p.suffix in (".mha", ".npz", ".rrd", ".csv", ".mot")
    }
    again = pipeline.run_scan(tiny_settings, tiny_run.folder, on_progress=quiet)
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert again.rows() == tiny_run.rows()


def test_a_changed_setting_computes_again_what_hangs_on_it_and_nothing_else(
    tiny_run, tiny_settings, tmp_path
):
    for path in tiny_run.folder.iterdir():
        if path.is_file():
            os.link(path, tmp_path / path.name)
    projections = (tmp_path / "projections.mha").stat().st_mtime_ns
    volume = (tmp_path / "volume-static.mha").stat().st_mtime_ns
    coarser = tiny_settings.model_copy(update={"grid": config.GridConfig(voxels=40, voxel_mm=6.0)})
    pipeline.run_scan(coarser, tmp_path, on_progress=quiet)
    assert (tmp_path / "projections.mha").stat().st_mtime_ns == projections
    assert (tmp_path / "volume-static.mha").stat().st_mtime_ns != volume
    assert image_files.load_volume(tmp_path / "volume-static.mha").grid.shape_zyx == (40, 40, 40)


def test_the_report_is_of_the_sensors_file_as_it_is_now(tiny_run, tiny_settings, tmp_path):
    for path in tiny_run.folder.iterdir():
        if path.is_file() and path.name not in ("report.html", "recording.rrd"):
            os.link(path, tmp_path / path.name)
    sensor = tmp_path / "mine.toml"
    shipped = Path(load_sensor.__code__.co_filename).parents[2] / "models/sensors/bmi160.toml"
    trees = tiny_settings.model_dump(), {"imu": {"noise": {"kind": str(sensor)}}}
    settings = config.from_trees("paper", *trees, {"methods": {"run": ["uncorrected"]}})
    for bias, said in (("40", "0.392 m/s^2"), ("400", "3.92 m/s^2")):
        start = "turn_on_bias_mg = { value = "
        sensor.write_text(shipped.read_text().replace(f"{start}40", f"{start}{bias}"))
        pipeline.run_scan(settings, tmp_path, on_progress=quiet)
        assert f"biases of {said}" in (tmp_path / "report.html").read_text()


def test_ctrl_c_loses_nothing_that_was_finished(tiny_run, tiny_settings, tmp_path):
    for name in (
        "coordinates.mot",
        "joint_centres.csv",
        "poses.npz",
        *("kinematics.json", "scaled_model.osim", "model_markers.trc", "marker_errors.sto"),
        "imu.csv",
        "geometry.json",
        "geometry_rtk.xml",
    ):
        os.link(tiny_run.folder / name, tmp_path / name)
    manifest = json.loads((tiny_run.folder / "manifest.json").read_text())
    manifest["stages"] = {
        k: v for k, v in manifest["stages"].items() if k in ("kinematics", "imu", "geometry")
    }
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "projecting" and done > total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pipeline.run_scan(tiny_settings, tmp_path, on_progress=interrupt)
    assert not (tmp_path / "projections.mha").exists()
    assert not list(tmp_path.glob(".*"))
    with RunFolder(tmp_path, {}) as folder:
        assert folder.done("imu", manifest["stages"]["imu"]["key"])


def test_rows_have_a_cell_a_column(tiny_run):
    assert {len(row) for row in tiny_run.rows()} == {len(tiny_run.columns())}
    assert all(
        (tiny_run.folder / line.split(": ")[1]).exists() or "legsim view" in line
        for line in tiny_run.places()
    )


def test_the_command_to_look_around_is_one_for_a_shell(tmp_path):
    result = pipeline.RunResult(tmp_path / "my run [1]", ())
    (line,) = (line for line in result.places() if "legsim view" in line)
    assert shlex.split(line.removeprefix("to look around: ")) == [
        "legsim",
        "view",
        str(tmp_path / "my run [1]"),
    ]


def test_a_scan_longer_than_the_recording_is_refused(tiny_settings, tmp_path):
    slow = tiny_settings.model_copy(
        update={"scan": tiny_settings.scan.model_copy(update={"rate_hz": 1.0})}
    )
    with pytest.raises(LegsimError, match=r"recording lasts .* s, the scan 123.00 s"):
        pipeline.run_scan(slow, tmp_path, on_progress=quiet)


def test_a_leg_can_be_scanned_alone(tiny_run, tiny_settings, tmp_path):
    """The other leg's shadow is gone from all images, and what has to be known of the scanned one
    is still known.
    """
    alone = tiny_settings.model_copy(
        update={"phantom": tiny_settings.phantom.model_copy(update={"legs": "scanned"})}
    )
    result = pipeline.run_scan(alone, tmp_path, on_progress=quiet)
    geometry = geometry_files.load_geometry(tmp_path / "geometry.json")
    folders = (tiny_run.folder, tmp_path)
    with_both, of_one = (
        image_files.load_projections(f / "projections.mha", geometry).line_integrals
        for f in folders
    )
    assert (of_one <= with_both + 1e-4).all()
    assert (of_one < with_both - 0.5).any()
    assert [m.method for m in result.methods] == [m.method for m in tiny_run.methods]
    both, one = ({m.method: m for m in methods} for methods in (tiny_run.methods, result.methods))
    assert one["rigid"].residual_mm == both["rigid"].residual_mm


def test_the_papers_chain_runs_on_real_standing(shared_data, tiny_settings, tmp_path):
    motion = replace_file(tiny_settings, shared_data / "mocap/standing_bmc/static_run.trc")
    result = pipeline.run_scan(motion, tmp_path, on_progress=quiet)
    rmse = {m.method: m.metrics.of("leg").rmse for m in result.methods}
    assert rmse["rigid"] < rmse["uncorrected"]
    assert abs(rmse["rigid"] - rmse["oracle"]) < 1e-3


def replace_file(settings: config.RunConfig, path: Path) -> config.RunConfig:
    return settings.model_copy(
        update={"motion": settings.motion.model_copy(update={"file": str(path)})}
    )


def test_residual_of_the_truth_is_what_the_femur_adds(tiny_run):
    results = {m.method: m for m in tiny_run.methods}
    assert results["static"].residual_mm is None
    assert 0 < results["oracle"].residual_mm < results["uncorrected"].residual_mm


def test_the_example_makes_scans_with_their_truth(tmp_path):
    documents = Path(__file__).parents[2] / "docs"
    spec = importlib.util.spec_from_file_location(
        "many_scans", documents / "examples/many_scans.py"
    )
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    tiny = (
        "scan.views=31",
        "scan.increment_deg=6.6",
        "scan.rate_hz=3.875",
        "scan.columns=62",
        "scan.rows=48",
        "scan.pixel_mm=6.16",
    )
    example.main(
        tmp_path,
        7,
        1,
        (
            *tiny,
            "scan.rays_per_pixel=1",
            "grid.voxels=40",
            "grid.voxel_mm=6.0",
            "methods.node_mm=40",
            "evaluation.registered=none",
        ),
    )
    folder = tmp_path / "00007"
    page = (documents / "study.md").read_text().partition("## Many scans as data")[2]
    promised = re.findall(r"^\| `([\w.-]+)` \|", page, re.M)
    assert len(promised) > 5
    assert not [name for name in promised if not (folder / name).exists()]
    rmse = {
        m["method"]: m["metrics"]["regions"][0]["rmse"]
        for m in json.loads((folder / "metrics.json").read_text())["methods"]
    }
    assert rmse["oracle-nonrigid"] < rmse["uncorrected"]
    # the documents' own lines, for this folder
    (reading,) = re.findall(r"```python\n(.*?)```", page, re.S)
    read: dict = {}
    exec(reading.replace("data/00000", str(folder)), read)
    assert read["measured"].shape == (31, 48, 62)
    assert read["wanted"].shape == (40, 40, 40)
    assert len(read["motion"]) == 31
    assert np.abs(read["motion"]).max() > 1e-4


@pytest.fixture(scope="module")
def stepping(tiny_settings, tmp_path_factory) -> config.RunConfig:
    """A scan of a person that steps aside by 0.5 m between two samples."""
    whole = solve_kinematics(tiny_settings.motion.file).trajectories
    values = whole.values.copy()
    values[600:, whole.coordinate_names.index("pelvis_tx")] += 0.5
    file = tmp_path_factory.mktemp("step") / "step.mot"
    opensim.save(file, JointTrajectories(whole.times, whole.coordinate_names, values))
    motion = tiny_settings.motion.model_copy(update={"file": str(file)})
    return tiny_settings.model_copy(update={"motion": motion})


def test_a_movement_that_no_leg_makes_is_solved_but_not_scanned(stepping, tmp_path):
    message = r"step\.mot: pelvis_tx steps at 60 m/s from frame 599 .* --force"
    with pytest.raises(LegsimError, match=message):
        pipeline.run_scan(stepping, tmp_path)
    written = {p.name for p in tmp_path.iterdir()}
    assert "kinematics.json" in written
    assert not {n for n in written if n.startswith("projections")}
    said = json.loads((tmp_path / "kinematics.json").read_text())["warnings"]
    assert said[0].startswith("pelvis_tx steps at 60 m/s")


@pytest.mark.end_to_end
def test_a_device_that_fails_halfway_ends_in_one_line_and_keeps_what_was_finished(
    tiny_settings, tmp_path, monkeypatch
):
    def fail(*_: object) -> None:
        raise cl.MemoryError("clCreateBuffer failed: MEM_OBJECT_ALLOCATION_FAILURE")

    monkeypatch.setattr(Device, "zeros", fail)
    with pytest.raises(LegsimError, match=r"memory does not suffice .*; finished stages are kept$"):
        pipeline.run_scan(tiny_settings, tmp_path, on_progress=quiet)
    stages = json.loads((tmp_path / "manifest.json").read_text())["stages"]
    assert {"kinematics", "imu"} <= stages.keys()
    assert not list(tmp_path.glob(".*"))
