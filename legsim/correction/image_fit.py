"""One rigid motion from sharpness and from what else is known: maximum a posteriori by L-BFGS.

The cost of a vector of errors e, each counted in standard deviations of its prior, is

    weight (H(M(e)) - <pull, M(e)>) + |e|^2 / 2 + standing + foot

with H the entropy of :mod:`legsim.correction.image_criterion`. Its derivatives are exact; any
number of errors costs two back-projections of a box. ``pull`` is what the criterion would pull a
motion by that is right (calibrated by :mod:`legsim.correction.reprojection`).
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import eigh
from scipy.optimize import minimize

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, whole_counts
from legsim.correction.error_state import SensorPath
from legsim.correction.image_criterion import Focus
from legsim.correction.path_measurements import StandingFoot, StandingPrior
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.reconstruction.field_of_view import pixel_at_isocenter

_CURVATURE = 0.13e6
"""nats per m^2, second derivative of entropies by the RMS of what images see of a motion: between
0.11 and 0.15 at 1 mm"""

_SEEN = 2.4e-5
"""m at the isocenter, 0.03 px of 0.8 mm: what an error of one standard deviation must look like"""

_SPARSE = 4
"""of so many views one decides the curvature"""

_ARM = 0.05
"""m from its middle at which a leg's turns count as its shifts do"""

_SEEN_FINE = 1.6e-5
"""m, the same where the criterion's curvature is measured"""

_DIFFERENCE = 1.5
"""steps of the expected curvature, of the differences that measure it: rougher below"""

_FLATTEST = 0.05
"""of the median curvature that a way has at least"""

_SHARES = (1.0, 0.4, 0.16)
"""of a step, until one lowers the cost"""

_GAINED = 0.5
"""of the cost that a step must gain for another one: less than a standard deviation squared"""

_TRUST = 10.0
"""times its weight that a motion found by measured curvature has against the priors on the way back
to the model's paths"""

_ROUNDS, _STILL = 10, 1e-3
"""steps back onto a model's own paths at most, and standard deviations of the last one"""

_MEMORY = 30
_SETTLED = 1e-10


class PathModel(Protocol):
    """A path over the views as a function of errors, such as an ErrorState."""

    @property
    def size(self) -> int: ...

    def path(self, errors: FloatArray) -> SensorPath: ...


_FEWEST_KNOTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SplinePath:
    """Six cubic B-splines over the scan about one point: what moves when no sensor says how."""

    times: FloatArray
    """(v,) s"""
    center: FloatArray
    """(3,) m"""
    knots: int = 9
    """coefficients of each"""
    turn: float = np.radians(1.0)
    """rad, standard deviation of a coefficient"""
    shift: float = 5e-3
    """m, the same"""

    def __post_init__(self) -> None:
        (knots,) = whole_counts("SplinePath.knots", (self.knots,))
        if knots < _FEWEST_KNOTS:
            raise LegsimError(
                f"a cubic spline has {_FEWEST_KNOTS} coefficients or more; knots is {knots}"
            )

    @property
    def size(self) -> int:
        return 6 * self.knots

    def basis(self) -> FloatArray:
        """(v, knots)"""
        first, last = self.times[0], self.times[-1]
        inner = np.linspace(first, last, self.knots - 2)
        knots = np.concatenate([[first] * 3, inner, [last] * 3])
        return BSpline.design_matrix(np.clip(self.times, first, last), knots, 3).toarray()

    def path(self, errors: FloatArray) -> SensorPath:
        """Poses and their derivatives."""
        basis, sizes = self.basis(), np.array([self.turn] * 3 + [self.shift] * 3)
        found = np.einsum("vk,kj->vj", basis, errors.reshape(self.knots, 6) * sizes)
        rotation = transforms.rotation_from_vector(found[:, :3])
        poses = transforms.rigid(rotation, self.center + found[:, 3:] - rotation @ self.center)
        turns = np.zeros((len(basis), 6, self.knots, 6))
        by_vector = _left_jacobian(found[:, :3])
        turns[:, :3, :, :3] = np.einsum("vij,vk->vikj", self.turn * by_vector, basis)
        arm = transforms.cross_matrix(self.center + found[:, 3:])
        turns[:, 3:, :, :3] = np.einsum("vil,vlkj->vikj", arm, turns[:, :3, :, :3])
        turns[:, 3:, :, 3:] = self.shift * np.einsum("vk,ij->vikj", basis, np.eye(3))
        return SensorPath(poses, turns.reshape(len(basis), 6, -1))


