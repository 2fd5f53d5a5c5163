"""Cone-beam geometry and projections.

Every view is one 3x4 matrix from world meters to pixel coordinates (column u, row v), pixel centers
at integers, the first pixel at 0. Rows count upwards along world y in a circular scan, as in RTK,
so that files exchange without a flip.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import (
    Float32Array,
    FloatArray,
    frozen,
    frozen_owned,
    increasing_times,
    plain_numbers,
    positive,
    whole_counts,
    within,
)
from legsim.geometry.counts import THICKEST


@dataclass(frozen=True, slots=True, eq=False)
class ConeBeamGeometry:
    """Where source and detector are, view by view."""

    times: FloatArray
    """(v,) s, acquisition time of each view"""
    matrices: FloatArray
    """(v, 3, 4): (u w, v w, w) = matrix @ (x, y, z, 1) in world meters. Stored with a third row of
    unit normal: w is the depth in meters along the principal ray, positive in the scanned
    region.
    """
    shape_vu: tuple[int, int]
    """(rows, columns)"""
    pixel_pitch: float = 1e-3
    """m between neighboring columns on the detector. Rays do not depend on it: it only says how far
    away the detector is. That between rows follows from the matrices: :meth:`row_pitch`.
    """
    sides_stated: bool = False
    """True: the depths of the matrices as given are positive in the scanned region. False: the
    views' principal rays say where that is (:func:`_sides`), and it is True from then on, so that
    ``dataclasses.replace`` keeps the sides.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("ConeBeamGeometry.times", self.times))
        matrices = plain_numbers("ConeBeamGeometry.matrices", self.matrices).astype(float)
        if matrices.shape != (len(self.times), 3, 4) or not np.isfinite(matrices).all():
            raise LegsimError(
                f"ConeBeamGeometry.matrices has shape {matrices.shape}; expected "
                f"{(len(self.times), 3, 4)}, all finite"
            )
        # numbers near the largest that there are overflow here, and are refused
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            determinants = np.abs(np.linalg.det(matrices[:, :, :3]))
            scale = np.linalg.norm(matrices[:, 2, :3], axis=-1)
            regular = determinants > 1e-12 * scale**3
            scaled = matrices / scale[:, None, None]
        if not regular.all():
            raise LegsimError(
                f"ConeBeamGeometry.matrices[{int(np.argmin(regular))}] is singular: it has "
                "no source position"
            )
        matrices = scaled
        try:
            if not (within(matrices) and np.isfinite(_source_positions(matrices)).all()):
                raise np.linalg.LinAlgError
            if not self.sides_stated:
                matrices = _sides(matrices)[:, None, None] * matrices
        except np.linalg.LinAlgError as error:
            raise LegsimError(
                "ConeBeamGeometry.matrices hold numbers too large to find the sources; give them "
                "in world meters"
            ) from error
        object.__setattr__(self, "matrices", frozen("matrices", matrices, matrices.shape))
        object.__setattr__(self, "sides_stated", True)
        counts = whole_counts("ConeBeamGeometry.shape_vu", self.shape_vu)
        if len(counts) != 2 or min(counts) < 1:
            raise LegsimError(
                f"ConeBeamGeometry.shape_vu is {self.shape_vu}; expected (rows, columns), and both "
                "counts must be positive"
            )
        object.__setattr__(self, "shape_vu", counts)
        object.__setattr__(
            self, "pixel_pitch", positive("ConeBeamGeometry.pixel_pitch", self.pixel_pitch)
        )

    @classmethod
    def circular(
        cls,
        *,
        times: ArrayLike,
        angles: ArrayLike,
        source_isocenter: float,
        source_detector: float,
        shape_vu: tuple[int, int],
        pixel_pitch: float,
        isocenter: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "ConeBeamGeometry":
        """A C-arm turning about the vertical (world y) through ``isocenter``.

        At angle a (rad) the source stands at isocenter + source_isocenter (sin a, 0, cos a);
        columns run along (cos a, 0, -sin a), rows along +y; the principal ray hits the middle of
        the detector. Distances in m.
        """
        angles, isocenter = np.atleast_1d(np.asarray(angles, float)), np.asarray(isocenter, float)
        sine, cosine, zero, one = (
            np.sin(angles),
            np.cos(angles),
            np.zeros_like(angles),
            np.ones_like(angles),
        )
        toward_source = np.stack([sine, zero, cosine], -1)
        axis_u, axis_v = np.stack([cosine, zero, -sine], -1), np.stack([zero, one, zero], -1)
        focal = source_detector / pixel_pitch
        rows, columns = shape_vu
        camera = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
        rotation = np.stack([axis_u, axis_v, -toward_source], -2)
        source = isocenter + source_isocenter * toward_source
        shift = -np.einsum("vij,vj->vi", rotation, source)
        matrices = camera @ np.concatenate([rotation, shift[..., None]], -1)
        return cls(np.asarray(times, float), matrices, shape_vu, pixel_pitch, sides_stated=True)

    def __repr__(self) -> str:
        columns, rows = self.shape_vu[::-1]
        center = self.rotation_center()
        to_center = 1e3 * np.linalg.norm(self.sources() - center, axis=-1).mean()
        to_detector = 1e3 * self.pixel_pitch * self.focal_lengths().mean()
        return (
            f"ConeBeamGeometry({self._views()} of {columns}x{rows} pixels of "
            f"{1e3 * self.pixel_pitch:.4g} mm, source to center {to_center:.4g}, to detector "
            f"{to_detector:.4g} mm)"
        )

    def _views(self) -> str:
        """Count of views, and the angle that the source turns about the center between them."""
        arms = self.sources() - self.rotation_center()
        crossed = np.linalg.norm(np.cross(arms[1:], arms[:-1]), axis=-1)
        arc = np.degrees(np.arctan2(crossed, (arms[1:] * arms[:-1]).sum(-1)).sum())
        return f"{len(self)} view{'s' * (len(self) != 1)} over {arc:.4g} deg"

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, views: slice) -> "ConeBeamGeometry":
        """The geometry of a slice of the views."""
        return replace(self, times=self.times[views], matrices=self.matrices[views])

    def finer(self, factor: int) -> "ConeBeamGeometry":
        """The same detector with every pixel parted into ``factor`` x ``factor``."""
        _check_factor(factor)
        rows, columns = self.shape_vu
        parted = np.array(
            [[factor, 0, 0.5 * (factor - 1)], [0, factor, 0.5 * (factor - 1)], [0, 0, 1.0]]
        )
        return replace(
            self,
            matrices=parted @ self.matrices,
            shape_vu=(factor * rows, factor * columns),
            pixel_pitch=self.pixel_pitch / factor,
        )

    def coarser(self, factor: int) -> "ConeBeamGeometry":
        """The detector with blocks of ``factor`` x ``factor`` pixels as pixels.

        Incomplete blocks at the far edges are cut off.
        """
        _check_factor(factor)
        rows, columns = self.shape_vu
        # the middle of the first block, pixel (factor - 1) / 2 of these, is its pixel 0
        joined = (
            np.array([[1, 0, 0.5 * (1 - factor)], [0, 1, 0.5 * (1 - factor)], [0, 0, factor]])
            / factor
        )
        shape_vu = (rows // factor, columns // factor)
        return replace(
            self,
            matrices=joined @ self.matrices,
            shape_vu=shape_vu,
            pixel_pitch=factor * self.pixel_pitch,
        )

    def focal_lengths(self) -> FloatArray:
        """(v,) source to detector in columns: length of each first row across the principal ray."""
        row, normal = self.matrices[:, 0, :3], self.matrices[:, 2, :3]
        return np.linalg.norm(row - (row * normal).sum(-1, keepdims=True) * normal, axis=-1)

    def row_pitch(self) -> float:
        """m between neighboring rows on the detector, a mean of all views.

        Exactly the pixel pitch where it is that to nine digits.
        """
        steps = np.linalg.norm(np.linalg.inv(self.matrices[:, :, :3])[:, :, :2], axis=1)
        ratio = float((steps[:, 1] / steps[:, 0]).mean())
        return self.pixel_pitch * (1.0 if abs(ratio - 1) < 1e-9 else ratio)

    def mirrored(self) -> NDArray[np.bool_]:
        """(v,) views whose rows run the other way than those of a circular scan.

        Seen from the source, with columns to the right, their rows count downwards.
        """
        return np.linalg.det(self.matrices[:, :, :3]) > 0

    def rows_turned(self) -> "ConeBeamGeometry":
        """The same rays on a detector whose rows are counted from the other edge."""
        turn = np.array([[1.0, 0, 0], [0, -1, self.shape_vu[0] - 1], [0, 0, 1]])
        return replace(self, matrices=turn @ self.matrices)

    def sources(self) -> FloatArray:
        """(v, 3) source positions in world."""
        return _source_positions(self.matrices)

    def ray_directions(self, u: ArrayLike, v: ArrayLike) -> FloatArray:
        """(views, *pixels, 3) world vectors from source through pixel (u, v), of depth 1."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        pixels = np.stack([u, v, np.ones_like(u)], -1)
        return np.einsum("vij,...j->v...i", np.linalg.inv(self.matrices[:, :, :3]), pixels)

    def project(self, points_world: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """((v, p, 2) pixels (u, v), (v, p) depths in m) of points (p, 3) or (v, p, 3)."""
        points = np.asarray(points_world, float)
        homogeneous = (
            points @ np.swapaxes(self.matrices[:, :, :3], -1, -2) + self.matrices[:, None, :, 3]
        )
        return homogeneous[..., :2] / homogeneous[..., 2:], homogeneous[..., 2]

    def moved(self, moved_from_reference: ArrayLike) -> "ConeBeamGeometry":
        """P(i) M(i): the scanner that sees the resting object as this one sees the moved one.

        ``moved_from_reference`` is (v, 4, 4) or (4, 4).
        """
        return replace(self, matrices=self.matrices @ np.asarray(moved_from_reference, float))

    def rotation_center(self) -> FloatArray:
        """(3,) point nearest to all principal rays: the isocenter of a circular scan."""
        return _nearest_point_to_principal_rays(self.matrices)


def _check_factor(factor: int) -> None:
    if whole_counts("the factor of a detector's pixels", (factor,))[0] < 1:
        raise LegsimError(f"pixels cannot be changed by a factor of {factor}; give 1, 2, 3 ...")


_LEAST_SPREAD = 1e-4
"""share of principal rays' spread that is along their mean direction, below which they say nothing
of depth: a calibration's noise alone makes 1e-6
"""


def _sides(matrices: FloatArray) -> FloatArray:
    """(v,) 1 or -1 for matrices (v, 3, 4): what makes their depths positive in the scanned region.

    That is where principal rays meet. A single view or parallel ones do not say: then it is the
    point on them that is nearest to world's origin.
    """
    nearest = _nearest_point_to_principal_rays(matrices, _LEAST_SPREAD)
    return np.where(matrices[:, 2, :3] @ nearest + matrices[:, 2, 3] < 0, -1.0, 1.0)


def _source_positions(matrices: FloatArray) -> FloatArray:
    """(v, 3): the point that each matrix maps to nothing."""
    return np.asarray(-np.linalg.solve(matrices[:, :, :3], matrices[:, :, 3:])[..., 0], np.float64)


def _nearest_point_to_principal_rays(matrices: FloatArray, least: float = 1e-9) -> FloatArray:
    """Least-squares point (3,) of the lines through each source along the third row's normal.

    Directions in which the lines spread by less than ``least`` are left open.
    """
    sources = _source_positions(matrices)
    normals = matrices[:, 2, :3] / np.linalg.norm(matrices[:, 2, :3], axis=-1, keepdims=True)
    across = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    # a single view (or parallel ones) leaves the place along the ray open: pinv then picks the
    # point nearest to the origin
    return np.linalg.pinv(across.sum(0), rcond=least) @ np.einsum("vij,vj->i", across, sources)


@dataclass(frozen=True, slots=True, eq=False)
class Projections:
    """Line integrals of attenuation, one image per view."""

    geometry: ConeBeamGeometry
    line_integrals: Float32Array
    """(v, rows, columns) float32, dimensionless; an array of that type is taken over, not copied,
    and can no more be written
    """

    def __post_init__(self) -> None:
        expected = (len(self.geometry), *self.geometry.shape_vu)
        numbers = plain_numbers("Projections.line_integrals", self.line_integrals)
        if numbers.dtype.kind in "iu" and numbers.size and numbers.max() > THICKEST:
            raise LegsimError(
                f"Projections.line_integrals holds whole numbers up to {numbers.max()}, counts of "
                "a detector; make line integrals of them (read_scan with counts, or -log)"
            )
        images = np.ascontiguousarray(numbers, np.float32)
        if images.shape != expected:
            raise LegsimError(
                f"Projections.line_integrals has shape {images.shape}; the geometry says "
                f"{expected} (views, rows, columns)"
            )
        object.__setattr__(self, "line_integrals", frozen_owned(images))

    def __repr__(self) -> str:
        rows, columns = self.geometry.shape_vu
        return (
            f"Projections({self.geometry._views()} of {columns}x{rows} pixels, "
            "dimensionless line integrals)"
        )

    def coarser(self, factor: int) -> "Projections":
        """Means of blocks of pixels, as :meth:`ConeBeamGeometry.coarser`."""
        geometry = self.geometry.coarser(factor)
        rows, columns = geometry.shape_vu
        whole = self.line_integrals[:, : factor * rows, : factor * columns]
        return Projections(geometry, whole.reshape(-1, rows, factor, columns, factor).mean((2, 4)))
