"""Joint coordinates from markers: weighted least squares with joint limits, solved for many frames
at once.

Minimized at each frame: sum over seen markers of weight |model - measured|^2, plus weak priors that
decide what the markers leave open. The Gauss-Newton matrix of such a sum is the joint-space inertia
of the leg if its mass sat in the markers, so it is composed like one (composite rigid bodies,
Featherstone 1983): 22 sums a marker instead of its Jacobian, and the second derivatives come along
for nothing. Damped as by Levenberg and Marquardt; coordinates at a limit that want to go beyond it
are held (projected Newton, Bertsekas 1982).
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, frozen_owned
from legsim.kinematics._ik_problem import Problem, ReplayConfig, State
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

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
"""rad of pelvis rotation: a start that is turned farther from the pelvis' own markers begins at
these
"""

_STARTS_DEG = ((10.0, -10.0, 0.0), (50.0, -60.0, 15.0), (90.0, -100.0, 30.0))
"""hip flexion, knee angle, ankle angle that an anchor frame is tried from: standing, half and deep
squat
"""


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
        return float(
            np.sqrt(
                np.sum(self.marker_rms[seen] ** 2 * self.marker_seen[seen])
                / max(self.marker_seen.sum(), 1)
            )
        )


class Solution(NamedTuple):
    """What :func:`solve` finds."""

    trajectories: JointTrajectories
    report: IkReport
    modelled: MarkerTrajectories
    """where the solved model has the markers"""


def solve(
    leg: Leg,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    config: ReplayConfig | None = None,
    *,
    progress: Progress | None = None,
) -> Solution:
    """Joint coordinates that bring the model's markers closest to the measured ones, frame by
    frame.

    Args:
        leg: the scaled model.
        motion: markers named like ``sites``; NaN where not seen; other names are ignored.
        sites: where the markers sit on the scaled segments.
        config: priors and tolerances; the defaults suit the seven markers of the study as well as
            full sets.
        progress: told (frames done, frames in all).

    Raises:
        LegsimError: no frame shows three markers of the pelvis, or a leg has no marker at all.
    """
    config = config or ReplayConfig()
    sites = sites.only(
        [
            name
            for name in motion.marker_names
            if name in sites.names and sites.weights[sites.index(name)] > 0
        ]
    )
    measured = motion.positions_world[:, [motion.marker_names.index(name) for name in sites.names]]
    problem = Problem(leg, sites, config)
    seen = np.asarray(np.isfinite(measured).all(-1))
    values, trace = _solve_all(problem, measured, seen, progress)
    trajectories = JointTrajectories(motion.times, leg.coordinate_names, values)
    modelled = MarkerTrajectories(motion.times, sites.names, leg.marker_positions(values, sites))
    return Solution(
        trajectories, _report(problem, values, trace, measured, seen, modelled), modelled
    )


def calibrate(
    leg: Leg,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    roles: Collection[str],
    config: ReplayConfig | None = None,
) -> MarkerSites:
    """Sites with those in ``roles`` moved to where the recording shows them on the model posed by
    all the others (median over frames).

    This is OpenSim's marker placer for clusters whose place differs between laboratories; landmarks
    keep their places.
    """
    landmarks = sites.only([name for name in sites.names if name not in roles])
    poses = leg.segment_poses(solve(leg, motion, landmarks, config).trajectories)
    positions = sites.positions.copy()
    for k, (name, segment) in enumerate(zip(sites.names, sites.segments, strict=True)):
        if name in roles and name in motion.marker_names:
            local = transforms.apply(
                transforms.inverse(poses.of(segment)), motion.marker(name)[:, None]
            )[:, 0]
            if np.isfinite(local).any():
                positions[k] = np.nanmedian(local, axis=0)
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


class _Trace(NamedTuple):
    iterations: np.ndarray
    converged: np.ndarray


def _solve_all(
    problem: Problem, measured: FloatArray, seen: np.ndarray, progress: Progress | None
) -> tuple[FloatArray, _Trace]:
    """A few frames from scratch, then ever more of them from between their neighbors; frames that
    show nothing are bridged.
    """
    n, weights = len(measured), seen * problem.sites.weights
    trace = _Trace(np.zeros(n, int), np.zeros(n, bool))
    upright = seen[:, problem.pelvis_rows].sum(1) >= 3
    if not upright.any():
        raise LegsimError("no frame shows three markers of the pelvis; the motion cannot be solved")
    pelvis = np.full((n, problem.leg.pelvis_coordinates), np.nan)
    pelvis[upright] = problem.pelvis_starts(measured[upright])
    usable = np.flatnonzero(_all_segments_shown(problem, seen, upright))
    first, *finer = problem.config.strides
    solved = _every(usable, first)
    values = _from_scratch(problem, pelvis[solved], measured[solved], weights[solved])
    for stride in finer:
        frames = _every(usable, stride)
        values = _starts(frames, solved, values)
        _turn_along(problem, values, pelvis[frames])
        for chunk in np.array_split(np.arange(len(frames)), max(1, len(frames) // _CHUNK)):
            rows = frames[chunk]
            state, iterations, converged = _minimize(
                problem, values[chunk], measured[rows], weights[rows]
            )
            values[chunk], trace.iterations[rows], trace.converged[rows] = (
                state.values,
                trace.iterations[rows] + iterations,
                converged,
            )
            if progress and stride == 1:
                progress(int(rows[-1]) + 1, n)
        solved = frames
    everywhere = _between(np.arange(n), solved, values)
    solved = _march(problem, everywhere, solved, pelvis, measured, weights, trace)
    if progress:
        progress(n, n)
    return _between(np.arange(n), solved, everywhere[solved]), trace


def _all_segments_shown(problem: Problem, seen: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(n,) which of the frames ``shown`` show a marker of every segment that has one, as far as
    there are such frames.
    """
    for segment in sorted({problem.sites.segments[k] for k in range(seen.shape[1])} - {"pelvis"}):
        here = seen[:, [k for k, name in enumerate(problem.sites.segments) if name == segment]].any(
            1
        )
        shown = shown & here if (shown & here).any() else shown
    return shown


