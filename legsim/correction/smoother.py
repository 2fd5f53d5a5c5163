"""One estimate of a sensor's path over a scan from all that is measured of it.

Batch maximum a posteriori by Gauss-Newton steps over the sensor's errors
(:mod:`legsim.correction.error_state`), each with its prior of one standard deviation. Measurements
are what there is of: a person who stands and stays in place, shadows of beads whose places are
unknown, shadows of fiducials in the sensor whose spacing is known. Beads' places are eliminated
(Schur complement). Shadows lose weight beyond three standard deviations, as its inverse square, so
that wrong ones do not pull.

The result has its covariance. It is that of the model: soft tissue between skin, sensor and bone is
in it only as far as the errors of the shadows say so. Where the shadows miss the path by more than
their errors allow, they are as wrong as that, and the estimate is made again.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, positive
from legsim.correction.error_state import ErrorState, SensorPath
from legsim.correction.triangulation import triangulated
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry

_ROUNDS = 20

_SETTLED = 1e-3
"""standard deviations by which the last step may still change any error"""

_NEAR = 0.01
"""m that a person may move over a scan while the shadows have no say"""

_DOUBTED = 3.0
"""standard deviations of a shadow's distance, beyond which it loses weight"""

_FIRM = 0.1
"""m, standard deviation of a bead about its first place: keeps one that is seldom seen in place"""

SHADOW_ERROR_PX = 0.3
"""standard deviation along u and v of a shadow's place, where nothing else is known of it"""

_BEYOND_CHANCE = 1.2
"""times their standard deviation that shadows may miss the path by, RMS: dozens of them make 1.1"""

_FEWEST_VIEWS = 3
"""that a bead must be seen in to have a place"""


class DivergedError(LegsimError):
    """No path fits what is measured; what was given may all be of the right form."""


@dataclass(frozen=True, slots=True, eq=False)
class StandingPrior:
    """Nobody who stands leaves: points at the knee stay within a few millimeters."""

    points: FloatArray
    """(p, 3) m in world at the first view"""
    spread: float = 2e-3
    """m, RMS of each coordinate's displacement over the scan"""
    samples: float = 8.0
    """independent samples in a scan: sway is slow, so that a view says little beside the last"""

    def weight(self, views: int) -> float:
        """Root of the weight of one coordinate of one point in one view."""
        return float(np.sqrt(self.samples / (views * len(self.points)))) / self.spread

    @classmethod
    def at(cls, knee: FloatArray, spread: float = 2e-3) -> "StandingPrior":
        """Four points of a lower leg around and below a knee."""
        arms = [[0.0, -20.0, 0.0], [0.0, -80.0, 0.0], [30.0, -40.0, 0.0], [0.0, -40.0, 30.0]]
        return cls(np.asarray(knee) + 1e-3 * np.array(arms), spread)


