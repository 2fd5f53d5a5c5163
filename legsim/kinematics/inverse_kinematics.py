"""Joint coordinates from markers: weighted least squares with joint limits, solved for many frames
at once.

Minimized at each frame: sum over seen markers of weight |model - measured|^2, plus weak priors that
decide what the markers leave open. The Gauss-Newton matrix of such a sum is the joint-space inertia
of the leg if its mass sat in the markers, so it is composed like one (composite rigid bodies,
Featherstone 1983): 22 sums a marker instead of its Jacobian, and the second derivatives come along
for nothing. Damped as by Levenberg and Marquardt; coordinates at a limit that want to go beyond it
are held (projected Newton, Bertsekas 1982).
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray, frozen, frozen_owned
from legsim.kinematics import _stance
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics._ik_trajectory import Progress, Trace, solve_all
from legsim.kinematics._marker_fading import faded
from legsim.kinematics._planted_feet import Pegs
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import segment_index
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_ENOUGH_ON_FOOT = 3
"""markers that show how a foot lies"""


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
    coordinate_by_prior: np.ndarray
    """(20,) int, frames in which priors decide a coordinate of the foot: they show fewer than three
    markers of that foot, or for the toes none on them
    """
    frames: int
    frames_unseen: np.ndarray
    """indices of frames that show no marker, bridged between their neighbors"""
    frames_unconverged: np.ndarray
    """indices of frames that did not reach the tolerance"""
    frames_jumping: np.ndarray
    """indices of frames after which the solution jumps to another one, because the one before ends
    there
    """
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
    config: IkOptions | None = None,
    *,
    pegs: Pegs | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Joint coordinates that bring the model's markers closest to the measured ones, frame by
    frame.

    Args:
        leg: the scaled model.
        motion: markers named like ``sites``; NaN where not seen; other names are ignored.
        sites: where the markers sit on the scaled segments.
        config: weights, tasks, locks, priors and tolerances; the defaults suit the seven markers of
            the study as well as full sets. Names of markers are those of ``sites``.
        pegs: of feet that stand still in ``motion``, as registration finds them.
        progress: called with (frames done, frames in all).

    Raises:
        LegsimError: no frame shows three markers of the pelvis, or a leg has no marker at all.
    """
    config = _stance.with_feet(config or IkOptions(), motion, sites)
    sites = sites.weighted(config.marker_weights)
    sites = sites.only(
        [
            name
            for name in motion.marker_names
            if name in sites.names and sites.weights[sites.index(name)] > 0
        ]
    )
    measured = motion.positions_world[:, [motion.marker_names.index(name) for name in sites.names]]
    seen = np.asarray(np.isfinite(measured).all(-1))
    # one frame has no neighbor to come from or go to
    shares = faded(seen, motion.rate_hz) if len(seen) > 1 else seen.astype(float)
    held, shown = sites, measured
    if pegs is not None:
        held, shown = pegs.beside(sites), pegs.beside_markers(measured)
        shares = np.concatenate([shares, pegs.shares], axis=1)
        seen = shares > 0
    problem = Problem(leg, held, config)
    values, trace = solve_all(problem, shown, seen, shares, progress)
    trajectories = JointTrajectories(motion.times, leg.coordinate_names, values)
    modelled = MarkerTrajectories(motion.times, sites.names, leg.marker_positions(values, sites))
    share = _marker_share(problem, values, seen)
    return Solution(
        trajectories, _report(problem, values, trace, measured, modelled, share), modelled
    )


def calibrate(
    leg: Leg,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    roles: Collection[str],
    config: IkOptions | None = None,
) -> MarkerSites:
    """Sites with those in ``roles`` moved to where the recording shows them on the model posed by
    all the others (median over frames).

    This is OpenSim's marker placer for clusters whose place differs between laboratories; landmarks
    keep their places, and so do those of a foot that is not flat on the floor, because nothing else
    says how it lies. A foot is posed flat, so that only frames in which it is count for its
    markers.
    """
    config = _stance.with_feet(config or IkOptions(), motion, sites)
    if not config.feet_on_floor:
        roles = set(roles) - _landmarks_of_foot(sites)
    landmarks = sites.only([name for name in sites.names if name not in roles])
    poses = leg.segment_poses(solve(leg, motion, landmarks, config).trajectories)
    positions = sites.positions.copy()
    flat = _stance.flat_feet(motion, sites)
    for k, (name, segment) in enumerate(zip(sites.names, sites.segments, strict=True)):
        if name in roles and name in motion.marker_names:
            local = transforms.apply(
                transforms.inverse(poses.of(segment)), motion.marker(name)[:, None]
            )[:, 0]
            if segment in flat:
                local = local[flat[segment]]
            if np.isfinite(local).any():
                positions[k] = np.nanmedian(local, axis=0)
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


