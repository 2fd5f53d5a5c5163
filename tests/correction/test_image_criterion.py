"""Sharpness of a box along a motion: exact slopes, least where the motion is right."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import image_criterion
from legsim.correction.image_criterion import COARSE, FINE, Focus, binned, focus
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.opencl.device import Device
from tests.examples.knee_scan import GEOMETRY, VIEWS, motion_of, scanned
from tests.references.sway import Sway

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
TRUE = motion_of(Sway.standing(4, position_mm=1.5, angle_deg=0.4))
STILL = RigidMotion.identity(VIEWS).moved_from_reference


@pytest.fixture(scope="module")
def sharpness() -> Focus:
    from legsim.opencl.device import open_device

    return focus(scanned(TRUE), STILL, COARSE, open_device())


def twisted(twists: np.ndarray) -> np.ndarray:
    turn = transforms.rotation_from_vector(twists[:, :3])
    return transforms.rigid(turn, twists[:, 3:]) @ TRUE.moved_from_reference


def test_slopes_are_finite_differences(sharpness: Focus, rng: np.random.Generator) -> None:
    """Of slow twists of all kinds, steps along the rays among them.

    To what interpolation roughens pixels of 1.6 mm by.
    """
    _, slopes = sharpness(TRUE.moved_from_reference)
    phase = (VIEWS / VIEWS[-1])[:, None]
    for _ in range(3):
        slow = np.sin(3 * phase + rng.uniform(0, 6, 6)) * [1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4]
        step = 0.05
        by_step = (twisted(1e-3 * slow) - twisted(-1e-3 * slow)) / 2e-3
        found = float((slopes * by_step).sum())
        ends = [sharpness(twisted(k * step * slow))[0] for k in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert found == pytest.approx(expected, rel=0.06, abs=2e-5)


def test_the_true_motion_is_sharpest(sharpness: Focus) -> None:
    best, _ = sharpness(TRUE.moved_from_reference)
    assert sharpness(STILL)[0] > best + 0.01
    bent = ((VIEWS / VIEWS[-1]) ** 2)[:, None] * [0, 0, 0, 1.0, 0.5, 1.0]
    assert min(sharpness(twisted(k * 2e-3 * bent))[0] for k in (1, -1)) > best + 1e-3


def test_the_same_images_give_the_same_digits(sharpness: Focus) -> None:
    again = sharpness.of(scanned(TRUE))
    for a, b in zip(sharpness(STILL), again(STILL), strict=True):
        np.testing.assert_array_equal(a, b)


def test_voxels_that_count_are_near_the_leg_and_seen(sharpness: Focus) -> None:
    mask = sharpness.criterion.mask
    points = transforms.apply(sharpness.world_from_box, sharpness.grid.positions())[mask.ravel()]
    below = GEOMETRY.rotation_center()[1] - points[:, 1]
    assert below.min() > -0.04
    pixels = GEOMETRY.project(points)[0]
    assert pixels.min() > 0
    assert (pixels.max((0, 1)) < np.array(GEOMETRY.shape_vu[::-1]) - 1).all()
    assert 0.2 < mask.mean() < 0.9


@pytest.mark.parametrize("voxel", [1.6e-3, 1e-3])
def test_what_counts_reaches_five_millimeters_into_the_air(voxel: float) -> None:
    """To a voxel, along an axis, whatever the size of the voxels."""
    volume = np.zeros((40, 40, 40), np.float32)
    volume[12:28, 12:28, 12:28] = 20.0
    mask = image_criterion.near_leg(volume, voxel)
    reach = 12 - int(np.flatnonzero(mask[:, 20, 20])[0])
    assert reach == pytest.approx(5e-3 / voxel, abs=1)


def test_without_a_leg_it_says_so(device: Device) -> None:
    empty = Projections(GEOMETRY, np.zeros((len(VIEWS), *GEOMETRY.shape_vu), np.float32))
    with pytest.raises(LegsimError, match=r"only 0 voxels of 1\.6 mm below"):
        focus(empty, STILL, FINE, device)
    with pytest.raises(LegsimError, match=r"voxels of 2\.5 mm above"):
        focus(empty, STILL, COARSE, device, below=False)


def test_fine_pixels_are_averaged() -> None:
    """A pixel has 1.6 mm at the isocenter here: it is left alone until it is parted."""
    images = scanned(TRUE)
    assert binned(images) is images
    fine = GEOMETRY.finer(4)
    parted = Projections(fine, np.kron(images.line_integrals, np.ones((1, 4, 4), np.float32)))
    assert binned(parted).geometry.shape_vu == GEOMETRY.finer(2).shape_vu