@dataclass(frozen=True, slots=True, eq=False)
class BeadShadows:
    """Shadows of beads on what the sensor is fixed to; their places are unknown."""

    pixels: FloatArray
    """(v, b, 2) (u, v); NaN where unseen"""
    error_px: float = SHADOW_ERROR_PX
    """standard deviation along u and v, of detection and of skin that slides"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "pixels", frozen("BeadShadows.pixels", self.pixels, (None, None, 2))
        )
        positive("BeadShadows.error_px", self.error_px)

    def enough(self) -> "BeadShadows":
        """Only the beads that are seen often enough to have a place.

        Raises:
            LegsimError: there is none.
        """
        kept = np.isfinite(self.pixels).all(-1).sum(0) >= _FEWEST_VIEWS
        if not kept.any():
            raise LegsimError(
                f"none of {len(kept)} beads was found in {_FEWEST_VIEWS} views; use larger beads, "
                "or place them where every view sees them"
            )
        return BeadShadows(self.pixels[:, kept], self.error_px)


@dataclass(frozen=True, slots=True, eq=False)
class FiducialShadows:
    """Shadows of points whose places in the sensor are known."""

    pixels: FloatArray
    """(v, f, 2) (u, v); NaN where unseen"""
    points_sensor: FloatArray
    """(f, 3) m"""
    error_px: float = SHADOW_ERROR_PX
    """standard deviation along u and v"""

    def __post_init__(self) -> None:
        pixels = frozen("FiducialShadows.pixels", self.pixels, (None, None, 2))
        places = frozen("FiducialShadows.points_sensor", self.points_sensor, (pixels.shape[1], 3))
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "points_sensor", places)
        positive("FiducialShadows.error_px", self.error_px)

    def enough(self) -> "FiducialShadows":
        """The same, if they are seen often enough to tell anything.

        Raises:
            LegsimError: they are not.
        """
        views = int(np.isfinite(self.pixels).all(-1).any(-1).sum())
        if views < _FEWEST_VIEWS:
            raise LegsimError(
                f"fiducials of the sensor are seen in {views} views, {_FEWEST_VIEWS} are needed; "
                "place the sensor nearer to the knee, or ask for the paper's detector without "
                'bounds (methods.fiducials.detector = "unbounded")'
            )
        return self


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedPath:
    """A sensor's path and what is known of it."""

    times: FloatArray
    """(v,) s"""
    path: SensorPath
    errors: FloatArray
    """(n,) of the sensor and its start, in standard deviations of their priors"""
    covariance: FloatArray
    """(n, n) of those"""
    bead_places: FloatArray
    """(b, 3) m in world at the first view, of those that were used"""
    residual_px: float
    """RMS distance of the shadows that have weight; NaN without shadows"""
    settled: bool
    """whether the steps came to rest"""

    @property
    def motion(self) -> RigidMotion:
        """Motion of what carries the sensor, against the first view."""
        return RigidMotion(self.times, self.path.motion())

    def covariance_at(self, point: FloatArray) -> FloatArray:
        """Covariance (v, 3, 3) m^2 of where M(i) carries a point (3,); zero at the first view."""
        by = self.path.of_points(np.asarray(point, float)[None])[:, 0]
        return by @ self.covariance @ np.swapaxes(by, -1, -2)

    def turn_covariance(self) -> FloatArray:
        """Covariance (v, 3, 3) rad^2 of the rotation of M(i), as a rotation from the left."""
        by = self.path.of_rotation()
        return by @ self.covariance @ np.swapaxes(by, -1, -2)

    def errors_mm(self, point: FloatArray) -> FloatArray:
        """Standard deviation (v,) in mm of where a point (3,) is carried, all axes together."""
        return 1e3 * np.sqrt(np.trace(self.covariance_at(point), axis1=-2, axis2=-1))

    def seen_motion(self, geometry: ConeBeamGeometry, points: FloatArray) -> tuple[float, float]:
        """What images see of the motion of points (p, 3), and its standard deviation: RMS, px.

        A constant similarity of the scene and what it looks like, a step along the source's path
        with another size, changes no image: both numbers are after the best one.
        """
        motion = self.path.motion()
        at = transforms.apply(motion, points)
        pixel, by_point = _projected(geometry.matrices, at)
        seen = pixel - geometry.project(points)[0]
        by_errors = (by_point @ self.path.of_points(points)).reshape(seen.size, -1)
        arms = at - points.mean(0)
        similar = np.concatenate(
            [
                -transforms.cross_matrix(arms),
                np.broadcast_to(np.eye(3), (*at.shape, 3)),
                arms[..., None],
            ],
            -1,
        )
        basis, _ = np.linalg.qr((by_point @ similar).reshape(seen.size, 7))
        kept = seen.reshape(-1) - basis @ (basis.T @ seen.reshape(-1))
        by_errors = by_errors - basis @ (basis.T @ by_errors)
        variance = float(
            np.einsum("rn,nm,rm->", by_errors, self.covariance, by_errors, optimize=True)
        )
        count = seen.size / 2
        return float(np.sqrt(kept @ kept / count)), float(np.sqrt(variance / count))

    def errors_deg(self) -> FloatArray:
        """Standard deviation (v,) in degrees of the rotation, all axes together."""
        return np.degrees(np.sqrt(np.trace(self.turn_covariance(), axis1=-2, axis2=-1)))


