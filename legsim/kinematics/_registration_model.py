"""What registration varies: a vector of a person's parameters, what they make of leg and sites, and
how they move the markers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics import _planted_feet
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import Kinematics, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales, segment_index

_PARENTS = {
    "femur": "pelvis",
    "patella": "femur",
    "tibia": "femur",
    "talus": "tibia",
    "calcn": "talus",
    "toes": "calcn",
}

HIP = 0.006
"""m per axis: what people's hips deviate from the regression (Harrington 2007: 3 to 6 mm)"""

LENGTH = 0.03
"""of thigh and shank against the measured length, whose ends are markers on skin"""

UNLIKE = 0.015
"""of a person's right and left lengths against each other"""

NEUTRAL = np.radians(10.0)
"""rad of a person's habitual hip rotation against the model's neutral one"""

FOOT = (
    "heel",
    "meta1",
    "meta5",
    "toe",
    "toe_lateral",
    "toe_medial",
    "midfoot_superior",
    "midfoot_lateral",
    *(f"foot_{k}" for k in range(10)),
)
"""markers whose places tell how the foot lies in the ankle"""

PLACES = {
    "asis": (0.008, 0.008, 0.008),
    "psis": (0.008, 0.008, 0.008),
    "sacrum": (0.008, 0.008, 0.008),
    "epicondyle_lateral": (0.008, 0.008, 0.012),
    "epicondyle_medial": (0.008, 0.008, 0.012),
    "malleolus_lateral": (0.008, 0.008, 0.008),
    "malleolus_medial": (0.008, 0.008, 0.008),
    **dict.fromkeys(FOOT, (0.008, 0.008, 0.008)),
}
"""m along x, y, z of the segment: how far palpated landmarks lie from where the model has them;
flesh over the epicondyles is the most uncertain (Della Croce et al. 1999, Med Biol Eng Comput
37:155-161: 5 to 20 mm). Markers of the foot lie so far from where a flat foot shows them
"""

LOOSE = (0.03, 0.03, 0.03)
"""m: all other markers, whose place differs between laboratories"""


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """A leg model, the markers' places on it, and the habitual hip rotation of right and left."""

    leg: Leg
    sites: MarkerSites
    neutral: FloatArray
    """(2,) rad"""
    theta: FloatArray
    """(p,) the parameters that these were made from"""


