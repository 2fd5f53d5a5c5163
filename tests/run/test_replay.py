"""`legsim replay` as a whole: what the sensors' settings change and what they leave, going on where
it stopped, one line for bad input.
"""

from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.imu import simulation
from legsim.imu.files import load_imu
from legsim.imu.signals import ImuSignals
from legsim.kinematics import from_recording, osim_file
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim, trc
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.run import replay as run_replay
from legsim.run import sensors as run_sensors
from legsim.run import stages
from legsim.run.folder import RunFolder
from tests.examples import osim


def quiet(*_: object) -> None:
    """No progress."""


pytestmark = pytest.mark.end_to_end
TRUTH = ("coordinates.mot", "poses.npz", "joint_centres.csv")


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first two seconds of a held squat."""
    whole = trc.load(from_recording.find_recording("subject01/squat_30.trc"))
    path = tmp_path_factory.mktemp("recording") / "squat.trc"
    trc.save(
        path, MarkerTrajectories(whole.times[:240], whole.marker_names, whole.positions_world[:240])
    )
    return path


def replayed(file: Path, out: Path, *changes: str) -> Path:
    settings = config.load_settings(overrides=(f"motion.file={file}", *changes))
    run_replay.replay(settings, out, filtered=False, image=None, on_progress=lambda *_: None)
    return out


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out recording and pictures, which take most of the time."""
    monkeypatch.setattr(
        run_replay.view, "write_replay", lambda path, _: path.write_text("recording")
    )
    monkeypatch.setattr(run_replay.replay_page, "content", lambda *_: None)
    monkeypatch.setattr(run_replay.report_page, "render", lambda _: "page")


@pytest.fixture
def plain(standing: Path, tmp_path: Path, undrawn: None) -> Path:
    """A replay with sensors as they come."""
    return replayed(standing, tmp_path / "plain")


def signals(folder: Path) -> ImuSignals:
    return load_imu(folder / "imu.csv")


def contents(folder: Path, names: tuple[str, ...] = TRUTH) -> list[bytes]:
    return [(folder / name).read_bytes() for name in names]


def test_vibration_is_drawn_from_the_seed_and_moves_signals_alone(standing, plain, tmp_path):
    shaken = ("imu.vibration.acceleration_mg=3", "imu.vibration.angular_velocity_deg_per_s=0.3")
    first = replayed(standing, tmp_path / "first", *shaken)
    other = replayed(standing, tmp_path / "first_again", *shaken, "seed=5")
    assert contents(first) == contents(plain)
    assert not np.array_equal(signals(first).specific_force, signals(plain).specific_force)
    assert not np.array_equal(signals(first).specific_force, signals(other).specific_force)
    # the same folder knows that another seed means other signals
    replayed(standing, first, *shaken, "seed=5")
    np.testing.assert_array_equal(signals(first).specific_force, signals(other).specific_force)


def test_a_clock_offset_shifts_the_sensors_times_and_nothing_else(standing, plain, tmp_path):
    late = replayed(standing, tmp_path / "late", "imu.clock_offset_s=0.25")
    np.testing.assert_allclose(signals(late).times - signals(plain).times, 0.25, atol=1e-12)
    np.testing.assert_array_equal(signals(late).specific_force, signals(plain).specific_force)
    np.testing.assert_array_equal(signals(late).angular_velocity, signals(plain).angular_velocity)
    assert contents(late) == contents(plain)


def test_soft_tissue_without_amplitude_is_the_rigid_sensor_bit_for_bit(standing, plain, tmp_path):
    rigid = replayed(
        standing,
        tmp_path / "rigid",
        "imu.soft_tissue.amplitude=0",
        "imu.soft_tissue.frequency_hz=7",
    )
    assert contents(rigid, (*TRUTH, "imu.csv")) == contents(plain, (*TRUTH, "imu.csv"))
    solved, read = (
        from_recording.solve_kinematics(str(standing)),
        signals(rigid),
    )
    alone = simulation.simulate(
        solved.leg,
        solved.splines,
        run_sensors.sensors(config.ImuConfig()),
        read.times,
    )
    np.testing.assert_array_equal(read.specific_force, alone.specific_force)


def test_soft_tissue_shakes_the_accelerometer_and_leaves_gyroscope_and_truth(
    standing, plain, tmp_path
):
    soft = replayed(standing, tmp_path / "soft", "imu.soft_tissue.amplitude=1")
    shaken = signals(soft).specific_force - signals(plain).specific_force
    assert 1e-4 < shaken.std() < 0.2
    np.testing.assert_array_equal(signals(soft).angular_velocity, signals(plain).angular_velocity)
    assert contents(soft) == contents(plain)


def test_noise_that_is_asked_for_is_in_the_signals(standing, plain, tmp_path):
    noisy = replayed(
        standing,
        tmp_path / "noisy",
        "imu.noise.kind=rms",
        "imu.noise.acceleration_mg=5",
        "imu.noise.bandwidth_hz=60",
    )
    added = signals(noisy).specific_force - signals(plain).specific_force
    assert added.std() == pytest.approx(5e-3 * 9.80665, rel=0.1)
    assert contents(noisy) == contents(plain)


def test_a_second_replay_writes_nothing_and_a_changed_sensor_only_what_hangs_on_it(standing, plain):
    before = {p.name: p.stat().st_mtime_ns for p in plain.iterdir()}
    replayed(standing, plain)
    assert {p.name: p.stat().st_mtime_ns for p in plain.iterdir()} == before
    replayed(standing, plain, "imu.rate_hz=60")
    after = {p.name for p in plain.iterdir() if p.stat().st_mtime_ns != before[p.name]}
    assert after == {"imu.csv", "recording.rrd", "report.html", "manifest.json"}


