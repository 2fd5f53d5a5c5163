"""Bad pixels: which are found, and that a plane is filled without error."""

import numpy as np
import pytest

from legsim.geometry import bad_pixels


def views(rng, count=5, shape=(20, 30)):
    """Counts of a smooth object that moves, with noise."""
    u, v = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    shadow = np.stack([np.exp(-((u - 10 - 2 * k) ** 2 + (v - 9) ** 2) / 60) for k in range(count)])
    return rng.poisson(20000 * np.exp(-2 * shadow)).astype(np.uint16)


def test_dead_and_stuck_pixels_are_found_and_no_others(rng):
    images = views(rng)
    images[:, 3, 4] = 0
    images[:, 7, 8] = 9000
    dark, reference = np.zeros((20, 30)), np.full((20, 30), 2e4)
    reference[11, 12] = 0
    given = np.zeros((20, 30), bool)
    given[15, 15] = True
    found = bad_pixels.find(images, dark, reference, given)
    assert {tuple(p) for p in np.argwhere(found.always)} == {(3, 4), (7, 8), (11, 12), (15, 15)}
    assert (found.given, found.dead, found.stuck) == (1, 2, 1)
    assert "4 bad pixels interpolated in all views: 1 given, 2 dead, 1 stuck" in found.notes(0, 5)


def test_air_without_noise_is_not_stuck():
    """The views of a centered ball are all alike."""
    images = np.full((6, 20, 30), 20000, np.uint16)
    images[:, 5:15, 8:22] = 4000
    nothing = np.zeros((20, 30))
    assert not bad_pixels.find(images, nothing, nothing + 2e4, None).always.any()


@pytest.mark.parametrize(("top", "ends"), [(4095, True), (65535, True), (30000, False)])
def test_the_end_of_a_detectors_bits_is_saturation(top, ends):
    images = np.array([[[top, 5], [7, 9]]] * 2, np.uint16)
    found = bad_pixels.find(images, np.zeros((2, 2)), np.ones((2, 2)), None)
    assert found.saturation == (top if ends else np.inf)


@pytest.mark.parametrize(
    "wrong", [[(5, 5)], [(5, k) for k in range(1, 11)], [(k, 6) for k in range(1, 9)]]
)
def test_a_plane_is_filled_without_error(wrong):
    u, v = np.meshgrid(np.arange(12.0), np.arange(10.0))
    plane, mask = 0.3 + 0.2 * u - 0.1 * v, np.zeros((10, 12), bool)
    mask[tuple(np.transpose(wrong))] = True
    filled = bad_pixels.interpolated(np.where(mask, np.nan, plane), mask)
    inner = np.s_[2:-2, 2:-2]
    np.testing.assert_allclose(filled[inner], plane[inner], atol=1e-12)
    np.testing.assert_array_equal(filled[~mask], plane[~mask])


def test_a_wide_gap_is_filled_from_its_edges():
    image, mask = np.full((20, 20), 2.0), np.zeros((20, 20), bool)
    mask[4:14, 5:12] = True
    filled = bad_pixels.interpolated(np.where(mask, np.nan, image), mask)
    np.testing.assert_allclose(filled, image)