class Parameters(Protocol):
    """What registration varies of a person: theta (p,), zero for the person as scaled."""

    @property
    def size(self) -> int:
        """How many parameters there are, p."""
        ...

    @property
    def center(self) -> FloatArray:
        """(p,) mean of the prior."""
        ...

    @property
    def precision(self) -> FloatArray:
        """(p, p) of the prior."""
        ...

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Markers and pegs."""
        ...

    @property
    def pegged(self) -> np.ndarray:
        """(p,) which parameters are places of pegs."""
        ...

    def __call__(self, theta: FloatArray) -> Person:
        """The person of some parameters."""
        ...

    def jacobian(self, person: Person, values: FloatArray) -> FloatArray:
        """Derivatives (n, m, 3, p) of the markers by the parameters, at values (n, c)."""
        ...

    def neutral_columns(self) -> tuple[tuple[int, int], ...]:
        """Pairs of a parameter and the coordinate that it is the habitual value of."""
        ...

    def only(self, names: Sequence[str]) -> "Parameters":
        """Those of the same person with some of the markers."""
        ...

    def columns_of(self, names: Sequence[str]) -> np.ndarray:
        """Parameters here that remain with some of the markers."""
        ...


class PersonModel:
    """Parameters theta (p,): logarithms of scale factors (pelvis x, y, z; thighs and shanks),
    offsets of the markers in their segments (m), habitual hip rotations (rad).

    All are zero for the person as scaled; ``center`` (p,) and ``precision`` (p, p) are the prior's.
    """

    def __init__(self, leg: Leg, sites: MarkerSites) -> None:
        self._leg, self._sites = leg, sites
        self._scales = leg.scales
        bones = ("femur_r", "femur_l", "tibia_r", "tibia_l")
        self._columns = [("pelvis", (axis,)) for axis in range(3)]
        self._columns += [(bone, (0, 1, 2)) for bone in bones]
        self._first_offset = len(self._columns)
        self._first_neutral = self._first_offset + 3 * len(sites.names)
        self.size = self._first_neutral + 2
        self.precision, self.center = self._prior(leg)

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Markers and pegs."""
        return self._sites.names

    @property
    def pegged(self) -> np.ndarray:
        """(p,) which parameters are places of pegs."""
        pegged = np.zeros(self.size, bool)
        pegs = np.repeat([_planted_feet.is_peg(name) for name in self._sites.names], 3)
        pegged[self._first_offset : self._first_neutral] = pegs
        return pegged

    def _prior(self, leg: Leg) -> tuple[FloatArray, FloatArray]:
        """Precision and mean: lengths as measured, but right and left alike."""
        spread = np.zeros(self.size)
        pose = leg.kinematics(leg.default_coordinates[None])
        hip = pose.origins[0, segment_index("femur_r")] - pose.origins[0, segment_index("pelvis")]
        spread[:3] = HIP / np.abs(hip)
        spread[3 : self._first_offset] = LENGTH
        spread[self._first_offset : self._first_neutral] = np.ravel(
            [
                _planted_feet.spread(name)
                or PLACES.get(name.removesuffix("_r").removesuffix("_l"), LOOSE)
                for name in self._sites.names
            ]
        )
        spread[self._first_neutral :] = NEUTRAL
        precision, pull = np.diag(spread**-2.0), np.zeros(self.size)
        for right, length in ((3, leg.thigh_length), (5, leg.shank_length)):
            pair = np.zeros(self.size)
            pair[[right, right + 1]] = 1.0, -1.0
            precision += np.outer(pair, pair) / UNLIKE**2
            pull -= pair * np.log(length("r") / length("l")) / UNLIKE**2
        return precision, np.asarray(np.linalg.solve(precision, pull), np.float64)

    def __call__(self, theta: FloatArray) -> Person:
        """The person of some parameters."""
        factors = self._scales.factors.copy()
        for column, (bone, axes) in enumerate(self._columns):
            growth = np.exp(theta[column])
            for name in (bone, bone.replace("femur", "patella")):
                factors[segment_index(name), list(axes)] = (
                    self._scales.of(name)[list(axes)] * growth
                )
        scales = SegmentScales(factors, self._scales.mass)
        positions = self._sites.positions * self._growth(scales)
        positions = positions + theta[self._first_offset : self._first_neutral].reshape(-1, 3)
        names, segments, weights = self._sites.names, self._sites.segments, self._sites.weights
        sites = MarkerSites(names, segments, positions, weights)
        neutral = theta[self._first_neutral :].copy()
        return Person(LegModel.load(scales), sites, neutral, theta.copy())

    def _growth(self, scales: SegmentScales) -> FloatArray:
        """(m, 3) how markers follow their bones; the pelvis' stay, so that its factors move the
        hips alone.
        """
        rows = [segment_index(s) for s in self._sites.segments]
        growth = (scales.factors / self._scales.factors)[rows]
        return np.where(np.array(self._sites.segments)[:, None] == "pelvis", 1.0, growth)

    def jacobian(self, person: Person, values: FloatArray) -> FloatArray:
        """Derivatives (n, m, 3, p) of the markers by the parameters, at values (n, c)."""
        pose = person.leg.kinematics(values)
        n, m = len(pose.origins), len(self._sites.names)
        moved = np.zeros((n, m, 3, self.size))
        for k, segment in enumerate(self._sites.segments):
            row = segment_index(segment)
            turn = pose.rotations[:, row]
            first = self._first_offset + 3 * k
            moved[:, k, :, first : first + 3] = turn
            grown = person.sites.positions[k] - self._offset(person, k)
            for column, (bone, axes) in enumerate(self._columns):
                if bone == segment and bone != "pelvis":
                    moved[:, k, :, column] += (turn[:, :, list(axes)] * grown[list(axes)]).sum(-1)
                moved[:, k, :, column] += _carried(pose, segment, bone, axes)
        return moved

    def _offset(self, person: Person, k: int) -> FloatArray:
        """(3,) what marker k was moved by, beyond the growth of its bone."""
        grown = self._sites.positions * self._growth(person.leg.scales)
        return person.sites.positions[k] - grown[k]

    def neutral_columns(self) -> tuple[tuple[int, int], ...]:
        """Pairs of a parameter and the coordinate that it is the habitual value of."""
        names = self._leg.coordinate_names
        return tuple(
            (self._first_neutral + k, names.index(f"hip_rotation_{side}"))
            for k, side in enumerate("rl")
            if f"hip_rotation_{side}" in names
        )

    def only(self, names: Sequence[str]) -> "PersonModel":
        """The model of the same person with some of the markers."""
        return PersonModel(self._leg, self._sites.only(names))

    def columns_of(self, names: Sequence[str]) -> np.ndarray:
        """Parameters here that remain with some of the markers."""
        markers = [self._sites.index(name) for name in names]
        offsets = self._first_offset + 3 * np.array(markers)[:, None] + np.arange(3)
        neutral = np.arange(self._first_neutral, self.size)
        return np.concatenate([np.arange(self._first_offset), offsets.ravel(), neutral])


