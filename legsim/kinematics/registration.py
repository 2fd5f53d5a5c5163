"""A person's leg found together with the poses: lengths, hip centers, and where each marker sits.

Scaling takes a person's size from distances between markers, as if each sat where the model's does.
People's do not: a marker over the epicondyle that lies 15 mm further out turns the thigh by 15
degrees. Registration minimizes over some frames, that differ in posture,

    sum over frames of (IK's own sum) + e^2 (theta - c)' P (theta - c)

where theta are the person's parameters, c and P the mean and precision of their prior, in units of
the error e of a marker. The poses are eliminated: at each theta they are those of inverse
kinematics, and the Hessian of theta is the Schur complement (variable projection, Golub and
Pereyra 1973). OpenSim's marker placer and AddBiomechanics (Werling et al. 2023) do likewise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray, frozen
from legsim.kinematics import _ik_branches, _planted_feet, _stance
from legsim.kinematics._ik_newton import held_at_limits, minimize
from legsim.kinematics._ik_problem import Problem, State
from legsim.kinematics._planted_feet import Pegs
from legsim.kinematics._registration_model import (
    Parameters,
    Person,
    PersonModel,
    joint_blocks,
)
from legsim.kinematics.ik_options import IkOptions, leg_priors
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import segment_index
from legsim.mocap.trajectories import MarkerTrajectories

MARKER_ERROR = 0.003
"""m per axis, of a marker of weight 1: what skin slides between postures. A recording of many
postures shows its own
"""

_HELD_HIP_ERROR = 0.005
"""m: markers of less error leave the hip above a foot that stands 10 degrees about its habitual
rotation from posture to posture, others MARKER_ERROR's 6. Squats turn hips over feet that stand by
more, and the foot says how
"""

_LEAST_ERROR, _MOST_ERROR = 0.0003, 0.02
"""m that a recording may show"""

_MANY = 8
"""postures that show the error of markers"""

_MOST_FRAMES = 60

_INDEPENDENT = 2.0
"""frames that count in full; more share that weight, because skin slides alike in like postures"""

_APART = 0.015
"""m: postures differ where a marker has moved by so much against the pelvis"""

_MOST_STEPS = 40

_MOST_ROUNDS = 8

_SAME_ERROR = 0.1
"""relative change of the markers' error that is none"""

_HIPS_FAR = 0.015
"""m: 2.5 standard deviations of the regression along one axis"""

_SETTLED = 1e-5
"""relative decrease of the sum below which a step is the last"""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """What :func:`register` finds."""

    leg: Leg
    sites: MarkerSites
    """where the markers sit on the leg"""
    pegs: Pegs | None
    """of the feet that stand still in the recording"""
    config: IkOptions
    """as it was given, with the person's habitual hip rotation as that prior's value"""
    frames: int
    """how many frames were used"""
    rms_before: float
    """m, of the markers in those frames on the leg as scaled"""
    rms_after: float
    """m"""
    model: Parameters
    theta: FloatArray
    """(p,) the parameters"""
    covariance: FloatArray
    """(p, p) of the parameters, given the markers, their errors and the priors"""
    error: float
    """m per axis, of a marker of weight 1: what the recording showed, or MARKER_ERROR where it has
    too few postures to show it
    """
    hips_moved: FloatArray
    """(2,) m, how far registration moved the right and left hip center against the pelvis' markers
    """

    def notes(self) -> tuple[str, ...]:
        """A warning where the recording moves the hips farther than people's hips lie from the
        regression.
        """
        if self.hips_moved.max() <= _HIPS_FAR:
            return ()
        right, left = 1e3 * self.hips_moved
        return (
            f"warning: registration moves the hip centers by {right:.0f} and {left:.0f} mm (right, "
            "left) from the regression, which people's hips seldom are; skin that slides does "
            "that, most in deep squats, and shifts the angles of hips and knees: scale from a "
            "static trial or from shallower squats (motion.scaling_file)",
        )


