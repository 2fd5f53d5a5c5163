"""A motion fitted to sharpness: derivatives by what a path depends on, and the way down."""

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from legsim.core import transforms
from legsim.correction.image_criterion import Focus
from legsim.correction.image_fit import (
    ImageProblem,
    SplinePath,
    by_errors,
    fitted,
    sharpened,
    similarity_part,
)
from legsim.correction.path_measurements import StandingFoot, StandingPrior
from legsim.correction.smoother import SmoothedPath
from legsim.reconstruction.field_of_view import pixel_at_isocenter
from tests.examples.knee_scan import GEOMETRY, KNEE, VIEWS

SPLINES = SplinePath(VIEWS, KNEE, 7)
STANDING = StandingPrior.at(KNEE, 5e-3)
FOOT = StandingFoot(KNEE - [0.0, 0.4, 0.0], 5e-3)
ON_A_FOOT = pytest.mark.parametrize("foot", [None, FOOT], ids=["free", "on a foot"])


@pytest.mark.parametrize("size", [3.0, 3e-3])
def test_twists_of_splines_are_finite_differences_of_their_poses(
    rng: np.random.Generator, size: float
) -> None:
    """Of turns of degrees, and of some 1e-5 rad, where series take over."""
    errors = size * rng.normal(size=SPLINES.size)
    found = SPLINES.path(errors).twists
    for k in rng.integers(0, SPLINES.size, 12):
        step = np.zeros(SPLINES.size)
        step[k] = 1e-5
        after, before = (SPLINES.path(errors + s * step).poses for s in (1, -1))
        change = after @ transforms.inverse(before)
        turn = transforms.vector_from_rotation(change[:, :3, :3]) / 2e-5
        middle = 0.5 * (after + before)[:, :3, 3]
        shift = (after - before)[:, :3, 3] / 2e-5 - np.cross(turn, middle)
        np.testing.assert_allclose(found[:, :3, k], turn, atol=1e-9)
        np.testing.assert_allclose(found[:, 3:, k], shift, atol=1e-8)


def test_splines_begin_and_end_with_the_scan() -> None:
    basis = SPLINES.basis()
    np.testing.assert_allclose(basis.sum(1), 1, atol=1e-12)
    assert basis[0, 0] == pytest.approx(1)
    assert basis[-1, -1] == pytest.approx(1)


def test_the_chain_rule_holds_for_any_function_of_the_motion(rng: np.random.Generator) -> None:
    errors = rng.normal(size=SPLINES.size)
    weights = rng.normal(size=(len(VIEWS), 4, 4))
    weights[:, 3] = 0

    def value(at: np.ndarray) -> float:
        return float((weights * SPLINES.path(at).motion()).sum())

    found = by_errors(weights, SPLINES.path(errors))
    for k in rng.integers(0, SPLINES.size, 12):
        step = np.zeros(SPLINES.size)
        step[k] = 1e-5
        slope = (value(errors + step) - value(errors - step)) / 2e-5
        assert found[k] == pytest.approx(slope, abs=1e-6 * np.abs(found).max())


def nearness(
    true: np.ndarray, sizes: tuple[float, float] = (1.0, 1.0)
) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """A sharpness of known minimum: 0.13 / 2 nats per mm^2 of what images see.

    ``sizes`` weight columns and rows.
    """
    points = STANDING.points
    target = GEOMETRY.project(transforms.apply(true, points))[0]
    pixel, matrices = 1.604e-3, GEOMETRY.matrices

    def sharpness(motion: np.ndarray) -> tuple[float, np.ndarray]:
        moved = transforms.apply(motion, points)
        pixels, depths = GEOMETRY.project(moved)
        off = pixel * (pixels - target)
        pulled = np.array(sizes) * off
        rows = matrices[:, None, :2, :3] - pixels[..., None] * matrices[:, None, 2:, :3]
        by_point = pixel * np.einsum("vpk,vpki->vpi", pulled, rows / depths[..., None, None])
        scale = 0.13e6 / depths.size
        by_motion = np.zeros((len(motion), 4, 4))
        ends = np.concatenate([points, np.ones((len(points), 1))], -1)
        by_motion[:, :3] = scale * np.einsum("vpi,pj->vij", by_point, ends)
        return 0.5 * scale * float((pulled * off).sum()), by_motion

    return sharpness


def problem(true: np.ndarray, pull: np.ndarray | None = None) -> ImageProblem:
    sharpness = cast(Focus, nearness(true))
    return ImageProblem(SPLINES, sharpness, STANDING, GEOMETRY, 1e5, pull)


@ON_A_FOOT
def test_slopes_of_the_cost_are_finite_differences(
    rng: np.random.Generator, foot: StandingFoot | None
) -> None:
    true = SPLINES.path(0.3 * rng.normal(size=SPLINES.size)).motion()
    pull = 1e-3 * rng.normal(size=true.shape) * [[1], [1], [1], [0]]
    asked, errors = replace(problem(true, pull), foot=foot), 0.3 * rng.normal(size=SPLINES.size)
    _, slopes, _ = asked.cost(errors)
    for k in rng.integers(0, SPLINES.size, 12):
        step = np.zeros(SPLINES.size)
        step[k] = 1e-4
        slope = (asked.cost(errors + step)[0] - asked.cost(errors - step)[0]) / 2e-4
        assert slopes[k] == pytest.approx(slope, abs=1e-5 * np.abs(slopes).max())


