"""Views that the detector's edge cuts off nearer to the axis than others: what they show there."""

import warnings

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import Projections
from legsim.reconstruction.detector_alignment import AlignedDetector
from legsim.reconstruction.weights import ShortScanWarning

# share of the views whose nearer edge may cut off the object: beyond, attenuation is off by
# percents
_MOST_CUT_OFF = 0.05

# of a view's largest reading above air: an edge that reads more cuts off the object
_CUT_READING = 0.05

# quantiles of a view that are its air, and its largest reading but for hot pixels; of an edge, its
# largest reading likewise; of all views' readings there, what is no object
_AIR, _BRIGHTEST, _BRIGHT, _IN_NEARLY_ALL = 0.01, 0.999, 0.99, 0.1


def check_cut_off(detector: AlignedDetector, projections: Projections) -> None:
    """Warns (:class:`ShortScanWarning`) of views that the detector's edge cuts off nearer.

    ``projections`` are the scanner's.

    Raises:
        LegsimError: over a twentieth of all views show the object at that edge: weights that count
            lines alike in all views are then wrong.
    """
    views, among = detector.cut_off, len(projections.geometry)
    if not views:
        return
    named = ", ".join(map(str, views[:5])) + (", ..." if len(views) > 5 else "")
    found = (
        f"the detector stands farther to one side in {len(views)} of {among} "
        f"views ({named}): lines that pass the axis at {1e3 * detector.radius:.0f} mm or more are "
        "missing there"
    )
    through = _views_cut_through(detector, projections)
    if through > _MOST_CUT_OFF * among:
        raise LegsimError(
            f"{found}, and {through} of them show the object at that edge; filtered "
            "back-projection weights all views alike: reconstruct by cgls, which takes each view "
            "as it is, or views of one side alone"
        )
    warnings.warn(
        f"{found}, and are estimated; reconstruct by cgls, which takes each view as it is, or "
        "leave these views out",
        ShortScanWarning,
        stacklevel=4,
    )


def _views_cut_through(detector: AlignedDetector, projections: Projections) -> int:
    """How many of the views that are cut off nearer show something at that edge.

    An edge reads what its brightest pixels show more than air does in its view. What it reads in
    nearly all views is no object: edges behind a collimator, noise. Nearer edges are those of at
    most about half of all views.
    """
    images = projections.line_integrals
    turns = np.zeros(len(images)) if detector.turns is None else detector.turns
    air, most = np.stack([_quantiles(image, _AIR, _BRIGHTEST) for image in images], 1)
    readings: dict[tuple[int, int], FloatArray] = {}
    through = 0
    for view, edge in zip(detector.cut_off, detector.cut_edges, strict=True):
        lines = _scanner_lines(turns[view], edge)
        for axis, end in lines:
            if (axis, end) not in readings:
                ends = np.moveaxis(images, axis, 0)[end]
                reading = np.array([_quantiles(line, _BRIGHT)[0] for line in ends]) - air
                readings[axis, end] = reading - np.quantile(reading, _IN_NEARLY_ALL)
        least = _CUT_READING * (most[view] - air[view])
        through += any(readings[line][view] > least for line in lines)
    return through


def _scanner_lines(angle: float, edge: int) -> list[tuple[int, int]]:
    """(axis of the images (v, rows, columns), index) of the scanner's first or last rows or columns
    that lie towards the first (0) or last (-1) column of images turned by ``angle``.

    Both a row and a column where the angle is nearer to 45 degrees than to a multiple of 90.
    """
    outwards = np.array([np.sin(angle), np.cos(angle)]) * (1 if edge else -1)
    return [(1 + k, -1 if out > 0 else 0) for k, out in enumerate(outwards) if abs(out) > 0.4]


def _quantiles(values: Float32Array, *shares: float) -> FloatArray:
    """Quantiles of the values that are finite, each one of them; 0 where none is finite."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return np.zeros(len(shares))
    return np.quantile(finite, np.array(shares), method="lower").astype(float)