def register(
    leg: Leg,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    config: IkOptions | None = None,
) -> Registration:
    """The leg, the places of the markers and the habitual hip rotation that a recording shows.

    Args:
        leg: scaled from the same person (:func:`legsim.kinematics.scaling.fit`).
        motion: markers named like ``sites``; up to 60 frames that differ in posture are used.
        sites: places on the scaled leg.
        config: of inverse kinematics.

    Raises:
        LegsimError: no frame shows three markers of the pelvis, or a leg has no marker at all.
    """
    config = (config or IkOptions()).settled(leg_priors())
    config = _stance.with_feet(config, motion, sites)
    sites = sites.weighted(config.marker_weights)
    sites = sites.only([name for name in motion.marker_names if name in sites.names])
    measured = motion.positions_world[:, [motion.marker_names.index(n) for n in sites.names]]
    problem = Problem(leg, sites, config)
    chosen = postures(problem, measured)
    pegs = _planted_feet.find(leg, sites, motion, chosen, _posed(problem, measured[chosen]))
    shown = measured[chosen]
    if pegs is not None:
        sites, shown = pegs.beside(sites), pegs.beside_markers(shown)
        shown[:, measured.shape[1] :][pegs.shares[chosen] < 1] = np.nan
    return settled(PersonModel(leg, sites), config, shown, pegs=pegs)


def settled(
    model: Parameters,
    config: IkOptions,
    measured: FloatArray,
    *,
    error: float = MARKER_ERROR,
    least_error: float = _LEAST_ERROR,
    many: int = _MANY,
    pegs: Pegs | None = None,
) -> Registration:
    """The parameters that follow markers and pegs (n, m, 3) of some postures best.

    ``error`` (m) is that of a marker until ``many`` postures show their own, ``least_error`` the
    smallest that they may show.
    """
    fit = _Fit(model, config, measured, error, least_error, many)
    fit.settle()
    return fit.result(pegs)


def _posed(problem: Problem, measured: FloatArray) -> FloatArray:
    """Values (n, c) of the cheapest minimum of each frame."""
    weights = np.isfinite(measured).all(-1) * problem.sites.weights
    minima = _ik_branches.find(problem, problem.pelvis_starts(measured), measured, weights)
    return np.array([m.values[0] for m in minima])


