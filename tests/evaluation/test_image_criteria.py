"""Criteria of sharpness: their slopes are finite differences, their value that of the measure."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from legsim.core.errors import LegsimError
from legsim.evaluation.image_criteria import GradientEntropy
from legsim.evaluation.similarity import gradient_entropy

SHAPE = (9, 11, 13)


def drawn(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A volume in 1/m and a ragged mask that reaches the border."""
    volume = 20 * gaussian_filter(rng.normal(0, 1, SHAPE), 0.7)
    return volume.astype(np.float32), rng.random(SHAPE) < 0.7


def test_slopes_are_finite_differences(rng: np.random.Generator) -> None:
    volume, mask = drawn(rng)
    criterion = GradientEntropy(mask)
    # values that single precision holds, so that differences have no rounding of their own
    volume = np.round(volume * 256) / np.float32(256)
    _, slopes = criterion(volume)
    step, error = np.float32(1 / 64), 2e-4 * float(np.abs(slopes).max())
    for voxel in rng.integers(0, SHAPE, (60, 3)):
        change = np.zeros(SHAPE, np.float32)
        change[tuple(voxel)] = step
        difference = (criterion(volume + change)[0] - criterion(volume - change)[0]) / (2 * step)
        assert slopes[tuple(voxel)] == pytest.approx(difference, abs=error)


def test_without_a_floor_it_is_the_measure_of_the_scores(rng: np.random.Generator) -> None:
    volume, mask = drawn(rng)
    value, _ = GradientEntropy(mask, 1e-6)(volume)
    assert value == pytest.approx(gradient_entropy(volume, mask), abs=1e-6)


def test_the_floor_is_added_to_each_difference_in_squares(rng: np.random.Generator) -> None:
    volume, mask = drawn(rng)
    floor = 5.0
    value, _ = GradientEntropy(mask, floor)(volume)
    z, y, x = (np.roll(volume, -1, axis) - np.roll(volume, 1, axis) for axis in range(3))
    sizes = np.sqrt(np.square([z, y, x], dtype=float).sum(0) + floor**2)[1:-1, 1:-1, 1:-1]
    shares = sizes[mask[1:-1, 1:-1, 1:-1]]
    shares /= shares.sum()
    assert value == pytest.approx(-(shares * np.log(shares)).sum(), abs=1e-9)


def test_the_same_everywhere_is_the_logarithm_of_the_count() -> None:
    value, slopes = GradientEntropy(np.ones(SHAPE, bool))(np.full(SHAPE, 7.0, np.float32))
    assert value == pytest.approx(np.log(7 * 9 * 11))
    assert not slopes.any()


def test_blur_raises_it_and_an_offset_does_not_change_it(rng: np.random.Generator) -> None:
    box = np.zeros((20, 20, 20), np.float32)
    box[6:14, 6:14, 6:14] = 40
    criterion = GradientEntropy(np.ones(box.shape, bool))
    values = [criterion(gaussian_filter(box, sigma))[0] for sigma in (0.0, 0.7, 1.4)]
    assert values[0] < values[1] < values[2]
    assert criterion(box + 64)[0] == pytest.approx(values[0], abs=1e-9)


def test_refusals(rng: np.random.Generator) -> None:
    volume, mask = drawn(rng)
    with pytest.raises(LegsimError, match="no voxel within the border"):
        GradientEntropy(np.zeros(SHAPE, bool))
    with pytest.raises(LegsimError, match="floor is 0"):
        GradientEntropy(mask, 0.0)
    with pytest.raises(LegsimError, match=r"the volume is \(8, 11, 13\)"):
        GradientEntropy(mask)(volume[1:])
