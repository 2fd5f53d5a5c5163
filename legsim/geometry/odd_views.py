"""Views that a scanner does not take: dropped ones, copies, and images without air."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import Float32Array
from legsim.geometry.counts import THICKEST

_NAMED = 5
"""views that are named; of more their number is"""

_NO_AIR = 0.5
"""line integral above which the thinnest ray of a scan passes an object, not air"""

_FEW_LEVELS = 256
"""different readings of images of 8 bits"""


def objections(values: Float32Array, *, by_reading: bool) -> tuple[str, ...]:
    """Lines on line integrals (v, rows, columns) that are doubtful, with the fix.

    Args:
        values: line integrals.
        by_reading: whether they are of counts by a reading without an object (i0 or a flat field).
    """
    constant = np.flatnonzero(values.min((1, 2)) == values.max((1, 2)))
    if len(constant) == len(values):
        return ("every view has one value throughout, so that nothing was scanned",)
    found = []
    if len(constant):
        found.append(
            f"{_named(constant)} one value throughout: if the scanner dropped them, take them out "
            "of images, geometry and times"
        )
    same = [k for k in range(1, len(values)) if np.array_equal(values[k], values[k - 1])]
    same = [k for k in same if k not in set(constant.tolist())]
    if same:
        found.append(
            f"{_named(same)} the same image as the one before: if the scanner repeated them, take "
            "them out of images, geometry and times"
        )
    thin, thick = float(values.min()), float(values.max())
    if by_reading and thin > _NO_AIR:
        found.append(
            f"no pixel of any view has a line integral below {thin:.2g}: where some see air, the "
            f"reading without an object is {np.exp(thin):.2g} times too large"
        )
    if thick > THICKEST and (values > THICKEST).mean() > 1e-3:
        found.append(
            f"line integrals go up to {thick:.4g}, but no body reaches {THICKEST:g}: the volume "
            "is not in 1/mm"
        )
    return tuple(found)


def coarse(images: NDArray) -> tuple[str, ...]:
    """A line on counts of 8 bits, in which dense parts have few levels."""
    if images.dtype.kind not in "iu" or np.ptp(images.astype(np.int64, copy=False)) >= _FEW_LEVELS:
        return ()
    least = max(1, int(images.min()))
    step = np.log1p(1 / least)
    return (
        f"the images have {_FEW_LEVELS} levels of gray at most: where they are darkest, one level "
        f"is {step:.2g} of a line integral; export 16 bits if the scanner has them",
    )


def _named(views: Sequence[int] | NDArray) -> str:
    if len(views) == 1:
        return f"view {views[0]} has"
    if len(views) <= _NAMED:
        return f"views {', '.join(map(str, views))} have"
    return f"{len(views)} views from {views[0]} to {views[-1]} have"