def postures(problem: Problem, measured: FloatArray) -> np.ndarray:
    """Frames that show the most markers and differ in posture, each the farthest from those before
    it.
    """
    seen = np.asarray(np.isfinite(measured).all(-1))
    count = np.where(seen[:, problem.pelvis_rows].sum(1) >= 3, seen.sum(1), -1)
    frames = np.flatnonzero(count == count.max())
    frames = frames[:: max(1, len(frames) // 600)]
    pelvis = np.array(problem.pelvis_rows)
    local = []
    for frame in measured[frames]:
        use = pelvis[np.isfinite(frame[pelvis, 0])]
        pose = transforms.best_rigid(
            problem.sites.positions[use], frame[use], problem.sites.weights[use]
        )
        local.append(transforms.apply(transforms.inverse(pose), frame))
    shapes = np.array(local)[:, seen[frames].any(0)]
    chosen = [int(_apart(shapes, np.nanmedian(shapes, 0)).argmin())]
    away = np.full(len(frames), np.inf)
    while len(chosen) < _MOST_FRAMES:
        away = np.minimum(away, _apart(shapes, shapes[chosen[-1]]))
        if away.max() < _APART:
            break
        chosen.append(int(away.argmax()))
    return np.sort(frames[chosen])


def _apart(shapes: FloatArray, one: FloatArray) -> FloatArray:
    """(n,) m: how far markers (n, m, 3) are from another posture's (m, 3) at most, of those that
    both show.
    """
    return np.nan_to_num(np.linalg.norm(shapes - one, axis=-1)).max(1)


class _Fit:
    """Levenberg-Marquardt on the person's parameters; poses follow."""

    def __init__(
        self,
        model: Parameters,
        config: IkOptions,
        measured: FloatArray,
        error: float,
        least_error: float,
        many: int,
    ) -> None:
        self._model, self._config = model, config
        self._least, self._many = least_error, many
        self._seen = np.asarray(np.isfinite(measured).all(-1))
        self._is_peg = np.array([_planted_feet.is_peg(name) for name in model.marker_names])
        self._standing = _planted_feet.sides(model.marker_names)
        self._measured = np.nan_to_num(measured)
        self._share = min(1.0, _INDEPENDENT / len(measured))
        self.theta = np.zeros(model.size)
        self._expect(error)
        self.state = self._posed_from_scratch()
        self.rms_before = self._rms()

    def _at(self, theta: FloatArray) -> tuple[Person, Problem]:
        person = self._model(theta)
        sites = _planted_feet.weighed(person.sites, self.error)
        return person, Problem(person.leg, sites, self._settings(person))

    def _settings(self, person: Person) -> IkOptions:
        """Hip rotation is pulled to the habitual one by as much as markers of this error leave it
        open, less where a foot stands; on a user's model, whose markers may be exact, all priors
        weigh by that.
        """
        share = min(1.0, self.error / MARKER_ERROR) ** 2
        held = min(1.0, self.error / _HELD_HIP_ERROR) ** 2
        shares = {side: held if side in self._standing else share for side in "rl"}
        settings = with_neutral(self._config, person.neutral, shares)
        if isinstance(self._model, PersonModel):
            return settings
        hips = {f"hip_rotation_{side}" for side in "rl"}
        priors = tuple(
            p if p.coordinate in hips else replace(p, weight=share * p.weight)
            for p in settings.priors or ()
        )
        return replace(settings, priors=priors, flat_foot_weight=share * settings.flat_foot_weight)

    def _posed_from_scratch(self) -> State:
        measured = np.where(self._seen[..., None], self._measured, np.nan)
        return self._posed(self._problem, _posed(self._problem, measured))

    def _posed(self, problem: Problem, starts: FloatArray) -> State:
        return minimize(problem, starts, self._measured, self._weights)[0]

    def _total(self, state: State, theta: FloatArray) -> float:
        away = theta - self._model.center
        return float(state.cost.sum()) + 0.5 * float(away @ self._precision @ away)

    def _expect(self, error: float) -> None:
        """Weighs the prior for markers of this error, m."""
        self.error = error
        self._unit = error**2 / self._share
        self._precision = self._unit * self._model.precision
        self.person, self._problem = self._at(self.theta)
        self._weights = self._seen * self._problem.sites.weights

    def settle(self) -> None:
        """Steps until the sum stays, with the error that the markers show, then looks for postures
        that cost less now.
        """
        for _ in range(_MOST_ROUNDS):
            self._descend()
            total = self._total(self.state, self.theta)
            again = self._posed_from_scratch()
            cheaper = self._total(again, self.theta) < total * (1 - _SETTLED)
            if cheaper:
                self.state = again
            before = self.error
            if len(self._measured) >= self._many:
                self._expect(float(np.clip(self._shown_error(), self._least, _MOST_ERROR)))
                self.state = self._posed(self._problem, self.state.values)
            if not cheaper and abs(np.log(self.error / before)) < _SAME_ERROR:
                break

    def _shown_error(self) -> float:
        """m: root of the weighted sum of squares over the degrees of freedom that neither poses nor
        parameters take.
        """
        plain = np.zeros(len(self._measured), bool)
        values, problem = self.state.values, self._problem
        pulls = problem.pulls(self._weights)
        # the pegs count as priors
        held = self._weights * self._is_peg
        nothing = problem.at(values, self._measured, held, plain, pulls)
        whole = problem.at(values, self._measured, self._weights, plain)
        faint = 1e-12 * np.eye(values.shape[1])
        open_share = np.linalg.solve(whole.curvature + faint, nothing.curvature + faint)
        posed = values.shape[1] - np.einsum("ncc->n", open_share)
        _, hessian, _ = self._system()
        placed = 1 - np.einsum("pq,qp->p", np.linalg.inv(hessian), self._precision)
        decided = float(placed[~self._model.pegged].sum())
        freedom = 3 * int(self._seen[:, ~self._is_peg].sum()) - float(posed.sum()) - decided
        squares = 2 * float((whole.cost - nothing.cost).sum())
        return float(np.sqrt(max(squares, 0.0) / max(freedom, 1.0)))

    def _descend(self) -> None:
        damping, total = 1e-4, self._total(self.state, self.theta)
        for _ in range(_MOST_STEPS):
            gradient, hessian, follow = self._system()
            damped = hessian + damping * np.diag(np.diag(hessian))
            step = -np.linalg.solve(damped, gradient)
            theta = self.theta + step
            person, problem = self._at(theta)
            state = self._posed(problem, self.state.values - follow @ step)
            trial = self._total(state, theta)
            if not trial <= total:  # also where it is not a number
                damping = 10 * max(damping, 1e-4)
                if damping > 1e6:
                    break
                continue
            self.theta, self.person, self._problem, self.state = theta, person, problem, state
            damping, gain, total = damping / 10, total - trial, trial
            if gain <= _SETTLED * total:
                break

    def _system(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradient (p,) and Hessian (p, p) with the poses eliminated; (n, c, p) how poses follow
        the parameters, turned about.
        """
        person, problem, values = self.person, self._problem, self.state.values
        plain = np.zeros(len(values), bool)
        state = problem.at(values, self._measured, self._weights, plain)
        crossing, own, gradient = joint_blocks(
            self._model, person, problem, values, self._measured, self._weights
        )
        free = ~held_at_limits(problem, state)
        curvature = state.curvature * (free[:, :, None] & free[:, None])
        diagonal = np.arange(values.shape[1])
        curvature[:, diagonal, diagonal] += np.where(free, 1e-12, 1.0)
        crossing = crossing * free[..., None]
        follow = np.asarray(np.linalg.solve(curvature, crossing), np.float64)
        hessian = own - np.einsum("ncp,ncq->pq", crossing, follow) + self._precision
        gradient = gradient + self._precision @ (self.theta - self._model.center)
        return gradient, hessian, follow

    def _rms(self) -> float:
        where = self.person.leg.marker_positions(self.state.values, self.person.sites)
        squares = ((where - self._measured) ** 2).sum(-1)
        return float(np.sqrt(squares[self._seen & ~self._is_peg].mean()))

    def _hips_moved(self) -> FloatArray:
        """(2,) m, against the mean of the pelvis' markers."""
        hips = []
        for person in (self.person, self._model(np.zeros(self._model.size))):
            pose = person.leg.kinematics(person.leg.default_coordinates[None])
            pelvis = segment_index("pelvis")
            femurs = [segment_index(f"femur_{side}") for side in "rl"]
            away = (pose.origins[0, femurs] - pose.origins[0, pelvis]) @ pose.rotations[0, pelvis]
            rows = [k for k, s in enumerate(person.sites.segments) if s == "pelvis"]
            hips.append(away - person.sites.positions[rows].mean(0))
        return frozen("hips_moved", np.linalg.norm(hips[0] - hips[1], axis=1), (2,))

    def result(self, pegs: Pegs | None) -> Registration:
        """What was found."""
        _, hessian, _ = self._system()
        sites = self._problem.sites
        return Registration(
            leg=self.person.leg,
            sites=sites.only([n for n in sites.names if not _planted_feet.is_peg(n)]),
            pegs=None if pegs is None else pegs.at(sites),
            config=self._settings(self.person),
            frames=len(self._measured),
            rms_before=self.rms_before,
            rms_after=self._rms(),
            model=self._model,
            theta=frozen("theta", self.theta, (self._model.size,)),
            hips_moved=self._hips_moved(),
            error=self.error,
            covariance=frozen("covariance", self._unit * np.linalg.inv(hessian), hessian.shape),
        )


def with_neutral(config: IkOptions, neutral: FloatArray, shares: Mapping[str, float]) -> IkOptions:
    """The settings with the hip's prior at the habitual rotations (2,) rad of right and left, its
    weight times the share of the side.
    """
    values: dict[str, float] = {
        f"hip_rotation_{side}": float(value) for side, value in zip("rl", neutral, strict=True)
    }
    priors = tuple(
        replace(
            prior,
            weight=shares[prior.coordinate[-1]] * prior.weight,
            value=prior.value + values[prior.coordinate],
        )
        if prior.coordinate in values
        else prior
        for prior in config.priors or ()
    )
    return replace(config, priors=priors)
