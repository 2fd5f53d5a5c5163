"""Real sensors find their predicted ones, and what is found can be used."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

import legsim as ls
from legsim import config
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu.files import save_imu
from legsim.imu.sensors import Sensor, default_sensors
from legsim.imu.signals import ImuSignals
from legsim.run import imu_comparison
from legsim.run import replay as run_replay
from tests.examples.sensors import swaying

TURN = [0.4, -0.3, 0.2]
TILT = [0.0, 0.1, 0.0]


def predicted() -> ImuSignals:
    """Two predicted sensors, the shank's not along its segment."""
    one = swaying()
    shank, thigh = default_sensors()
    shank = Sensor.placed(shank.name, shank.segment, 0.14, rotation_vector=TILT)
    both = (np.stack([v, v], 1) for v in (one.angular_velocity, one.specific_force))
    return ImuSignals(one.times, (shank.name, thigh.name), *both, sensors=(shank, thigh))


def write(folder, name="left_shank_l", lag=0.037):
    """A measured sensor, mounted by TURN against the predicted one and 37 ms late."""
    one, axes = swaying(), transforms.rotation_from_vector(TURN)
    path = folder / f"{name}.csv"
    rate, force = (v @ axes for v in (one.angular_velocity, one.specific_force))
    save_imu(path, ImuSignals(one.times + lag, (name,), rate[:, None], force[:, None]))
    return path


def test_the_mounting_on_the_segment_and_the_lag_are_found(tmp_path):
    worn = imu_comparison.of_argument(str(write(tmp_path)))
    (found,) = imu_comparison.compare(worn, predicted(), 0.0)
    assert found.sensor.name == "shank_l"
    expected = transforms.rotation_from_vector(TILT) @ transforms.rotation_from_vector(TURN)
    back = found.segment_from_sensor @ expected.T
    assert np.degrees(transforms.rotation_angle(back)) < 0.3
    assert "its clock reads 37 ms more than the markers'" in found.lines()[0]
    assert "by gravity" in found.lines()[0]


def test_what_was_found_and_given_back_leaves_no_lag(tmp_path):
    """The rotation vector of one comparison is that of imu.sensors in the next."""
    path = write(tmp_path)
    (found,) = imu_comparison.compare(imu_comparison.of_argument(str(path)), predicted(), 0.0)
    (tmp_path / "known.toml").write_text(
        f'file = "{path.name}"\nclock_offset_s = 0.037\n[[sensors]]\nname = "left_shank_l"\n'
        f'segment = "tibia_l"\nrotation_deg = {list(found.rotation_deg())}\n'
    )
    worn = imu_comparison.of_argument(str(tmp_path / "known.toml"))
    (again,) = imu_comparison.compare(worn, predicted(), 0.0)
    assert abs(again.found.lag) < 1e-3
    assert again.mounting_given
    assert again.found.bands[0].correlation > 0.999


def test_the_clock_of_predicted_signals_is_taken_off(tmp_path):
    shifted = predicted()
    shifted = ImuSignals(
        shifted.times + 0.5, shifted.sensor_names, shifted.angular_velocity,
        shifted.specific_force, shifted.sensors,
    )  # fmt: skip
    worn = imu_comparison.of_argument(str(write(tmp_path)))
    (found,) = imu_comparison.compare(worn, shifted, 0.5)
    assert found.found.lag == pytest.approx(0.037, abs=2e-3)


def test_a_segment_names_the_place_of_any_file(tmp_path):
    path = write(tmp_path, "logger7")
    worn = imu_comparison.of_argument(f"femur_l={path}")
    (found,) = imu_comparison.compare(worn, predicted(), 0.0)
    assert found.sensor.name == "thigh_l"
    with pytest.raises(LegsimError, match=r"sensor logger7: the name 'logger7' is that of 0"):
        imu_comparison.compare(imu_comparison.of_argument(str(path)), predicted(), 0.0)
    with pytest.raises(LegsimError, match=r"segment 'tibia_r' is that of 0 .*SEGMENT=FILE"):
        imu_comparison.compare(imu_comparison.of_argument(f"tibia_r={path}"), predicted(), 0.0)


def test_the_table_has_a_row_per_sensor_quantity_and_band(tmp_path):
    worn = imu_comparison.of_argument(str(write(tmp_path)))
    text = imu_comparison.table(imu_comparison.compare(worn, predicted(), 0.0))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [(r["quantity"], r["band_low_hz"]) for r in rows] == [
        *(("rate", b) for b in ("0.2", "6", "12")),
        *(("force", b) for b in ("0.2", "6", "12")),
    ]
    assert float(rows[0]["lag_ms"]) == pytest.approx(37, abs=2)
    assert (rows[0]["unit"], rows[3]["unit"]) == ("deg/s", "mg")


