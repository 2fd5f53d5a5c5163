"""One estimate of two sensors, on thigh and shank, that share the knee's center.

Each sensor alone has a gauge of its own: M(0) = I puts the error of the first view into a constant
displacement of thigh against shank, which no registration of the volume as a whole takes away. The
knee's center is known in both sensors, and both must carry it to the same place. That joins two
problems of :mod:`legsim.correction.path_problem` into one, by Gauss-Newton steps over the errors of
both. The foot below the shank stands.

The thigh's and the shank's lengths are in the places of the joints: a sensor carries both ends of
its segment rigidly. The angle between the two is left free, as the knee's is.
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.correction.error_state import ErrorState, SensorPath
from legsim.correction.fused import SensorPriors, sensor_state
from legsim.correction.method import Scan
from legsim.correction.path_measurements import (
    ANKLE_WALK,
    BeadShadows,
    FiducialShadows,
    StandingFoot,
    StandingPrior,
)
from legsim.correction.path_problem import (
    Normal,
    PathProblem,
    add_measurements,
    at_rest,
    believed,
    descended,
    on_foot_as_found,
    prepared,
    solved,
)
from legsim.correction.smoother import SmoothedPath, smoothed
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry

_KNEE = 3
"""numbers of the knee's place in the thigh's sensor"""

_ROUNDS, _BEYOND = 8, 1.2
"""estimates with more and more freedom, at most, and by how much what is found exceeds it"""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSegment:
    """A sensor on a segment, and what else is measured of that segment."""

    state: ErrorState
    standing: StandingPrior | None = None
    beads: BeadShadows | None = None
    """on this segment"""
    fiducials: FiducialShadows | None = None
    """in this sensor"""


@dataclass(frozen=True, slots=True, eq=False)
class LegTie:
    """Where the joints are in the sensors of one leg, and how firmly they tie the two.

    Each standard deviation is per coordinate.
    """

    knee_in_thigh: FloatArray
    """(3,) m in the thigh's sensor"""
    knee_in_shank: FloatArray
    """(3,) m in the shank's sensor"""
    ankle_in_shank: FloatArray
    """(3,) m in the shank's sensor"""
    hip_in_thigh: FloatArray
    """(3,) m in the thigh's sensor"""
    laxity: float = 1e-3
    """m by which both sensors may have the knee apart over the scan: soft tissue, and a knee that
    is no ball in a socket"""
    placement: float = 5e-3
    """m by which the knee is misplaced in the thigh's sensor, as far as the shank's has it"""
    together: float | None = 0.25e-3
    """m, RMS over the scan, by which thigh and shank of a person who holds a posture move against
    each other at the knee; None leaves them free

    Beads tell little of it along the rays. Where it is found to be more, it is as large as that,
    and the estimate is made again.
    """
    ankle_walk: float | None = ANKLE_WALK
    """m per root of a second by which the ankle of a foot that stands wanders; None leaves it free:
    see :class:`legsim.correction.path_measurements.StandingFoot`
    """
    samples: float = 8.0
    """independent samples in a scan, as of a StandingPrior"""

    def __post_init__(self) -> None:
        for name in ("knee_in_thigh", "knee_in_shank", "ankle_in_shank", "hip_in_thigh"):
            object.__setattr__(self, name, frozen(name, getattr(self, name), (3,)))
        for name in ("laxity", "placement", "together", "ankle_walk", "samples"):
            size = getattr(self, name)
            if size is not None and not size > 0:
                raise LegsimError(f"{name} of a leg's tie must be positive; got {size:g}")

    def weight(self, views: int) -> float:
        """Root of the weight of one coordinate of the knee in one view."""
        return float(np.sqrt(self.samples / views)) / self.laxity

    @property
    def foot(self) -> StandingFoot | None:
        """What the shank stands on."""
        if self.ankle_walk is None:
            return None
        return StandingFoot(self.ankle_in_shank, self.ankle_walk)