def _left_jacobian(vectors: FloatArray) -> FloatArray:
    """(v, 3, 3): rotation from the left by a change of rotation vectors (v, 3)."""
    cross = transforms.cross_matrix(vectors)
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    safe = np.where(angle < 1e-4, 1.0, angle)
    first = np.where(angle < 1e-4, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(angle < 1e-4, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * cross + second * cross @ cross


@dataclass(frozen=True, slots=True, eq=False)
class ImageFit:
    """Least cost that was found."""

    errors: FloatArray
    """(n,)"""
    value: float
    """entropy there, pull left out"""
    evaluations: int


@dataclass(frozen=True, slots=True, eq=False)
class ImageProblem:
    """What the cost is made of."""

    model: PathModel
    sharpness: Focus
    standing: StandingPrior
    geometry: ConeBeamGeometry
    weight: float
    pull: FloatArray | None = None
    """(v, 4, 4) by M(i)"""
    foot: StandingFoot | None = None
    """below the sensor whose path it is"""

    def cost(self, errors: FloatArray) -> tuple[float, FloatArray, float]:
        """(cost, its derivatives (n,), entropy)."""
        total, slopes, entropy = self.of_path(self.model.path(errors))
        return total + 0.5 * float((errors**2).sum()), slopes + errors, entropy

    def of_path(self, path: SensorPath) -> tuple[float, FloatArray, float]:
        """The same of a path alone: images, standing and foot, by what its twists are of."""
        motion = path.motion()
        entropy, by_motion = self.sharpness(motion)
        total = entropy
        if self.pull is not None:
            total -= float((self.pull * motion).sum())
            by_motion = by_motion - self.pull
        points, share = self.standing.points, self.standing.weight(len(motion)) ** 2
        moved = transforms.apply(motion, points) - points
        by_points = np.einsum("vpi,vpin->n", moved, path.of_points(points))
        steps, by_steps = self._ankle(path)
        slopes = self.weight * by_errors(by_motion, path) + share * by_points + by_steps.T @ steps
        priors = 0.5 * (share * float((moved**2).sum()) + float(steps @ steps))
        return self.weight * total + priors, slopes, entropy

    def curvature(self, errors: FloatArray) -> FloatArray:
        """About the second derivatives (n, n) of the cost."""
        known, seen = self.known_and_seen(errors)
        return known + self.weight * _CURVATURE * seen

    def known_and_seen(self, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Quadratic forms (n, n) of errors: of the priors, and mean square (m^2) that images see.

        That is across the rays, at the points of the standing prior, a constant similarity of the
        scene left out. The entropy rises with it. Every fourth view decides.
        """
        path = self.model.path(errors)
        by_point, moved, every = self._rows(path)
        points = self.standing.points
        arms = moved - points.mean(0)
        shifts = np.broadcast_to(np.eye(3), (*moved.shape, 3))
        similar = np.concatenate([-transforms.cross_matrix(arms), shifts, arms[..., None]], -1)
        across = np.einsum("vpki,vpin->vpkn", by_point, every).reshape(-1, self.model.size)
        basis, _ = np.linalg.qr((by_point @ similar).reshape(-1, 7))
        across = across - np.einsum("rk,kn->rn", basis, np.einsum("rk,rn->kn", basis, across))
        seen = np.einsum("rn,rm->nm", across, across) / moved[..., 0].size
        return self._known(path, every), seen

    def _rows(self, path: SensorPath) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of a few views: m at the isocenter by points (v, p, 2, 3), points, and both by errors."""
        points = self.standing.points
        motion, by = path.motion()[::_SPARSE], path.of_points(points)[::_SPARSE]
        moved = transforms.apply(motion, points)
        matrices = self.geometry.matrices[::_SPARSE, None]
        depths = (matrices[..., 2, :3] * moved).sum(-1) + matrices[..., 2, 3]
        rows = matrices[..., :3] @ moved[..., None] + matrices[..., 3:]
        pixels = rows[..., :2, :] / rows[..., 2:, :]
        by_point = matrices[..., :2, :3] - pixels * matrices[..., 2:, :3]
        by_point = pixel_at_isocenter(self.geometry) * by_point / depths[..., None, None]
        return by_point, moved, by

    def _share(self, views: int) -> float:
        """Weight of a displacement squared (1/m^2), of a few views."""
        count = len(self.geometry)
        return count / views * self.standing.weight(count) ** 2

    def _ankle(self, path: SensorPath) -> tuple[FloatArray, FloatArray]:
        """Its steps (s,) in standard deviations, and their changes (s, n); none without a foot."""
        count = path.twists.shape[-1]
        if self.foot is None:
            return np.zeros(0), np.zeros((0, count))
        steps, by = self.foot.steps(path, self.geometry.times)
        return steps.ravel(), by.reshape(-1, count)

    def _known(self, path: SensorPath, every: FloatArray) -> FloatArray:
        flat, (_, by_steps) = every.reshape(-1, self.model.size), self._ankle(path)
        known = np.eye(self.model.size) + by_steps.T @ by_steps
        return known + self._share(len(every)) * np.einsum("rn,rm->nm", flat, flat)

    def retracted(self, errors: FloatArray, motion: FloatArray) -> FloatArray:
        """The likeliest errors (n,) by which points are seen as along M(i) (v, 4, 4).

        Whole Gauss-Newton steps: bias and tilt hide each other along a curved valley, which a
        descent would crawl through.
        """
        points, target = self.standing.points, motion[::_SPARSE]
        wanted = transforms.apply(target, points)
        for _ in range(_ROUNDS):
            path = self.model.path(errors)
            by_point, moved, every = self._rows(path)
            share = self.weight * _CURVATURE / moved[..., 0].size
            across = np.einsum("vpki,vpin->vpkn", by_point, every).reshape(-1, self.model.size)
            off = np.einsum("vpki,vpi->vpk", by_point, moved - wanted).ravel()
            flat, standing = every.reshape(-1, self.model.size), self._share(len(moved))
            right = errors + share * np.einsum("rn,r->n", across, off)
            right = right + standing * np.einsum("rn,r->n", flat, (moved - points).ravel())
            steps, by_steps = self._ankle(path)
            right = right + by_steps.T @ steps
            matrix = self._known(path, every) + share * np.einsum("rn,rm->nm", across, across)
            step = np.linalg.solve(matrix, right)
            errors = errors - step
            if np.abs(step).max() < _STILL:
                break
        return errors


@dataclass(frozen=True, slots=True, eq=False)
class _Tangent:
    """Paths near one: each pose turned and shifted as if its errors acted linearly."""

    path: SensorPath
    twists: FloatArray
    """(v, 6, k) of the poses by k numbers"""

    def at(self, z: FloatArray) -> SensorPath:
        """The path of numbers (k,), with its exact derivatives."""
        found = np.einsum("vck,k->vc", self.twists, z)
        change = transforms.rigid(transforms.rotation_from_vector(found[:, :3]), found[:, 3:])
        turn = _left_jacobian(found[:, :3]) @ self.twists[:, :3]
        shift = self.twists[:, 3:] + transforms.cross_matrix(found[:, 3:]) @ turn
        return SensorPath(change @ self.path.poses, np.concatenate([turn, shift], 1))


def by_errors(by_motion: FloatArray, path: SensorPath) -> FloatArray:
    """(n,) from derivatives by M(i) (v, 4, 4): dM(i) = E(i) M(i) - M(i) E(0)."""
    motion = path.motion()
    left = _twists(by_motion @ np.swapaxes(motion, -1, -2))
    right = _twists((np.swapaxes(motion, -1, -2) @ by_motion).sum(0))
    return np.einsum("vk,vkn->n", left, path.twists) - np.einsum("k,kn->n", right, path.twists[0])


def _twists(generators: FloatArray) -> FloatArray:
    """(..., 6) from derivatives by the entries of generators (..., 4, 4)."""
    turns = [generators[..., j, i] - generators[..., i, j] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([np.stack(turns, -1), generators[..., :3, 3]], -1)


def similarity_part(
    by_motion: FloatArray, motion: FloatArray, geometry: ConeBeamGeometry, middle: FloatArray
) -> FloatArray:
    """The part (v, 4, 4) of derivatives by M(i) that tells scenes apart which look the same.

    One rigid motion before all M(i), and a step along the source's path with another size, change
    no image. A criterion of a box that stands in space changes by them all the same: the leg moves
    through its ends. Less this part it does not, to first order about ``motion``; ``middle`` (3,)
    is where the leg is.
    """
    turns = transforms.cross_matrix(np.eye(3))
    before = np.zeros((7, len(motion), 4, 4))
    # about the middle, in m at 5 cm from it
    before[:3, :, :3, :3] = turns[:, None] / _ARM
    before[:3, :, :3, 3] = -(turns @ middle)[:, None] / _ARM
    before[3:6, :, :3, 3] = np.eye(3)[:, None]
    ways = motion @ before
    ways[6, :, :3, 3] = geometry.sources() - geometry.rotation_center()
    twists = ways @ transforms.inverse(motion)
    # as turns about the middle in units of the same effect, and shifts of it
    flat = np.concatenate(
        [
            _ARM * np.stack([twists[..., 2, 1], twists[..., 0, 2], twists[..., 1, 0]], -1),
            (twists @ np.append(middle, 1.0))[..., :3],
        ],
        -1,
    )
    wanted = np.einsum("kvij,vij->k", ways, by_motion)
    shares = np.linalg.lstsq(np.einsum("kvi,lvi->kl", flat, flat), wanted, rcond=1e-12)[0]
    forms = np.einsum("k,kvi->vi", shares, flat)
    generators = np.zeros_like(motion)
    generators[:, :3, :3] = 0.5 * _ARM * transforms.cross_matrix(forms[:, :3])
    generators[:, :3, :3] += forms[:, 3:, None] * middle
    generators[:, :3, 3] = forms[:, 3:]
    return generators @ np.swapaxes(transforms.inverse(motion), -1, -2)


@dataclass(frozen=True, slots=True, eq=False)
class _Descent:
    """The cost near some errors, by the few ways to be wrong that images see."""

    problem: ImageProblem
    errors: FloatArray
    """(n,)"""
    ways: FloatArray
    """(n, k), in steps that the expected curvature makes alike"""
    near: _Tangent

    @classmethod
    def at(cls, problem: ImageProblem, errors: FloatArray, least: float) -> "_Descent | None":
        """Ways that images see by ``least`` (m) in one standard deviation; None: there is none.

        The others stay as the priors have them, and so do not follow the criterion's own errors.
        """
        known, seen = problem.known_and_seen(errors)
        squares, ways = eigh(seen, known)
        kept = squares > least**2
        if not kept.any():
            return None
        ways = ways[:, kept] / np.sqrt(1 + problem.weight * _CURVATURE * squares[kept])
        path = problem.model.path(errors)
        near = _Tangent(path, np.einsum("vcn,nk->vck", path.twists, ways))
        return cls(problem, errors, ways, near)

    def cost(self, z: FloatArray) -> tuple[float, FloatArray]:
        """Cost at numbers (k,) along the ways, and its derivatives (k,)."""
        value, slopes, _ = self.problem.of_path(self.near.at(z))
        there = self.errors + self.ways @ z
        return value + 0.5 * float((there**2).sum()), slopes + self.ways.T @ there

    def curvature(self, slopes: FloatArray) -> FloatArray:
        """Second derivatives (k, k) from slopes a step downhill along each way."""
        found = np.empty((len(slopes), len(slopes)))
        for way, slope in enumerate(slopes):
            z = np.zeros(len(slopes))
            z[way] = -np.copysign(_DIFFERENCE, slope)
            found[way] = (self.cost(z)[1] - slopes) / z[way]
        return 0.5 * (found + found.T)

    def end(self, z: FloatArray, evaluations: int, trust: float = 1.0) -> ImageFit:
        """The model's own path nearest to the tangent's."""
        guess, problem = self.errors + self.ways @ z, self.problem
        stiff = replace(problem, weight=trust * problem.weight)
        best = stiff.retracted(guess, self.near.at(z).motion())
        return ImageFit(best, problem.cost(best)[2], evaluations)


def fitted(problem: ImageProblem, errors: FloatArray, iterations: int) -> ImageFit:
    """Descends from ``errors`` along what images may see of them, by L-BFGS."""
    descent = _Descent.at(problem, errors, _SEEN)
    if descent is None:
        return ImageFit(errors, problem.cost(errors)[2], 1)
    found = minimize(
        descent.cost,
        np.zeros(descent.ways.shape[1]),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": iterations, "maxcor": _MEMORY, "ftol": _SETTLED, "gtol": 1e-2},
    )
    return descent.end(found.x, int(found.nfev))


def sharpened(problem: ImageProblem, errors: FloatArray, steps: int) -> ImageFit:
    """Descends by Newton's steps, for errors that are small already.

    The criterion's curvature along each way differs tenfold from the expected one, and L-BFGS stops
    far above the least cost. Here it is measured, at the price of an evaluation for each way, and
    smaller errors are sought. Directions that curve downwards count as if they curved upwards.
    """
    descent = _Descent.at(problem, errors, _SEEN_FINE)
    if descent is None:
        return ImageFit(errors, problem.cost(errors)[2], 1)
    z = np.zeros(descent.ways.shape[1])
    value, slopes = descent.cost(z)
    sizes, axes = np.linalg.eigh(descent.curvature(slopes))
    sizes = np.maximum(np.abs(sizes), _FLATTEST * float(np.median(np.abs(sizes))))
    evaluations = 1 + len(z)
    for _ in range(steps):
        step, before = -axes @ ((axes.T @ slopes) / sizes), value
        for share in _SHARES:
            tried, there = descent.cost(z + share * step)
            evaluations += 1
            if tried < value:
                z, value, slopes = z + share * step, tried, there
                break
        if before - value < _GAINED:
            break
    return descent.end(z, evaluations, _TRUST)
