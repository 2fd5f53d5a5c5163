"""A static trial of a frame or two is its mean pose; longer ones stay."""

import numpy as np
import pytest

from legsim.mocap import cleaning, marker_sets
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.static_trial import as_static
from legsim.mocap.trajectories import MarkerTrajectories

LABELS = ("SACR", "RASI", "LASI", "RKNE", "LKNE", "RANK", "LANK")
STANDING = np.array(
    [
        [-0.16, 0.98, 0.0],
        *([0.0, 0.95, z] for z in (0.12, -0.12)),
        *([-0.05, 0.5, z] for z in (0.15, -0.15)),
        *([-0.05, 0.08, z] for z in (0.14, -0.14)),
    ]
)


def trial(frames: int) -> MarkerTrajectories:
    sway = 0.002 * np.arange(frames)[:, None, None]
    return MarkerTrajectories(np.arange(frames) / 100, LABELS, STANDING + sway)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_short_trial_is_its_mean_pose_and_can_be_cleaned(frames):
    chosen = marker_sets.guess(LABELS)
    markers, _ = cleaning.clean(as_static(trial(frames)), chosen, required=PAPER_ROLES)
    for role, place in zip(PAPER_ROLES, STANDING + 0.001 * (frames - 1), strict=True):
        np.testing.assert_allclose(markers.marker(role), np.tile(place, (4, 1)), atol=1e-12)


def test_a_marker_that_one_frame_hides_is_where_the_others_show_it():
    motion = trial(3)
    positions = motion.positions_world.copy()
    positions[1:, 0], positions[:, 1] = np.nan, np.nan
    still = as_static(MarkerTrajectories(motion.times, LABELS, positions)).positions_world
    np.testing.assert_allclose(still[:, 0], np.tile(STANDING[0], (4, 1)), atol=1e-12)
    assert np.isnan(still[:, 1]).all()


def test_a_longer_trial_stays():
    motion = trial(4)
    assert as_static(motion) is motion
