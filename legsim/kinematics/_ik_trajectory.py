"""The order in which the frames of a recording are solved, so that the solutions are one
movement.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics import _ik_branches
from legsim.kinematics._ik_neighbors import settle, without_turns
from legsim.kinematics._ik_newton import minimize
from legsim.kinematics._ik_problem import Problem

Progress = Callable[[int, int], None]

_CHUNK = 256
"""frames solved together: few enough for their arrays to stay in the cache"""

_CLOSE = 16
"""frames that a cubic may span; farther apart it overshoots"""

_REACH = 4
"""frames at a time that a gap with few markers is solved inwards by"""

_ASTRAY = np.radians(20.0)
"""rad of pelvis rotation: a start that is turned farther from the pelvis' own markers begins at
these
"""

_KINK = 8.0
"""times the median change of step from frame to frame, and at least _SMALLEST_KINK, that asks
whether two frames are one movement
"""

_SMALLEST_KINK = np.radians(0.1)

_LONGEST_REPAIR = 128
"""frames that the solution on one side of a jump is followed for until it meets the other's"""

_MOST_REPAIRS = 20


class Trace(NamedTuple):
    """How each of n frames was solved."""

    iterations: np.ndarray
    converged: np.ndarray
    jumps: np.ndarray
    """the last frames before a step that the markers do not explain"""


