"""Vibration of a mount: as large as asked for, in its bands, with mean 0, and with gravity in it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch

from legsim.core.errors import LegsimError
from legsim.imu.signals import ImuSignals
from legsim.imu.vibration import Vibration, vibrate

RATE_HZ = 120.0
TIMES = np.arange(24000) / RATE_HZ
GRAVITY = np.array([0.0, 9.80665, 0.0])


def resting(gravity: np.ndarray = GRAVITY) -> ImuSignals:
    force = np.tile(gravity, (len(TIMES), 1, 1))
    return ImuSignals(TIMES, ("s",), np.zeros_like(force), force)


def added(vibration: Vibration, gravity: np.ndarray = GRAVITY) -> tuple[np.ndarray, np.ndarray]:
    """(rate, force) (n, 3) that the vibration adds to a sensor at rest."""
    felt = vibrate(resting(gravity), vibration, np.random.default_rng(1))
    return felt.angular_velocity[:, 0], felt.specific_force[:, 0] - gravity


def length_rms(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.square(vectors).sum(-1).mean()))


def test_sizes_are_those_asked_for_and_the_mean_is_zero():
    rate, turned = added(Vibration(rate=0.02), gravity=np.zeros(3))
    _, force = added(Vibration(acceleration=0.05))
    np.testing.assert_array_equal(turned, 0)
    assert length_rms(force) == pytest.approx(0.05, rel=0.03)
    assert length_rms(rate) == pytest.approx(0.02, rel=0.03)
    np.testing.assert_allclose(force.mean(0), 0, atol=1e-12)
    np.testing.assert_allclose(rate.mean(0), 0, atol=1e-12)


def test_power_lies_in_the_band_and_falls_beyond_it():
    """By the law of a 2nd-order high-pass and a 1st-order low-pass."""
    _, force = added(Vibration(acceleration=1.0, acceleration_band_hz=(6.0, 24.0)))
    frequency, power = welch(force, RATE_HZ, nperseg=600, axis=0)  # pyright: ignore[reportCallIssue]
    power = np.asarray(power).sum(-1)

    def near(hz: float) -> float:
        return float(power[np.abs(frequency - hz) < 0.5].mean())

    def law(hz: float) -> float:
        return 1 / (1 + (6 / hz) ** 4) / (1 + (hz / 24) ** 2)

    for hz in (3.0, 6.0, 24.0, 48.0):
        assert near(hz) / near(12.0) == pytest.approx(law(hz) / law(12.0), rel=0.15)


def test_the_mount_stays_where_it_is():
    """Integrated twice, its shift grows no further in 200 s than in 20 s, and is that of a wave of
    the band's lower end.
    """
    _, force = added(Vibration(acceleration=0.05, acceleration_band_hz=(2.0, 20.0)))
    frequency = np.fft.rfftfreq(len(force), 1 / RATE_HZ)[1:, None]
    shift = np.fft.rfft(force, axis=0)
    shift[1:] /= -np.square(2 * np.pi * frequency)
    path = np.fft.irfft(shift, len(force), axis=0)
    early, all_time = np.ptp(path[:2400], axis=0).max(), np.ptp(path, axis=0).max()
    assert all_time < 2 * early
    assert length_rms(path) < 0.05 / (2 * np.pi * 2.0) ** 2


def test_axes_share_the_size():
    rate, _ = added(Vibration(rate=0.02, rate_axes=(0, 2, 1)))
    _, force = added(Vibration(acceleration=0.05, acceleration_axes=(1, 0, 0)))
    assert force[:, 0].std() == pytest.approx(0.05, rel=0.04)
    np.testing.assert_allclose(force[:, 1:], 0, atol=1e-15)
    assert rate[:, 1].std() / rate[:, 2].std() == pytest.approx(2.0, rel=0.1)


def test_a_turn_of_the_mount_turns_gravity():
    """About x by a small angle a, gravity along y is read along -z as g a, with a' the rate."""
    rate, force = added(Vibration(rate=0.01, rate_axes=(1, 0, 0)))
    tilt = np.arcsin(-force[:, 2] / 9.80665)
    # the noise is periodic, so its derivative by the spectrum is exact; an even number of samples
    # leaves half the sampling rate without a slope
    frequency = np.fft.rfftfreq(len(tilt), 1 / RATE_HZ)
    expected = np.fft.rfft(rate[:, 0])[:-1]
    np.testing.assert_allclose(
        (2j * np.pi * frequency * np.fft.rfft(tilt))[:-1], expected, atol=1e-9 * abs(expected).max()
    )
    assert np.linalg.norm(GRAVITY + force, axis=-1) == pytest.approx(9.80665, abs=1e-9)


def test_one_seed_gives_one_vibration_and_sizes_do_not_change_the_draw():
    first, again = (
        vibrate(resting(), Vibration(acceleration=0.05), np.random.default_rng(4)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.specific_force, again.specific_force)
    double = vibrate(resting(), Vibration(acceleration=0.1), np.random.default_rng(4))
    np.testing.assert_allclose(
        double.specific_force - GRAVITY, 2 * (first.specific_force - GRAVITY), atol=1e-12
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"acceleration": -1.0}, "must not be negative"),
        ({"rate": np.nan}, "must not be negative"),
        ({"acceleration_band_hz": (20.0, 5.0)}, "to a higher one; got 20 to 5 Hz"),
        ({"rate_band_hz": (0.0, 5.0)}, "above 0"),
        ({"rate_axes": (0.0, 0.0, 0.0)}, "one above 0"),
    ],
)
def test_what_is_no_vibration_is_refused(wrong: dict, message: str):
    with pytest.raises(LegsimError, match=message):
        Vibration(**wrong)


def test_signals_too_slow_or_uneven_are_refused():
    fast = Vibration(acceleration=0.1, acceleration_band_hz=(5.0, 60.0))
    with pytest.raises(LegsimError, match="at least 180 Hz; got 120 Hz"):
        vibrate(resting(), fast, np.random.default_rng(0))
    uneven = replace(resting(), times=TIMES + 1e-3 * np.sin(TIMES))
    with pytest.raises(LegsimError, match="even times"):
        vibrate(uneven, Vibration(acceleration=0.1), np.random.default_rng(0))
