"""Joint coordinates from markers: weighted least squares with joint limits, solved for many frames at once.

Minimized at each frame: sum over seen markers of weight |model - measured|^2, plus weak priors that decide what the markers leave open.
The Gauss-Newton matrix of such a sum is the joint-space inertia of the leg if its mass sat in the markers, so it is composed like one
(composite rigid bodies, Featherstone 1983): 22 sums a marker instead of its Jacobian, and the second derivatives come along for nothing.
Damped as by Levenberg and Marquardt; coordinates at a limit that want to go beyond it are held (projected Newton, Bertsekas 1982).
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from legsim import transforms
from legsim.anatomy import MarkerSites, segment_index
from legsim.arrays import FloatArray, frozen, frozen_owned
from legsim.errors import LegsimError
from legsim.leg import COORDINATES, Kinematics, Leg, marker_rows
from legsim.signals import JointTrajectories, Motion

Progress = Callable[[int, int], None]

_CHUNK = 256
"""frames solved together: few enough for their arrays to stay in the cache"""
_CLOSE = 16
"""frames that a cubic may span; farther apart it overshoots"""
_REACH = 4
"""frames at a time that a gap with few markers is solved inwards by"""
_FIRST_DAMPING = 1e-5
"""of the curvature's diagonal; below it and at it the curvature is exact"""
_ASTRAY = np.radians(20.0)
"""rad of pelvis rotation: a start that is turned farther from the pelvis' own markers begins at these"""
_STARTS_DEG = ((10.0, -10.0, 0.0), (50.0, -60.0, 15.0), (90.0, -100.0, 30.0))
"""hip flexion, knee angle, ankle angle that an anchor frame is tried from: standing, half and deep squat"""


@dataclass(frozen=True, slots=True)
class CoordinatePrior:
    """A coordinate is pulled to a value: adds ``weight * (coordinate - value)^2`` to the sum over the markers."""

    coordinate: str
    weight: float
    """m^2/rad^2: (marker error / coordinate's spread)^2"""
    value: float = 0.0
    """rad"""


def _default_priors() -> tuple[CoordinatePrior, ...]:
    # 5 mm of marker error against 10 degrees of spread: decides hip rotation when the knee is straight, hardly counts when it is bent
    weak = (("hip_rotation", 8e-4), ("subtalar_angle", 1e-7), ("mtp_angle", 1e-7))
    return tuple(CoordinatePrior(f"{name}_{side}", weight) for name, weight in weak for side in "rl")


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """How markers become coordinates."""

    priors: tuple[CoordinatePrior, ...] = field(default_factory=_default_priors)
    """hip rotation toward neutral, toes straight; subtalar so weakly that the flat foot decides"""
    flat_foot_weight: float = 1e-5
    """m^2: of the squared horizontal part of each foot's upright axis; where no marker sits on the foot it stands flat on the floor"""
    tolerance: float = 1e-9
    """m: converged when no free coordinate's gradient, over the root of its own curvature, exceeds this"""
    max_iterations: int = 200
    """of one frame; a frame that has not converged by then is counted in the report"""
    strides: tuple[int, ...] = (64, 8, 1)
    """frames between those solved first, from scratch; then ever closer ones, each started between solved neighbors"""


@dataclass(frozen=True, slots=True, eq=False)
class IkReport:
    """How well the model follows the markers."""

    marker_names: tuple[str, ...]
    marker_rms: FloatArray
    """(m,) m, over the frames that show the marker; NaN for one that is never seen"""
    marker_worst: FloatArray
    """(m,) m"""
    marker_worst_frame: np.ndarray
    """(m,) int"""
    marker_seen: np.ndarray
    """(m,) int, frames that show the marker"""
    coordinate_names: tuple[str, ...]
    coordinate_share: FloatArray
    """(20,) how much of each coordinate the markers decide, 0 to 1; the rest is the priors'"""
    coordinate_at_limit: np.ndarray
    """(20,) int, frames in which a joint limit holds the coordinate"""
    frames: int
    frames_unseen: np.ndarray
    """indices of frames that show no marker, bridged between their neighbors"""
    frames_unconverged: np.ndarray
    """indices of frames that did not reach the tolerance"""
    iterations: float
    """mean over the frames"""

    @property
    def rms(self) -> float:
        """m, over all seen markers and frames."""
        seen = self.marker_seen > 0
        return float(np.sqrt(np.sum(self.marker_rms[seen] ** 2 * self.marker_seen[seen]) / max(self.marker_seen.sum(), 1)))


