"""Finds markers whose trajectories are late or early against the others, by what inverse kinematics
leaves of them.

A marker that is late by t lies t v behind, v its velocity. The pose follows it in part, so that a
pattern is left on all markers: (1 - J A^-1 J' W) t v, with J the markers' Jacobian and A the
Gauss-Newton matrix of inverse kinematics. The least-squares factor of that pattern in the residuals
is the lag, and the share of the residuals that it explains tells whether it is one. A marker that
sits elsewhere on its segment looks late while somebody walks on evenly, so that what stays constant
on the segments counts on neither side.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.kinematics._ik_problem import Problem
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_FRAMES = 600
"""are looked at, evenly over the recording"""

_EXPLAINED = 0.5
"""of the squared residuals"""

_LEAST_M, _LEAST_FRAMES = 1e-3, 1.0
"""RMS distance and frames of a lag that is worth a word"""

_CARRIES = 0.05
"""of the largest marker's share in a pattern: markers with less do not count against it"""


@dataclass(frozen=True, slots=True)
class LateMarker:
    """A marker that is late (seconds > 0) or early."""

    role: str
    seconds: float
    frames: float
    explained: float
    """share of the squared residuals"""


def find_late(
    problem: Problem, solution: JointTrajectories, measured: MarkerTrajectories
) -> tuple[LateMarker, ...]:
    """Finds late and early markers, those that explain most first.

    Args:
        problem: of inverse kinematics, with the markers of ``measured``.
        solution: joint coordinates.
        measured: positions by role, NaN where not seen, at the times of the solution.
    """
    times = measured.times
    step = float(times[-1] - times[0]) / (len(times) - 1)
    some = np.unique(np.linspace(0, len(times) - 1, _FRAMES).astype(int))
    velocity = (np.gradient(measured.positions_world, axis=0) / step)[some]
    jacobian, points, turns = _jacobian(problem, problem.leg.values_of(solution)[some])
    residual = measured.positions_world[some] - points
    there = np.asarray(np.isfinite(residual + velocity).all(-1))
    weights = there * problem.sites.weights
    velocity, residual = (np.where(there[..., None], v, 0.0) for v in (velocity, residual))
    weighted = jacobian * weights[:, None, :, None]
    curvature = np.einsum("ncmx,ndmx->ncd", weighted, jacobian)
    inverse = np.linalg.inv(curvature + np.diag(problem.prior_weights) + problem.floor())
    residual = _varying(residual, turns, weights)
    squares = (weights[..., None] * residual**2).sum((0, 2))
    found = []
    for k, role in enumerate(measured.marker_names):
        follows = np.einsum("ncd,ndx,nx->nc", inverse, weighted[:, :, k], velocity[:, k])
        pattern = -np.einsum("nc,ncmx->nmx", follows, jacobian)
        pattern[:, k] += velocity[:, k]
        pattern = _varying(pattern, turns, weights)
        power = (weights[..., None] * pattern**2).sum((0, 2))
        carries = power > _CARRIES * power.max(initial=0.0)
        if not carries.any():
            continue
        shared = float((weights[..., None] * residual * pattern).sum())
        lag = -shared / float(power.sum())
        explained = shared**2 / float(power.sum()) / max(float(squares[carries].sum()), 1e-18)
        moved = abs(lag) * float(np.sqrt((velocity[:, k] ** 2).sum(-1).mean()))
        if explained > _EXPLAINED and moved > _LEAST_M and abs(lag) > _LEAST_FRAMES * step:
            found.append(LateMarker(role, lag, lag / step, explained))
    return tuple(sorted(found, key=lambda one: -one.explained))


def _varying(vectors: FloatArray, turns: FloatArray, weights: FloatArray) -> FloatArray:
    """Vectors (n, m, 3) of markers, without their means on the segments that ``turns`` (n, m, 3, 3)
    carries to the world.
    """
    local = np.einsum("nmji,nmj->nmi", turns, vectors)
    total = np.maximum(weights.sum(0), 1e-18)[:, None]
    mean = np.einsum("nm,nmi->mi", weights, local) / total
    return vectors - np.einsum("nmij,mj->nmi", turns, mean)


def _jacobian(problem: Problem, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives (n, c, m, 3) of the markers by the coordinates, the markers (n, m, 3), and their
    segments' rotations (n, m, 3, 3).
    """
    pose, rows = problem.leg.kinematics(values), problem.rows
    places = problem.sites.positions[..., None]
    points = pose.origins[:, rows] + (pose.rotations[:, rows] @ places)[..., 0]
    turned = transforms.cross(pose.angular[:, :, None], points[:, None])
    moves = problem.leg.moves[:, rows]
    return (
        (pose.linear[:, :, None] + turned) * moves[None, ..., None],
        points,
        pose.rotations[:, rows],
    )


def notes(found: tuple[LateMarker, ...], labels: dict[str, str]) -> tuple[str, ...]:
    """A warning on the marker that explains most, and on others that do."""
    if not found:
        return ()
    said = [
        f"{labels.get(one.role, one.role)} is {'late' if one.seconds > 0 else 'early'} by about "
        f"{1e3 * abs(one.seconds):.0f} ms ({abs(one.frames):.1f} frames)"
        for one in found[:3]
    ]
    return (
        f"warning: against the other markers {', '.join(said)}: shift its trajectory in the "
        "recording, or export it again",
    )
