"""The chain of a sensor's errors: nothing off is nothing changed, and each term by its own law."""

import warnings

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.calibration import Calibration
from legsim.imu.errors import TERMS, SensorErrors, TemperatureCourse, TriadErrors
from legsim.imu.readout import oversampling, read_out
from legsim.imu.signals import ImuSignals
from tests.references.sway import Sway

GRAVITY = 9.80665
FULL = TriadErrors(
    noise_density=1e-3,
    turn_on_bias=0.1,
    instability=1e-4,
    random_walk=1e-5,
    scale_error=0.01,
    misalignment=0.02,
    bias_per_kelvin=1e-3,
    scale_per_kelvin=1e-4,
    full_scale=40.0,
    bits=16,
    bandwidth_hz=80.0,
)
ALL = SensorErrors(
    FULL, TriadErrors(**{n: getattr(FULL, n) for n in FULL.__slots__} | {"g_sensitivity": 1e-3})
)
WARM = TemperatureCourse((0.0, 2.0), (0.0, 4.0))


def swaying(count: int = 480, names: tuple[str, ...] = ("shank_l",)) -> ImuSignals:
    times = np.arange(count) / 120
    rate, force = Sway.standing(1).signals(times)
    both = (np.stack([a] * len(names), 1) for a in (rate, force))
    return ImuSignals(times, names, *both)


def still(count: int, rate_hz: float = 100.0, sensors: int = 1) -> ImuSignals:
    force = np.tile([0.0, GRAVITY, 0.0], (count, sensors, 1))
    names = tuple(f"s{k}" for k in range(sensors))
    return ImuSignals(np.arange(count) / rate_hz, names, np.zeros_like(force), force)


def read(given: ImuSignals, errors: SensorErrors, seed: int = 0, **options) -> ImuSignals:
    return read_out(given, errors, np.random.default_rng(seed), **options)


def test_everything_off_changes_no_digit():
    given = swaying()
    for errors in (SensorErrors(), ALL.without(*TERMS)):
        out = read(given, errors, temperature=WARM)
        np.testing.assert_array_equal(out.angular_velocity, given.angular_velocity)
        np.testing.assert_array_equal(out.specific_force, given.specific_force)
        np.testing.assert_array_equal(out.times, given.times)
        assert out.rest_force is None


NOT_ADDED = ("quantisation", "saturation", "low-pass")
"""Terms that are not linear, or draw nothing"""


@pytest.mark.parametrize("term", [term for term in TERMS if term not in NOT_ADDED])
def test_switching_one_term_leaves_the_draws_of_all_others(term: str):
    """Terms before low-pass and rounding add up, so that the rest without one is the same rest."""
    linear = ALL.without(*NOT_ADDED)
    given = swaying()
    everything = read(given, linear, temperature=WARM)
    without = read(given, linear.without(term), temperature=WARM)
    alone = read(given, linear.only(term), temperature=WARM)
    for name in ("angular_velocity", "specific_force"):
        clean = getattr(given, name)
        total = getattr(without, name) + getattr(alone, name) - clean
        np.testing.assert_allclose(total, getattr(everything, name), atol=1e-12)
        if term != "g-sensitivity" or name == "angular_velocity":
            assert np.abs(getattr(alone, name) - clean).max() > 0


def test_a_second_sensor_and_other_names_leave_the_draws_of_the_first():
    one = read(swaying(names=("a/b",)), ALL)
    two = read(swaying(names=("c", "a/b")), ALL)
    np.testing.assert_array_equal(one.specific_force[:, 0], two.specific_force[:, 1])
    assert (two.specific_force[:, 0] != two.specific_force[:, 1]).any()


def test_one_seed_is_one_reading_and_a_longer_recording_begins_alike():
    first, again = read(swaying(), ALL), read(swaying(), ALL)
    np.testing.assert_array_equal(first.specific_force, again.specific_force)
    # the rate of the samples differs by rounding with their count
    longer = read(swaying(960), ALL.without(*NOT_ADDED))
    shorter = read(swaying(480), ALL.without(*NOT_ADDED))
    np.testing.assert_allclose(longer.specific_force[:480], shorter.specific_force, atol=1e-9)


@pytest.mark.parametrize(
    ("term", "constant"),
    [("turn-on-bias", True), ("temperature", True), ("g-sensitivity", True), ("scale", False)],
)
def test_constants_have_their_standard_deviation_between_sensors(term: str, constant: bool):
    given = still(3, sensors=1500)
    out = read(given, ALL.only(term), temperature=TemperatureCourse((0.0,), (2.0,)))
    off = out.specific_force - given.specific_force
    turned = out.angular_velocity
    assert np.ptp(off, axis=0).max() < 1e-12
    if term == "turn-on-bias":
        assert off[0].std() == pytest.approx(0.1, rel=0.05)
        assert turned[0].std() == pytest.approx(0.1, rel=0.05)
    elif term == "temperature":
        assert off[0][:, [0, 2]].std() == pytest.approx(2e-3, rel=0.05)
        along = 2 * np.hypot(1e-3, 1e-4 * GRAVITY)
        assert off[0][:, 1].std() == pytest.approx(along, rel=0.06)
    elif term == "g-sensitivity":
        assert turned[0].std() == pytest.approx(1e-3 * GRAVITY, rel=0.05)
    else:
        assert off[0][:, 1].std() == pytest.approx(0.01 * GRAVITY, rel=0.06)
        assert np.abs(off[0][:, [0, 2]]).max() == 0


