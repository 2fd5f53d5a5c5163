"""What is measured of a sensor's path: what arrays may be, and how much of them is needed."""

from collections.abc import Callable

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.error_state import SensorPath
from legsim.correction.path_measurements import (
    BeadShadows,
    FiducialShadows,
    StandingFoot,
    StandingPrior,
)

PLACES = np.array([[0.04, -0.02, 0.03], [-0.05, -0.06, 0.01]])


@pytest.mark.parametrize("made", [BeadShadows, lambda *a: FiducialShadows(a[0], PLACES, *a[1:])])
def test_what_numpy_would_take_for_shadows_is_refused(made: Callable[..., object]) -> None:
    """One point without its axis, three coordinates, and an error that is no size."""
    for shape in ((5, 2), (5, 1, 3)):
        with pytest.raises(LegsimError, match=r"Shadows\.pixels has shape"):
            made(np.zeros(shape))
    for size in (0.0, -0.3, float("nan")):
        with pytest.raises(LegsimError, match=r"error_px is .* finite and positive"):
            made(np.zeros((5, len(PLACES), 2)), size)


def test_points_seen_in_two_views_are_too_few():
    pixels = np.zeros((5, 2, 2))
    pixels[2:, 1] = np.nan
    assert BeadShadows(pixels).enough().pixels.shape == (5, 1, 2)
    pixels[2:] = np.nan
    with pytest.raises(LegsimError, match="none of 2 beads was found in 3 views"):
        BeadShadows(pixels).enough()
    with pytest.raises(LegsimError, match="seen in 2 views, 3 are needed"):
        FiducialShadows(pixels, PLACES).enough()


def test_a_standing_prior_weighs_the_same_however_many_views_and_points():
    few = StandingPrior.at(np.zeros(3))
    many = StandingPrior(np.tile(few.points, (3, 1)))
    assert 60 * 4 * few.weight(60) ** 2 == pytest.approx(248 * 12 * many.weight(248) ** 2)


def test_an_ankle_that_walks_at_random_has_unit_weights(rng: np.random.Generator):
    """Between views that are not evenly apart, too."""
    views = np.cumsum(rng.uniform(0.01, 0.1, 5000))
    foot = StandingFoot(np.zeros(3), 3e-4)
    walk = 3e-4 * np.cumsum(np.sqrt(np.diff(views)) * rng.standard_normal(len(views) - 1))
    poses = transforms.translation(np.append(0.0, walk)[:, None] * [1.0, 0.0, 0.0])
    steps, _ = foot.steps(SensorPath(poses, np.zeros((len(views), 6, 1))), views)
    assert np.mean(steps[:, 0] ** 2) == pytest.approx(
        1, abs=0.08
    )  # four standard deviations of the mean
    with pytest.raises(LegsimError, match=r"StandingFoot\.ankle_sensor has shape"):
        StandingFoot(np.zeros((1, 3)))
    with pytest.raises(LegsimError, match=r"walk is .* finite and positive"):
        StandingFoot(np.zeros(3), 0.0)