class Solution(NamedTuple):
    """What :func:`solve` finds."""

    trajectories: JointTrajectories
    report: IkReport
    modelled: Motion
    """where the solved model has the markers"""


def solve(
    leg: Leg, motion: Motion, sites: MarkerSites, config: ReplayConfig | None = None, *, progress: Progress | None = None
) -> Solution:
    """Joint coordinates that bring the model's markers closest to the measured ones, frame by frame.

    Args:
        leg: the scaled model.
        motion: markers named like ``sites``; NaN where not seen; other names are ignored.
        sites: where the markers sit on the scaled segments.
        config: priors and tolerances; the defaults suit the seven markers of the study as well as full sets.
        progress: told (frames done, frames in all).

    Raises:
        LegsimError: no frame shows three markers of the pelvis, or a leg has no marker at all.
    """
    config = config or ReplayConfig()
    sites = sites.only([name for name in motion.marker_names if name in sites.names and sites.weights[sites.index(name)] > 0])
    measured = motion.positions_world[:, [motion.marker_names.index(name) for name in sites.names]]
    problem = _Problem(leg, sites, config)
    seen = np.asarray(np.isfinite(measured).all(-1))
    values, trace = _solve_all(problem, measured, seen, progress)
    trajectories = JointTrajectories(motion.times, leg.coordinate_names, values)
    modelled = Motion(motion.times, sites.names, leg.marker_positions(values, sites))
    return Solution(trajectories, _report(problem, values, trace, measured, seen, modelled), modelled)


def calibrate(leg: Leg, motion: Motion, sites: MarkerSites, roles: Collection[str], config: ReplayConfig | None = None) -> MarkerSites:
    """Sites with those in ``roles`` moved to where the recording shows them on the model posed by all the others (median over frames).

    This is OpenSim's marker placer for clusters whose place differs between laboratories; landmarks keep their places.
    """
    landmarks = sites.only([name for name in sites.names if name not in roles])
    poses = leg.segment_poses(solve(leg, motion, landmarks, config).trajectories)
    positions = sites.positions.copy()
    for k, (name, segment) in enumerate(zip(sites.names, sites.segments, strict=True)):
        if name in roles and name in motion.marker_names:
            local = transforms.apply(transforms.inverse(poses.of(segment)), motion.marker(name)[:, None])[:, 0]
            if np.isfinite(local).any():
                positions[k] = np.nanmedian(local, axis=0)
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


class _State(NamedTuple):
    """The sum at some coordinates, n frames."""

    values: FloatArray
    cost: FloatArray
    gradient: FloatArray
    curvature: FloatArray
    scale: FloatArray
    """(n, 20) diagonal of the Gauss-Newton matrix"""