class Recording(NamedTuple):
    """What is solved: n frames of m markers."""

    measured: FloatArray
    """(n, m, 3) m"""
    weights: FloatArray
    """(n, m), 0 where a marker is not seen"""
    pelvis: FloatArray
    """(n, p) coordinates of the pelvis from its own markers, NaN where fewer than three are seen"""

    def at(self, frames: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Markers and weights of some frames."""
        return self.measured[frames], self.weights[frames]


def solve_all(
    problem: Problem,
    measured: FloatArray,
    seen: np.ndarray,
    shares: FloatArray,
    progress: Progress | None,
) -> tuple[FloatArray, Trace]:
    """Values (n, c): a few frames from scratch, then ever more of them from between their
    neighbors; frames that show nothing are bridged.

    ``shares`` (n, m) of their weights are kept by markers, and pegs, that come or go.
    """
    n, weights = len(measured), shares * problem.sites.weights
    trace = Trace(np.zeros(n, int), np.zeros(n, bool), np.zeros(n, bool))
    upright = seen[:, problem.pelvis_rows].sum(1) >= 3
    if not upright.any():
        raise LegsimError("no frame shows three markers of the pelvis; the motion cannot be solved")
    pelvis = np.full((n, problem.leg.pelvis_coordinates), np.nan)
    pelvis[upright] = problem.pelvis_starts(measured[upright])
    recording = Recording(measured, weights, pelvis)
    usable = np.flatnonzero(_all_segments_shown(problem, seen[:, problem.markers], upright))
    solved, values = _one_movement(problem, recording, usable)
    for stride in problem.config.strides[1:]:
        frames = _every(usable, stride)
        values = _starts(frames, solved, values)
        _turn_along(problem, values, pelvis[frames])
        _solve_chunks(problem, recording, frames, values, trace, progress if stride == 1 else None)
        solved = frames
    _join(problem, recording, solved, values)
    everywhere = _between(np.arange(n), solved, without_turns(problem.leg, values))
    solved = _march(problem, everywhere, solved, recording, trace)
    if progress:
        progress(n, n)
    whole = without_turns(problem.leg, everywhere[solved])
    trace.jumps[solved[_jumps(problem, recording, solved, whole)]] = True
    return _between(np.arange(n), solved, whole), trace


def _one_movement(
    problem: Problem, recording: Recording, usable: np.ndarray
) -> tuple[np.ndarray, FloatArray]:
    """Frames and values that are solved first: those of the movement that jumps least and costs
    least.
    """
    anchors = _every(usable, problem.config.strides[0])
    minima = _ik_branches.find(problem, recording.pelvis[anchors], *recording.at(anchors))
    if all(len(m.values) == 1 for m in minima):
        return anchors, np.array([m.values[0] for m in minima])
    frames = np.union1d(anchors, _every(usable, problem.config.strides[1]))
    course = _ik_branches.Course(
        problem, minima, anchors, frames, *recording.at(frames), recording.pelvis[frames]
    )
    places, values = course.best()
    return frames[places], values


def _solve_chunks(
    problem: Problem,
    recording: Recording,
    frames: np.ndarray,
    values: FloatArray,
    trace: Trace,
    progress: Progress | None,
) -> None:
    """Solves ``frames`` from their starts, ``values`` (f, c), in place."""
    for chunk in np.array_split(np.arange(len(frames)), max(1, len(frames) // _CHUNK)):
        rows = frames[chunk]
        state, iterations, converged = minimize(problem, values[chunk], *recording.at(rows))
        values[chunk] = state.values
        trace.iterations[rows] += iterations
        trace.converged[rows] = converged
        if progress:
            progress(int(rows[-1]) + 1, len(trace.iterations))


def _join(problem: Problem, recording: Recording, frames: np.ndarray, values: FloatArray) -> None:
    """Repairs jumps between neighboring ``frames`` in ``values`` (f, c); those that are left, and
    new ones at gaps, are looked for when all frames are solved.
    """
    for place in _jumps(problem, recording, frames, values)[:_MOST_REPAIRS]:
        if not _joined(problem, recording, frames, values, np.array([place]))[0]:
            _repair(problem, recording, frames, values, int(place))


def _jumps(
    problem: Problem, recording: Recording, frames: np.ndarray, values: FloatArray
) -> np.ndarray:
    """Places (j,) in ``frames`` before steps that do not lead from one solution to the next."""
    if len(frames) < 3:
        return np.zeros(0, int)
    steps = np.diff(values, axis=0)[:, problem.leg.pelvis_coordinates :]
    bends = np.abs(np.diff(steps, axis=0)).max(1)
    limit = max(_KINK * float(np.median(bends)), _SMALLEST_KINK)
    kinks = np.flatnonzero(bends > limit)
    doubtful = np.unique(np.concatenate([kinks, kinks + 1]))
    beside = frames[doubtful + 1] == frames[doubtful] + 1
    doubtful = doubtful[beside & (np.abs(steps[doubtful]).max(1) > limit / 2)]
    return doubtful[~_joined(problem, recording, frames, values, doubtful)]


def _joined(
    problem: Problem,
    recording: Recording,
    frames: np.ndarray,
    values: FloatArray,
    places: np.ndarray,
) -> np.ndarray:
    """Which of the steps behind ``places`` lead there and back again."""
    if len(places) == 0:
        return np.zeros(0, bool)
    ahead, _, _ = minimize(problem, values[places], *recording.at(frames[places + 1]))
    back, _, _ = minimize(problem, values[places + 1], *recording.at(frames[places]))
    return np.array(
        [
            _ik_branches.same(problem.leg, a, b) and _ik_branches.same(problem.leg, c, d)
            for a, b, c, d in zip(
                ahead.values, values[places + 1], back.values, values[places], strict=True
            )
        ]
    )


def _repair(
    problem: Problem, recording: Recording, frames: np.ndarray, values: FloatArray, place: int
) -> None:
    """Goes on from one side of a jump until that meets the solutions of the other side; the cheaper
    way of the two, where either does.
    """
    ways = [
        _detour(problem, recording, frames, values, place, 1),
        _detour(problem, recording, frames, values, place + 1, -1),
    ]
    found = [way for way in ways if way is not None]
    if found:
        _, places, better = min(found, key=lambda way: way[0])
        values[places] = better


def _detour(
    problem: Problem,
    recording: Recording,
    frames: np.ndarray,
    values: FloatArray,
    place: int,
    way: int,
) -> tuple[float, np.ndarray, FloatArray] | None:
    """Further cost, places (p,) and values (p, c) of going on from ``place``; None where that does
    not meet what is there.
    """
    now, places, path, cost = values[place], [], [], 0.0
    for step in range(1, _LONGEST_REPAIR + 1):
        there = place + way * step
        if not 0 <= there < len(frames):
            return cost, np.array(places), np.array(path)
        here = recording.at(frames[[there]])
        new, _, _ = minimize(
            problem,
            np.stack([now, values[there]]),
            here[0].repeat(2, 0),
            here[1].repeat(2, 0),
            iterations_at_most=_ik_branches.ENOUGH,
        )
        if _ik_branches.same(problem.leg, new.values[0], values[there]):
            return (cost, np.array(places), np.array(path)) if places else None
        now = new.values[0]
        places.append(there)
        path.append(now)
        cost += float(new.cost[0] - new.cost[1])
    return None


def _all_segments_shown(problem: Problem, seen: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(n,) which of the frames ``shown`` show a marker of every segment that has one, as far as
    there are such frames.
    """
    carriers = [problem.sites.segments[k] for k in np.flatnonzero(problem.markers)]
    for segment in sorted(set(carriers) - {"pelvis"}):
        here = seen[:, [k for k, name in enumerate(carriers) if name == segment]].any(1)
        shown = shown & here if (shown & here).any() else shown
    return shown


def _march(
    problem: Problem,
    values: FloatArray,
    solved: np.ndarray,
    recording: Recording,
    trace: Trace,
) -> np.ndarray:
    """Solves in ``values`` (n, c) what markers are left for, a few frames at a time from either
    side of each gap; frames solved in all.

    A frame starts as far from the one before it as the straight line across the gap goes; a
    coordinate that moves no marker in sight goes straight between the frames that tell it.
    """
    shown, subtrees = (
        recording.weights[:, problem.markers] > 0,
        problem.subtrees[:, problem.markers],
    )
    line, done, rest = values.copy(), np.zeros(len(values), bool), np.asarray(shown.any(1))
    done[solved], rest[solved] = True, False
    lost = (shown @ subtrees.T == 0) & subtrees.any(1) & rest[:, None]
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
        _turn_along(problem, starts, recording.pelvis[rows])
        state, iterations, converged = minimize(problem, starts, *recording.at(rows))
        values[rows], trace.iterations[rows], trace.converged[rows] = (
            state.values,
            iterations,
            converged,
        )
        done[rows], rest[rows] = True, False
    frames = np.flatnonzero(done)
    doubtful = _doubtful(frames, values[frames], trace)
    rows = np.union1d(np.setdiff1d(frames, solved), doubtful)
    settle(problem, values, frames, rows, *recording[:2], trace.converged)
    for k in np.flatnonzero(lost.any(0)):
        kept = frames[~lost[frames, k]]
        values[lost[:, k], k] = np.interp(np.flatnonzero(lost[:, k]), kept, values[kept, k])
    return frames


def _doubtful(frames: np.ndarray, values: FloatArray, trace: Trace) -> np.ndarray:
    """Those of ``frames`` that did not converge, or that step more than most from the one before or
    to the next.
    """
    steps = np.abs(np.diff(values, axis=0)).max(1)
    kinks = np.flatnonzero(steps > max(_KINK * float(np.median(steps)), _SMALLEST_KINK))
    return np.union1d(frames[~trace.converged[frames]], frames[np.union1d(kinks, kinks + 1)])


def _every(frames: np.ndarray, stride: int) -> np.ndarray:
    """The first of ``frames`` in every stretch of ``stride``, and the last of all."""
    return np.unique([*frames[np.unique(frames // stride, return_index=True)[1]], frames[-1]])


def _starts(frames: np.ndarray, solved: np.ndarray, values: FloatArray) -> FloatArray:
    """Where to start (n, c) at ``frames``: on a cubic between close neighbors, so that two steps
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
    """Values (n, c) at ``frames``, straight between the solved ones."""
    return np.stack([np.interp(frames, solved, column) for column in values.T], -1)
