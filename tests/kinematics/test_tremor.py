"""Tremor of the bones: as large as asked for, in its band, on feet that stay."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.signal import welch

from legsim.core.errors import LegsimError
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.tremor import Tremor, trembling
from legsim.mocap.trajectories import JointTrajectories

TIMES = np.arange(1200) / 120
TREMOR = Tremor(acceleration=0.03)


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


@pytest.fixture(scope="module")
def held(leg: LegModel) -> JointTrajectories:
    """A squat of 50 degrees, held without any motion."""
    posture = leg.posture(np.radians(40.0), np.radians(-50.0), np.radians(20.0))
    return JointTrajectories(TIMES, leg.coordinate_names, np.tile(posture, (len(TIMES), 1)))


@pytest.fixture(scope="module")
def shaken(leg: LegModel, held: JointTrajectories) -> JointTrajectories:
    return trembling(leg, held, TREMOR, np.random.default_rng(3))


def path_of(leg: LegModel, moving: JointTrajectories, segment: str) -> np.ndarray:
    return leg.segment_poses(moving).of(segment)[:, :3, 3]


def acceleration(path: np.ndarray) -> np.ndarray:
    return make_interp_spline(TIMES, path, k=5).derivative(2)(TIMES)[60:-60]


def test_knees_are_accelerated_as_asked(leg, shaken):
    knees = [acceleration(path_of(leg, shaken, f"tibia_{side}")) for side in "rl"]
    size = np.sqrt(np.mean([np.square(a).sum(-1).mean() for a in knees]))
    assert size == pytest.approx(TREMOR.acceleration, rel=0.01)


def test_power_peaks_in_the_band_and_the_mean_stays(leg, held, shaken):
    path = path_of(leg, shaken, "tibia_l") - path_of(leg, held, "tibia_l")
    # two passes of the filter leave the noise's mean, its second order the bend of the arc
    assert np.abs(path.mean(0)).max() < 1e-6
    frequency, power = welch(acceleration(path), 120.0, nperseg=240, axis=0)  # pyright: ignore[reportCallIssue]
    power = np.asarray(power).sum(-1)
    assert 8.0 <= frequency[power.argmax()] <= 12.0
    within = (frequency >= 7) & (frequency <= 13)
    assert power[within].sum() > 0.9 * power.sum()


def test_feet_stay_where_they_are_and_upright(leg, held, shaken):
    for side in "rl":
        before, after = (leg.segment_poses(moving).of(f"calcn_{side}") for moving in (held, shaken))
        bone = np.abs(path_of(leg, shaken, f"tibia_{side}") - path_of(leg, held, f"tibia_{side}"))
        # to second order in a tremor of 10 um
        assert np.abs(after - before)[:, :3, 3].max() < 1e-3 * bone.max()
        assert np.abs(after - before)[:, :3, 1].max() < 1e-8


def test_both_legs_tremble_for_themselves(leg, held, shaken):
    twists = [
        shaken.coordinate(f"hip_rotation_{side}") - held.coordinate(f"hip_rotation_{side}")
        for side in "rl"
    ]
    assert abs(np.corrcoef(*twists)[0, 1]) < 0.5
    assert shaken.coordinate("mtp_angle_l") == pytest.approx(held.coordinate("mtp_angle_l"))


def test_one_seed_gives_one_tremor_and_twice_the_size_twice_the_motion(leg, held, shaken):
    again = trembling(leg, held, TREMOR, np.random.default_rng(3))
    np.testing.assert_array_equal(again.values, shaken.values)
    double = trembling(leg, held, Tremor(2 * TREMOR.acceleration), np.random.default_rng(3))
    np.testing.assert_allclose(
        double.values - held.values, 2 * (shaken.values - held.values), atol=1e-14
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ((-1.0, (8.0, 12.0)), "must not be negative"),
        ((np.nan, (8.0, 12.0)), "must not be negative"),
        ((1.0, (12.0, 8.0)), "got 12 to 8 Hz"),
        ((1.0, (0.0, 8.0)), "above 0"),
    ],
)
def test_what_is_no_tremor_is_refused(wrong, message):
    with pytest.raises(LegsimError, match=message):
        Tremor(*wrong)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (TIMES[:120], "2 s or more"),
        (np.arange(300) / 30, "at least 48 Hz; this one has 30 Hz"),
        (TIMES + 2e-3 * np.sin(TIMES * 20), "even samples"),
    ],
)
def test_recordings_that_cannot_hold_a_tremor_are_refused(leg, held, times, message):
    short = JointTrajectories(times, held.coordinate_names, held.values[: len(times)])
    with pytest.raises(LegsimError, match=message):
        trembling(leg, short, TREMOR, np.random.default_rng(0))
