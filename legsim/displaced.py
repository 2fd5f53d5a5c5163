"""Full turns whose detector stands to one side of the axis (half fan): it is made as wide on the short side as on the long one.

Filtered images reach beyond the pixels that were measured, and so must the columns that back-projection reads.
"""

from dataclasses import replace

import numpy as np

from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Projections
from legsim.redundancy import fan_angles, source_arc

# of the detector's width: views whose sides differ by less count each ray as measured twice, as RTK does
_LEAST_OFFSET = 0.1


def padding(geometry: ConeBeamGeometry) -> tuple[int, int]:
    """(columns to add before the first, after the last); (0, 0) unless all views of a full turn are off to the same side by over a tenth.

    Raises:
        LegsimError: no axis of rotation fits the sources, or the detector does not reach it.
    """
    arc, columns = source_arc(geometry), geometry.shape_vu[1]
    if not arc.full_turn:
        return 0, 0
    u = np.arange(columns + 1, dtype=float) - 0.5
    fans = fan_angles(geometry, arc, u)
    at_axis = np.array([np.interp(0.0, *((view, u) if view[-1] > view[0] else (view[::-1], u[::-1]))) for view in fans])
    before, after = at_axis + 0.5, columns - 0.5 - at_axis
    longer = (after - before) / columns
    if np.abs(longer).min() <= _LEAST_OFFSET or np.ptp(np.sign(longer)) > 0:
        return 0, 0
    short, long = (before, after) if longer[0] > 0 else (after, before)
    if short.min() <= 0:
        raise LegsimError(
            f"view {int(np.argmin(short))}: the detector ends before the axis of rotation, so nothing near it is measured; "
            "check the offsets of detector and source"
        )
    added = int(np.ceil(long.max() - short.min() - 1e-3))  # where the axis is seen is told to a ten-thousandth of a column
    return (added, 0) if longer[0] > 0 else (0, added)


def widened(geometry: ConeBeamGeometry) -> ConeBeamGeometry:
    """The same scan on the detector with the added columns; itself where there are none."""
    before, after = padding(geometry)
    if before + after == 0:
        return geometry
    shift = np.array([[1.0, 0, before], [0, 1, 0], [0, 0, 1]])
    rows, columns = geometry.shape_vu
    return replace(geometry, matrices=shift @ geometry.matrices, shape_vu=(rows, columns + before + after))


def padded(projections: Projections) -> Projections:
    """The images as :func:`widened` has the scan, zero in the added columns."""
    before, after = padding(projections.geometry)
    if before + after == 0:
        return projections
    images = np.pad(projections.line_integrals, ((0, 0), (0, 0), (before, after)))
    return Projections(widened(projections.geometry), images)