def test_a_second_real_replay_leaves_every_byte(standing, tmp_path):
    first = {p.name: p.read_bytes() for p in replayed(standing, tmp_path).iterdir()}
    assert {p.name: p.read_bytes() for p in replayed(standing, tmp_path).iterdir()} == first


@pytest.mark.parametrize("stage", ["coordinates.mot", "imu.csv", "report.html"])
def test_ctrl_c_leaves_no_half_file_and_the_next_replay_ends_it(standing, tmp_path, undrawn, stage):
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "write_text", broken_off(stage, Path.write_text))
        replayed(standing, tmp_path)
    assert not (tmp_path / stage).exists()
    assert not list(tmp_path.glob(".*"))
    replayed(standing, tmp_path)
    assert {
        *TRUTH,
        "imu.csv",
        "recording.rrd",
        "report.html",
        "kinematics.json",
        "scaled_model.osim",
        "model_markers.trc",
        "marker_errors.sto",
        "manifest.json",
    } == {p.name for p in tmp_path.iterdir()}


def broken_off(name: str, write):
    """``write``, but for files called ``name`` (with any prefix) it stops in their middle."""

    def written(
        path: Path,
        text: str,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
    ) -> int:
        if path.name.endswith(name):
            write(path, text[: len(text) // 2], encoding, errors, newline)
            raise KeyboardInterrupt
        return write(path, text, encoding, errors, newline)

    return written


def test_coordinates_in_degrees_and_in_radians_give_the_same_signals(standing, tmp_path):
    solved = from_recording.solve_kinematics(str(standing))
    read = []
    for name, in_degrees in (("degrees.mot", True), ("radians.mot", False)):
        opensim.save(tmp_path / name, solved.trajectories, in_degrees=in_degrees)
        again = from_recording.solve_kinematics(str(tmp_path / name))
        np.testing.assert_allclose(
            again.trajectories.values, solved.trajectories.values, atol=1e-14
        )
        read.append(run_sensors.sense(again, config.ImuConfig()))
    np.testing.assert_allclose(read[0].specific_force, read[1].specific_force, atol=1e-7)
    np.testing.assert_allclose(read[0].angular_velocity, read[1].angular_velocity, atol=1e-9)


def test_replay_of_markers_and_of_the_coordinates_it_wrote_agree(tiny_run, tmp_path):
    settings = config.load_settings(
        overrides=(f"motion.file={tiny_run.folder / 'coordinates.mot'}",)
    )
    result = run_replay.replay(
        settings, tmp_path, filtered=False, image=tmp_path / "still.png", on_progress=quiet
    )
    assert {p.name for p in tmp_path.iterdir()} >= {
        "coordinates.mot",
        "joint_centres.csv",
        "poses.npz",
        "imu.csv",
        "recording.rrd",
        "still.png",
    }
    assert any("legsim view" in line for line in result.lines())
    first, second = (
        opensim.load(folder / "coordinates.mot") for folder in (tiny_run.folder, tmp_path)
    )
    np.testing.assert_array_equal(first.values, second.values)


def test_a_users_own_model_is_replayed_with_its_markers(tmp_path):
    """With every file; what a model of one's own has no use for is not there."""
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS)
    model = osim.saved(tmp_path, text)
    leg = OsimLeg(osim_file.read(model))
    sites, _ = leg.marker_sites()
    times = np.arange(60) / 60
    bent = leg.posture(*np.radians((30, -50, 10)))
    values = bent + 0.02 * np.sin(3 * times[:, None] + np.arange(len(bent)))
    places = leg.marker_positions(values, sites)
    trc.save(tmp_path / "m.trc", MarkerTrajectories(times, sites.names, places))
    replayed(tmp_path / "m.trc", tmp_path / "o", f"motion.model={model}")
    there = {path.name for path in (tmp_path / "o").iterdir()}
    assert {"recording.rrd", "model_markers.trc", "marker_errors.sto", "imu.csv"} <= there
    assert "scaled_model.osim" not in there
    modelled = trc.load(tmp_path / "o/model_markers.trc").positions_world
    assert np.abs(modelled - places)[5:-5].max() < 1e-3
    again = OsimLeg(leg.model).values_of(opensim.load(tmp_path / "o/coordinates.mot"))
    assert np.degrees(np.abs(again - values)[5:-5].max()) < 0.5


def test_a_calibrated_sensor_is_read_again_with_its_rest(standing, tmp_path, undrawn):
    changes = ("imu.noise.kind=mti300", "imu.noise.calibration=rest", "imu.lost_share=0.05")
    out = replayed(standing, tmp_path, *changes)
    settings = config.load_settings(overrides=(f"motion.file={standing}", *changes))
    person = from_recording.solve_kinematics(str(standing))
    first = float(person.trajectories.times[0])
    key = stages.motion_key(settings)
    with RunFolder(out, {}, kind="replay") as folder:
        again = stages.read_sensors(settings, person, folder, key, rest_at=first)
    rng = np.random.default_rng([settings.seed, stages.NOISE])
    fresh = run_sensors.record(person, settings.imu, view_rate_hz=31.0, rest_at=first, rng=rng)
    np.testing.assert_array_equal(again.specific_force, fresh.specific_force)
    np.testing.assert_array_equal(again.rest_force, fresh.rest_force)
    assert np.isnan(again.specific_force).any()
    assert again.sensor_names == fresh.sensor_names
