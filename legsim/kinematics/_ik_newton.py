"""Damped Newton steps within limits, for many frames at once."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics._ik_problem import Problem, State

_FIRST_DAMPING = 1e-5
"""of the curvature's diagonal; below it and at it the curvature is exact"""


def minimize(
    problem: Problem,
    start: FloatArray,
    measured: FloatArray,
    weights: FloatArray,
    *,
    iterations_at_most: int | None = None,
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
    iterations, held = np.zeros(n, int), held_at_limits(problem, state)
    open_frames = np.flatnonzero(~_converged(problem, state, held))
    for _ in range(iterations_at_most or problem.config.max_iterations):
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
        held[taken] = held_at_limits(problem, State(*(a[taken] for a in state)))
        still = ~_converged(problem, State(*(a[open_frames] for a in state)), held[open_frames])
        open_frames = open_frames[still]
    converged = np.ones(n, bool)
    converged[open_frames] = False
    return state, iterations, converged


def held_at_limits(problem: Problem, state: State) -> np.ndarray:
    """(n, 20) coordinates at a limit that the gradient pushes beyond it, and locked ones."""
    beyond = ((state.values <= problem.low) & (state.gradient > 0)) | (
        (state.values >= problem.high) & (state.gradient < 0)
    )
    return beyond | problem.locked


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
