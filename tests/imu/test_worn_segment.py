"""A sensor that moves as another segment does is noticed; one that stands is left alone."""

from collections.abc import Sequence

import numpy as np
import pytest

from legsim.core import transforms
from legsim.imu.lag import find_lag
from legsim.imu.recording import ImuRecording
from legsim.imu.worn_segment import better_segment
from tests.examples.sensors import still

TIMES = np.arange(1500) / 100
HALF_A_STEP = 0.55


def walking(name: str, delay: float = 0.0, size: float = 1.0, sharp: float = 1.0) -> ImuRecording:
    """Angular velocity of a segment that swings once in 1.1 s; ``sharp`` shapes the swing."""
    phase = 2 * np.pi * (TIMES - delay) / (2 * HALF_A_STEP)
    swing = size * (np.sin(phase) + 0.7 * sharp * np.sin(2 * phase + 0.4))
    rate = np.stack([0.2 * np.cos(phase), 0.1 * np.sin(2 * phase), swing], -1)
    return ImuRecording(name, TIMES, rate, np.tile([0, 9.81, 0.0], (len(TIMES), 1)))


SEGMENTS = (
    walking("tibia_l", sharp=2.0),
    walking("tibia_r", HALF_A_STEP, sharp=2.0),
    walking("femur_l", 0.2, sharp=0.1),
    walking("femur_r", 0.2 + HALF_A_STEP, sharp=0.1),
)


def worn(of: ImuRecording, lag: float = 0.03) -> ImuRecording:
    """The same with another clock, mounted somehow, and noise."""
    axes = transforms.rotation_from_vector([0.3, -2.0, 0.5])
    noise = 0.05 * np.random.default_rng(1).standard_normal((len(TIMES), 3))
    return ImuRecording(
        "m", of.times + lag, of.angular_velocity @ axes + noise, of.specific_force @ axes
    )


def better(
    measured: ImuRecording, named: ImuRecording, segments: Sequence[ImuRecording]
) -> tuple[str, float, float] | None:
    """What is found by the clock that fits the named segment; lags are of the sensor's own."""
    lag, correlation = find_lag(named, measured, step=0.01)
    found = better_segment(measured.shifted(-lag), named.name, correlation, segments)
    return found and (found[0], found[1], found[2] + lag)


@pytest.mark.parametrize("segment", SEGMENTS, ids=[one.name for one in SEGMENTS])
def test_the_segment_that_wears_the_sensor_is_kept(segment: ImuRecording):
    assert better(worn(segment), segment, SEGMENTS) is None


@pytest.mark.parametrize(("true", "named"), [(0, 2), (2, 0), (3, 1)])
def test_a_segment_of_another_kind_is_noticed(true: int, named: int):
    found = better(worn(SEGMENTS[true]), SEGMENTS[named], SEGMENTS)
    assert found is not None
    name, correlation, lag = found
    assert name.partition("_")[0] == SEGMENTS[true].name.partition("_")[0]
    assert correlation > 0.95
    assert lag == pytest.approx(0.03, abs=0.01) or abs(lag) == pytest.approx(0.55, abs=0.05)


def test_a_sensor_at_rest_belongs_wherever_it_is_said_to_be():
    quiet = still(count=1500, seed=2)
    assert better(quiet, SEGMENTS[0], SEGMENTS) is None


def test_the_other_leg_is_noticed_where_both_differ():
    """A step of its own length on each side, as all people have."""
    right = walking("tibia_r", 0.7, sharp=0.4)
    found = better(worn(right), SEGMENTS[0], (SEGMENTS[0], right))
    assert found is not None
    assert found[0] == "tibia_r"
    assert found[2] == pytest.approx(0.03, abs=0.01)
