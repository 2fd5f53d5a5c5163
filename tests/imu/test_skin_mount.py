import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import skin_mount
from legsim.imu.signals import ImuSignals
from legsim.imu.skin_mount import SkinMount

TIMES = np.arange(0, 20, 1 / 240)
TISSUE = SkinMount(frequency_hz=8.0, damping=0.2)


def shaken(frequency_hz: float, size: float = 0.5) -> ImuSignals:
    """One sensor that rests upright but for a wave along its x."""
    force = np.tile([0.0, 9.8, 0.0], (len(TIMES), 1, 1))
    force[:, 0, 0] += size * np.sin(2 * np.pi * frequency_hz * TIMES)
    return ImuSignals(TIMES, ("s",), np.zeros_like(force), force)


@pytest.mark.parametrize("frequency_hz", [1.0, 5.0, 8.0, 20.0])
def test_a_wave_is_passed_as_by_a_damped_oscillator(frequency_hz):
    """Amplitude against the law's: |2 z w s + w^2| / |s^2 + 2 z w s + w^2| at s = 2 pi i f."""
    signals = shaken(frequency_hz)
    felt = skin_mount.swing(signals, TISSUE).signals.specific_force[2400:, 0, 0]
    w, s = 2 * np.pi * TISSUE.frequency_hz, 2j * np.pi * frequency_hz
    spring = 2 * TISSUE.damping * w * s + w**2
    assert np.sqrt(2) * felt.std() == pytest.approx(0.5 * abs(spring / (s**2 + spring)), rel=0.03)


def test_the_reading_is_the_rigid_ones_and_the_shifts_second_derivative():
    signals = shaken(3.0)
    swung = skin_mount.swing(signals, SkinMount(8.0, 0.2, amplitude=0.4))
    x = swung.shift[:, 0, 0]
    second = (x[2:] - 2 * x[1:-1] + x[:-2]) * 240**2
    added = (swung.signals.specific_force - signals.specific_force)[1:-1, 0, 0]
    np.testing.assert_allclose(second[500:], added[500:], atol=2e-3)
    np.testing.assert_array_equal(swung.signals.angular_velocity, signals.angular_velocity)


def turning(frequency_hz: float, size: float = 0.01) -> ImuSignals:
    """One sensor on a bone that turns to and fro about the sensor's y, under gravity along x."""
    rate = np.zeros((len(TIMES), 1, 3))
    rate[:, 0, 1] = size * np.sin(2 * np.pi * frequency_hz * TIMES)
    return ImuSignals(TIMES, ("s",), rate, np.tile([9.8, 0.0, 0.0], (len(TIMES), 1, 1)))


@pytest.mark.parametrize("frequency_hz", [1.0, 6.0, 15.0])
def test_a_turn_is_passed_as_by_a_damped_oscillator(frequency_hz):
    """The mount's own resonance of turns decides the gyroscope, by the law of the shift."""
    mount = SkinMount(8.0, 0.2, 0.0, turn_amplitude=1.0, turn_frequency_hz=6.0)
    swung = skin_mount.swing(turning(frequency_hz), mount)
    felt = swung.signals.angular_velocity[2400:, 0, 1]
    w, s = 2 * np.pi * 6.0, 2j * np.pi * frequency_hz
    spring = 0.4 * w * s + w**2
    assert np.sqrt(2) * felt.std() == pytest.approx(0.01 * abs(spring / (s**2 + spring)), rel=0.03)
    np.testing.assert_array_equal(swung.shift, 0)


def test_the_rate_error_is_the_turns_derivative_and_turns_gravity():
    signals = turning(3.0)
    mount = SkinMount(8.0, 0.2, 0.0, turn_amplitude=0.5, turn_frequency_hz=6.0)
    swung = skin_mount.swing(signals, mount)
    turn = swung.turn[:, 0, 1]
    slope = (turn[2:] - turn[:-2]) * 120
    added = (swung.signals.angular_velocity - signals.angular_velocity)[1:-1, 0, 1]
    np.testing.assert_allclose(slope[500:], added[500:], atol=2e-5)
    # gravity along x, turned about y by a, is seen along z as g sin a
    np.testing.assert_allclose(
        swung.signals.specific_force[:, 0, 2], 9.8 * np.sin(turn), atol=1e-12
    )


def test_each_axis_swings_by_its_own_share():
    force = np.random.default_rng(0).normal(size=(len(TIMES), 1, 3))
    signals = ImuSignals(TIMES, ("s",), force, force)
    full = skin_mount.swing(signals, SkinMount(8.0, 0.2, turn_amplitude=1.0))
    part = skin_mount.swing(
        signals,
        SkinMount(8.0, 0.2, 0.5, (1.0, 0.0, 0.5), 0.5, turn_axes=(0.0, 2.0, 1.0)),
    )
    np.testing.assert_allclose(part.shift, [0.5, 0.0, 0.25] * full.shift)
    np.testing.assert_allclose(part.turn, [0.0, 1.0, 0.5] * full.turn)


def test_at_rest_and_without_amplitude_nothing_changes():
    resting = shaken(1.0, size=0.0)
    np.testing.assert_allclose(
        skin_mount.swing(resting, TISSUE).signals.specific_force, resting.specific_force, atol=1e-12
    )
    moving = shaken(6.0)
    rigid = skin_mount.swing(moving, SkinMount(8.0, 0.2, amplitude=0.0))
    np.testing.assert_array_equal(rigid.signals.specific_force, moving.specific_force)
    np.testing.assert_array_equal(rigid.shift, 0)


def test_a_tilt_moves_the_sensor_by_the_springs_sag():
    """Another part of gravity along x shifts the sensor by g / w^2, and the reading settles where
    the rigid one is.
    """
    force = np.tile([0.0, 9.8, 0.0], (len(TIMES), 1, 1))
    force[len(TIMES) // 2 :, 0, 0] += 1.0
    swung = skin_mount.swing(ImuSignals(TIMES, ("s",), np.zeros_like(force), force), TISSUE)
    w = 2 * np.pi * TISSUE.frequency_hz
    assert swung.shift[0, 0, 0] - swung.shift[-1, 0, 0] == pytest.approx(1 / w**2, rel=1e-6)
    np.testing.assert_allclose(swung.signals.specific_force[[0, -1]], force[[0, -1]], atol=1e-9)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 0.2, 1.0), "above 0"),
        ((8.0, 0.0, 1.0), "above 0"),
        ((8.0, 0.2, -1.0), "negative; got -1"),
        ((8.0, 0.2, 1.0, (1, 1, -2)), "negative; got -2"),
        ((8.0, 0.2, 1.0, (1, 1, 1), np.nan), "negative; got nan"),
        ((8.0, 0.2, 1.0, (1, 1, 1), 1.0, 0.0), "above 0"),
    ],
)
def test_what_is_no_tissue_is_refused(values, message):
    with pytest.raises(LegsimError, match=message):
        SkinMount(*values)


def test_a_resonance_that_the_samples_cannot_show_is_refused():
    with pytest.raises(
        LegsimError, match=r"needs signals of at least 400 Hz; got 240 Hz: raise imu\.rate_hz"
    ):
        skin_mount.swing(shaken(1.0), SkinMount(100.0, 0.2))


def test_uneven_samples_are_refused():
    signals = shaken(1.0)
    uneven = ImuSignals(
        TIMES + 1e-3 * np.sin(TIMES), ("s",), signals.angular_velocity, signals.specific_force
    )
    with pytest.raises(LegsimError, match="even times"):
        skin_mount.swing(uneven, TISSUE)
