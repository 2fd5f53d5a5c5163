"""Detectors aligned with the axis of rotation: rows turned across it, half fans widened.

Filtered images reach beyond the pixels that were measured, and so must the columns that
back-projection reads.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
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

# rad by which a view's rows may be off the mean of all views before each is turned by itself:
# attenuation is then off by a percent
_MOST_APART = np.radians(8.0)


@dataclass(frozen=True, slots=True, eq=False)
class AlignedDetector:
    """The detector that FDK works on, and how the scanner's images get onto it."""

    geometry: ConeBeamGeometry
    """the same scan on that detector; the scanner's own where nothing changes"""
    tilt: float
    """rad in (-pi/2, pi/2] from the scanner's rows to the direction across the axis, a mean of all
    views
    """
    turns: FloatArray | None
    """(v,) rad by which each view's rows are turned; None: images are not turned"""
    turned_shape_vu: tuple[int, int]
    """(rows, columns) of the images before columns are added"""
    added: tuple[int, int]
    """columns without a measurement before the first column, and after the last"""
    from_scanner: FloatArray
    """(v, 3, 3) homographies from the scanner's pixels to those of ``geometry``"""
    cut_off: tuple[int, ...]
    """views whose edge is nearer to the axis than others' by over a tenth of the width: the longer
    side's of a half fan, else the nearer one
    """
    cut_edges: tuple[int, ...]
    """that edge of each of these views: 0 is the first column, -1 the last"""
    radius: float
    """m from the axis to the nearest of these edges"""

    def apply(self, projections: Projections) -> Projections:
        """The scanner's images on this detector.

        Turned images are interpolated linearly, added columns are zero. Returns ``projections``
        where nothing changes.
        """
        if self.turns is None and not any(self.added):
            return projections
        images = projections.line_integrals
        if self.turns is not None:
            images = _turned_images(images, self.turns, self.turned_shape_vu)
        if any(self.added):
            images = np.pad(images, ((0, 0), (0, 0), self.added))
        return Projections(self.geometry, images)

    def unmeasured(self, scanner_shape_vu: tuple[int, int]) -> NDArray[np.intp] | None:
        """(v, rows, 2) columns before a row's first measurement, and after its last.

        None where all rows are measured alike, but for the added columns. A row without any has all
        its columns before the first.
        """
        if self.turns is None:
            return None
        found = np.empty((len(self.turns), self.turned_shape_vu[0], 2), np.intp)
        same: dict[float, NDArray[np.intp]] = {}
        for view, turn in enumerate(self.turns.tolist()):
            if turn not in same:
                same[turn] = _row_gaps(turn, scanner_shape_vu, self.turned_shape_vu)
            found[view] = same[turn]
        return found + self.added if found.any() else None


def align(geometry: ConeBeamGeometry, seen: ConeBeamGeometry | None = None) -> AlignedDetector:
    """Finds how a scan's detector is aligned with its axis of rotation.

    Images are turned where rows are off by over 3 degrees, each by its own angle where one differs
    from the mean by over 8 degrees. Columns are added where views are off to one side by over a
    tenth of the width, in the median (half fan).

    ``seen`` is the scan as the object saw it. Its axis counts where the scanner has none: where the
    object turned. Elsewhere the scanner's own counts, however far a motion has drifted.

    Raises:
        LegsimError: no axis of rotation fits the sources, or a detector does not reach the axis.
    """
    path = geometry
    try:
        arc = source_arc(path)
    except LegsimError:
        if seen is None:
            raise
        path = seen
        arc = source_arc(path)
    tilt, turns = _turns(path, arc)
    shape_vu, homographies = geometry.shape_vu, np.tile(np.eye(3), (len(geometry), 1, 1))
    if turns is not None:
        shape_vu = _enclosing(geometry.shape_vu, turns)
        homographies = _turning(geometry.shape_vu, shape_vu, turns)
        path = replace(path, matrices=homographies @ path.matrices, shape_vu=shape_vu)
    added, cut_off, edges, radius = _missing_columns(path, arc)
    cut = cut_off, edges, radius
    if turns is None and not any(added):
        return AlignedDetector(geometry, tilt, None, shape_vu, added, homographies, *cut)
    homographies = np.array([[1.0, 0, added[0]], [0, 1, 0], [0, 0, 1]]) @ homographies
    aligned = replace(
        geometry,
        matrices=homographies @ geometry.matrices,
        shape_vu=(shape_vu[0], shape_vu[1] + sum(added)),
    )
    return AlignedDetector(aligned, tilt, turns, shape_vu, added, homographies, *cut)


def _turns(geometry: ConeBeamGeometry, arc: SourceArc) -> tuple[float, FloatArray | None]:
    """(rad from the rows to the direction across the axis, from u to v: a mean of all views; by
    which each view's rows are to be turned, (v,), None where they are near enough).
    """
    along = np.einsum("vji,j->vi", np.linalg.inv(geometry.matrices[:, :, :3]), arc.axis)
    # pixels (u, v) that move along (B_v . a, -B_u . a) stay where they are along the axis a; a
    # direction has no sign, hence the doubling
    doubled = np.exp(2j * np.arctan2(-along[:, 0], along[:, 1]))
    mean = doubled.mean()
    tilt = 0.5 * float(np.angle(mean))
    others = 0.5 * np.angle(doubled * np.conj(mean))
    if np.abs(others).max() > _MOST_APART:
        return tilt, tilt + others
    return tilt, np.full(len(geometry), tilt) if abs(tilt) > _MOST_TILT else None