def test_misalignment_reads_other_axes_alone():
    given = still(3, sensors=1500)
    off = (read(given, ALL.only("misalignment")).specific_force - given.specific_force)[0]
    assert off[:, [0, 2]].std() == pytest.approx(0.02 * GRAVITY, rel=0.05)
    assert np.abs(off[:, 1]).max() == 0


def test_white_noise_is_white_and_of_its_density():
    given = still(20000)
    out = read(given, ALL.only("white-noise"))
    noise = (out.specific_force - given.specific_force)[:, 0]
    assert noise.std() == pytest.approx(1e-3 * np.sqrt(50), rel=0.02)
    both = np.concatenate([noise[1:], noise[:-1], out.angular_velocity[1:, 0]], 1)
    assert np.abs(np.corrcoef(both.T) - np.eye(9)).max() < 0.04


def test_temperature_follows_its_course():
    given = still(201)
    out = read(given, ALL.only("temperature"), temperature=WARM)
    drift = out.angular_velocity[:, 0]
    np.testing.assert_allclose(drift, drift[-1] * np.linspace(0, 1, 201)[:, None], atol=1e-15)


def test_readings_are_whole_bits_within_half_a_bit_and_the_full_scale():
    errors = SensorErrors(gyroscope=TriadErrors(full_scale=0.01, bits=6))
    given = swaying()
    with pytest.warns(UserWarning, match=r"sensor shank_l: .*gyroscope.*full scale"):
        out = read(given, errors)
    step = errors.gyroscope.step
    bits = out.angular_velocity / step
    np.testing.assert_allclose(bits, np.round(bits), atol=1e-9)
    assert bits.min() == -32
    assert bits.max() == 31
    inside = np.abs(given.angular_velocity) < 0.01 - step
    assert np.abs(out.angular_velocity - given.angular_velocity)[inside].max() <= step / 2 + 1e-12
    np.testing.assert_array_equal(out.specific_force, given.specific_force)


def test_a_range_that_is_wide_enough_warns_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(swaying(), SensorErrors(TriadErrors(full_scale=40.0), TriadErrors(full_scale=5.0)))


def test_a_low_pass_sees_the_continuous_signal_and_delays_it():
    errors = SensorErrors(gyroscope=TriadErrors(bandwidth_hz=20.0))
    every = oversampling(errors, 120.0)
    assert every == 8
    times = np.arange(480 * every) / (120 * every)
    rate, force = Sway.standing(1).signals(times)
    fine = ImuSignals(times, ("s",), rate[:, None], force[:, None])
    out = read(fine, errors, every=every)
    np.testing.assert_array_equal(out.times, times[::every])
    np.testing.assert_array_equal(out.specific_force[:, 0], force[::every])
    # below 2 Hz a filter of 20 Hz is its group delay, to (2 / 20)^2 of a derivative
    delay = np.sqrt(2) / (2 * np.pi * 20)
    late = Sway.standing(1).signals(out.times - delay)[0]
    settled = out.times > 0.5
    size = np.ptp(rate)
    assert np.abs(out.angular_velocity[settled, 0] - late[settled]).max() < 2e-3 * size
    assert np.abs(out.angular_velocity - rate[::every, None])[settled].max() > 2e-2 * size


def test_no_low_pass_needs_no_finer_samples():
    assert oversampling(ALL.without("low-pass"), 120.0) == 1
    assert oversampling(ALL, 2000.0) == 1


def test_a_rest_removes_the_bias_down_to_the_noise_of_its_seconds():
    given, rest = still(400, sensors=400), np.tile([0.0, GRAVITY, 0.0], (400, 1))
    errors = ALL.only("turn-on-bias", "white-noise")
    out = read(given, errors, calibration=Calibration("rest", 4.0), rest_force=rest)
    left = out.angular_velocity.mean(0)
    # mean of 4 s of noise of the rest, and of 4 s of the scan
    assert left.std() == pytest.approx(1e-3 / np.sqrt(2 * 4) * np.sqrt(2), rel=0.05)
    biased = read(given, errors).specific_force[:, :, 0].mean(0)
    assert out.rest_force is not None
    np.testing.assert_allclose(out.rest_force[:, 0], biased, atol=5e-3)


def test_six_positions_leave_noise_alone():
    given = still(100, sensors=20)
    rest = given.specific_force[0]
    errors = ALL.only("turn-on-bias", "scale", "misalignment")
    out = read(given, errors, calibration=Calibration("six-positions", 1.0), rest_force=rest)
    np.testing.assert_allclose(out.specific_force, given.specific_force, atol=1e-9)
    np.testing.assert_allclose(out.angular_velocity, 0, atol=1e-12)
    assert out.rest_force is not None
    np.testing.assert_allclose(out.rest_force, rest, atol=1e-9)


def test_refuses_what_has_no_rate_and_a_rest_without_a_pose():
    with pytest.raises(LegsimError, match="at least 2 samples"):
        read(still(2).__class__(np.zeros(1), ("s",), np.zeros((1, 1, 3)), np.zeros((1, 1, 3))), ALL)
    with pytest.raises(LegsimError, match="give rest_force"):
        read(still(10), ALL, calibration=Calibration("rest"))
