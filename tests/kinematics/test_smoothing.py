import numpy as np
import pytest

from legsim.kinematics import marker_sites, smoothing
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories

LEG = LegModel.load()
SITES = marker_sites.load().only(PAPER_ROLES)
TIMES = np.arange(0, 10, 1 / 120)
NOISE = 2e-4


def moving(frequency_hz: float, degrees: float) -> JointTrajectories:
    """A knee that waves."""
    values = np.tile(LEG.default_coordinates, (len(TIMES), 1))
    values[:, COORDINATES.index("knee_angle_l")] += np.radians(
        -30 + degrees * np.sin(2 * np.pi * frequency_hz * TIMES)
    )
    return JointTrajectories(TIMES, COORDINATES, values)


def settled(
    trajectories: JointTrajectories, noise: float = NOISE, filter_hz: float = 6.0
) -> tuple[JointTrajectories, float]:
    return smoothing.smooth_below_noise(LEG, trajectories, SITES, noise=noise, filter_hz=filter_hz)


def test_what_a_filter_leaves_of_white_noise_is_the_laws(rng):
    """Through the very filter, and differentiated by the spectrum: value and acceleration within 5
    %.
    """
    white = NOISE * rng.standard_normal((20000, 12))
    left = low_pass(white, 120.0, 6.0)
    turn = 2 * np.pi * np.fft.rfftfreq(20000, 1 / 120)[:, None]
    second = np.fft.irfft(-(turn**2) * np.fft.rfft(left[:, :], axis=0), axis=0)[500:-500]
    value_rms, second_rms = smoothing.left_by_filter(NOISE, 6.0, 120.0)
    assert left.std() == pytest.approx(value_rms, rel=0.05)
    assert second.std() == pytest.approx(second_rms, rel=0.05)
    assert (1e3 * value_rms, 1e3 * second_rms / 9.80665) == pytest.approx((0.0577, 4.83), rel=0.01)


def test_tremble_that_noise_can_make_is_taken_out():
    calm, cutoff = settled(moving(5.5, 0.004))
    assert cutoff == smoothing.CUTOFFS_HZ[0]
    assert calm.coordinate("knee_angle_l")[200:-200].std() < 0.01 * np.radians(0.004)


def test_slow_sway_stays():
    given = moving(0.5, 0.5)
    calm, cutoff = settled(given)
    assert cutoff == smoothing.CUTOFFS_HZ[0]
    assert np.abs(calm.values - given.values)[120:-120].max() < np.radians(1e-4)


@pytest.mark.parametrize(("frequency_hz", "degrees"), [(4.5, 1.0), (3.0, 10.0)])
def test_movement_larger_than_the_noise_is_left_alone(frequency_hz, degrees):
    given = moving(frequency_hz, degrees)
    same, cutoff = settled(given)
    assert cutoff == 0
    np.testing.assert_array_equal(same.values, given.values)


def test_a_short_jerk_in_a_long_rest_is_left_alone():
    given = moving(0.2, 0.1)
    values = given.values.copy()
    values[600:612, COORDINATES.index("knee_angle_l")] += np.radians(0.4) * np.sin(
        np.linspace(0, 2 * np.pi, 12)
    )
    same, cutoff = settled(JointTrajectories(TIMES, COORDINATES, values))
    assert cutoff == 0 or np.abs(same.values - values).max() < np.radians(0.1)


@pytest.mark.parametrize("silent", [{"noise": 0.0}, {"filter_hz": 0.0}])
def test_without_noise_or_filter_nothing_is_done(silent):
    given = moving(5.5, 0.004)
    same, cutoff = settled(given, **silent)
    assert (same, cutoff) == (given, 0.0)


def test_no_cutoff_above_the_markers_own_is_tried():
    assert settled(moving(0.5, 0.5), filter_hz=2.0)[1] == 0
