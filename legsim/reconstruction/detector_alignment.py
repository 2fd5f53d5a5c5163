"""Images aligned with the axis of rotation before filtering: rows turned to run across it, half-fan
detectors widened.

Filtered images reach beyond the pixels that were measured, and so must the columns that
back-projection reads.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction.source_path import fan_angles, source_arc

# of the detector's width: views whose sides differ by less count each ray as measured twice, as RTK
# does
_LEAST_OFFSET = 0.1


def padding(geometry: ConeBeamGeometry) -> tuple[int, int]:
    """(columns to add before the first, after the last); (0, 0) unless all views of a full turn are
    off to the same side by over a tenth.

    Raises:
        LegsimError: no axis of rotation fits the sources, or the detector does not reach it.
    """
    arc, columns = source_arc(geometry), geometry.shape_vu[1]
    if not arc.full_turn:
        return 0, 0
    u = np.arange(columns + 1, dtype=float) - 0.5
    fans = fan_angles(geometry, arc, u)
    at_axis = np.array(
        [
            np.interp(0.0, *((view, u) if view[-1] > view[0] else (view[::-1], u[::-1])))
            for view in fans
        ]
    )
    before, after = at_axis + 0.5, columns - 0.5 - at_axis
    longer = (after - before) / columns
    if np.abs(longer).min() <= _LEAST_OFFSET or np.ptp(np.sign(longer)) > 0:
        return 0, 0
    short, long = (before, after) if longer[0] > 0 else (after, before)
    if short.min() <= 0:
        raise LegsimError(
            f"view {int(np.argmin(short))}: the detector ends before the axis of rotation, so "
            "nothing near it is measured; "
            "check the offsets of detector and source"
        )
    added = int(
        np.ceil(long.max() - short.min() - 1e-3)
    )  # where the axis is seen is told to a ten-thousandth of a column
    return (added, 0) if longer[0] > 0 else (0, added)


def widened(geometry: ConeBeamGeometry) -> ConeBeamGeometry:
    """The same scan on the detector with the added columns; itself where there are none."""
    before, after = padding(geometry)
    if before + after == 0:
        return geometry
    shift = np.array([[1.0, 0, before], [0, 1, 0], [0, 0, 1]])
    rows, columns = geometry.shape_vu
    return replace(
        geometry, matrices=shift @ geometry.matrices, shape_vu=(rows, columns + before + after)
    )


def padded(projections: Projections) -> Projections:
    """The images as :func:`widened` has the scan, zero in the added columns."""
    before, after = padding(projections.geometry)
    if before + after == 0:
        return projections
    images = np.pad(projections.line_integrals, ((0, 0), (0, 0), (before, after)))
    return Projections(widened(projections.geometry), images)


# rad by which a scan's rows may be off before its images are turned: small tilts cost less than
# interpolation does
_MOST_TILT = np.radians(3.0)


def tilt(geometry: ConeBeamGeometry) -> float:
    """Rad in (-pi/2, pi/2] from the detector's rows to the direction across the axis, in the plane
    of pixels (u to v); a mean of all views.

    Raises:
        LegsimError: no axis of rotation fits the sources.
    """
    along = np.einsum(
        "vji,j->vi", np.linalg.inv(geometry.matrices[:, :, :3]), source_arc(geometry).axis
    )
    # pixels (u, v) that move along (B_v . a, -B_u . a) stay where they are along the axis a; a
    # direction has no sign, hence the doubling
    doubled = np.exp(2j * np.arctan2(-along[:, 0], along[:, 1])).mean()
    return 0.5 * float(np.angle(doubled))


def upright(geometry: ConeBeamGeometry) -> ConeBeamGeometry:
    """The same scan on a detector, large enough, whose rows run across the axis; itself where they
    do so to 3 degrees.
    """
    angle = tilt(geometry)
    if abs(angle) <= _MOST_TILT:
        return geometry
    (rows, columns), shape_vu = geometry.shape_vu, _enclosing(geometry.shape_vu, angle)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    from_middle = np.array([[1, 0, -0.5 * (columns - 1)], [0, 1, -0.5 * (rows - 1)], [0, 0, 1]])
    to_corner = np.array(
        [[1, 0, 0.5 * (shape_vu[1] - 1)], [0, 1, 0.5 * (shape_vu[0] - 1)], [0, 0, 1]]
    )
    return replace(
        geometry, matrices=to_corner @ turn @ from_middle @ geometry.matrices, shape_vu=shape_vu
    )


def stood_up(projections: Projections) -> Projections:
    """The images as :func:`upright` has the scan, interpolated linearly; as they are where that
    changes nothing.
    """
    geometry, stood = projections.geometry, upright(projections.geometry)
    if stood is geometry:
        return projections
    angle = tilt(geometry)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array(
        [[cosine, sine], [-sine, cosine]]
    )  # (v, u) of the detector from (v, u) of the one that stands
    offset = 0.5 * (np.array(geometry.shape_vu) - 1) - turn @ (0.5 * (np.array(stood.shape_vu) - 1))
    homogeneous = np.block([[turn, offset[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    images = np.empty((len(geometry), *stood.shape_vu), np.float32)
    for image, source in zip(images, projections.line_integrals, strict=True):
        ndimage.affine_transform(
            source,
            homogeneous,
            output=image,
            output_shape=stood.shape_vu,
            order=1,
            mode="grid-constant",
        )
    return Projections(stood, images)


def _enclosing(shape_vu: tuple[int, int], angle: float) -> tuple[int, int]:
    extent: FloatArray = np.array(shape_vu) - 1.0
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    rows, columns = np.ceil(np.array([[cosine, sine], [sine, cosine]]) @ extent - 1e-6) + 1
    return int(rows), int(columns)