class _Shadows(NamedTuple):
    """Distances of shadows to projected points, in standard deviations."""

    miss: FloatArray
    """(v, p, 2); 0 where unseen"""
    by_point: FloatArray
    """(v, p, 2, 3) per m of the point's shift in world"""
    weights: FloatArray
    """(v, p)"""


class _Normal(NamedTuple):
    """Normal equations; beads' places are independent of each other."""

    matrix: FloatArray
    """(n, n) of the errors"""
    right: FloatArray
    """(n,)"""
    mixed: FloatArray
    """(b, n, 3) errors by places"""
    of_places: FloatArray
    """(b, 3, 3)"""
    right_places: FloatArray
    """(b, 3)"""

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """Matrix and right side of the errors alone: the Schur complement."""
        through = self.mixed @ np.linalg.inv(self.of_places)
        matrix = self.matrix - np.einsum("bni,bmi->nm", through, self.mixed)
        return matrix, self.right - np.einsum("bni,bi->n", through, self.right_places)

    def step(self) -> tuple[FloatArray, FloatArray]:
        """Change (n,) of the errors and (b, 3) of the places."""
        matrix, right = self.reduced()
        errors = -solved(matrix, right)
        return errors, self.of_beads(errors)

    def of_beads(self, errors: FloatArray) -> FloatArray:
        """Change (b, 3) of the places that a change (n,) of the errors asks for."""
        left = self.right_places + np.einsum("bni,n->bi", self.mixed, errors)
        return -np.linalg.solve(self.of_places, left[..., None])[..., 0]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """All measurements of one sensor."""

    state: ErrorState
    standing: StandingPrior | None = None
    geometry: ConeBeamGeometry | None = None
    beads: BeadShadows | None = None
    fiducials: FiducialShadows | None = None
    first_places: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(b, 3) m about which beads are held loosely"""

    def shadows(
        self, poses: FloatArray, places: FloatArray
    ) -> tuple[_Shadows | None, _Shadows | None]:
        """Shadows of the beads and of the fiducials."""
        of_beads = of_fiducials = None
        if self.beads is not None:
            at = transforms.apply(poses @ transforms.inverse(poses[0]), places)
            of_beads = _missed(self.geometry, at, self.beads.pixels, self.beads.error_px)
        if self.fiducials is not None:
            at = transforms.apply(poses, self.fiducials.points_sensor)
            of_fiducials = _missed(
                self.geometry, at, self.fiducials.pixels, self.fiducials.error_px
            )
        return of_beads, of_fiducials

    def linearized(self, errors: FloatArray, places: FloatArray) -> tuple[_Normal, SensorPath]:
        """Normal equations at errors (n,) and places (b, 3)."""
        path = self.state.path(errors)
        matrix, right = np.eye(len(errors)), errors.copy()
        of_beads, of_fiducials = self.shadows(path.poses, places)
        if self.standing is not None:
            points = self.standing.points
            weight = self.standing.weight(len(path.poses))
            moved = weight * (transforms.apply(path.motion(), points) - points)
            _add(matrix, right, moved, weight * path.of_points(points))
        if of_fiducials is not None and self.fiducials is not None:
            by = path.of_attached(self.fiducials.points_sensor)
            root = np.sqrt(of_fiducials.weights)[..., None]
            _add(
                matrix,
                right,
                root * of_fiducials.miss,
                root[..., None] * of_fiducials.by_point @ by,
            )
        count = len(places)
        mixed, of_places = np.zeros((count, len(errors), 3)), np.zeros((count, 3, 3))
        right_places = (places - self.first_places) / _FIRM**2
        if of_beads is not None:
            root = np.sqrt(of_beads.weights)[..., None]
            miss, by_point = root * of_beads.miss, root[..., None] * of_beads.by_point
            by = by_point @ path.of_points(places)
            by_place = by_point @ path.motion()[:, None, :3, :3]
            _add(matrix, right, miss, by)
            mixed = np.einsum("vbkn,vbki->bni", by, by_place, optimize=True)
            of_places = np.einsum("vbki,vbkj->bij", by_place, by_place)
            right_places = right_places + np.einsum("vbki,vbk->bi", by_place, miss)
        of_places = of_places + np.eye(3) / _FIRM**2
        return _Normal(matrix, right, mixed, of_places, right_places), path


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """The solution of normal equations.

    Raises:
        DivergedError: they have none, as where steps ran far away.
    """
    try:
        return cho_solve(cho_factor(matrix), right)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise DivergedError(
            "no path of the sensor fits its start, its signals and the shadows of beads or "
            "points; check which is which, the order of the views, and (column, row) of the pixels"
        ) from error


def _add(matrix: FloatArray, right: FloatArray, residual: FloatArray, by: FloatArray) -> None:
    """Adds measurements to the normal equations, in place."""
    rows = by.reshape(-1, by.shape[-1])
    matrix += rows.T @ rows
    right += rows.T @ residual.reshape(-1)


def _missed(
    geometry: ConeBeamGeometry | None, at: FloatArray, pixels: FloatArray, error_px: float
) -> _Shadows:
    """How far points (v, p, 3) are projected from their shadows (v, p, 2)."""
    pixel, by_point = _projected(_of(geometry).matrices, at)
    miss = (pixel - pixels) / error_px
    return _Shadows(np.nan_to_num(miss, posinf=0, neginf=0), by_point / error_px, _weights(miss))


def _projected(matrices: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (v, p, 2) of points (v, p, 3), and their derivatives (v, p, 2, 3) in px/m."""
    homogeneous = at @ np.swapaxes(matrices[:, :, :3], -1, -2) + matrices[:, None, :, 3]
    depth, pixel = homogeneous[..., 2:], homogeneous[..., :2] / homogeneous[..., 2:]
    rows = matrices[:, None, :, :3]
    return pixel, (rows[..., :2, :] - pixel[..., None] * rows[..., 2:, :]) / depth[..., None]


