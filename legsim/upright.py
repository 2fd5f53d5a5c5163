"""Images whose rows run across the axis of rotation, along which FDK filters: turned in their plane where they do not."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from legsim.arrays import FloatArray
from legsim.geometry import ConeBeamGeometry, Projections
from legsim.redundancy import source_arc

# rad by which a scan's rows may be off before its images are turned: small tilts cost less than interpolation does
_MOST_TILT = np.radians(3.0)


def tilt(geometry: ConeBeamGeometry) -> float:
    """Rad in (-pi/2, pi/2] from the detector's rows to the direction across the axis, in the plane of pixels (u to v); a mean of all views.

    Raises:
        LegsimError: no axis of rotation fits the sources.
    """
    along = np.einsum("vji,j->vi", np.linalg.inv(geometry.matrices[:, :, :3]), source_arc(geometry).axis)
    # pixels (u, v) that move along (B_v . a, -B_u . a) stay where they are along the axis a; a direction has no sign, hence the doubling
    doubled = np.exp(2j * np.arctan2(-along[:, 0], along[:, 1])).mean()
    return 0.5 * float(np.angle(doubled))


def upright(geometry: ConeBeamGeometry) -> ConeBeamGeometry:
    """The same scan on a detector, large enough, whose rows run across the axis; itself where they do so to 3 degrees."""
    angle = tilt(geometry)
    if abs(angle) <= _MOST_TILT:
        return geometry
    (rows, columns), shape_vu = geometry.shape_vu, _enclosing(geometry.shape_vu, angle)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    from_middle = np.array([[1, 0, -0.5 * (columns - 1)], [0, 1, -0.5 * (rows - 1)], [0, 0, 1]])
    to_corner = np.array([[1, 0, 0.5 * (shape_vu[1] - 1)], [0, 1, 0.5 * (shape_vu[0] - 1)], [0, 0, 1]])
    return replace(geometry, matrices=to_corner @ turn @ from_middle @ geometry.matrices, shape_vu=shape_vu)


def stood_up(projections: Projections) -> Projections:
    """The images as :func:`upright` has the scan, interpolated linearly; as they are where that changes nothing."""
    geometry, stood = projections.geometry, upright(projections.geometry)
    if stood is geometry:
        return projections
    angle = tilt(geometry)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine], [-sine, cosine]])  # (v, u) of the detector from (v, u) of the one that stands
    offset = 0.5 * (np.array(geometry.shape_vu) - 1) - turn @ (0.5 * (np.array(stood.shape_vu) - 1))
    homogeneous = np.block([[turn, offset[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    images = np.empty((len(geometry), *stood.shape_vu), np.float32)
    for image, source in zip(images, projections.line_integrals, strict=True):
        ndimage.affine_transform(source, homogeneous, output=image, output_shape=stood.shape_vu, order=1, mode="grid-constant")
    return Projections(stood, images)


def _enclosing(shape_vu: tuple[int, int], angle: float) -> tuple[int, int]:
    extent: FloatArray = np.array(shape_vu) - 1.0
    cosine, sine = abs(np.cos(angle)), abs(np.sin(angle))
    rows, columns = np.ceil(np.array([[cosine, sine], [sine, cosine]]) @ extent - 1e-6) + 1
    return int(rows), int(columns)
