"""The least-squares problem of one sensor's path: its errors, places of beads, what is measured.

Gauss-Newton steps over the errors of :mod:`legsim.correction.error_state`, each with its prior of
one standard deviation. Beads' places are eliminated (Schur complement). Shadows lose weight beyond
three standard deviations, as its inverse square, so that wrong ones do not pull.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.error_state import ErrorState, SensorPath
from legsim.correction.path_measurements import (
    BeadShadows,
    FiducialShadows,
    StandingFoot,
    StandingPrior,
)
from legsim.correction.triangulation import triangulated
from legsim.geometry.cone_beam import ConeBeamGeometry

_HALF_STEPS = (0.5,) * 40

_STEPS = (1.0,) * 20 + _HALF_STEPS
"""sizes of the steps

Whole ones first: bias and tilt hide each other along a curved valley, where a step first raises the
cost (gravity times half the square of a turn, over the scan's time) and the next one lowers it.
Where wrong shadows take turns in having weight, whole steps go round in a circle or run away; half
ones do not.
"""

_SETTLED = 1e-3
"""standard deviations by which the last step may still change any error"""

_NEAR = 0.01
"""m that a person may move over a scan while the shadows have no say"""

_DOUBTED = 3.0
"""standard deviations of a shadow's distance, beyond which it loses weight"""

_FIRM = 0.1
"""m, standard deviation of a bead about its first place: keeps one that is seldom seen in place"""

_BEYOND_CHANCE = 1.2
"""times their standard deviation that shadows may miss the path by, and an ankle may step, RMS:
dozens of them make 1.1
"""


_STEP_S = (0.2, 0.5, 1.0)
"""s between views whose steps tell how an ankle wanders; sooner ones are noise of the sensor"""


class DivergedError(LegsimError):
    """No path fits what is measured; what was given may all be of the right form."""


class _Shadows(NamedTuple):
    """Distances of shadows to projected points, in standard deviations."""

    miss: FloatArray
    """(v, p, 2); 0 where unseen"""
    by_point: FloatArray
    """(v, p, 2, 3) per m of the point's shift in world"""
    weights: FloatArray
    """(v, p)"""

    def squares(self) -> tuple[float, float]:
        """Weighted sum of squared distances along u and v together, and sum of the weights."""
        return float((self.weights * (self.miss**2).sum(-1)).sum()), float(self.weights.sum())


class Normal(NamedTuple):
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
class PathProblem:
    """All measurements of one sensor."""

    state: ErrorState
    standing: StandingPrior | None = None
    geometry: ConeBeamGeometry | None = None
    beads: BeadShadows | None = None
    fiducials: FiducialShadows | None = None
    first_places: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(b, 3) m about which beads are held loosely"""
    foot: StandingFoot | None = None
    """below the sensor; None where none stands, or its ankle is not known"""

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

    def linearized(self, errors: FloatArray, places: FloatArray) -> tuple[Normal, SensorPath]:
        """Normal equations at errors (n,) and places (b, 3)."""
        path = self.state.path(errors)
        matrix, right = np.eye(len(errors)), errors.copy()
        of_beads, of_fiducials = self.shadows(path.poses, places)
        if self.standing is not None:
            points = self.standing.points
            weight = self.standing.weight(len(path.poses))
            moved = weight * (transforms.apply(path.motion(), points) - points)
            add_measurements(matrix, right, moved, weight * path.of_points(points))
        if self.foot is not None:
            add_measurements(matrix, right, *self.foot.steps(path, self.state.views))
        if of_fiducials is not None and self.fiducials is not None:
            by = path.of_attached(self.fiducials.points_sensor)
            root = np.sqrt(of_fiducials.weights)[..., None]
            add_measurements(
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
            add_measurements(matrix, right, miss, by)
            mixed = np.einsum("vbkn,vbki->bni", by, by_place, optimize=True)
            of_places = np.einsum("vbki,vbkj->bij", by_place, by_place)
            right_places = right_places + np.einsum("vbki,vbk->bi", by_place, miss)
        of_places = of_places + np.eye(3) / _FIRM**2
        return Normal(matrix, right, mixed, of_places, right_places), path


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


def add_measurements(
    matrix: FloatArray, right: FloatArray, residual: FloatArray, by: FloatArray
) -> None:
    """Adds measurements to the normal equations, in place."""
    rows = by.reshape(-1, by.shape[-1])
    matrix += rows.T @ rows
    right += rows.T @ residual.reshape(-1)


def _missed(
    geometry: ConeBeamGeometry | None, at: FloatArray, pixels: FloatArray, error_px: float
) -> _Shadows:
    """How far points (v, p, 3) are projected from their shadows (v, p, 2)."""
    pixel, by_point = projected(_of(geometry).matrices, at)
    miss = (pixel - pixels) / error_px
    return _Shadows(np.nan_to_num(miss, posinf=0, neginf=0), by_point / error_px, _weights(miss))


def projected(matrices: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
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


def prepared(
    state: ErrorState,
    standing: StandingPrior | None,
    geometry: ConeBeamGeometry | None,
    beads: BeadShadows | None,
    fiducials: FiducialShadows | None,
) -> tuple[PathProblem, FloatArray, FloatArray]:
    """The problem of one sensor, and errors and places of beads to start from."""
    for given in (beads, fiducials):
        if given is not None and len(given.pixels) != len(state.views):
            raise LegsimError(
                f"shadows are of {len(given.pixels)} views, the scan has {len(state.views)}; give "
                "one row per view, NaN where unseen"
            )
    if beads is None and fiducials is None:
        plain = PathProblem(state, standing)
        return plain, state.first_guess(), plain.first_places
    # someone who stays in place brings the path near enough for shadows to be linear in its errors
    near = standing or StandingPrior.at(_of(geometry).rotation_center(), _NEAR)
    plain = PathProblem(state, near)
    errors, places, _ = descended(plain, state.first_guess(), plain.first_places)
    used = None
    if beads is not None:
        used = beads.enough()
        moved = _of(geometry).moved(state.path(errors).motion())
        places = triangulated(moved, used.pixels)
    return PathProblem(state, standing, geometry, used, fiducials, places), errors, places


def descended(
    problem: PathProblem, errors: FloatArray, places: FloatArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Errors and places of least cost, and whether the steps came to rest.

    Raises:
        DivergedError: as :func:`at_rest`.
    """

    def step(errors: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        return problem.linearized(errors, places)[0].step()

    (errors, places), settled = at_rest(step, (errors, places), errors=1)
    return errors, places, settled


def at_rest(
    step: Callable[..., Sequence[FloatArray]], begun: Sequence[FloatArray], errors: int
) -> tuple[Sequence[FloatArray], bool]:
    """Unknowns where Gauss-Newton steps end, and whether they came to rest there.

    Args:
        step: from unknowns to the whole step of each.
        begun: unknowns to start from.
        errors: how many of them, the first ones, are errors of sensors; these must come to rest.

    Raises:
        DivergedError: half steps run away, too.
    """
    try:
        return _stepped(step, begun, errors, _STEPS)
    except DivergedError:
        return _stepped(step, begun, errors, _HALF_STEPS)


def _stepped(
    step: Callable[..., Sequence[FloatArray]],
    at: Sequence[FloatArray],
    errors: int,
    sizes: Sequence[float],
) -> tuple[Sequence[FloatArray], bool]:
    for size in sizes:
        whole = step(*at)
        at = [one + size * by for one, by in zip(at, whole, strict=True)]
        if max(np.abs(by).max() for by in whole[:errors]) < _SETTLED:
            return at, True
    return at, False


def believed(problem: PathProblem, path: SensorPath, places: FloatArray) -> PathProblem:
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


def on_foot_as_found(problem: PathProblem, path: SensorPath) -> PathProblem:
    """The problem of a person whose ankle wanders by as much as is found; the same where that is
    as stated or less.
    """
    if problem.foot is None:
        return problem
    steps, _ = problem.foot.steps(path, problem.state.views)
    return _wandering(problem, problem.foot, float(np.square(steps).mean()))


def on_foot_as_free(problem: PathProblem, path: SensorPath, covariance: FloatArray) -> PathProblem:
    """The same by a path that knew of no foot, with the covariance (n, n) of its errors.

    Its ankle also wanders by these, which is taken off with twice the chance that it has. Slow
    movements show in steps of longer times.
    """
    if problem.foot is None:
        return problem
    views, found = problem.state.views, [0.0]
    lasted = float(views[-1] - views[0])
    for seconds, apart in _apart(views):
        steps, by = problem.foot.steps(path, views, apart)
        chance = _hidden(by, covariance)
        samples = 3 * lasted / max(seconds, _STEP_S[0])
        found.append(float(np.square(steps).mean()) - chance * (1 + 2 * np.sqrt(2 / samples)))
    return _wandering(problem, problem.foot, max(found))


def standing_as_expected(
    problem: PathProblem, path: SensorPath, covariance: FloatArray
) -> PathProblem:
    """The problem of a person whose ankle and knee move by as much as they are found to, and by
    what the errors with their covariance (n, n) may hide; the same where that is as stated or less.
    """
    if problem.foot is not None:
        largest = max(
            _mean_square(*problem.foot.steps(path, problem.state.views, apart), covariance)
            for apart in (1, *(count for _, count in _apart(problem.state.views)))
        )
        problem = _wandering(problem, problem.foot, largest)
    standing = problem.standing
    if standing is None:
        return problem
    moved = transforms.apply(path.motion(), standing.points) - standing.points
    found = _mean_square(moved, path.of_points(standing.points), covariance)
    if found <= (_BEYOND_CHANCE * standing.spread) ** 2:
        return problem
    return replace(problem, standing=replace(standing, spread=float(np.sqrt(found))))


def _mean_square(found: FloatArray, by: FloatArray, covariance: FloatArray) -> float:
    """Of coordinates (..., 3) with changes (..., 3, n), their errors' variance included."""
    return float(np.square(found).mean()) + _hidden(by, covariance)


def _hidden(by: FloatArray, covariance: FloatArray) -> float:
    """Mean variance of coordinates with changes (..., 3, n) by errors of covariance (n, n)."""
    return float((by @ covariance * by).sum(-1).mean())


def _apart(views: FloatArray) -> list[tuple[float, int]]:
    """Seconds, and numbers of views, between those whose steps tell how an ankle wanders."""
    rate = (len(views) - 1) / float(views[-1] - views[0])
    counts = [(seconds, max(1, round(seconds * rate))) for seconds in _STEP_S]
    return [(seconds, count) for seconds, count in counts if count < len(views)]


def _wandering(problem: PathProblem, foot: StandingFoot, squares: float) -> PathProblem:
    """The problem of an ankle with steps of these mean ``squares``, beyond chance."""
    if squares <= _BEYOND_CHANCE**2:
        return problem
    return replace(problem, foot=replace(foot, walk=np.sqrt(squares) * foot.walk))


def _misfit(shadows: _Shadows) -> float:
    """RMS distance along u and v of the shadows that have weight, in standard deviations."""
    squares, total = shadows.squares()
    return float(np.sqrt(squares / (2 * total))) if total else 0.0
