"""Pixels that read nothing, are saturated or never change, and what stands in for them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from legsim.core.values import FloatArray

_STUCK = 0.1
"""share by which a pixel that never changes must differ from its neighbors to be called stuck"""

_ALONE = 0.4
"""share of 5 x 5 pixels that never change from which on they are no defect"""

_NEIGHBORS = np.array([[1.0, 2.0, 1.0], [2.0, 0.0, 2.0], [1.0, 2.0, 1.0]])
"""weights of the neighbors that stand in for a pixel"""


@dataclass(frozen=True, slots=True, eq=False)
class BadPixels:
    """What is wrong in all views, and from which reading on a pixel is saturated."""

    always: NDArray[np.bool_]
    """(rows, columns)"""
    given: int
    dead: int
    stuck: int
    saturation: float
    """a reading; infinity where none is known"""

    def notes(self, single: int, views: int) -> tuple[str, ...]:
        """Lines for people; ``single`` pixels more were bad in single ones of ``views``."""
        lines = []
        if self.always.any():
            lines.append(
                f"{self.always.sum()} bad pixels interpolated in all views: {self.given} given, "
                f"{self.dead} dead, {self.stuck} stuck"
            )
        if single:
            lines.append(
                f"{single} pixels that read nothing or are saturated in single views interpolated "
                f"({100 * single / (views * self.always.size):.2g} % of all)"
            )
        return tuple(lines)


def find(
    images: NDArray, dark: FloatArray, reference: FloatArray, given: NDArray[np.bool_] | None
) -> BadPixels:
    """Finds what is bad in all of images (v, rows, columns).

    Dead pixels read nothing in the reference (rows, columns; dark subtracted) or in all views;
    stuck ones have the same reading in all views, far from their neighbors' median.
    """
    known = np.zeros(dark.shape, bool) if given is None else np.asarray(given, bool)
    dead = ~np.isfinite(reference) | (reference <= 0) | (images.max(0) - dark <= 0)
    stuck = _stuck(images) & ~dead if len(images) > 1 else np.zeros_like(dead)
    return BadPixels(
        known | dead | stuck,
        int(known.sum()),
        int((dead & ~known).sum()),
        int((stuck & ~known).sum()),
        _saturation(images),
    )


def _stuck(images: NDArray) -> NDArray[np.bool_]:
    constant = images.max(0) == images.min(0)
    if not constant.any():
        return constant
    middle = images[len(images) // 2].astype(float)
    apart = np.abs(middle - ndimage.median_filter(middle, 5)) > _STUCK * np.abs(middle)
    # air without noise never changes either, but its neighbors do not
    alone = ndimage.uniform_filter(constant.astype(float), 5) < _ALONE
    return constant & apart & alone


def _saturation(images: NDArray) -> float:
    """The reading that whole numbers of a detector's bits end at, where the images reach it."""
    if images.dtype.kind not in "iu":
        return np.inf
    highest = int(images.max())
    ends = {2**bits - 1 for bits in (8, 10, 12, 14, 16)} | {int(np.iinfo(images.dtype).max)}
    return float(highest) if highest in ends else np.inf


def interpolated(image: FloatArray, wrong: NDArray[np.bool_]) -> FloatArray:
    """An image (rows, columns) whose wrong pixels are weighted means of their good neighbors.

    Wide gaps are filled from their edges inwards. A plane is filled without error where good
    neighbors stand on opposite sides.
    """
    if not wrong.any():
        return image
    filled, missing = np.where(wrong, 0.0, image), wrong.copy()
    while missing.any():
        known = (~missing).astype(float)
        weights = ndimage.convolve(known, _NEIGHBORS, mode="constant")
        sums = ndimage.convolve(filled * known, _NEIGHBORS, mode="constant")
        now = missing & (weights > 0)
        if not now.any():
            break
        filled[now] = sums[now] / weights[now]
        missing &= ~now
    return filled