def _landmarks_of_foot(sites: MarkerSites) -> set[str]:
    """Markers at places of the foot that have a name, other than glued clusters."""
    on_segments = zip(sites.names, sites.segments, strict=True)
    return {n for n, at in on_segments if at.startswith("calcn") and not n.startswith("foot_")}


def _report(
    problem: Problem,
    values: FloatArray,
    trace: Trace,
    measured: FloatArray,
    modelled: MarkerTrajectories,
    share: FloatArray,
) -> IkReport:
    seen = np.asarray(np.isfinite(measured).all(-1))
    errors = np.linalg.norm(modelled.positions_world - measured, axis=-1)
    shown = np.where(seen, errors, -1.0)
    count = seen.sum(0)
    squares = np.where(seen, errors, 0.0) ** 2
    rms = np.sqrt(squares.sum(0) / np.where(count > 0, count, np.nan))
    at_limit = (values <= problem.low + 1e-9) | (values >= problem.high - 1e-9)
    at_limit &= ~problem.locked
    return IkReport(
        marker_names=modelled.marker_names,
        marker_rms=frozen("marker_rms", rms, (None,)),
        marker_worst=frozen("marker_worst", np.where(count > 0, shown.max(0), np.nan), (None,)),
        marker_worst_frame=frozen_owned(shown.argmax(0)),
        marker_seen=frozen_owned(count),
        coordinate_names=problem.leg.coordinate_names,
        coordinate_share=share,
        coordinate_at_limit=frozen_owned(at_limit.sum(0)),
        coordinate_by_prior=frozen_owned(_by_prior(problem, seen)),
        frames=len(values),
        frames_unseen=frozen_owned(np.flatnonzero(~seen.any(1))),
        frames_unconverged=frozen_owned(np.flatnonzero(~trace.converged & seen.any(1))),
        frames_jumping=frozen_owned(np.flatnonzero(trace.jumps)),
        iterations=float(trace.iterations.mean()),
    )


def _by_prior(problem: Problem, seen: np.ndarray) -> np.ndarray:
    """(c,) frames in which priors decide a coordinate of the foot; none with a task or a lock."""
    leg, found = problem.leg, np.zeros(len(problem.low), int)
    segments = np.array(problem.sites.segments)[problem.markers]
    for side in "rl":
        tibia, calcn, toes = (
            leg.moves[:, segment_index(f"{name}_{side}")] for name in ("tibia", "calcn", "toes")
        )
        on_toes = segments == f"toes_{side}"
        on_foot = on_toes | np.isin(segments, [f"talus_{side}", f"calcn_{side}"])
        enough = seen[:, on_foot].sum(1) >= _ENOUGH_ON_FOOT
        found[calcn & ~tibia] = (~enough).sum()
        found[toes & ~calcn] = (~(enough & seen[:, on_toes].any(1))).sum()
    return np.where(problem.locked | (problem.task_weights > 0), 0, found)


def _marker_share(problem: Problem, values: FloatArray, seen: np.ndarray) -> FloatArray:
    """Diagonal (20,) of (markers + priors)^-1 markers, mean over some twenty frames; pegs count as
    priors.
    """
    some = np.unique(np.linspace(0, len(values) - 1, 20).astype(int))
    weights = seen[some] * problem.sites.weights
    measured = np.zeros((len(some), len(problem.rows), 3))
    plain = np.zeros(len(some), bool)
    pulls = problem.pulls(weights)
    held = weights * ~problem.markers
    whole = problem.at(values[some], measured, weights, plain, pulls).curvature
    priors = problem.at(values[some], measured, held, plain, pulls).curvature
    share = 1 - np.einsum(
        "nij,nji->ni", np.linalg.inv(whole + problem.floor()), priors + problem.floor()
    )
    return frozen("share", np.mean(np.clip(share, 0, 1), axis=0), (None,))