@pytest.mark.end_to_end
def test_real_sensors_are_set_beside_the_markers_of_the_same_seconds(shared_data, tmp_path):
    """A person who stands: the clocks differ by 0.01 to 0.03 s, as was found by other means."""
    markers = shared_data / "cases/19_branch_jump"
    settings = config.load_settings(
        overrides=(
            f"motion.file={markers / 'standing_11s.trc'}",
            f"motion.marker_map={markers / 'seven.toml'}",
        )
    )
    measured = [str(shared_data / f"imu/standing_{name}_l.txt") for name in ("shank", "thigh")]
    result = run_replay.replay(
        settings, tmp_path, filtered=False, image=None,
        on_progress=lambda *_: None, measured=measured,
    )  # fmt: skip
    with (tmp_path / imu_comparison.FILE).open() as stream:
        rows = {(r["sensor"], r["quantity"], r["band_low_hz"]): r for r in csv.DictReader(stream)}
    for name, rate, force in (("shank", 0.55, 2.2), ("thigh", 1.09, 6.0)):
        slow = rows[f"standing_{name}_l", "rate", "0.2"]
        assert 10 <= float(slow["lag_ms"]) <= 30
        assert float(slow["measured_rms"]) == pytest.approx(rate, abs=0.01)
        assert float(slow["correlation"]) > 0.5
        heavy = rows[f"standing_{name}_l", "force", "0.2"]
        assert float(heavy["measured_rms"]) == pytest.approx(force, abs=0.1)
    assert any("standing_thigh_l on femur_l" in line for line in result.lines())
    assert "Measured sensors" in (tmp_path / "report.html").read_text()


def test_a_sensor_near_the_ankle_of_the_other_leg_is_found_there(tmp_path):
    """The right shank's, 33 cm below the knee, given as the left shank's and as the right's."""
    person = ls.solve_kinematics("subject01/squats.trc")
    sensor = Sensor.placed("logger", "tibia_r", 0.33, [0.02, 0, 0.04], TURN)
    signals = ls.simulate_imu(person, [sensor], rate_hz=100)
    save_imu(tmp_path / "logger.csv", signals)
    predicted = ls.simulate_imu(person, rate_hz=100)
    worn = imu_comparison.of_argument(f"tibia_r={tmp_path / 'logger.csv'}")
    (found,) = imu_comparison.compare(worn, predicted, 0.0, person)
    (line,) = [one for one in found.lines() if one.startswith("In doubt")]
    assert "set its distance_mm to 330 and its offset_mm to [20, 0, 40] in imu.sensors" in line
    assert any("no sensor of imu.sensors is on tibia_r" in one for one in found.lines())
    turned = transforms.vector_from_rotation(found.segment_from_sensor)
    np.testing.assert_allclose(turned, TURN, atol=0.01)


def test_a_sensor_of_another_segment_is_in_doubt(tmp_path):
    worn = imu_comparison.of_argument(str(write(tmp_path)))
    (found,) = imu_comparison.compare(worn, predicted(), 0.0)
    other = replace(found, elsewhere=("tibia_r", 0.97, 0.026))
    (line,) = [one for one in other.lines() if one.startswith("In doubt")]
    assert "turns as tibia_r does (correlation of the rates 0.97 at a lag of 63 ms)" in line
    assert line.endswith("give tibia_r=FILE if it was worn there.")


def test_lost_samples_of_the_predicted_sensor_are_left_out(tmp_path):
    rate = np.array(predicted().angular_velocity)
    rate[100:103] = np.nan
    lost = replace(predicted(), angular_velocity=rate)
    worn = imu_comparison.of_argument(str(write(tmp_path)))
    (found,) = imu_comparison.compare(worn, lost, 0.0)
    assert found.found.lag == pytest.approx(0.037, abs=2e-3)
    assert imu_comparison.compare((), lost, 0.0) == ()


def test_a_short_trial_is_compared_where_its_clock_is_stated(tmp_path):
    one = predicted()
    brief = one.angular_velocity[:140, :1], one.specific_force[:140, :1]
    save_imu(tmp_path / "a.csv", ImuSignals(one.times[:140] + 5, ("a",), *brief))
    about = 'file = "a.csv"\n{}[[sensors]]\nname = "a"\nsegment = "tibia_l"\n'
    (tmp_path / "a.toml").write_text(about.format(""))
    worn = imu_comparison.of_argument(str(tmp_path / "a.toml"))
    with pytest.raises(LegsimError, match=r"record a longer trial, or state clock_offset_s"):
        imu_comparison.compare(worn, one, 0.0)
    (tmp_path / "a.toml").write_text(about.format("clock_offset_s = 5\n"))
    worn = imu_comparison.of_argument(str(tmp_path / "a.toml"))
    (found,) = imu_comparison.compare(worn, one, 0.0)
    first, second = found.lines()
    assert "its clock is taken as stated (correlation of the rates 1.00)" in first
    assert second == (
        "Sensor a: it shares 1.4 s with the markers, less than 3 s: neither a lag nor another "
        "place or segment is searched."
    )


def test_a_name_that_no_file_can_have_is_one_line():
    with pytest.raises(LegsimError, match="cannot be read"):
        imu_comparison.of_argument("tibia_l=" + "a" * 300)


def test_a_mounting_that_does_not_fit_the_rates_is_in_doubt(tmp_path):
    """By columns of the gyroscope in another order, and by a given mounting that is wrong."""
    path = write(tmp_path)
    (worn,) = imu_comparison.of_argument(str(path))
    swapped = worn.recording.angular_velocity[:, [1, 0, 2]]
    other = replace(worn, recording=replace(worn.recording, angular_velocity=swapped))
    wrong = replace(worn, worn=worn.worn.model_copy(update={"rotation_deg": (0.0, 0.0, 90.0)}))
    for one, said in ((worn, ""), (other, "that gravity wants"), (wrong, "in the mounting given")):
        (found,) = imu_comparison.compare((one,), predicted(), 0.0)
        doubts = [line for line in found.lines() if "its rates agree by" in line]
        assert len(doubts) == bool(said)
        assert said in "".join(doubts)