@dataclass(frozen=True, slots=True, eq=False)
class TiedPaths:
    """Paths of both sensors and what is known of them together."""

    thigh: SmoothedPath
    shank: SmoothedPath
    covariance: FloatArray
    """(n, n) of the errors of the thigh's sensor, the shank's, and the knee's place in the thigh's
    sensor"""
    knee_off: FloatArray
    """(3,) m by which the knee was misplaced in the thigh's sensor"""
    settled: bool

    @property
    def motions(self) -> tuple[RigidMotion, RigidMotion]:
        """Motions of thigh and shank against the first view."""
        return self.thigh.motion, self.shank.motion

    def joints(self, tie: LegTie) -> FloatArray:
        """Hip, knee and ankle (3, 3) m in world at the first view."""
        thigh, shank = self.thigh.path.poses[0], self.shank.path.poses[0]
        return np.concatenate(
            [
                transforms.apply(pose, place[None])
                for pose, place in (
                    (thigh, tie.hip_in_thigh),
                    (shank, tie.knee_in_shank),
                    (shank, tie.ankle_in_shank),
                )
            ]
        )

    def apart(self, point: FloatArray) -> FloatArray:
        """How far (v, 3) m the thigh carries a point (3,) of the first view from where the shank
        does.
        """
        at = np.asarray(point, float)[None]
        thigh, shank = self.motions
        return (thigh.carry(at) - shank.carry(at))[:, 0]

    def apart_covariance(self, point: FloatArray) -> FloatArray:
        """Covariance (v, 3, 3) m^2 of :meth:`apart`."""
        at = np.asarray(point, float)[None]
        by = np.concatenate(
            [self.thigh.path.of_points(at)[:, 0], -self.shank.path.of_points(at)[:, 0]], -1
        )
        errors = self.covariance[:-_KNEE, :-_KNEE]
        return by @ errors @ np.swapaxes(by, -1, -2)

    def parting(self, points: FloatArray) -> tuple[float, float]:
        """How far thigh and shank carry the same points (p, 3) m of the first view apart, RMS over
        points and views, and its standard deviation: m.
        """
        apart = np.mean([np.square(self.apart(point)).sum(-1).mean() for point in points])
        spread = np.mean(
            [np.trace(self.apart_covariance(p), axis1=-2, axis2=-1).mean() for p in points]
        )
        return float(np.sqrt(apart)), float(np.sqrt(spread))


