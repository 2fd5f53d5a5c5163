"""What registration varies of a person on a user's OpenSim model: factors of the bodies, places of
the markers, habitual hip rotation.

A scaled model's rotations do not depend on its size, and its positions are linear in the factors of
the bodies, so their derivatives are exact.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from legsim.core.values import FloatArray, frozen
from legsim.kinematics import osim_scaling
from legsim.kinematics._registration_model import NEUTRAL, Person
from legsim.kinematics.osim_file import OsimModel
from legsim.kinematics.osim_leg import OsimLeg


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """How the bodies of the legs grow: logarithms of their factors are ``start + matrix @ theta``,
    theta (k,) normally distributed about zero.
    """

    start: FloatArray
    """(b, 3)"""
    matrix: FloatArray
    """(b, 3, k)"""
    precision: FloatArray
    """(k, k)"""
    carries: np.ndarray
    """(b,) whether a body's markers grow with it; else they stay where they are on it"""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where the markers are before they are moved, and how far each may be moved."""

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    locations: FloatArray
    """(m, 3) m in its body, at the size of ``Growth.start``"""
    weights: FloatArray
    """(m,)"""
    spread: FloatArray
    """(m, 3) m, standard deviation along the body's axes; 0: not moved"""


class OsimPerson:
    """Parameters theta: growth of the bodies (k,), offsets (m) of the markers that may move,
    habitual hip rotations (rad) of right and left.
    """

    def __init__(
        self, model: OsimModel, held: Collection[str], growth: Growth, places: Places
    ) -> None:
        self._model, self._held, self.growth, self.markers = model, held, growth, places
        self._leg = OsimLeg(model, held=held)
        self._rows = [self._leg.bodies.index(body) for body in places.bodies]
        self._moved = np.flatnonzero(places.spread.all(1))
        self._first_offset = growth.matrix.shape[-1]
        self._first_neutral = self._first_offset + 3 * len(self._moved)
        self.size = self._first_neutral + 2
        self.center = np.zeros(self.size)
        spread = np.concatenate([np.ravel(places.spread[self._moved]), np.full(2, NEUTRAL)])
        self.precision = np.zeros((self.size, self.size))
        self.precision[: self._first_offset, : self._first_offset] = growth.precision
        own = np.arange(self._first_offset, self.size)
        self.precision[own, own] = spread**-2.0
        self.pegged = np.zeros(self.size, bool)

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the markers."""
        return self.markers.names

    def factors(self, theta: FloatArray) -> FloatArray:
        """Factors (b, 3) of the legs' bodies over the user's model."""
        return np.exp(self.growth.start + self.growth.matrix @ theta[: self._first_offset])

    def places(self, theta: FloatArray) -> FloatArray:
        """Where the markers are on the bodies, (m, 3) m."""
        places = self._grown(self.factors(theta))
        places[self._moved] += theta[self._first_offset : self._first_neutral].reshape(-1, 3)
        return places

    def __call__(self, theta: FloatArray) -> Person:
        """The person of some parameters."""
        factors = dict(zip(self._leg.bodies, self.factors(theta), strict=True))
        placed = dict(zip(self.markers.names, self.places(theta), strict=True))
        model = with_markers(osim_scaling.scaled(self._model, factors), placed)
        leg = OsimLeg(model, held=self._held)
        weights = dict(zip(self.markers.names, self.markers.weights, strict=True))
        sites = leg.marker_sites()[0].only(self.markers.names).weighted(weights)
        return Person(leg, sites, theta[self._first_neutral :].copy(), theta.copy())

    def jacobian(self, person: Person, values: FloatArray) -> FloatArray:
        """Derivatives (n, m, 3, p) of the markers by the parameters, at values (n, c)."""
        assert isinstance(person.leg, OsimLeg)
        factors = self.factors(person.theta)
        poses = person.leg.body_poses(values)
        turns = np.stack([poses[body][:, :3, :3] for body in self.markers.bodies], 1)
        shift = person.leg.growth(values, factors)[:, self._rows]
        grown = self._grown(factors)
        for k, row in enumerate(self._rows):
            if self.growth.carries[row]:
                shift[:, k, :, row] += turns[:, k] * grown[k]
        n, m = turns.shape[:2]
        moved = np.zeros((n, m, 3, self.size))
        moved[..., : self._first_offset] = np.tensordot(shift, self.growth.matrix, 2)
        for j, k in enumerate(self._moved):
            first = self._first_offset + 3 * j
            moved[:, k, :, first : first + 3] = turns[:, k]
        return moved

    def neutral_columns(self) -> tuple[tuple[int, int], ...]:
        """Pairs of a parameter and the coordinate that it is the habitual value of."""
        names = self._leg.coordinate_names
        return tuple(
            (self._first_neutral + k, names.index(f"hip_rotation_{side}"))
            for k, side in enumerate("rl")
            if f"hip_rotation_{side}" in names
        )

    def only(self, names: Sequence[str]) -> "OsimPerson":
        """Those of the same person with some of the markers."""
        rows = [self.markers.names.index(name) for name in names]
        places = Places(
            tuple(names),
            tuple(self.markers.bodies[k] for k in rows),
            self.markers.locations[rows],
            self.markers.weights[rows],
            self.markers.spread[rows],
        )
        return OsimPerson(self._model, self._held, self.growth, places)

    def columns_of(self, names: Sequence[str]) -> np.ndarray:
        """Parameters here that remain with some of the markers."""
        rows = [self.markers.names.index(name) for name in names]
        moved = [int(np.flatnonzero(self._moved == k)[0]) for k in rows if k in self._moved]
        offsets = self._first_offset + 3 * np.array(moved, int)[:, None] + np.arange(3)
        neutral = np.arange(self._first_neutral, self.size)
        return np.concatenate([np.arange(self._first_offset), offsets.ravel(), neutral])

    def _grown(self, factors: FloatArray) -> FloatArray:
        """(m, 3) the markers' places as they grow with their bodies."""
        growth = factors / np.exp(self.growth.start)
        growth = np.where(self.growth.carries[:, None], growth, 1.0)
        return self.markers.locations * growth[self._rows]


def with_markers(model: OsimModel, places: Mapping[str, FloatArray]) -> OsimModel:
    """The model with the named markers at other places (3,) m of their bodies."""
    return replace(
        model,
        markers=tuple(
            replace(m, location=frozen("location", places[m.name], (3,))) if m.name in places else m
            for m in model.markers
        ),
    )
