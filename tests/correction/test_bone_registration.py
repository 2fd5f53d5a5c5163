"""Steps that move bones where images show them."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.correction.bone_images import EdgeFilter
from legsim.correction.bone_registration import (
    BonePoses,
    BonePriors,
    about,
    misfit,
    stepped,
)
from legsim.correction.image_fit import SplinePath
from legsim.opencl.device import Device
from tests.correction.test_bone_images import GEOMETRY, VIEWS, motion, smooth_bone

PRIORS = BonePriors(knots=6, weight=1.0)
EDGES = EdgeFilter(margin=0.0)
STILL = np.tile(np.eye(4), (1, len(VIEWS), 1, 1))


def residual(true: np.ndarray, guess: np.ndarray, device: Device) -> np.ndarray:
    bone = smooth_bone()
    images = (bone.images(GEOMETRY, m, device) for m in (true, guess))
    seen, explained = images
    return EDGES(seen - explained)


def test_the_slopes_are_those_of_the_squared_misfit(device: Device):
    """Of each view by each number, against finite differences: sums of slopes of images."""
    bone, sizes = smooth_bone(), PRIORS.sizes
    guess = motion()
    r = residual(STILL[0], guess, device)
    found = misfit(r, [bone], guess[None], GEOMETRY, EDGES, sizes, device)
    for k in range(6):
        twists = np.zeros((len(VIEWS), 6))
        twists[:, k] = 0.2 * sizes[k]
        costs = [
            0.5
            * (residual(STILL[0], guess @ about(bone.middle, s * twists), device) ** 2).sum((1, 2))
            for s in (1, -1)
        ]
        slope = (costs[0] - costs[1]) / 0.4
        largest = np.abs(found.slopes).max()
        np.testing.assert_allclose(-found.slopes[:, k], slope, atol=0.05 * largest)


def test_steps_halve_the_error_of_a_known_motion_three_times(device: Device):
    """A volume without motion: in pixels, at points of the bone."""
    bone = smooth_bone()
    basis = SplinePath(VIEWS, np.zeros(3), PRIORS.knots).basis()
    drawn = np.random.default_rng(3).standard_normal((PRIORS.knots, 6))
    true = about(bone.middle, basis @ drawn * PRIORS.sizes)
    poses = BonePoses(STILL, np.zeros((PRIORS.knots, 6)))
    points = bone.middle + 0.02 * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, 0]])

    def left(motions: np.ndarray) -> float:
        at = (GEOMETRY.project(transforms.apply(m, points))[0] for m in (motions, true))
        mine, right = at
        return float(np.sqrt(((mine - right) ** 2).sum(-1).mean()))

    before = left(poses.motions[0])
    for _ in range(3):
        r = residual(true, poses.motions[0], device)
        seen = misfit(r, [bone], poses.motions, GEOMETRY, EDGES, PRIORS.sizes, device)
        poses = stepped(poses, seen, [bone.middle], VIEWS, PRIORS)
    assert left(poses.motions[0]) < before / 8
    assert poses.determined > 30


def test_images_that_say_nothing_leave_bones_where_they_were(device: Device):
    bone, nothing = smooth_bone(), np.zeros((len(VIEWS), *GEOMETRY.shape_vu), np.float32)
    seen = misfit(nothing, [bone], STILL, GEOMETRY, EDGES, PRIORS.sizes, device)
    seen.matrices[:] = 0
    found = stepped(
        BonePoses(STILL, np.zeros((PRIORS.knots, 6))), seen, [bone.middle], VIEWS, PRIORS
    )
    np.testing.assert_array_equal(found.motions, STILL)
    assert found.determined == 0
    assert found.last == 0


def test_fewer_views_than_poses_still_move_all(device: Device):
    """One step for half a pixel, within a tenth of a pixel or two."""
    bone = smooth_bone()
    few = GEOMETRY[::2]
    shifted = STILL[0, ::2].copy()
    shifted[:, 1, 3] = 1e-3
    images = (bone.images(few, m, device) for m in (shifted, STILL[0, ::2]))
    seen, explained = images
    found = misfit(EDGES(seen - explained), [bone], STILL[:, ::2], few, EDGES, PRIORS.sizes, device)
    moved = stepped(
        BonePoses(STILL, np.zeros((PRIORS.knots, 6))),
        found,
        [bone.middle],
        VIEWS,
        replace(PRIORS, weight=100.0),
        2,
    )
    assert moved.motions.shape == (1, len(VIEWS), 4, 4)
    middle = transforms.apply(moved.motions[0], bone.middle[None])[:, 0]
    assert middle[:, 1] - bone.middle[1] == pytest.approx(1e-3, rel=0.35)
