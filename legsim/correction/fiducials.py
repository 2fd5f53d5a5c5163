"""Pose and velocity of a sensor at the first view, from four metal points in the projections.

Maier et al. 2022, section 2.4: the sensor's origin and the tips of its three axes are projected;
each lies on a known ray, and their distances and right angles are known. Seen from far away (an
object of centimeters at three quarters of a meter) the differences of the projected points are, up
to one scale, two rows of the rotation matrix. Two orthonormal rows have exactly one right-handed
completion. Their length is the scale, hence the depth: there is one root. Perspective changes this
by the ratio of size to distance only, and is corrected by iteration (DeMenthon and Davis 1995) and
a least squares fit of the reprojection. The mirrored root of the constraint system, which fits to
about a pixel, is left-handed, and no rotation.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.geometry.cone_beam import ConeBeamGeometry

FIDUCIAL_NAMES = ("origin", "x", "y", "z")

DetectorBounds = Literal["bounded", "unbounded"]

_PERSPECTIVE_ROUNDS = 50

_REFINEMENT_ROUNDS = 50


@dataclass(frozen=True, slots=True)
class Fiducials:
    """Four metal points in a sensor: its origin and one on each axis."""

    axis_length: float = 0.010
    """m from the origin to each tip; the longer, the better the pose is known"""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.axis_length) and self.axis_length > 0):
            raise LegsimError(f"fiducials need a positive axis length in m; got {self.axis_length}")

    @property
    def points_sensor(self) -> FloatArray:
        """(4, 3) m in the sensor frame, in the order of FIDUCIAL_NAMES."""
        return self.axis_length * np.concatenate([np.zeros((1, 3)), np.eye(3)])


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """A pose found in one view, and its quality."""

    world_from_sensor: FloatArray
    """(4, 4)"""
    residual_px: float
    """RMS distance between seen and reprojected points; rounding only for exact points"""
    covariance_per_px2: FloatArray
    """(6, 6) for a detection error of one pixel (standard deviation along u and along v)

    First the rotation of the sensor about its origin as a world vector (rad), then its position in
    world (m).
    """

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "world_from_sensor",
            frozen("PoseFit.world_from_sensor", self.world_from_sensor, (4, 4)),
        )
        object.__setattr__(
            self,
            "covariance_per_px2",
            frozen("PoseFit.covariance_per_px2", self.covariance_per_px2, (6, 6)),
        )

    def covariance(self, detection_error_px: float) -> FloatArray:
        """Covariance (6, 6) in rad and m, for points of this standard deviation along each axis."""
        return self.covariance_per_px2 * detection_error_px**2

    def position_error(self, detection_error_px: float) -> float:
        """Standard deviation in m of the position error, most of it along the ray."""
        return float(np.sqrt(np.diag(self.covariance(detection_error_px))[3:].sum()))

    def tilt_error(self, detection_error_px: float) -> float:
        """Standard deviation in rad of the sensor's tilt against the vertical.

        It leaks gravity: g tilt t^2 / 2 of drift.
        """
        x, _, z = np.diag(self.covariance(detection_error_px))[:3]
        return float(np.sqrt(x + z))


def project_fiducials(
    geometry: ConeBeamGeometry, view: int, world_from_sensor: ArrayLike, fiducials: Fiducials
) -> FloatArray:
    """Projects the four points to (4, 2) pixels (u, v) in one view, on an unbounded detector."""
    return _projected(
        _matrix(geometry, view), np.asarray(world_from_sensor, float), fiducials.points_sensor
    )


def on_detector(
    geometry: ConeBeamGeometry, world_from_sensor: ArrayLike, fiducials: Fiducials
) -> NDArray[np.bool_]:
    """Whether each fiducial of a sensor with poses (v, 4, 4) falls on the detector, (v, 4)."""
    pixels, depth = geometry.project(transforms.apply(world_from_sensor, fiducials.points_sensor))
    return _within(pixels, geometry.shape_vu) & (depth > 0)


def pose_from_fiducials(
    geometry: ConeBeamGeometry,
    view: int,
    pixels: ArrayLike,
    fiducials: Fiducials,
    *,
    detector: DetectorBounds = "bounded",
) -> PoseFit:
    """Finds the sensor's pose in one view from its four projected points (4, 2).

    Points are NaN where hidden.

    Args:
        geometry: of the scan, calibrated.
        view: which of its views.
        pixels: (4, 2) columns and rows (u, v), in the order of FIDUCIAL_NAMES, any fraction of a
            pixel.
        fiducials: how far the points are apart.
        detector: "unbounded" allows points off the detector, as the paper does for sensors that its
            detector cannot see.

    Raises:
        LegsimError: points hidden, off a bounded detector, coincident, or an unknown view.
    """
    pixels = frozen("fiducial pixels", pixels, (4, 2))
    matrix = _matrix(geometry, view)
    _check_seen(pixels, geometry, view, detector)
    start = _from_far(matrix, pixels, fiducials.axis_length)
    fitted, residual = _reprojected(matrix, pixels, start, fiducials.points_sensor)
    jacobian = _jacobian(matrix, fitted, fiducials.points_sensor)
    return PoseFit(fitted, residual, np.asarray(np.linalg.inv(jacobian.T @ jacobian), float))


def _within(pixels: FloatArray, shape_vu: tuple[int, int]) -> NDArray[np.bool_]:
    rows, columns = shape_vu
    return np.all((pixels >= -0.5) & (pixels <= [columns - 0.5, rows - 0.5]), axis=-1)


def _matrix(geometry: ConeBeamGeometry, view: int) -> FloatArray:
    if not 0 <= view < len(geometry):
        raise LegsimError(f"unknown view {view}; the geometry has views 0 to {len(geometry) - 1}")
    return geometry.matrices[view]


def _check_seen(
    pixels: FloatArray, geometry: ConeBeamGeometry, view: int, detector: DetectorBounds
) -> None:
    hidden = [
        name
        for name, pixel in zip(FIDUCIAL_NAMES, pixels, strict=True)
        if not np.isfinite(pixel).all()
    ]
    if hidden:
        raise LegsimError(
            f"view {view}: fiducial {', '.join(hidden)} is hidden; a pose needs all four, take "
            "another view or placement"
        )
    within = _within(pixels, geometry.shape_vu)
    outside = [name for name, inside in zip(FIDUCIAL_NAMES, within, strict=True) if not inside]
    if outside and detector == "bounded":
        rows, columns = geometry.shape_vu
        raise LegsimError(
            f"view {view}: fiducial {', '.join(outside)} is off the detector of {columns} x {rows} "
            "pixels; place the sensor nearer to the "
            'knee, or ask for the paper\'s detector without bounds (detector = "unbounded")'
        )


def _from_far(matrix: FloatArray, pixels: FloatArray, axis_length: float) -> FloatArray:
    """World_from_sensor (4, 4) by scaled orthography, corrected for perspective iteratively."""
    rays = np.linalg.solve(matrix[:, :3], np.concatenate([pixels.T, np.ones((1, 4))])).T
    source = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    normal = matrix[2, :3]
    across = np.linalg.svd(normal[None])[2][1:]
    basis = np.stack([*across, normal])
    basis[0] *= np.sign(np.linalg.det(basis))
    stretch, rotation, depth = np.zeros(3), np.eye(3), 0.0
    for _ in range(_PERSPECTIVE_ROUNDS):
        # columns: (tip - origin) / depth = (axis_length / depth) R; its third row in this basis is
        # what perspective adds
        seen = basis[:2] @ ((1 + stretch)[:, None] * rays[1:] - rays[0]).T
        left, scales, right = np.linalg.svd(seen, full_matrices=False)
        if not scales[1] > 0:
            raise LegsimError(
                "the fiducials' projections fall on one line, which no right-angled frame does; "
                "check their order"
            )
        rows = left @ right
        rotation, depth = np.stack([*rows, np.cross(*rows)]), axis_length / scales.mean()
        before, stretch = stretch, rotation[2] * axis_length / depth
        if np.abs(stretch - before).max() < 1e-14:
            break
    return transforms.rigid(basis.T @ rotation, source + depth * rays[0])


def _reprojected(
    matrix: FloatArray, pixels: FloatArray, start: FloatArray, points: FloatArray
) -> tuple[FloatArray, float]:
    """Pose (4, 4) and RMS in px of the least-squares reprojection error, starting at ``start``.

    Levenberg and Marquardt's rule.
    """
    pose, damping = start, 1e-9
    miss = (pixels - _projected(matrix, pose, points)).ravel()
    for _ in range(_REFINEMENT_ROUNDS):
        jacobian = _jacobian(matrix, pose, points)
        normal = jacobian.T @ jacobian
        step = np.linalg.lstsq(
            normal + damping * np.diag(np.diag(normal)), jacobian.T @ miss, rcond=None
        )[0]
        turned = transforms.rotation_from_vector(step[:3]) @ pose[:3, :3]
        tried = transforms.rigid(turned, pose[:3, 3] + step[3:])
        tried_miss = (pixels - _projected(matrix, tried, points)).ravel()
        if tried_miss @ tried_miss < miss @ miss:
            pose, miss, damping = tried, tried_miss, damping / 10
        elif np.abs(step).max() < 1e-9:
            break
        else:
            damping = max(damping, 1e-6) * 10
    return pose, float(np.sqrt((miss**2).sum() / len(points)))


def _projected(matrix: FloatArray, world_from_sensor: FloatArray, points: FloatArray) -> FloatArray:
    homogeneous = transforms.apply(world_from_sensor, points) @ matrix[:, :3].T + matrix[:, 3]
    return homogeneous[:, :2] / homogeneous[:, 2:]


def _jacobian(matrix: FloatArray, world_from_sensor: FloatArray, points: FloatArray) -> FloatArray:
    """Jacobian (8, 6): pixels by (rotation about the origin, position), both in world."""
    arms = points @ world_from_sensor[:3, :3].T
    homogeneous = (arms + world_from_sensor[:3, 3]) @ matrix[:, :3].T + matrix[:, 3]
    depth = homogeneous[:, 2, None, None]
    by_point = (matrix[:2, :3] - homogeneous[:, :2, None] / depth * matrix[2, :3]) / depth
    return np.concatenate([by_point @ -transforms.cross_matrix(arms), by_point], -1).reshape(8, 6)


@dataclass(frozen=True, slots=True, eq=False)
class VelocityFit:
    """The velocity at the first view, and how errors of the seen positions affect it."""

    velocity: FloatArray
    """(3,) m/s in world"""
    start_shift: FloatArray
    """(3,) m to be added to the start position; zero from two views"""
    residual: float
    """m, RMS of the residuals at the views; zero from two views"""
    error_per_position_error: float
    """1/s: standard deviation of a velocity component per standard deviation of a position"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", frozen("VelocityFit.velocity", self.velocity, (3,)))
        object.__setattr__(
            self, "start_shift", frozen("VelocityFit.start_shift", self.start_shift, (3,))
        )


