"""One estimate of a sensor's path over a scan from all that is measured of it.

Batch maximum a posteriori over the sensor's errors (:mod:`legsim.correction.error_state`), by the
steps of :mod:`legsim.correction.path_problem`. Measurements are what there is of: a person who
stands and stays in place, shadows of beads whose places are unknown, shadows of fiducials in the
sensor whose spacing is known.

The result has its covariance. It is that of the model: soft tissue between skin, sensor and bone is
in it only as far as the errors of the shadows say so. Where the shadows miss the path by more than
their errors allow, they are as wrong as that, and the estimate is made again. So it is with an
ankle that wanders by more than that of a foot that stands.
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction.error_state import ErrorState, SensorPath
from legsim.correction.path_measurements import (
    BeadShadows,
    FiducialShadows,
    StandingFoot,
    StandingPrior,
)
from legsim.correction.path_problem import (
    PathProblem,
    believed,
    descended,
    on_foot_as_free,
    prepared,
    projected,
    solved,
    standing_as_expected,
)
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry

_ROUNDS = 12
"""estimates over a foot that stands less and less still, at most"""


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
    foot: StandingFoot | None = None
    """that the sensor's segment was found to stand on, as still as it was found to be"""
    standing: StandingPrior | None = None
    """as wide as the person was found to move"""

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
        pixel, by_point = projected(geometry.matrices, at)
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


def smooth(
    state: ErrorState,
    *,
    standing: StandingPrior | None = None,
    geometry: ConeBeamGeometry | None = None,
    beads: BeadShadows | None = None,
    fiducials: FiducialShadows | None = None,
    foot: StandingFoot | None = None,
) -> SmoothedPath:
    """Estimates the path of one sensor over a scan.

    Args:
        state: the sensor's signals, start, and how far both may be off.
        standing: the person stays in place.
        geometry: of the scan; needed by shadows.
        beads: on what the sensor is fixed to. A bead seen in fewer than three views is left out.
        fiducials: in the sensor.
        foot: of the shank that the sensor is on.

    Raises:
        LegsimError: shadows without a geometry or of other views.
        DivergedError: no path fits them.
    """
    problem, *begun = prepared(state, standing, geometry, beads, fiducials)
    if foot is not None and beads is None and fiducials is None:
        return _on_foot_alone(replace(problem, foot=foot), *begun)
    found = descended(problem, *begun)
    worse = believed(problem, state.path(found[0]), found[1])
    if worse is not problem:
        problem, found = worse, descended(worse, *begun)
    if foot is None:
        return _result(problem, *found)
    # a path that knows of no foot tells whether it stands: held to one that steps, whole paths run
    # away, and the shadows seem wrong
    matrix, path = _reduced(problem, *found[:2])
    covariance = solved(matrix, np.eye(len(matrix)))
    on_foot = on_foot_as_free(replace(problem, foot=foot), path, covariance)
    return _result(on_foot, *descended(on_foot, *found[:2]))


def _on_foot_alone(problem: PathProblem, errors: FloatArray, places: FloatArray) -> SmoothedPath:
    """The path of a sensor of which nothing is seen, of a person who moves by what is found; not
    settled where that grew to the end.

    Without a foot such a path is off by more than an ankle steps, and cannot tell. What is found is
    small where the priors say so: the errors that it may still have count as well (expectation
    maximization of their widths).
    """
    found = _result(problem, *descended(problem, errors, places))
    for _ in range(_ROUNDS):
        freer = standing_as_expected(problem, found.path, found.covariance)
        if freer is problem:
            return found
        problem = freer
        found = _result(problem, *descended(problem, found.errors, places))
    return replace(found, settled=False)


def _reduced(
    problem: PathProblem, errors: FloatArray, places: FloatArray
) -> tuple[FloatArray, SensorPath]:
    """The inverse of the errors' covariance (n, n), and the path."""
    normal, path = problem.linearized(errors, places)
    return normal.reduced()[0], path


def _result(
    problem: PathProblem, errors: FloatArray, places: FloatArray, settled: bool
) -> SmoothedPath:
    matrix, path = _reduced(problem, errors, places)
    covariance = solved(matrix, np.eye(len(errors)))
    return smoothed(problem, path, errors, covariance, places, settled)


def smoothed(
    problem: PathProblem,
    path: SensorPath,
    errors: FloatArray,
    covariance: FloatArray,
    places: FloatArray,
    settled: bool,
) -> SmoothedPath:
    seen = [s for s in problem.shadows(path.poses, places) if s is not None]
    sizes = [g.error_px for g in (problem.beads, problem.fiducials) if g is not None]
    sums = [s.squares() for s in seen]
    squares = sum(of * px**2 for (of, _), px in zip(sums, sizes, strict=True))
    total = sum(weight for _, weight in sums)
    residual = float(np.sqrt(squares / total)) if total else float("nan")
    views = problem.state.views
    stood = problem.foot, problem.standing
    return SmoothedPath(views, path, errors, covariance, places, residual, settled, *stood)