class _Problem:
    """The least-squares problem of one leg and marker set."""

    def __init__(self, leg: Leg, sites: MarkerSites, config: ReplayConfig) -> None:
        self.leg, self.sites, self.config = leg, sites, config
        for side, word in (("r", "right"), ("l", "left")):
            if not any(s.endswith(f"_{side}") for s in sites.segments):
                raise LegsimError(f"no marker sits on the {word} leg; complete the marker map")
        self.rows = marker_rows(sites)
        self.pelvis_rows = [k for k, segment in enumerate(sites.segments) if segment == "pelvis"]
        self.subtrees = leg.moves[:, self.rows].astype(float)
        related = (leg.moves[:, None] & leg.moves[None]).any(-1)
        self._related = np.triu(related).astype(float)
        # the pelvis translates along the world's axes, whatever its turn
        self._turning = self._related.copy()
        self._turning[:3, 3:6] = 0
        self._diagonal = np.arange(len(COORDINATES))
        self._feet = [segment_index(f"calcn_{side}") for side in "rl"]
        self._prior_weights, self._prior_values = np.zeros((2, len(COORDINATES)))
        for prior in config.priors:
            if prior.coordinate not in COORDINATES:
                raise LegsimError(f"no coordinate named {prior.coordinate!r} for a prior; there are: {', '.join(COORDINATES)}")
            column = COORDINATES.index(prior.coordinate)
            self._prior_weights[column], self._prior_values[column] = prior.weight, prior.value
        limits = leg.coordinate_ranges.copy()
        limits[:6] = -np.inf, np.inf
        self.low, self.high = limits.T

    def at(self, values: FloatArray, measured: FloatArray, weights: FloatArray, exact: np.ndarray) -> _State:
        """Cost, gradient and curvature at values (n, 20); ``weights`` (n, m) are 0 where a marker is not seen.

        The curvature is Gauss and Newton's, with the second derivatives of the markers where ``exact`` (n,) says so.
        """
        pose = self.leg.kinematics(values)
        # about the pelvis, so that a subject far from the world's origin loses no digits
        center = pose.origins[:, :1]
        angular, linear = pose.angular, pose.linear + _cross(pose.angular, center)
        points = pose.origins[:, self.rows] + (pose.rotations[:, self.rows] @ self.sites.positions[..., None])[..., 0]
        residuals = np.where(weights[..., None] > 0, points - measured, 0.0)
        cost = 0.5 * (weights * (residuals**2).sum(-1)).sum(1)
        gradient, upper, bend = self._composite(angular, linear, points - center, residuals, weights)
        away = values - self._prior_values
        gradient += self._prior_weights * away
        upper[:, self._diagonal, self._diagonal] += self._prior_weights
        cost = cost + 0.5 * (self._prior_weights * away**2).sum(1) + self._add_flat_feet(pose, gradient, upper, bend)
        scale = np.einsum("ncc->nc", upper).copy()
        upper[exact] += bend[exact]
        curvature = upper + np.swapaxes(np.triu(upper, 1), -1, -2)
        return _State(values, cost, gradient, curvature, scale)

    def _composite(
        self, angular: FloatArray, linear: FloatArray, points: FloatArray, residuals: FloatArray, weights: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradient (n, 20), upper triangles (n, 20, 20) of the Gauss-Newton matrix and of the second derivatives, from sums over subtrees.

        The knee's own glide is left out of its second derivative; that costs an iteration, not accuracy.
        """
        n, m = weights.shape
        force, mass_points = weights[..., None] * residuals, weights[..., None] * points
        squares = (mass_points[..., :, None] * points[..., None, :]).reshape(n, m, 9)
        works = (points[..., :, None] * force[..., None, :]).reshape(n, m, 9)
        sums = self.subtrees @ np.concatenate([weights[..., None], mass_points, force, squares, works], -1)
        mass, first, push = sums[..., :1], sums[..., 1:4], sums[..., 4:7]
        second, work = sums[..., 7:16].reshape(n, -1, 3, 3), sums[..., 16:].reshape(n, -1, 3, 3)
        torque = np.stack([work[..., a, b] - work[..., b, a] for a, b in ((1, 2), (2, 0), (0, 1))], -1)
        gradient = (linear * push).sum(-1) + (angular * torque).sum(-1)
        shift = mass * linear + _cross(angular, first)
        twist = _cross(first, linear) + _traced(second, angular)
        upper = (np.concatenate([linear, angular], -1) @ np.swapaxes(np.concatenate([shift, twist], -1), -1, -2)) * self._related
        turned = _cross(linear, push) - _traced(work, angular)
        return gradient, upper, (angular @ np.swapaxes(turned, -1, -2)) * self._turning

    def _add_flat_feet(self, pose: Kinematics, gradient: FloatArray, upper: FloatArray, bend: FloatArray) -> FloatArray:
        """Adds the prior on the feet to gradient and upper triangles in place; returns its cost (n,)."""
        weight, cost = self.config.flat_foot_weight, np.zeros(len(gradient))
        for foot in self._feet if weight > 0 else ():
            angular, upright = pose.angular * self.leg.moves[:, foot, None], pose.rotations[:, foot, :, 1]
            lean = upright * (1.0, 0.0, 1.0)
            turns = _cross(angular, upright[:, None])
            flat = turns * (1.0, 0.0, 1.0)
            gradient += weight * (turns @ lean[..., None])[..., 0]
            upper += (weight * self._related) * (flat @ np.swapaxes(flat, -1, -2))
            bend += (weight * self._related) * (angular @ np.swapaxes(_cross(turns, lean[:, None]), -1, -2))
            cost += 0.5 * weight * (lean**2).sum(1)
        return cost

    def pelvis_starts(self, measured: FloatArray) -> FloatArray:
        """Pelvis coordinates (n, 6) from its own markers (n, m, 3), three seen at least; angles run on past half a turn."""
        rows = np.array(self.pelvis_rows)
        found = np.empty((len(measured), 6))
        for i, frame in enumerate(measured[:, rows]):
            use = np.isfinite(frame[:, 0])
            pose = transforms.best_rigid(self.sites.positions[rows[use]], frame[use], self.sites.weights[rows[use]])
            found[i] = *_pelvis_angles(pose[:3, :3]), *pose[:3, 3]
        found[:, :3] = np.unwrap(found[:, :3], axis=0)
        return found


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product on the last axis; np.cross without its overhead."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    return np.stack([x, y, a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]], -1)


def _traced(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """(trace(M) - M) v."""
    trace = matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2]
    return trace[..., None] * vectors - np.einsum("ncij,ncj->nci", matrices, vectors)


def _pelvis_angles(rotation: FloatArray) -> tuple[float, float, float]:
    """Tilt (z), list (x), rotation (y) of a pelvis whose rotation is Rz Rx Ry."""
    r = rotation
    return float(np.arctan2(-r[0, 1], r[1, 1])), float(np.arcsin(np.clip(r[2, 1], -1, 1))), float(np.arctan2(-r[2, 0], r[2, 2]))


class _Trace(NamedTuple):
    iterations: np.ndarray
    converged: np.ndarray


def _solve_all(problem: _Problem, measured: FloatArray, seen: np.ndarray, progress: Progress | None) -> tuple[FloatArray, _Trace]:
    """A few frames from scratch, then ever more of them from between their neighbors; frames that show nothing are bridged."""
    n, weights = len(measured), seen * problem.sites.weights
    trace = _Trace(np.zeros(n, int), np.zeros(n, bool))
    upright = seen[:, problem.pelvis_rows].sum(1) >= 3
    if not upright.any():
        raise LegsimError("no frame shows three markers of the pelvis; the motion cannot be solved")
    pelvis = np.full((n, 6), np.nan)
    pelvis[upright] = problem.pelvis_starts(measured[upright])
    usable = np.flatnonzero(_all_segments_shown(problem, seen, upright))
    first, *finer = problem.config.strides
    solved = _every(usable, first)
    values = _from_scratch(problem, pelvis[solved], measured[solved], weights[solved])
    for stride in finer:
        frames = _every(usable, stride)
        values = _starts(frames, solved, values)
        _turn_along(values, pelvis[frames])
        for chunk in np.array_split(np.arange(len(frames)), max(1, len(frames) // _CHUNK)):
            rows = frames[chunk]
            state, iterations, converged = _minimize(problem, values[chunk], measured[rows], weights[rows])
            values[chunk], trace.iterations[rows], trace.converged[rows] = state.values, trace.iterations[rows] + iterations, converged
            if progress and stride == 1:
                progress(int(rows[-1]) + 1, n)
        solved = frames
    everywhere = _between(np.arange(n), solved, values)
    solved = _march(problem, everywhere, solved, pelvis, measured, weights, trace)
    if progress:
        progress(n, n)
    return _between(np.arange(n), solved, everywhere[solved]), trace


def _all_segments_shown(problem: _Problem, seen: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(n,) which of the frames ``shown`` show a marker of every segment that has one, as far as there are such frames."""
    for segment in sorted({problem.sites.segments[k] for k in range(seen.shape[1])} - {"pelvis"}):
        here = seen[:, [k for k, name in enumerate(problem.sites.segments) if name == segment]].any(1)
        shown = shown & here if (shown & here).any() else shown
    return shown


def _march(
    problem: _Problem,
    values: FloatArray,
    solved: np.ndarray,
    pelvis: FloatArray,
    measured: FloatArray,
    weights: FloatArray,
    trace: _Trace,
) -> np.ndarray:
    """Solves in ``values`` (n, 20) what markers are left for, a few frames at a time from either side of each gap; frames solved in all.

    A frame starts as far from the one before it as the straight line across the gap goes; a coordinate that moves no marker in sight
    stays on that line.
    """
    line, done, rest = values.copy(), np.zeros(len(values), bool), np.asarray(weights.any(1))
    done[solved], rest[solved] = True, False
    lost = ((weights > 0) @ problem.subtrees.T == 0) & problem.subtrees.any(1) & rest[:, None]
    # and what hangs on it
    moves = problem.leg.moves
    lost = lost @ (moves[:, None] >= moves[None]).all(-1)
    while rest.any():
        known, frames = np.flatnonzero(done), np.flatnonzero(rest)
        after = np.searchsorted(known, frames)
        left, right = known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]
        nearest = np.where(np.abs(frames - left) <= np.abs(right - frames), left, right)
        away = np.abs(frames - nearest)
        reach = max(_REACH, int(away.min()))
        rows, source = frames[away <= reach], nearest[away <= reach]
        starts = values[source] + line[rows] - line[source]
        _turn_along(starts, pelvis[rows])
        state, iterations, converged = _minimize(problem, starts, measured[rows], weights[rows])
        values[rows], trace.iterations[rows], trace.converged[rows] = state.values, iterations, converged
        done[rows], rest[rows] = True, False
    values[lost] = line[lost]
    return np.flatnonzero(done)