def joint_blocks(
    model: Parameters,
    person: Person,
    problem: Problem,
    values: FloatArray,
    measured: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Blocks of the Gauss-Newton matrix of poses (n, c) and parameters together: mixed (n, c, p),
    parameters alone (p, p); and the gradient (p,). Without the parameters' prior.
    """
    by_person = model.jacobian(person, values)
    by_pose = person.leg.marker_jacobians(values, person.sites)
    weighted = weights[..., None, None] * by_person
    n, p = len(values), model.size
    flat = weighted.reshape(n, -1, p)
    mixed = np.swapaxes(by_pose.reshape(n, -1, values.shape[1]), 1, 2) @ flat
    # frame by frame: one product over all rows would round by the number of threads
    alone = (np.swapaxes(by_person.reshape(n, -1, p), 1, 2) @ flat).sum(0)
    where = person.leg.marker_positions(values, person.sites)
    residuals = np.where(weights[..., None] > 0, where - measured, 0.0)
    gradient = np.einsum("nmip,nmi->p", weighted, residuals)
    for parameter, coordinate in model.neutral_columns():
        weight = float(problem.prior_weights[coordinate])
        mixed[:, coordinate, parameter] -= weight
        alone[parameter, parameter] += n * weight
        away = values[:, coordinate] - problem.prior_values[coordinate]
        gradient[parameter] -= weight * float(away.sum())
    return mixed, alone, gradient


def _carried(pose: Kinematics, segment: str, bone: str, axes: tuple[int, ...]) -> FloatArray:
    """(n, 3) shift of a segment's origin per logarithm of the factors of a bone above it."""
    shift = np.zeros((len(pose.origins), 3))
    part, _, side = segment.partition("_")
    while part in _PARENTS:
        parent = _PARENTS[part] + ("" if _PARENTS[part] == "pelvis" else f"_{side}")
        if parent == bone:
            above, below = segment_index(parent), segment_index(f"{part}_{side}")
            turn = pose.rotations[:, above]
            lever = np.einsum("nji,nj->ni", turn, pose.origins[:, below] - pose.origins[:, above])
            shift += np.einsum("nij,nj->ni", turn[:, :, list(axes)], lever[:, list(axes)])
        part = _PARENTS[part]
    return shift


assert set(_PARENTS) == {name.partition("_")[0] for name in SEGMENTS} - {"pelvis"}