def _weights(miss: FloatArray) -> FloatArray:
    """Weights (v, p) of shadows: 1, beyond the doubt its inverse square, 0 where unseen.

    While the path is still far off, the median distance stands for one standard deviation.
    """
    seen = np.isfinite(miss).all(-1)
    distance = np.linalg.norm(np.nan_to_num(miss), axis=-1)
    typical = max(1.0, float(np.median(distance[seen]))) if seen.any() else 1.0
    doubt = np.maximum(distance / (_DOUBTED * typical), 1.0)
    return np.where(seen, doubt**-2, 0.0)


def _of(geometry: ConeBeamGeometry | None) -> ConeBeamGeometry:
    if geometry is None:
        raise LegsimError("shadows need the geometry of the scan; give geometry=")
    return geometry


def smooth(
    state: ErrorState,
    *,
    standing: StandingPrior | None = None,
    geometry: ConeBeamGeometry | None = None,
    beads: BeadShadows | None = None,
    fiducials: FiducialShadows | None = None,
) -> SmoothedPath:
    """Estimates the path of one sensor over a scan.

    Args:
        state: the sensor's signals, start, and how far both may be off.
        standing: the person stays in place.
        geometry: of the scan; needed by shadows.
        beads: on what the sensor is fixed to. A bead seen in fewer than three views is left out.
        fiducials: in the sensor.

    Raises:
        LegsimError: shadows without a geometry or of other views.
        DivergedError: no path fits them.
    """
    problem, *begun = _prepared(state, standing, geometry, beads, fiducials)
    found = _descended(problem, *begun)
    worse = _believed(problem, state.path(found[0]), found[1])
    if worse is not problem:
        problem, found = worse, _descended(worse, *begun)
    return _result(problem, *found)