def _march(
    problem: Problem,
    values: FloatArray,
    solved: np.ndarray,
    pelvis: FloatArray,
    measured: FloatArray,
    weights: FloatArray,
    trace: _Trace,
) -> np.ndarray:
    """Solves in ``values`` (n, 20) what markers are left for, a few frames at a time from either
    side of each gap; frames solved in all.

    A frame starts as far from the one before it as the straight line across the gap goes; a
    coordinate that moves no marker in sight stays on that line.
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
        _turn_along(problem, starts, pelvis[rows])
        state, iterations, converged = _minimize(problem, starts, measured[rows], weights[rows])
        values[rows], trace.iterations[rows], trace.converged[rows] = (
            state.values,
            iterations,
            converged,
        )
        done[rows], rest[rows] = True, False
    values[lost] = line[lost]
    return np.flatnonzero(done)


def _every(frames: np.ndarray, stride: int) -> np.ndarray:
    """The first of ``frames`` in every stretch of ``stride``, and the last of all."""
    return np.unique([*frames[np.unique(frames // stride, return_index=True)[1]], frames[-1]])


def _starts(frames: np.ndarray, solved: np.ndarray, values: FloatArray) -> FloatArray:
    """Where to start (n, 20) at ``frames``: on a cubic between close neighbors, so that two steps
    do; straight across wide gaps.
    """
    straight = _between(frames, solved, values)
    if len(solved) < 4:
        return straight
    after = np.clip(np.searchsorted(solved, frames), 1, len(solved) - 1)
    close = solved[after] - solved[after - 1] <= _CLOSE
    return np.where(close[:, None], CubicSpline(solved, values)(frames), straight)


def _turn_along(problem: Problem, values: FloatArray, pelvis: FloatArray) -> None:
    """Puts the pelvis of starts (n, c) where its own markers have it (n, p; NaN: unseen), if it
    turned too far meanwhile.
    """
    heading = problem.leg.heading
    if heading is not None:
        astray = np.abs(values[:, heading] - pelvis[:, heading]) > _ASTRAY
        values[astray, : pelvis.shape[1]] = pelvis[astray]


def _between(frames: np.ndarray, solved: np.ndarray, values: FloatArray) -> FloatArray:
    """Values (n, 20) at ``frames``, straight between the solved ones."""
    return np.stack([np.interp(frames, solved, column) for column in values.T], -1)


def _from_scratch(
    problem: Problem, pelvis: FloatArray, measured: FloatArray, weights: FloatArray
) -> FloatArray:
    """Best solution (n, 20) over the starting postures."""
    best: State | None = None
    for posture in _STARTS_DEG:
        start = np.tile(problem.leg.posture(*np.radians(posture)), (len(pelvis), 1))
        start[:, : pelvis.shape[1]] = pelvis
        state, _, _ = _minimize(problem, start, measured, weights)
        if best is None:
            best = state
        else:
            better = state.cost < best.cost
            best = State(
                *(
                    np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b)
                    for a, b in zip(state, best, strict=True)
                )
            )
    assert best is not None
    return best.values


def _minimize(
    problem: Problem, start: FloatArray, measured: FloatArray, weights: FloatArray
) -> tuple[State, np.ndarray, np.ndarray]:
    """Damped Newton within the limits from start (n, 20); final state, iterations (n,), converged
    (n,).
    """
    n = len(start)
    measured = np.where(weights[..., None] > 0, measured, 0.0)
    damping = np.full(n, _FIRST_DAMPING)
    state = problem.at(
        np.clip(start, problem.low, problem.high), measured, weights, damping < _FIRST_DAMPING
    )
    iterations, held = np.zeros(n, int), _held(problem, state)
    open_frames = np.flatnonzero(~_converged(problem, state, held))
    for _ in range(problem.config.max_iterations):
        if len(open_frames) == 0:
            break
        now, damp = State(*(a[open_frames] for a in state)), damping[open_frames]
        step = _step(now, held[open_frames], damp)
        # second derivatives help once steps succeed; far away they may point uphill
        exact = damp <= _FIRST_DAMPING
        trial = problem.at(
            np.clip(now.values + step, problem.low, problem.high),
            measured[open_frames],
            weights[open_frames],
            exact,
        )
        # near the end cost differences drown in rounding
        accepted = trial.cost <= now.cost * (1 + 1e-13)
        taken = open_frames[accepted]
        for whole, part in zip(state, trial, strict=True):
            whole[taken] = part[accepted]
        damping[open_frames] = np.where(
            accepted, damp / 10, np.maximum(damp, _FIRST_DAMPING / 10) * 10
        )
        iterations[open_frames] += 1
        held[taken] = _held(problem, State(*(a[taken] for a in state)))
        still = ~_converged(problem, State(*(a[open_frames] for a in state)), held[open_frames])
        open_frames = open_frames[still]
    converged = np.ones(n, bool)
    converged[open_frames] = False
    return state, iterations, converged


def _held(problem: Problem, state: State) -> np.ndarray:
    """(n, 20) coordinates at a limit that the gradient pushes beyond it."""
    return ((state.values <= problem.low) & (state.gradient > 0)) | (
        (state.values >= problem.high) & (state.gradient < 0)
    )


def _converged(problem: Problem, state: State, held: np.ndarray) -> np.ndarray:
    scaled = np.abs(state.gradient) / np.sqrt(np.maximum(state.scale, 1e-12))
    return np.where(held, 0.0, scaled).max(1) <= problem.config.tolerance


def _step(state: State, held: np.ndarray, damping: FloatArray) -> FloatArray:
    """Levenberg-Marquardt step (n, 20) of the free coordinates."""
    free = ~held
    matrix = state.curvature * (free[:, :, None] & free[:, None, :])
    diagonal = np.arange(matrix.shape[1])
    matrix[:, diagonal, diagonal] += damping[:, None] * state.scale + np.where(held, 1.0, 1e-12)
    step = np.linalg.solve(matrix, np.where(held, 0.0, state.gradient)[..., None])[..., 0]
    return -np.asarray(step, np.float64)


def _report(
    problem: Problem,
    values: FloatArray,
    trace: _Trace,
    measured: FloatArray,
    seen: np.ndarray,
    modelled: MarkerTrajectories,
) -> IkReport:
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
        coordinate_names=problem.leg.coordinate_names,
        coordinate_share=_marker_share(problem, values, seen),
        coordinate_at_limit=frozen_owned(at_limit.sum(0)),
        frames=len(values),
        frames_unseen=frozen_owned(np.flatnonzero(~seen.any(1))),
        frames_unconverged=frozen_owned(np.flatnonzero(~trace.converged & seen.any(1))),
        iterations=float(trace.iterations.mean()),
    )


def _marker_share(problem: Problem, values: FloatArray, seen: np.ndarray) -> FloatArray:
    """Diagonal (20,) of (markers + priors)^-1 markers, mean over some twenty frames."""
    some = np.unique(np.linspace(0, len(values) - 1, 20).astype(int))
    weights = seen[some] * problem.sites.weights
    measured = np.zeros((len(some), len(problem.rows), 3))
    plain = np.zeros(len(some), bool)
    whole = problem.at(values[some], measured, weights, plain).curvature
    priors = problem.at(values[some], measured, 0 * weights, plain).curvature
    # what neither markers nor priors see belongs to nobody
    unseen = 1e-12 * np.eye(whole.shape[1])
    whole = whole + unseen
    share = 1 - np.einsum("nij,nji->ni", np.linalg.inv(whole), priors + unseen)
    return frozen("share", np.mean(np.clip(share, 0, 1), axis=0), (None,))
