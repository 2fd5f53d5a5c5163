"""A person who stands starts from any tilt and from no known velocity."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.standing_start import standing_start
from legsim.imu import strapdown
from legsim.imu.signals import ImuSignals, SensorStart

TIMES = np.arange(0, 10, 0.01)
VIEWS = 1.0 + np.arange(248) / 31


def swaying(height: float = 0.4) -> tuple[ImuSignals, np.ndarray]:
    """A sensor on a pendulum about the floor that sways evenly, and its poses at the views."""

    def poses(times):
        phase = 2 * np.pi * 1.0 * (times - VIEWS[0]) / (VIEWS[-1] - VIEWS[0])
        lean = 0.01 * np.stack([np.sin(4 * phase), 0.3 * np.sin(6 * phase), np.cos(5 * phase)], -1)
        turn = transforms.rotation_from_vector(lean)
        return turn, height * turn[..., 1]

    h = 1e-4
    turn, place = poses(TIMES)
    ahead, behind = poses(TIMES + h), poses(TIMES - h)
    acceleration = (ahead[1] - 2 * place + behind[1]) / h**2
    step = np.swapaxes(behind[0], -1, -2) @ ahead[0]
    rate = transforms.vector_from_rotation(step) / (2 * h)
    force = np.einsum("nji,nj->ni", turn, acceleration + np.array([0, 9.80665, 0]))
    at_views = transforms.rigid(*poses(VIEWS))
    return ImuSignals(TIMES, ("s",), rate[:, None], force[:, None]), at_views


@pytest.mark.parametrize("degrees", [0.0, 3.0, 20.0, 90.0])
def test_any_tilt_ends_in_the_persons_sway(degrees):
    """Even sway has no trend but through its phase: a few millimeters and hundredths of a degree.

    Without this the same start runs away by g e t^2 / 2: 16 m from 3 degrees.
    """
    signals, truth = swaying()
    off = transforms.rotation_from_vector(np.radians([degrees, 0, 0]))
    rough = transforms.rigid(off @ truth[0, :3, :3], truth[0, :3, 3])
    found = standing_start(signals, "s", rough, VIEWS)
    path = strapdown.integrate(TIMES, *signals.sensor("s"), found.start, VIEWS)
    up = [np.swapaxes(poses[:, :3, :3], -1, -2)[..., 1] for poses in (path, truth)]
    assert np.degrees(np.linalg.norm(up[0] - up[1], axis=-1)).max() < 0.1
    # a large turn back also turns the heading a little: lengths do not see it
    moved = [np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=-1) for poses in (path, truth)]
    assert np.abs(moved[0] - moved[1]).max() < 4e-3
    assert abs(found.vertical_acceleration) < 1e-3


def test_the_heading_and_the_place_stay_as_given():
    signals, truth = swaying()
    turned = transforms.axis_rotation([0, 1, 0], np.array(0.7))
    rough = transforms.rigid(turned @ truth[0, :3, :3], [1.0, 2.0, 3.0])
    found = standing_start(signals, "s", rough, VIEWS).start
    same = standing_start(signals, "s", truth[0], VIEWS).start
    np.testing.assert_allclose(found.world_from_sensor[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(
        found.world_from_sensor[:3, :3], turned @ same.world_from_sensor[:3, :3], atol=1e-8
    )
    np.testing.assert_allclose(found.velocity, turned @ same.velocity, atol=1e-8)


def test_a_scale_error_of_the_accelerometer_is_reported():
    signals, truth = swaying()
    scaled = ImuSignals(
        TIMES, ("s",), signals.angular_velocity, 1.008 * np.asarray(signals.specific_force)
    )
    found = standing_start(scaled, "s", truth[0], VIEWS)
    assert found.vertical_acceleration == pytest.approx(0.008 * 9.80665, abs=2e-3)


def test_too_few_views_are_refused():
    signals, truth = swaying()
    with pytest.raises(LegsimError, match="three views"):
        standing_start(signals, "s", truth[0], VIEWS[:2])
    found = standing_start(signals, "s", truth[0], VIEWS[:3])
    np.testing.assert_array_equal(found.start.world_from_sensor[:3, 3], truth[0, :3, 3])


def test_the_start_is_a_start():
    signals, truth = swaying()
    assert isinstance(standing_start(signals, "s", truth[0], VIEWS).start, SensorStart)


def test_a_lost_sample_changes_little():
    signals, truth = swaying()
    rate, force = (np.array(a) for a in (signals.angular_velocity, signals.specific_force))
    rate[500], force[500] = np.nan, np.nan
    lost = standing_start(ImuSignals(TIMES, ("s",), rate, force), "s", truth[0], VIEWS).start
    whole = standing_start(signals, "s", truth[0], VIEWS).start
    np.testing.assert_allclose(lost.world_from_sensor, whole.world_from_sensor, atol=1e-4)
    np.testing.assert_allclose(lost.velocity, whole.velocity, atol=1e-3)