def _prepared(
    state: ErrorState,
    standing: StandingPrior | None,
    geometry: ConeBeamGeometry | None,
    beads: BeadShadows | None,
    fiducials: FiducialShadows | None,
) -> tuple[_Problem, FloatArray, FloatArray]:
    """The problem of one sensor, and errors and places of beads to start from."""
    for given in (beads, fiducials):
        if given is not None and len(given.pixels) != len(state.views):
            raise LegsimError(
                f"shadows are of {len(given.pixels)} views, the scan has {len(state.views)}; give "
                "one row per view, NaN where unseen"
            )
    if beads is None and fiducials is None:
        plain = _Problem(state, standing)
        return plain, state.first_guess(), plain.first_places
    # someone who stays in place brings the path near enough for shadows to be linear in its errors
    near = standing or StandingPrior.at(_of(geometry).rotation_center(), _NEAR)
    plain = _Problem(state, near)
    errors, places, _ = _descended(plain, state.first_guess(), plain.first_places)
    used = None
    if beads is not None:
        used = beads.enough()
        moved = _of(geometry).moved(state.path(errors).motion())
        places = triangulated(moved, used.pixels)
    return _Problem(state, standing, geometry, used, fiducials, places), errors, places


def _descended(
    problem: _Problem, errors: FloatArray, places: FloatArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Errors and places of least cost, and whether the steps came to rest.

    Whole steps: bias and tilt hide each other along a curved valley, where a step first raises the
    cost (gravity times half the square of a turn, over the scan's time) and the next one lowers it.
    """
    for _ in range(_ROUNDS):
        normal, _ = problem.linearized(errors, places)
        by_errors, by_places = normal.step()
        errors, places = errors + by_errors, places + by_places
        if np.abs(by_errors).max() < _SETTLED:
            return errors, places, True
    return errors, places, False


def _result(
    problem: _Problem, errors: FloatArray, places: FloatArray, settled: bool
) -> SmoothedPath:
    normal, path = problem.linearized(errors, places)
    matrix, _ = normal.reduced()
    covariance = solved(matrix, np.eye(len(errors)))
    return _smoothed(problem, path, errors, covariance, places, settled)


def _smoothed(
    problem: _Problem,
    path: SensorPath,
    errors: FloatArray,
    covariance: FloatArray,
    places: FloatArray,
    settled: bool,
) -> SmoothedPath:
    seen = [s for s in problem.shadows(path.poses, places) if s is not None]
    sizes = [g.error_px for g in (problem.beads, problem.fiducials) if g is not None]
    squares = sum(
        float((s.weights * (s.miss**2).sum(-1)).sum()) * px**2
        for s, px in zip(seen, sizes, strict=True)
    )
    total = sum(float(s.weights.sum()) for s in seen)
    residual = float(np.sqrt(squares / total)) if total else float("nan")
    views = problem.state.views
    return SmoothedPath(views, path, errors, covariance, places, residual, settled)


def _believed(problem: _Problem, path: SensorPath, places: FloatArray) -> _Problem:
    """The problem whose shadows have errors as large as they miss the path by; the same where they
    are as stated.
    """
    given, found = (problem.beads, problem.fiducials), problem.shadows(path.poses, places)
    beads, fiducials = (
        shadows
        if shadows is None or missed is None or (misfit := _misfit(missed)) <= _BEYOND_CHANCE
        else replace(shadows, error_px=misfit * shadows.error_px)
        for shadows, missed in zip(given, found, strict=True)
    )
    if beads is problem.beads and fiducials is problem.fiducials:
        return problem
    return replace(problem, beads=beads, fiducials=fiducials)


def _misfit(shadows: _Shadows) -> float:
    """RMS distance along u and v of the shadows that have weight, in standard deviations."""
    total = 2 * float(shadows.weights.sum())
    squares = float((shadows.weights * (shadows.miss**2).sum(-1)).sum())
    return float(np.sqrt(squares / total)) if total else 0.0