def _every(frames: np.ndarray, stride: int) -> np.ndarray:
    """The first of ``frames`` in every stretch of ``stride``, and the last of all."""
    return np.unique([*frames[np.unique(frames // stride, return_index=True)[1]], frames[-1]])


def _starts(frames: np.ndarray, solved: np.ndarray, values: FloatArray) -> FloatArray:
    """Where to start (n, 20) at ``frames``: on a cubic between close neighbors, so that two steps do; straight across wide gaps."""
    straight = _between(frames, solved, values)
    if len(solved) < 4:
        return straight
    after = np.clip(np.searchsorted(solved, frames), 1, len(solved) - 1)
    close = solved[after] - solved[after - 1] <= _CLOSE
    return np.where(close[:, None], CubicSpline(solved, values)(frames), straight)


def _turn_along(values: FloatArray, pelvis: FloatArray) -> None:
    """Puts the pelvis of starts (n, 20) where its own markers have it (n, 6; NaN: unseen), if it turned too far meanwhile."""
    astray = np.abs(values[:, 2] - pelvis[:, 2]) > _ASTRAY
    values[astray, :6] = pelvis[astray]


def _between(frames: np.ndarray, solved: np.ndarray, values: FloatArray) -> FloatArray:
    """Values (n, 20) at ``frames``, straight between the solved ones."""
    return np.stack([np.interp(frames, solved, column) for column in values.T], -1)


def _from_scratch(problem: _Problem, pelvis: FloatArray, measured: FloatArray, weights: FloatArray) -> FloatArray:
    """Best solution (n, 20) over the starting postures."""
    best: _State | None = None
    for posture in _STARTS_DEG:
        start = np.zeros((len(pelvis), len(COORDINATES)))
        start[:, :6] = pelvis
        for name, angle in zip(("hip_flexion", "knee_angle", "ankle_angle"), np.radians(posture), strict=True):
            for side in "rl":
                start[:, COORDINATES.index(f"{name}_{side}")] = angle
        state, _, _ = _minimize(problem, start, measured, weights)
        if best is None:
            best = state
        else:
            better = state.cost < best.cost
            best = _State(*(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(state, best, strict=True)))
    assert best is not None
    return best.values


def _minimize(problem: _Problem, start: FloatArray, measured: FloatArray, weights: FloatArray) -> tuple[_State, np.ndarray, np.ndarray]:
    """Damped Newton within the limits from start (n, 20); final state, iterations (n,), converged (n,)."""
    n = len(start)
    measured = np.where(weights[..., None] > 0, measured, 0.0)
    damping = np.full(n, _FIRST_DAMPING)
    state = problem.at(np.clip(start, problem.low, problem.high), measured, weights, damping < _FIRST_DAMPING)
    iterations, held = np.zeros(n, int), _held(problem, state)
    open_frames = np.flatnonzero(~_converged(problem, state, held))
    for _ in range(problem.config.max_iterations):
        if len(open_frames) == 0:
            break
        now, damp = _State(*(a[open_frames] for a in state)), damping[open_frames]
        step = _step(now, held[open_frames], damp)
        # second derivatives help once steps succeed; far away they may point uphill
        exact = damp <= _FIRST_DAMPING
        trial = problem.at(np.clip(now.values + step, problem.low, problem.high), measured[open_frames], weights[open_frames], exact)
        # near the end cost differences drown in rounding
        accepted = trial.cost <= now.cost * (1 + 1e-13)
        taken = open_frames[accepted]
        for whole, part in zip(state, trial, strict=True):
            whole[taken] = part[accepted]
        damping[open_frames] = np.where(accepted, damp / 10, np.maximum(damp, _FIRST_DAMPING / 10) * 10)
        iterations[open_frames] += 1
        held[taken] = _held(problem, _State(*(a[taken] for a in state)))
        still = ~_converged(problem, _State(*(a[open_frames] for a in state)), held[open_frames])
        open_frames = open_frames[still]
    converged = np.ones(n, bool)
    converged[open_frames] = False
    return state, iterations, converged


def _held(problem: _Problem, state: _State) -> np.ndarray:
    """(n, 20) coordinates at a limit that the gradient pushes beyond it."""
    return ((state.values <= problem.low) & (state.gradient > 0)) | ((state.values >= problem.high) & (state.gradient < 0))


def _converged(problem: _Problem, state: _State, held: np.ndarray) -> np.ndarray:
    scaled = np.abs(state.gradient) / np.sqrt(np.maximum(state.scale, 1e-12))
    return np.where(held, 0.0, scaled).max(1) <= problem.config.tolerance


def _step(state: _State, held: np.ndarray, damping: FloatArray) -> FloatArray:
    """Levenberg-Marquardt step (n, 20) of the free coordinates."""
    free = ~held
    matrix = state.curvature * (free[:, :, None] & free[:, None, :])
    diagonal = np.arange(matrix.shape[1])
    matrix[:, diagonal, diagonal] += damping[:, None] * state.scale + np.where(held, 1.0, 1e-12)
    step = np.linalg.solve(matrix, np.where(held, 0.0, state.gradient)[..., None])[..., 0]
    return -np.asarray(step, np.float64)


def _report(problem: _Problem, values: FloatArray, trace: _Trace, measured: FloatArray, seen: np.ndarray, modelled: Motion) -> IkReport:
    errors = np.linalg.norm(modelled.positions_world - measured, axis=-1)
    shown = np.where(seen, errors, -1.0)
    count = seen.sum(0)
    squares = np.where(seen, errors, 0.0) ** 2
    rms = np.sqrt(squares.sum(0) / np.where(count > 0, count, np.nan))
    at_limit = (values <= problem.low + 1e-9) | (values >= problem.high - 1e-9)
    return IkReport(
        marker_names=problem.sites.names,
        marker_rms=frozen("marker_rms", rms, (None,)),
        marker_worst=frozen("marker_worst", np.where(count > 0, shown.max(0), np.nan), (None,)),
        marker_worst_frame=frozen_owned(shown.argmax(0)),
        marker_seen=frozen_owned(count),
        coordinate_names=COORDINATES,
        coordinate_share=_marker_share(problem, values, seen),
        coordinate_at_limit=frozen_owned(at_limit.sum(0)),
        frames=len(values),
        frames_unseen=frozen_owned(np.flatnonzero(~seen.any(1))),
        frames_unconverged=frozen_owned(np.flatnonzero(~trace.converged & seen.any(1))),
        iterations=float(trace.iterations.mean()),
    )


def _marker_share(problem: _Problem, values: FloatArray, seen: np.ndarray) -> FloatArray:
    """Diagonal (20,) of (markers + priors)^-1 markers, mean over some twenty frames."""
    some = np.unique(np.linspace(0, len(values) - 1, 20).astype(int))
    weights = seen[some] * problem.sites.weights
    measured = np.zeros((len(some), len(problem.rows), 3))
    plain = np.zeros(len(some), bool)
    whole = problem.at(values[some], measured, weights, plain).curvature
    priors = problem.at(values[some], measured, 0 * weights, plain).curvature
    # what neither markers nor priors see belongs to nobody
    whole = whole + 1e-12 * np.eye(len(COORDINATES))
    share = 1 - np.einsum("nij,nji->ni", np.linalg.inv(whole), priors + 1e-12 * np.eye(len(COORDINATES)))
    return frozen("share", np.mean(np.clip(share, 0, 1), axis=0), (None,))
