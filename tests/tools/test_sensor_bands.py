"""What sensors read by bands: the measure itself, a real recording, and the shipped ones by it."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import welch

from legsim import config
from legsim.imu.signals import ImuSignals
from tools.experiments import sensor_bands
from tools.virtual_subjects import sensors
from tools.virtual_subjects.controller import band_noise
from tools.virtual_subjects.report import MOTIONS
from tools.virtual_subjects.statistics import load_truth
from tools.virtual_subjects.subjects import SUBJECTS

TIMES = np.arange(2400) / 120
NAMES = [subject.name for subject in SUBJECTS]


def wave(frequency_hz: float, axis: int) -> np.ndarray:
    """(n, 3) of root mean square 1."""
    values = np.zeros((len(TIMES), 3))
    values[:, axis] = np.sqrt(2) * np.sin(2 * np.pi * frequency_hz * TIMES)
    return values


@cache
def on_bones(name: str) -> ImuSignals:
    return sensors.on_bones(load_truth(str(MOTIONS / f"{name}_truth.npz")))


# ---- the measure
# -----------------------------------------------------------------------------------------------


def test_waves_are_counted_in_their_band_and_axis():
    rate = np.radians(2.0 * wave(2.0, 1) + 3.0 * wave(1.5, 0) + 1.0 * wave(8.5, 2))
    force = [0, 9.80665, 0] + 9.80665e-3 * (4.0 * wave(3.0, 0) + 5.0 * wave(22.0, 1))
    found = sensors.readings(rate, force, 120.0)
    assert found.rate_deg_s[0] == pytest.approx(np.hypot(2, 3), rel=0.05)
    assert found.rate_deg_s[1] == pytest.approx(1.0, rel=0.05)
    assert found.acceleration_mg[0] == pytest.approx(4.0, rel=0.05)
    assert found.acceleration_mg[2] == pytest.approx(5.0, rel=0.05)
    assert found.long_share == pytest.approx(4 / 13, rel=0.05)


def test_correlation_is_one_of_equals_and_nothing_of_strangers():
    one, other = wave(2.0, 1), wave(2.5, 1)
    assert sensors.correlation(one, 3 * one, 120.0) == pytest.approx(1.0)
    assert sensors.correlation(one, -one, 120.0) == pytest.approx(-1.0)
    assert abs(sensors.correlation(one, other, 120.0)) < 0.05
    assert sensors.correlation(one, one + wave(2.0, 0), 120.0) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("segment", ["shank", "thigh"])
def test_a_real_recording_reads_what_the_table_states(shared_data, segment):
    found = sensor_bands.recorded(shared_data / "imu" / f"standing_{segment}_l.txt")
    stated = sensors.STANDING[segment]
    # the table has two digits behind the point
    for value, (low, high) in (
        *zip(found.rate_deg_s, stated.rate_deg_s, strict=True),
        *zip(found.acceleration_mg, stated.acceleration_mg, strict=True),
        (found.long_share, stated.long_share),
    ):
        assert low - 0.005 <= value <= high + 0.005


# ---- the shipped recordings
# ------------------------------------------------------------------------------------


@pytest.mark.parametrize("subject", NAMES)
@pytest.mark.parametrize(("trial", "effort"), [("squat_30", 1.0), ("squat_60", 1.2)])
def test_shanks_turn_as_much_as_a_real_persons(subject: str, trial: str, effort: float):
    """Within a fifth of the range measured: one person, and a sensor on the skin. Muscles that do
    more tremble more.
    """
    signals = on_bones(f"{subject}/{trial}")
    stated = sensors.STANDING["shank"]
    for side in "lr":
        found = sensors.of_signals(signals)[f"shank_{side}"]
        low, high = stated.rate_deg_s[0]
        assert 0.8 * low < found.rate_deg_s[0] < 1.2 * effort * high
        low, high = stated.rate_deg_s[1]
        assert 0.8 * low < found.rate_deg_s[1] < 1.2 * high
        low, high = stated.acceleration_mg[0]
        assert 0.8 * low < found.acceleration_mg[0] < 1.2 * effort * high


@pytest.mark.parametrize("subject", NAMES)
@pytest.mark.parametrize("trial", ["squat_30", "squat_60"])
def test_legs_turn_about_their_long_axes_and_not_both_alike(subject: str, trial: str):
    signals = on_bones(f"{subject}/{trial}")
    read = sensors.of_signals(signals)
    assert all(0.5 < read[f"shank_{side}"].long_share < 0.9 for side in "lr")
    assert all(0.2 < read[f"thigh_{side}"].long_share < 0.9 for side in "lr")
    assert 0.2 < sensors.sides_correlated(signals, "shank") < 0.7
    assert 0.3 < sensors.sides_correlated(signals, "thigh") < 0.8


@pytest.mark.parametrize("subject", NAMES)
def test_bones_tremble_at_8_to_12_hz(subject: str):
    """Power of the shank's acceleration peaks there above the unrest on both sides."""
    force = on_bones(f"{subject}/squat_30").sensor("shank_l")[1]
    frequency, power = welch(force, 120.0, nperseg=480, axis=0)  # pyright: ignore[reportCallIssue]
    power = np.asarray(power).sum(-1)

    def mean(low: float, high: float) -> float:
        return float(power[(frequency >= low) & (frequency < high)].mean())

    assert mean(8.5, 11.5) > 1.5 * mean(5, 7)
    assert mean(8.5, 11.5) > 3 * mean(15, 20)


def test_tremor_is_band_noise_of_unit_size_and_seeded():
    one, again = (
        band_noise(np.random.default_rng(2), 120_000, 1 / 600, (8.0, 12.0)) for _ in range(2)
    )
    np.testing.assert_array_equal(one, again)
    assert one.std() == pytest.approx(1.0, abs=0.05)
    assert abs(one.mean()) < 0.01
    # stationary from the first sample on: 200 draws of it have unit variance too
    firsts = [band_noise(np.random.default_rng(k), 2, 1 / 600, (8.0, 12.0))[0] for k in range(200)]
    assert np.std(firsts) == pytest.approx(1.0, abs=0.2)
    frequency, power = welch(one, 600.0, nperseg=6000)
    assert 8.0 < frequency[power.argmax()] < 12.0
    assert power[(frequency > 7) & (frequency < 13)].sum() > 0.9 * power.sum()


# ---- what a run adds
# -------------------------------------------------------------------------------------------


def test_the_settings_for_skin_are_valid_and_off_is_the_plain_run():
    shaken, plain = (
        sensor_bands.settings_of(sensor_bands.ON_SKIN, "squat_30", shaken=on)[0]
        for on in (True, False)
    )
    assert shaken.motion.tremor.acceleration_mg > 0
    assert plain.motion == config.MotionConfig(file="subject01/squat_30.trc")
    assert all(s.vibration is None and s.soft_tissue is None for s in plain.imu.sensors)


@pytest.mark.parametrize("segment", ["shank", "thigh"])
def test_sensors_on_skin_read_as_much_as_a_real_persons(segment: str):
    """In each band within a quarter of the range measured."""
    settings = sensor_bands.settings_of(sensor_bands.ON_SKIN, "squat_30", shaken=True)[0]
    found = sensors.of_signals(sensor_bands.simulated(settings, 0))[f"{segment}_l"]
    stated = sensors.STANDING[segment]
    for value, (low, high) in (
        *zip(found.rate_deg_s, stated.rate_deg_s, strict=True),
        *zip(found.acceleration_mg, stated.acceleration_mg, strict=True),
    ):
        assert 0.75 * low < value < 1.25 * high