def velocity_from_views(
    view_times: ArrayLike, seen_positions: ArrayLike, free_positions: ArrayLike
) -> VelocityFit:
    """Velocity at the first view from seen positions and those integrated from a standstill.

    A wrong start velocity moves the integrated position by that velocity times the time gone by,
    and nothing else (section 2.4.2): exact in the accurate scheme for any ratio of the clocks, and
    in the published scheme for even views.

    Args:
        view_times: (k,) s, two or more views; two is as published, more average the errors of the
            seen positions.
        seen_positions: (k, 3) m in world, of the sensor's origin.
        free_positions: (k, 3) m in world, integrated from the seen pose of the first view with zero
            velocity.

    Raises:
        LegsimError: fewer than two views or positions that are not numbers.
    """
    times = increasing_times("view times", view_times)
    seen, free = (
        frozen(name, p, (len(times), 3))
        for name, p in (("seen positions", seen_positions), ("free positions", free_positions))
    )
    if len(times) < 2 or not np.isfinite(seen - free).all():
        raise LegsimError(
            "a start velocity needs positions in at least two views, all numbers; got "
            f"{len(times)} views"
        )
    since = times - times[0]
    design = np.stack([np.ones_like(since), since], -1)
    (shift, velocity), *_ = np.linalg.lstsq(design, seen - free, rcond=None)
    left = seen - free - design @ np.stack([shift, velocity])
    spread = float(np.sqrt(((since - since.mean()) ** 2).sum()))
    return VelocityFit(velocity, shift, float(np.sqrt((left**2).sum(-1).mean())), 1 / spread)