def test_what_images_see_of_errors_is_what_a_smoothed_path_says(rng: np.random.Generator) -> None:
    """Of errors in one direction; one of every four views decides here, and all of them there."""
    errors = 0.1 * rng.normal(size=SPLINES.size)
    path = SPLINES.path(errors)
    _, seen = problem(path.motion()).known_and_seen(errors)
    pixel = pixel_at_isocenter(GEOMETRY)
    for _ in range(5):
        way = rng.normal(size=SPLINES.size)
        alone = SmoothedPath(
            VIEWS, path, errors, np.outer(way, way), np.zeros((0, 3)), float("nan"), True
        )
        _, expected = alone.seen_motion(GEOMETRY, STANDING.points)
        assert np.sqrt(way @ seen @ way) / pixel == pytest.approx(expected, rel=0.15)


@ON_A_FOOT
def test_priors_curve_as_they_do(rng: np.random.Generator, foot: StandingFoot | None) -> None:
    """By differences of the slopes where the criterion has no weight."""
    still = SPLINES.path(np.zeros(SPLINES.size)).motion()
    asked = replace(problem(still), weight=0.0, foot=foot)
    errors = np.zeros(SPLINES.size)
    way = rng.normal(size=SPLINES.size)
    ends = [asked.cost(errors + k * 1e-3 * way)[1] for k in (1, -1)]
    second = way @ (ends[0] - ends[1]) / 2e-3
    assert way @ asked.curvature(errors) @ way == pytest.approx(second, rel=0.1)


def test_a_motion_is_found_again_to_what_priors_leave(rng: np.random.Generator) -> None:
    true = SPLINES.path(0.3 * rng.normal(size=SPLINES.size)).motion()
    found = fitted(problem(true), np.zeros(SPLINES.size), 60)
    motion = SPLINES.path(found.errors).motion()
    points = STANDING.points
    off, before = (
        GEOMETRY.project(transforms.apply(m, points))[0]
        - GEOMETRY.project(transforms.apply(true, points))[0]
        for m in (motion, np.broadcast_to(np.eye(4), motion.shape))
    )
    assert np.abs(off).max() < 0.05 * np.abs(before).max()
    assert found.value < 0.01 * problem(true).cost(np.zeros(SPLINES.size))[2]


def test_of_errors_that_images_do_not_tell_apart_those_over_a_still_ankle_are_likeliest() -> None:
    """Back on the model's paths from a motion that the leg's turn or its shift explains."""
    shift = np.zeros(SPLINES.size)
    shift[3::6] = np.linspace(-1, 1, SPLINES.knots)
    asked = problem(SPLINES.path(shift).motion())
    moved = []
    for foot in (None, replace(FOOT, walk=1e-4)):
        back = replace(asked, foot=foot, weight=1e3).retracted(shift, SPLINES.path(shift).motion())
        ankle = transforms.apply(SPLINES.path(back).poses, FOOT.ankle_sensor[None])[:, 0]
        moved.append(float(np.ptp(ankle, axis=0).max()))
    assert moved[1] < 0.1 * moved[0]


def test_steps_of_measured_curvature_find_a_motion_that_few_of_descent_do_not(
    rng: np.random.Generator,
) -> None:
    """Where one direction of the detector curves thirty times as much as the other."""
    true = SPLINES.path(0.1 * rng.normal(size=SPLINES.size)).motion()
    asked = replace(problem(true), sharpness=cast(Focus, nearness(true, (1.0, 0.03))), weight=1e7)
    points, left = STANDING.points, []
    for descend in (sharpened, fitted):
        found = descend(asked, np.zeros(SPLINES.size), 5)
        motion = SPLINES.path(found.errors).motion()
        off = GEOMETRY.project(transforms.apply(motion, points))[0]
        off = off - GEOMETRY.project(transforms.apply(true, points))[0]
        left.append(float(np.sqrt((off**2).sum(-1).mean())))
    assert left[0] < 0.02
    assert left[0] < 0.2 * left[1]


def test_nothing_that_images_see_is_nothing_to_step_along() -> None:
    """Splines that hardly move: where they are is where they stay."""
    stiff = replace(SPLINES, turn=1e-9, shift=1e-9)
    still = stiff.path(np.zeros(stiff.size)).motion()
    asked = replace(problem(still), model=stiff)
    for descend in (fitted, sharpened):
        found = descend(asked, np.zeros(stiff.size), 5)
        np.testing.assert_array_equal(found.errors, np.zeros(stiff.size))
        assert found.evaluations == 1


def test_the_part_that_tells_no_images_apart_is_taken_out(rng: np.random.Generator) -> None:
    motion = SPLINES.path(0.3 * rng.normal(size=SPLINES.size)).motion()
    slopes = rng.normal(size=motion.shape) * [[1], [1], [1], [0]]
    middle = KNEE - [0, 0.045, 0.01]
    part = similarity_part(slopes, motion, GEOMETRY, middle)
    turn = transforms.cross_matrix(rng.normal(size=3))
    before = np.zeros((4, 4))
    before[:3, :3], before[:3, 3] = turn, rng.normal(size=3)
    nearer = np.zeros_like(motion)
    nearer[:, :3, 3] = GEOMETRY.sources() - KNEE
    for way in (motion @ before, nearer):
        assert ((slopes - part) * way).sum() == pytest.approx(0, abs=1e-9 * np.abs(way).sum())
    again = similarity_part(slopes - part, motion, GEOMETRY, middle)
    assert np.abs(again).max() < 1e-9 * np.abs(part).max()


def test_a_path_is_led_back_to_its_models_own(rng: np.random.Generator) -> None:
    """The motion of some errors gives these errors again, from far off."""
    true = 0.3 * rng.normal(size=SPLINES.size)
    motion = SPLINES.path(true).motion()
    found = problem(motion).retracted(np.zeros(SPLINES.size), motion)
    off = transforms.apply(SPLINES.path(found).motion(), STANDING.points) - transforms.apply(
        motion, STANDING.points
    )
    assert np.sqrt((off**2).sum(-1).mean()) < 5e-4