def _turning(
    shape_vu: tuple[int, int], turned_vu: tuple[int, int], angles: FloatArray
) -> FloatArray:
    """(v, 3, 3) from pixels to those of a detector whose rows are turned by angles (v,)."""
    (rows, columns), cosine, sine = shape_vu, np.cos(angles), np.sin(angles)
    turn = np.tile(np.eye(3), (len(angles), 1, 1))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cosine, sine, -sine, cosine
    from_middle = np.array([[1, 0, -0.5 * (columns - 1)], [0, 1, -0.5 * (rows - 1)], [0, 0, 1]])
    to_corner = np.array(
        [[1, 0, 0.5 * (turned_vu[1] - 1)], [0, 1, 0.5 * (turned_vu[0] - 1)], [0, 0, 1]]
    )
    return to_corner @ turn @ from_middle


def _enclosing(shape_vu: tuple[int, int], angles: FloatArray) -> tuple[int, int]:
    """(rows, columns) of the least detector that holds all pixel centers, turned by any angle."""
    extent: FloatArray = np.array(shape_vu) - 1.0
    cosine, sine = np.abs(np.cos(angles)), np.abs(np.sin(angles))
    sizes = np.stack([cosine, sine, sine, cosine], -1).reshape(-1, 2, 2) @ extent
    rows, columns = np.ceil(sizes.max(0) - 1e-6) + 1
    return int(rows), int(columns)


def _to_scanner(
    angle: float, scanner_vu: tuple[int, int], turned_vu: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """(2, 2) and (2,) from (v, u) of the turned detector to that of the scanner's."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    middle = 0.5 * (np.array(scanner_vu) - 1)
    return turn, middle - turn @ (0.5 * (np.array(turned_vu) - 1))


def _turned_images(
    sources: Float32Array, angles: FloatArray, shape_vu: tuple[int, int]
) -> Float32Array:
    """Images (v, *shape_vu) whose rows are turned by angles (v,)."""
    images = np.empty((len(sources), *shape_vu), np.float32)
    for image, source, angle in zip(images, sources, angles, strict=True):
        turn, offset = _to_scanner(angle, source.shape, shape_vu)
        ndimage.affine_transform(
            source,
            np.block([[turn, offset[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]]),
            output=image,
            output_shape=shape_vu,
            order=1,
            mode="grid-constant",
        )
    return images


def _row_gaps(
    angle: float, scanner_vu: tuple[int, int], turned_vu: tuple[int, int]
) -> NDArray[np.intp]:
    """(rows, 2) columns of a turned image before a row's first measurement, and after its last."""
    turn, offset = _to_scanner(angle, scanner_vu, turned_vu)
    places = np.moveaxis(np.indices(turned_vu), 0, -1) @ turn.T + offset
    slack = 1e-6
    last = np.array(scanner_vu) - 1 + slack
    measured: NDArray[np.bool_] = np.all((places >= -slack) & (places <= last), axis=-1)
    gaps = np.stack([measured.argmax(1), measured[:, ::-1].argmax(1)], -1)
    gaps[~measured.any(1)] = turned_vu[1], 0
    return gaps


def _missing_columns(
    geometry: ConeBeamGeometry, arc: SourceArc
) -> tuple[tuple[int, int], tuple[int, ...], tuple[int, ...], float]:
    """((columns to add before the first, after the last), so that the axis is seen in the middle;
    views that are cut off nearer to it than others, their edges, and m from it to there).
    """
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
    usual = float(np.median(longer))
    if abs(usual) <= _LEAST_OFFSET:
        seen, most = nearer, min(np.median(before), np.median(after))
        edges = np.where(before < after, 0, -1)
    else:
        seen = after if usual > 0 else before
        most = np.median(seen)
        edges = np.full(len(seen), -1 if usual > 0 else 0)
    cut_off = np.flatnonzero(seen < most - _LEAST_OFFSET * columns)
    cut, cut_edges = tuple(cut_off.tolist()), tuple(edges[cut_off].tolist())
    radius = float(seen.min() * np.mean(arc.radii / geometry.focal_lengths()))
    if abs(usual) <= _LEAST_OFFSET:
        return (0, 0), cut, cut_edges, radius
    off = longer * np.sign(usual) > _LEAST_OFFSET
    # the axis is found in the images to a ten-thousandth of a column
    added = int(np.ceil(np.maximum(before, after)[off].max() - nearer[off].min() - 1e-3))
    return (added, 0) if usual > 0 else (0, added), cut, cut_edges, radius


def _columns_at_axis(geometry: ConeBeamGeometry, arc: SourceArc) -> FloatArray:
    """(v,) column, with its fraction, whose ray meets the axis."""
    u = np.arange(geometry.shape_vu[1] + 1, dtype=float) - 0.5
    fans = fan_angles(geometry, arc, u)
    ascending = ((fan, u) if fan[-1] > fan[0] else (fan[::-1], u[::-1]) for fan in fans)
    return np.array([np.interp(0.0, fan, at) for fan, at in ascending])
