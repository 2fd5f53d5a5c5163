"""Errors of a sensor: their propagation against finite differences of the exact integration."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.error_state import ErrorState, error_state
from legsim.correction.rough_start import EXACT, StartErrors
from legsim.imu import strapdown
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway

VIEWS = np.arange(93) / 31
SAMPLES = np.arange(-60, 480) / 120
SWAY = Sway.standing(3)
START = SensorStart(SWAY.poses(VIEWS[:1])[0], SWAY.velocities(VIEWS[:1])[0])
KNEE = SWAY.center + np.array([[0.0, 0.14, 0.0], [0.05, 0.1, -0.03]])


def signals(offset: float = 0.0) -> ImuSignals:
    """Exact ones, whose clock is ahead by ``offset``."""
    rate, force = SWAY.signals(SAMPLES)
    return ImuSignals(SAMPLES + offset, ("shank_l",), rate[:, None], force[:, None])


def state(
    errors: SensorErrors, start_errors: StartErrors = EXACT, clock: float = 0.0
) -> ErrorState:
    return error_state(signals(), "shank_l", START, VIEWS, errors, start_errors, clock=clock)


def carried(poses: np.ndarray) -> np.ndarray:
    return transforms.apply(poses @ transforms.inverse(poses[0]), KNEE)


def test_derivatives_are_those_of_the_exact_integration(rng: np.random.Generator):
    """At errors as large as a real sensor's. Trapezoids at 120 Hz miss 1e-4 of it at most, of the
    smallest ones 1e-5 m.
    """
    found = state(load_sensor("bmi160").errors, StartErrors(), clock=0.01)
    errors = 0.1 * rng.standard_normal(found.size)
    path, step = found.path(errors), 1e-3
    by_points, by_turn = path.of_points(KNEE), path.of_rotation()
    for k in [*range(0, found.size, 7), *range(9), found.size - 1]:
        change = step * (np.arange(found.size) == k)
        after, before = (found.poses(errors + sign * change) for sign in (1, -1))
        exact = (carried(after) - carried(before)) / (2 * step)
        np.testing.assert_allclose(by_points[..., k], exact, rtol=2e-4, atol=2e-5)
        turns = after @ transforms.inverse(after[0]), before @ transforms.inverse(before[0])
        turn = transforms.vector_from_rotation(
            turns[0][:, :3, :3] @ np.swapaxes(turns[1][:, :3, :3], -1, -2)
        )
        np.testing.assert_allclose(by_turn[..., k], turn / (2 * step), rtol=2e-4, atol=2e-5)


def test_points_fixed_in_the_sensor_move_with_its_pose(rng: np.random.Generator):
    found = state(load_sensor("bmi160").errors, StartErrors())
    errors, step = 0.1 * rng.standard_normal(found.size), 1e-3
    by = found.path(errors).of_attached(KNEE)
    for k in (1, 4, 7, 12, 40):
        change = step * (np.arange(found.size) == k)
        after, before = (
            transforms.apply(found.poses(errors + sign * change), KNEE) for sign in (1, -1)
        )
        np.testing.assert_allclose(by[..., k], (after - before) / (2 * step), rtol=2e-4, atol=2e-5)


def test_without_errors_the_path_is_the_integral_of_the_signals():
    found = state(load_sensor("bmi160").errors, StartErrors())
    exact = strapdown.integrate(*signals().samples("shank_l"), START, VIEWS)
    np.testing.assert_allclose(found.path(np.zeros(found.size)).poses, exact, atol=1e-10)


def test_the_right_errors_give_the_true_path():
    """A bias and a clock that are read off again leave the true poses."""
    bias = np.array([0.3, -0.2, 0.1])
    read = signals(offset=0.02)
    read = ImuSignals(
        read.times, read.sensor_names, read.angular_velocity, read.specific_force + bias
    )
    sensor = SensorErrors(TriadErrors(turn_on_bias=0.4), TriadErrors())
    found = error_state(read, "shank_l", START, VIEWS, sensor, EXACT, clock=0.01)
    errors = np.zeros(found.size)
    errors[9:12], errors[-1] = bias / 0.4, 2.0
    np.testing.assert_allclose(found.poses(errors), SWAY.poses(VIEWS), atol=1e-6)


def test_what_is_known_exactly_changes_nothing():
    found = state(SensorErrors(), EXACT)
    assert np.abs(found.path(np.ones(found.size)).twists).max() == 0
    np.testing.assert_array_equal(
        found.poses(np.ones(found.size)), found.poses(np.zeros(found.size))
    )


def test_a_gyroscope_s_bias_is_guessed_from_its_mean():
    """To 5 degrees of turn over the scan, within which a person may have turned."""
    bias = np.radians([2.0, -3.0, 1.0])
    read = signals()
    read = ImuSignals(
        read.times, read.sensor_names, read.angular_velocity + bias, read.specific_force
    )
    sensor = SensorErrors(TriadErrors(), TriadErrors(turn_on_bias=float(np.radians(3))))
    found = error_state(read, "shank_l", START, VIEWS, sensor, EXACT)
    at = 9 + found.force_errors.shape[-1]
    guess = found.first_guess()[at : at + 3] * np.radians(3)
    assert np.abs(guess - bias).max() * VIEWS[-1] < np.radians(5)


def test_white_noise_of_the_knots_walks_as_the_sensor_s_does():
    """The variance of the turn after a time t is density^2 t / 2, at any knot."""
    density = 1e-3
    found = state(SensorErrors(TriadErrors(), TriadErrors(noise_density=density)))
    turned = found.path(np.zeros(found.size)).of_rotation()
    variance = (turned**2).sum(-1).mean(-1)
    late = VIEWS > 1
    np.testing.assert_allclose(variance[late], density**2 * VIEWS[late] / 2, rtol=0.1)


def test_what_cannot_be_set_up_is_refused():
    with pytest.raises(LegsimError, match="three views"):
        error_state(signals(), "shank_l", START, VIEWS[:2], SensorErrors(), EXACT)
    with pytest.raises(LegsimError, match="clock"):
        state(SensorErrors(), clock=-1.0)
    late = error_state(signals(), "shank_l", START, VIEWS + 2, SensorErrors(), EXACT)
    with pytest.raises(LegsimError, match="recorded"):
        late.path(np.zeros(late.size))


def test_errors_are_carried_through_every_sample_between_the_views():
    found = state(load_sensor("bmi160").errors)
    sampled = np.asarray(signals().times)
    between = sampled[(sampled > VIEWS[0]) & (sampled < VIEWS[-1])]
    np.testing.assert_array_equal(found.nodes, np.unique(np.concatenate([VIEWS, between])))


def test_samples_within_rounding_of_a_view_are_that_view():
    """Their clocks meet every 30th of a second, but for the last bit."""
    at = SAMPLES[60:400:4]
    late = np.nextafter(at, np.inf)
    exact, rounded = (
        error_state(signals(), "shank_l", START, views, SensorErrors(), EXACT)
        for views in (at, late)
    )
    assert len(rounded.nodes) == len(exact.nodes)
    nothing = np.zeros(exact.size)
    poses = rounded.path(nothing).poses
    np.testing.assert_allclose(poses, exact.path(nothing).poses, atol=1e-12)


@pytest.mark.parametrize("clock", [0.01, 0.1, 0.3])
def test_the_signal_reaches_as_far_as_the_clock_may(clock: float):
    """To five standard deviations either way: the path is that of a start as much later."""
    samples = np.arange(-240, 720) / 120
    rate, force = SWAY.signals(samples)
    read = ImuSignals(samples, ("shank_l",), rate[:, None], force[:, None])
    found = error_state(read, "shank_l", START, VIEWS, SensorErrors(), EXACT, clock=clock)
    for sigmas in (-5.0, 5.0):
        errors = np.zeros(found.size)
        errors[-1] = sigmas
        assert np.isfinite(found.path(errors).poses).all()


GAPS = [(-0.3, 0.1), (-0.295, 0.6), (-0.9, 0.6), (-0.45, 0.02), (2.9, 3.3), (2.4, 3.26), (2.9, 3.9)]


@pytest.mark.parametrize("clock", [0.0, 0.01])
@pytest.mark.parametrize(("first", "last"), GAPS)
def test_gaps_at_either_end_of_the_views_are_bridged_as_without_errors(first, last, clock):
    """From all samples beside them, however far these are from the views."""
    samples = np.arange(-240, 720) / 120
    samples = samples[(samples <= first) | (samples >= last)]
    rate, force = SWAY.signals(samples)
    read = ImuSignals(samples, ("shank_l",), rate[:, None], force[:, None])
    found = error_state(read, "shank_l", START, VIEWS, SensorErrors(), EXACT, clock=clock)
    errors = np.zeros(found.size)
    exact = strapdown.integrate(*read.samples("shank_l"), START, VIEWS)
    np.testing.assert_allclose(found.path(errors).poses, exact, atol=1e-7)
    for sigmas in (-5.0, 5.0) if clock else ():
        errors[-1] = sigmas
        late = strapdown.integrate(samples - clock * sigmas, rate, force, START, VIEWS)
        # this one leaves a gap that the clock moved out of the views to its spline
        np.testing.assert_allclose(found.poses(errors), late, atol=1e-5)


def test_slow_samples_are_kept_on_both_sides_of_the_views():
    samples = np.arange(-20, 60) * 0.32 - 0.01
    rate, force = SWAY.signals(samples)
    read = ImuSignals(samples, ("shank_l",), rate[:, None], force[:, None])
    found = error_state(read, "shank_l", START, VIEWS, SensorErrors(), EXACT)
    assert found.times[0] < VIEWS[0]
    assert found.times[-1] > VIEWS[-1]