class _Joint(NamedTuple):
    """Both sensors' problems, where they stand, and the tie."""

    problems: tuple[PathProblem, PathProblem]
    """thigh, shank"""
    tie: LegTie
    alike: StandingPrior | None
    """points at the knee that thigh and shank carry to nearly the same places; None: anywhere"""

    def as_free_as(self, found: TiedPaths) -> "_Joint":
        """The same with priors of posture as wide as what is found; itself where they are.

        One coordinate counts, as the priors do. Without shadows of a segment its prior alone holds
        it, and stays.
        """
        alike = self.alike
        if alike is not None:
            alike = _widened(alike, found.parting(alike.points)[0] / np.sqrt(3))
        problems = tuple(
            _freed(problem, one.path)
            for problem, one in zip(self.problems, (found.thigh, found.shank), strict=True)
        )
        if alike is self.alike and all(map(operator.is_, problems, self.problems)):
            return self
        return self._replace(alike=alike, problems=(problems[0], problems[1]))

    def tied(
        self, paths: Sequence[SensorPath], knee_off: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Normal equations (n, n), (n,) that the ties add."""
        thigh = paths[0]
        sizes = [path.twists.shape[-1] for path in paths]
        count = sum(sizes) + _KNEE
        matrix, right = np.zeros((count, count)), np.zeros(count)
        weight = self.tie.weight(len(thigh.poses))
        # the knee's misplacement counts in meters here; its prior is of one standard deviation
        places = [(self.tie.knee_in_thigh + knee_off)[None], self.tie.knee_in_shank[None]]
        at = [transforms.apply(p.poses, k) for p, k in zip(paths, places, strict=True)]
        by_knee = np.broadcast_to(thigh.poses[:, None, :3, :3], (*at[0].shape, 3))
        ends = [p.of_attached(k) for p, k in zip(paths, places, strict=True)]
        rows = np.concatenate([ends[0], -ends[1], by_knee], -1)
        add_measurements(matrix, right, weight * (at[0] - at[1]), weight * rows)
        known = np.zeros((_KNEE, count))
        known[:, -_KNEE:] = np.eye(_KNEE)
        add_measurements(matrix, right, knee_off / self.tie.placement, known / self.tie.placement)
        if self.alike is not None:
            points, firm = self.alike.points, self.alike.weight(len(thigh.poses))
            there = [transforms.apply(path.motion(), points) for path in paths]
            by = [path.of_points(points) for path in paths]
            free = np.zeros((*there[0].shape, _KNEE))
            rows = np.concatenate([by[0], -by[1], free], -1)
            add_measurements(matrix, right, firm * (there[0] - there[1]), firm * rows)
        return matrix, right


def smooth_tied(
    thigh: MeasuredSegment, shank: MeasuredSegment, tie: LegTie, geometry: ConeBeamGeometry
) -> TiedPaths:
    """Estimates the paths of both sensors over a scan in one.

    Args:
        thigh: its sensor and what is measured of it.
        shank: the same.
        tie: where the joints are in both sensors.
        geometry: of the scan.

    Raises:
        LegsimError: the sensors' states are of other views; or as
            :func:`legsim.correction.smoother.smooth`.
    """
    if not np.array_equal(thigh.state.views, shank.state.views):
        raise LegsimError("tied sensors are of one scan; give both states the same views")
    starts = [
        prepared(one.state, one.standing, geometry, one.beads, one.fiducials)
        for one in (thigh, shank)
    ]
    problems = (starts[0][0], replace(starts[1][0], foot=tie.foot))
    # each alone first, so that the ties are linear in what is left of the errors
    errors, places = [], []
    for problem, begun, at in starts:
        own, own_places, _ = descended(problem, begun, at)
        errors.append(own)
        places.append(own_places)
    joint = _Joint(problems, tie, _alike(shank.state, errors[1], tie))
    found = _as_far_as_found(joint, errors, places)
    first, second = (
        believed(problem, one.path, one.bead_places)
        for problem, one in zip(problems, (found.thigh, found.shank), strict=True)
    )
    if first is problems[0] and second is problems[1]:
        return found
    # from the start: what wrong shadows made the leg seem to do must widen no prior
    return _as_far_as_found(joint._replace(problems=(first, second)), errors, places)


def tied_paths(
    scan: Scan,
    sensors: tuple[str, str],
    tie: LegTie,
    priors: SensorPriors,
    beads: tuple[BeadShadows | None, BeadShadows | None] = (None, None),
) -> TiedPaths:
    """Estimates the paths of the thigh's and the shank's sensor of a scan.

    Args:
        scan: with both sensors.
        sensors: names, of the thigh's and the shank's.
        tie: where the joints are in both.
        priors: of either sensor and of the person.
        beads: on thigh and shank.

    Raises:
        LegsimError: an unknown sensor, or as :func:`smooth_tied`.
    """
    geometry = scan.projections.geometry
    standing = StandingPrior.at(geometry.rotation_center(), priors.spread)
    thigh, shank = (
        MeasuredSegment(sensor_state(scan, name, priors, clock=priors.clock), standing, on)
        for name, on in zip(sensors, beads, strict=True)
    )
    return smooth_tied(thigh, shank, tie, geometry)


def _alike(state: ErrorState, errors: FloatArray, tie: LegTie) -> StandingPrior | None:
    """Points around the knee, where the shank's sensor has it at the first view.

    Each has its mirror image in the knee: turning about the knee then moves them by nothing in the
    mean, and no shift of one bone against the other can undo a bend.
    """
    if tie.together is None:
        return None
    knee = transforms.apply(state.poses(errors)[0], tie.knee_in_shank[None])[0]
    below = StandingPrior.at(knee, tie.together)
    points = np.concatenate([below.points, 2 * knee - below.points])
    return replace(below, points=points, samples=tie.samples)


def _widened(prior: StandingPrior, found: float) -> StandingPrior:
    """A prior whose spread is what is found (m); the same where it is about that or less."""
    return prior if found <= _BEYOND * prior.spread else replace(prior, spread=float(found))


def _freed(problem: PathProblem, path: SensorPath) -> PathProblem:
    """The problem of a person who leaves their place and foot by as much as is found."""
    problem, standing = on_foot_as_found(problem, path), problem.standing
    if standing is None or (problem.beads is None and problem.fiducials is None):
        return problem
    moved = transforms.apply(path.motion(), standing.points) - standing.points
    wider = _widened(standing, np.sqrt(np.square(moved).mean()))
    return problem if wider is standing else replace(problem, standing=wider)


def _as_far_as_found(
    joint: _Joint, errors: list[FloatArray], places: list[FloatArray]
) -> TiedPaths:
    """The estimate of a leg that leaves its place and bends by what is found; not settled where
    that grew to the end.
    """
    found = _descended_together(joint, errors, places)
    for _ in range(_ROUNDS):
        freer = joint.as_free_as(found)
        if freer is joint:
            return found
        joint = freer
        found = _descended_together(
            joint,
            [found.thigh.errors, found.shank.errors],
            [found.thigh.bead_places, found.shank.bead_places],
        )
    return found if joint.as_free_as(found) is joint else replace(found, settled=False)


def _descended_together(
    joint: _Joint, errors: list[FloatArray], places: list[FloatArray]
) -> TiedPaths:
    def step(thigh: FloatArray, shank: FloatArray, *others: FloatArray) -> tuple[FloatArray, ...]:
        *at, knee_off = others
        normals, matrix, right, _ = _linearized(joint, [thigh, shank], at, knee_off)
        of_thigh, of_shank, of_knee = np.split(
            -solved(matrix, right), np.cumsum([len(thigh), len(shank)])
        )
        of_places = [n.of_beads(by) for n, by in zip(normals, (of_thigh, of_shank), strict=True)]
        return of_thigh, of_shank, *of_places, of_knee

    (*found, knee_off), settled = at_rest(step, (*errors, *places, np.zeros(_KNEE)), errors=2)
    errors, places = found[:2], found[2:]
    _, matrix, _, paths = _linearized(joint, errors, places, knee_off)
    covariance = solved(matrix, np.eye(len(matrix)))
    smooth, first = [], 0
    for problem, path, own, at in zip(joint.problems, paths, errors, places, strict=True):
        block = slice(first, first + len(own))
        smooth.append(smoothed(problem, path, own, covariance[block, block], at, settled))
        first += len(own)
    return TiedPaths(smooth[0], smooth[1], covariance, knee_off, settled)


def _linearized(
    joint: _Joint, errors: list[FloatArray], places: list[FloatArray], knee_off: FloatArray
) -> tuple[list[Normal], FloatArray, FloatArray, list[SensorPath]]:
    """Normal equations of both sensors, of all with the ties, and the paths."""
    made = [p.linearized(*at) for p, *at in zip(joint.problems, errors, places, strict=True)]
    normals, paths = [normal for normal, _ in made], [path for _, path in made]
    alone = [normal.reduced() for normal in normals]
    matrix, right = joint.tied(paths, knee_off)
    matrix += block_diag(*(own for own, _ in alone), np.zeros((_KNEE, _KNEE)))
    right += np.concatenate([*(own for _, own in alone), np.zeros(_KNEE)])
    return normals, matrix, right, paths
