"""The least-squares problem of inverse kinematics: residuals, priors, limits and Jacobian."""

from typing import NamedTuple

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics import _planted_feet
from legsim.kinematics.ik_options import CoordinateLock, CoordinateTask, IkOptions, leg_priors
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import Kinematics, LegModel, marker_rows
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import segment_index

_ROUNDING = 1e-6
"""rad or m that a locked value may lie beyond its range: files hold few digits"""

_STRAIGHT = np.radians(10.0)
"""rad of hyperextension from which a knee is drawn back"""

_OF_FOOT = ("ankle_angle", "subtalar_angle")
"""beginnings of coordinates that turn a foot about its shank"""

_UNSEEN, _LOCK = 1e-12, 1e12
"""m^2/rad^2 of priors that stand for no prior and for a lock"""


class State(NamedTuple):
    """The sum at some coordinates, n frames."""

    values: FloatArray
    cost: FloatArray
    gradient: FloatArray
    curvature: FloatArray
    scale: FloatArray
    """(n, 20) diagonal of the Gauss-Newton matrix"""


class Problem:
    """The least-squares problem of one leg and marker set."""

    def __init__(self, leg: Leg, sites: MarkerSites, config: IkOptions) -> None:
        config = config.settled(leg_priors())
        self.leg, self.sites, self.config = leg, sites, config
        for side, word in (("r", "right"), ("l", "left")):
            if not any(s.endswith(f"_{side}") for s in sites.segments):
                raise LegsimError(f"no marker sits on the {word} leg; complete the marker map")
        self.rows = marker_rows(sites)
        # the others are pegs of planted feet
        self.markers = np.array([not _planted_feet.is_peg(name) for name in sites.names])
        self.pelvis_rows = [k for k, segment in enumerate(sites.segments) if segment == "pelvis"]
        self.subtrees = leg.moves[:, self.rows].astype(float)
        related = (leg.moves[:, None] & leg.moves[None]).any(-1)
        self._related = np.triu(related).astype(float)
        # the pelvis translates along the world's axes, whatever its turn
        self._turning = self._related.copy()
        names = leg.coordinate_names
        pelvis = names[: leg.pelvis_coordinates]
        self._turning[:, [k for k, name in enumerate(pelvis) if name in leg.shifts]] = 0
        self._pelvis_turns = [k for k, name in enumerate(pelvis) if name not in leg.shifts]
        self._diagonal = np.arange(len(names))
        self._feet = [segment_index(f"calcn_{side}") for side in "rl"]
        self.prior_weights, self.prior_values, self.task_weights = np.zeros((3, len(names)))
        for prior in config.priors or ():
            column = self._column(prior.coordinate, "prior")
            self.prior_weights[column], self.prior_values[column] = prior.weight, prior.value
        for k in self._hanging():
            if self.prior_weights[k] < config.flat_foot_weight:
                self.prior_weights[k] = config.flat_foot_weight
                self.prior_values[k] = leg.default_coordinates[k]
        for task in config.tasks:
            if task.weight > 0:
                column = self._column(task.coordinate, "task")
                self.prior_weights[column], self.task_weights[column] = 0.0, task.weight
                self.prior_values[column] = self._value(task, column)
        limits = leg.coordinate_ranges.copy()
        limits[: leg.pelvis_coordinates] = -np.inf, np.inf
        self.locked = np.zeros(len(names), bool)
        for lock in config.locked:
            column = self._column(lock.coordinate, "lock")
            limits[column], self.locked[column] = self._locked_value(lock, column, limits), True
        self.low, self.high = limits.T
        self._straight = np.full(len(names), np.inf)
        if isinstance(leg, LegModel):
            knees = [k for k, name in enumerate(names) if name.startswith("knee_angle")]
            self._straight[knees] = _STRAIGHT

    def _hanging(self) -> list[int]:
        """Joints that hold the foot of somebody who lies."""
        names = self.leg.coordinate_names
        on_floor = self.config.feet_on_floor
        return [] if on_floor else [k for k, name in enumerate(names) if name.startswith(_OF_FOOT)]

    def _column(self, coordinate: str, what: str) -> int:
        names = self.leg.coordinate_names
        if coordinate not in names:
            raise LegsimError(
                f"unknown coordinate {coordinate!r} for a {what}; known: {', '.join(names)}"
            )
        return names.index(coordinate)

    def _value(self, entry: CoordinateTask | CoordinateLock, column: int) -> float:
        """Value of a task or lock, rad or m."""
        unit = "m" if entry.coordinate in self.leg.shifts else "rad"
        if entry.unit not in ("", unit):
            kind, fix = ("a length", "mm or m") if unit == "m" else ("an angle", "degrees or rad")
            raise LegsimError(f"{entry.coordinate} is {kind}; give its value in {fix}")
        default = float(self.leg.default_coordinates[column])
        return default if entry.value is None else entry.value

    def _locked_value(self, lock: CoordinateLock, column: int, limits: FloatArray) -> float:
        value, (low, high) = self._value(lock, column), limits[column]
        if not low - _ROUNDING <= value <= high + _ROUNDING:
            shift = lock.coordinate in self.leg.shifts
            unit, by = ("mm", 1e3) if shift else ("deg", np.degrees(1.0))
            raise LegsimError(
                f"{lock.coordinate} cannot be locked at {by * value:g} {unit}: its range is "
                f"{by * low:.4g} to {by * high:.4g} {unit}"
            )
        return value

    def floor(self) -> FloatArray:
        """(c, c) curvature of what neither markers nor priors see, and of locks."""
        return np.diag(np.where(self.locked, _LOCK, _UNSEEN))

    def pulls(self, weights: FloatArray) -> FloatArray:
        """Weights (n, c) of priors and tasks in frames that show markers with ``weights`` (n, m).

        A task counts as in OpenSim, where the markers' sum is divided by that of their weights
        (Simbody's Markers::calcGoal).
        """
        return self.prior_weights + self.task_weights * weights.sum(1)[:, None]

    def at(
        self,
        values: FloatArray,
        measured: FloatArray,
        weights: FloatArray,
        exact: np.ndarray,
        pulls: FloatArray | None = None,
    ) -> State:
        """Cost, gradient and curvature at values (n, 20); ``weights`` (n, m) are 0 where a marker
        is not seen.

        ``pulls`` (n, c) are those of all priors and tasks, where not of the markers with
        ``weights``.

        The curvature is Gauss and Newton's, with the second derivatives of the markers where
        ``exact`` (n,) says so.
        """
        pose = self.leg.kinematics(values)
        # about the pelvis, so that a subject far from the world's origin loses no digits
        center = pose.origins[:, :1]
        angular, linear = pose.angular, pose.linear + transforms.cross(pose.angular, center)
        points = (
            pose.origins[:, self.rows]
            + (pose.rotations[:, self.rows] @ self.sites.positions[..., None])[..., 0]
        )
        residuals = np.where(weights[..., None] > 0, points - measured, 0.0)
        cost = 0.5 * (weights * (residuals**2).sum(-1)).sum(1)
        gradient, upper, bend = self._composite(
            angular, linear, points - center, residuals, weights
        )
        away = values - self.prior_values
        pulls = self.pulls(weights) if pulls is None else pulls
        gradient += pulls * away
        upper[:, self._diagonal, self._diagonal] += pulls
        beyond = np.maximum(values - self._straight, 0.0)
        draw = np.where(beyond > 0, self.config.hyperextension_weight, 0.0)
        gradient += draw * beyond
        upper[:, self._diagonal, self._diagonal] += draw
        cost = cost + 0.5 * (pulls * away**2 + draw * beyond**2).sum(1)
        cost = cost + self._add_flat_feet(pose, gradient, upper, bend)
        scale = np.einsum("ncc->nc", upper).copy()
        upper[exact] += bend[exact]
        curvature = upper + np.swapaxes(np.triu(upper, 1), -1, -2)
        return State(values, cost, gradient, curvature, scale)

    def _composite(
        self,
        angular: FloatArray,
        linear: FloatArray,
        points: FloatArray,
        residuals: FloatArray,
        weights: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradient (n, 20), upper triangles (n, 20, 20) of the Gauss-Newton matrix and of the
        second derivatives, from sums over subtrees.

        The knee's own glide is left out of its second derivative; that costs an iteration, not
        accuracy.
        """
        n, m = weights.shape
        force, mass_points = weights[..., None] * residuals, weights[..., None] * points
        squares = (mass_points[..., :, None] * points[..., None, :]).reshape(n, m, 9)
        works = (points[..., :, None] * force[..., None, :]).reshape(n, m, 9)
        sums = self.subtrees @ np.concatenate(
            [weights[..., None], mass_points, force, squares, works], -1
        )
        mass, first, push = sums[..., :1], sums[..., 1:4], sums[..., 4:7]
        second, work = sums[..., 7:16].reshape(n, -1, 3, 3), sums[..., 16:].reshape(n, -1, 3, 3)
        torque = np.stack(
            [work[..., a, b] - work[..., b, a] for a, b in ((1, 2), (2, 0), (0, 1))], -1
        )
        gradient = (linear * push).sum(-1) + (angular * torque).sum(-1)
        shift = mass * linear + transforms.cross(angular, first)
        twist = transforms.cross(first, linear) + _traced(second, angular)
        upper = (
            np.concatenate([linear, angular], -1)
            @ np.swapaxes(np.concatenate([shift, twist], -1), -1, -2)
        ) * self._related
        turned = transforms.cross(linear, push) - _traced(work, angular)
        return gradient, upper, (angular @ np.swapaxes(turned, -1, -2)) * self._turning

    def _add_flat_feet(
        self, pose: Kinematics, gradient: FloatArray, upper: FloatArray, bend: FloatArray
    ) -> FloatArray:
        """Adds the prior on the feet to gradient and upper triangles in place; returns its cost
        (n,).
        """
        weight = self.config.flat_foot_weight if self.config.feet_on_floor else 0.0
        cost = np.zeros(len(gradient))
        for foot in self._feet if weight > 0 else ():
            angular, upright = (
                pose.angular * self.leg.moves[:, foot, None],
                pose.rotations[:, foot, :, 1],
            )
            lean = upright * (1.0, 0.0, 1.0)
            turns = transforms.cross(angular, upright[:, None])
            flat = turns * (1.0, 0.0, 1.0)
            gradient += weight * (turns @ lean[..., None])[..., 0]
            upper += (weight * self._related) * (flat @ np.swapaxes(flat, -1, -2))
            bend += (weight * self._related) * (
                angular @ np.swapaxes(transforms.cross(turns, lean[:, None]), -1, -2)
            )
            cost += 0.5 * weight * (lean**2).sum(1)
        return cost

    def pelvis_starts(self, measured: FloatArray) -> FloatArray:
        """Pelvis coordinates (n, p) from its own markers (n, m, 3), three seen at least; angles run
        on past half a turn.
        """
        rows = np.array(self.pelvis_rows)
        poses = np.empty((len(measured), 4, 4))
        for i, frame in enumerate(measured[:, rows]):
            use = np.isfinite(frame[:, 0])
            poses[i] = transforms.best_rigid(
                self.sites.positions[rows[use]], frame[use], self.sites.weights[rows[use]]
            )
        found = self.leg.pelvis_values(poses)
        found[:, self._pelvis_turns] = np.unwrap(found[:, self._pelvis_turns], axis=0)
        return found


def _traced(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """(trace(M) - M) v."""
    trace = matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2]
    return trace[..., None] * vectors - np.einsum("ncij,ncj->nci", matrices, vectors)
