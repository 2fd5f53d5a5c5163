"""Detectors aligned with the axis of rotation: rows turned across it, half fans widened.

Filtered images reach beyond the pixels that were measured, and so must the columns that
back-projection reads.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction.source_path import SourceArc, fan_angles, source_arc

# of the detector's width: views whose sides differ by less count each ray as measured twice, as RTK
# does
_LEAST_OFFSET = 0.1

# rad by which a scan's rows may be off before its images are turned: small tilts cost less than
# interpolation does
_MOST_TILT = np.radians(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class AlignedDetector:
    """The detector that FDK works on, and how the scanner's images get onto it."""

    geometry: ConeBeamGeometry
    """the same scan on that detector; the scanner's own where nothing changes"""
    tilt: float
    """rad in (-pi/2, pi/2] from the scanner's rows to the direction across the axis"""
    turned_shape_vu: tuple[int, int] | None
    """(rows, columns) of the turned images before columns are added; None: images are not turned"""
    added: tuple[int, int]
    """columns without a measurement before the first column, and after the last"""

    def apply(self, projections: Projections) -> Projections:
        """The scanner's images on this detector.

        Turned images are interpolated linearly, added columns are zero. Returns ``projections``
        where nothing changes.
        """
        if self.turned_shape_vu is None and not any(self.added):
            return projections
        images = projections.line_integrals
        if self.turned_shape_vu is not None:
            images = _turned_images(images, self.tilt, self.turned_shape_vu)
        if any(self.added):
            images = np.pad(images, ((0, 0), (0, 0), self.added))
        return Projections(self.geometry, images)


def align(geometry: ConeBeamGeometry) -> AlignedDetector:
    """Finds how a scan's detector is aligned with its axis of rotation.

    Images are turned where rows are off by over 3 degrees. Columns are added where all views are
    off to the same side by over a tenth of the width (half fan).

    Raises:
        LegsimError: no axis of rotation fits the sources, or a detector does not reach the axis.
    """
    arc = source_arc(geometry)
    tilt = _tilt(geometry, arc)
    turned = _turned(geometry, tilt) if abs(tilt) > _MOST_TILT else geometry
    added = _missing_columns(turned, arc)
    shape_vu = None if turned is geometry else turned.shape_vu
    return AlignedDetector(_widened(turned, added), tilt, shape_vu, added)


def _tilt(geometry: ConeBeamGeometry, arc: SourceArc) -> float:
    """Rad from the rows to the direction across the axis, from u to v: a mean of all views."""
    along = np.einsum("vji,j->vi", np.linalg.inv(geometry.matrices[:, :, :3]), arc.axis)
    # pixels (u, v) that move along (B_v . a, -B_u . a) stay where they are along the axis a; a
    # direction has no sign, hence the doubling
    doubled = np.exp(2j * np.arctan2(-along[:, 0], along[:, 1])).mean()
    return 0.5 * float(np.angle(doubled))


def _turned(geometry: ConeBeamGeometry, angle: float) -> ConeBeamGeometry:
    """The same scan on a detector, large enough, whose rows are turned by ``angle``."""
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


def _enclosing(shape_vu: tuple[int, int], angle: float) -> tuple[int, int]:
    """(rows, columns) of the least detector turned by ``angle`` that holds all pixel centers."""
    extent: FloatArray = np.array(shape_vu) - 1.0
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    rows, columns = np.ceil(np.array([[cosine, sine], [sine, cosine]]) @ extent - 1e-6) + 1
    return int(rows), int(columns)


def _turned_images(sources: Float32Array, angle: float, shape_vu: tuple[int, int]) -> Float32Array:
    """Images (v, *shape_vu) on the detector of :func:`_turned`."""
    cosine, sine = np.cos(angle), np.sin(angle)
    # (v, u) of the scanner's detector from (v, u) of the turned one
    turn = np.array([[cosine, sine], [-sine, cosine]])
    middle = 0.5 * (np.array(sources.shape[1:]) - 1)
    offset = middle - turn @ (0.5 * (np.array(shape_vu) - 1))
    homogeneous = np.block([[turn, offset[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    images = np.empty((len(sources), *shape_vu), np.float32)
    for image, source in zip(images, sources, strict=True):
        ndimage.affine_transform(
            source,
            homogeneous,
            output=image,
            output_shape=shape_vu,
            order=1,
            mode="grid-constant",
        )
    return images


def _missing_columns(geometry: ConeBeamGeometry, arc: SourceArc) -> tuple[int, int]:
    """(columns to add before the first, after the last), so that the axis is seen in the middle."""
    columns = geometry.shape_vu[1]
    at_axis = _columns_at_axis(geometry, arc)
    before, after = at_axis + 0.5, columns - 0.5 - at_axis
    nearer = np.minimum(before, after)
    if nearer.min() <= 0:
        raise LegsimError(
            f"view {int(np.argmin(nearer))}: the detector ends before the axis of rotation, so "
            "nothing near it is measured; check the offsets of detector and source, and "
            "the sense of rotation"
        )
    longer = (after - before) / columns
    if np.abs(longer).min() <= _LEAST_OFFSET or np.ptp(np.sign(longer)) > 0:
        return 0, 0
    # the axis is found in the images to a ten-thousandth of a column
    added = int(np.ceil(np.maximum(before, after).max() - nearer.min() - 1e-3))
    return (added, 0) if longer[0] > 0 else (0, added)


def _columns_at_axis(geometry: ConeBeamGeometry, arc: SourceArc) -> FloatArray:
    """(v,) column, with its fraction, whose ray meets the axis."""
    u = np.arange(geometry.shape_vu[1] + 1, dtype=float) - 0.5
    fans = fan_angles(geometry, arc, u)
    ascending = ((fan, u) if fan[-1] > fan[0] else (fan[::-1], u[::-1]) for fan in fans)
    return np.array([np.interp(0.0, fan, at) for fan, at in ascending])


def _widened(geometry: ConeBeamGeometry, added: tuple[int, int]) -> ConeBeamGeometry:
    """The same scan on the detector with the added columns; itself where there are none."""
    if not any(added):
        return geometry
    shift = np.array([[1.0, 0, added[0]], [0, 1, 0], [0, 0, 1]])
    rows, columns = geometry.shape_vu
    return replace(
        geometry, matrices=shift @ geometry.matrices, shape_vu=(rows, columns + sum(added))
    )
