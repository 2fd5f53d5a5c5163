"""Frames with few markers in sight: none keeps a posture that its neighbor's betters."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics._ik_newton import minimize
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites

_CHEAPER = 0.99
"""times its cost, below which a frame takes the solution that its neighbor leads to"""

_ROUNDS = 500
"""frames that a better solution may spread over"""


def settle(
    problem: Problem,
    values: FloatArray,
    solved: np.ndarray,
    rows: np.ndarray,
    measured: FloatArray,
    weights: FloatArray,
    converged: np.ndarray,
) -> None:
    """Replaces in ``values`` (n, c) those of the frames ``rows`` whose neighbor leads to a cheaper
    solution, and goes on to their neighbors until none does.

    A frame that shows a few markers may have several minima, and the one that was found may lie far
    from the movement. What its neighbors know of the markers that it lacks decides.

    Args:
        problem: that was solved.
        values: solutions of all frames; changed in place.
        solved: (s,) frames that have solutions.
        rows: (r,) of them that are looked at first.
        measured: (n, m, 3) m.
        weights: (n, m), 0 where a marker is not seen.
        converged: (n,) of each frame; changed in place.
    """
    if len(rows) == 0:
        return
    eligible = np.zeros(len(values), bool)
    eligible[solved] = True
    cost = np.full(len(values), np.inf)
    cost[solved] = problem.at(
        values[solved],
        np.where(weights[solved, :, None] > 0, measured[solved], 0.0),
        weights[solved],
        np.zeros(len(solved), bool),
    ).cost
    open_rows = rows
    for _ in range(_ROUNDS):
        changed = np.zeros(len(values), bool)
        for way in (-1, 1):
            here = open_rows[(open_rows + way >= 0) & (open_rows + way < len(values))]
            here = here[eligible[here + way]]
            if len(here) == 0:
                continue
            found, _, done = minimize(problem, values[here + way], measured[here], weights[here])
            better = found.cost < _CHEAPER * cost[here]
            values[here[better]] = found.values[better]
            cost[here[better]] = found.cost[better]
            converged[here[better]] = done[better]
            changed[here[better]] = True
        around = np.flatnonzero(changed)
        around = np.union1d(around - 1, around + 1)
        around = around[(around >= 0) & (around < len(values))]
        open_rows = around[eligible[around]]
        if len(open_rows) == 0:
            return


def without_turns(leg: Leg, values: FloatArray) -> FloatArray:
    """Values (n, c) of the same postures whose pelvis rotations differ from frame to frame by less
    than half a turn, and whose first lies within half a turn of zero.

    Three rotations about axes of which neighbors are at right angles give the same posture as
    (a + pi, pi - b, c + pi); the one with b within a quarter turn is taken.
    """
    names = leg.coordinate_names[: leg.pelvis_coordinates]
    turns = [k for k, name in enumerate(names) if name not in leg.shifts]
    turned = values.copy()
    if len(turns) == 3:
        over = np.cos(turned[:, turns[1]]) < 0
        other = turned[over]
        other[:, turns] = np.array([1, -1, 1]) * other[:, turns] + np.pi
        if over.any() and _same_posture(leg, turned[over][:1], other[:1]):
            turned[over] = other
    for k in turns:
        angle = np.unwrap(turned[:, k])
        turned[:, k] = angle - 2 * np.pi * np.round(angle[0] / (2 * np.pi))
    return turned


def _same_posture(leg: Leg, one: FloatArray, other: FloatArray) -> bool:
    """Whether the pelvis is turned alike in two postures (1, c)."""
    sites = MarkerSites(("x", "y", "z"), ("pelvis",) * 3, np.eye(3), np.ones(3))
    places = [leg.marker_positions(values, sites) for values in (one, other)]
    return bool(np.allclose(*places, atol=1e-9))
