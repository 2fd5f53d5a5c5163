"""Options of inverse kinematics: weights of markers, tasks and locks of coordinates, priors, and
tolerances.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

from legsim.core.errors import LegsimError

Unit = Literal["", "rad", "m"]


@dataclass(frozen=True, slots=True)
class CoordinatePrior:
    """A coordinate is pulled to a value: adds ``weight * (coordinate - value)^2`` to the sum over
    the markers.
    """

    coordinate: str
    weight: float
    """m^2/rad^2: (marker error / coordinate's spread)^2"""
    value: float = 0.0
    """rad"""


@dataclass(frozen=True, slots=True)
class CoordinateTask:
    """OpenSim's IKCoordinateTask: a coordinate is pulled to a value, in place of its prior.

    OpenSim divides the sum over the markers by the sum of the weights of those that a frame shows,
    and adds ``weight * (coordinate - value)^2``.
    """

    coordinate: str
    weight: float
    """m^2/rad^2; for coordinates in m without unit; 0 is no task"""
    value: float | None = None
    """rad or m; None: the model's default"""
    unit: Unit = ""
    """of ``value``; checked against the coordinate where it is given"""


@dataclass(frozen=True, slots=True)
class CoordinateLock:
    """A coordinate that stays at a value."""

    coordinate: str
    value: float | None = None
    """rad or m; None: the model's default"""
    unit: Unit = ""
    """of ``value``; checked against the coordinate where it is given"""


@dataclass(frozen=True, slots=True)
class PriorStrengths:
    """How strong the model's own priors are: 1 as they are, 0 off, 2 twice the weight."""

    hip_rotation: float = 1.0
    """toward the habitual rotation, where the markers of the thigh leave it open"""
    flat_foot: float = 1.0
    """a foot without markers stands flat"""
    subtalar: float = 1.0
    """toward the default"""
    toes: float = 1.0
    """toward the default"""
    hyperextension: float = 1.0
    """a knee that is overextended by more than 10 degrees is drawn back"""
    default_posture: float = 1.0
    """of a user's own OpenSim model: all other coordinates toward their defaults"""

    def of(self, coordinate: str) -> float:
        """The strength of the prior of one coordinate."""
        for start, name in _NAMED.items():
            if coordinate.startswith(start):
                return getattr(self, name)
        return self.default_posture


_NAMED = {"hip_rotation": "hip_rotation", "subtalar": "subtalar", "mtp": "toes"}
"""beginnings of coordinates, and the strength of their prior"""


def leg_priors() -> tuple[CoordinatePrior, ...]:
    """The priors of legsim's own leg: hip rotation toward neutral, toes straight; subtalar so
    weakly that the flat foot decides.
    """
    # 5 mm of marker error against 10 degrees of spread: decides hip rotation when the knee is
    # straight, hardly counts when it is bent
    weak = (("hip_rotation", 8e-4), ("subtalar_angle", 1e-7), ("mtp_angle", 1e-7))
    return tuple(
        CoordinatePrior(f"{name}_{side}", weight) for name, weight in weak for side in "rl"
    )


@dataclass(frozen=True, slots=True)
class IkOptions:
    """How markers become coordinates."""

    marker_weights: Mapping[str, float] = field(default_factory=dict)
    """by the recording's label, by role or by the model's marker; 0 leaves it out; others keep the
    model's
    """
    tasks: tuple[CoordinateTask, ...] = ()
    locked: tuple[CoordinateLock, ...] = ()
    tasks_file: str | Path = ""
    """OpenSim's IKTaskSet or IK set-up (.xml); ``marker_weights`` and ``tasks`` override it"""
    strengths: PriorStrengths = PriorStrengths()
    """of the priors"""
    priors: tuple[CoordinatePrior, ...] | None = None
    """None: those of the model"""
    flat_foot_weight: float = 1e-5
    """m^2: of the squared horizontal part of each foot's upright axis; where no marker sits on the
    foot it stands flat on the floor
    """
    feet_on_floor: bool = True
    """where False, somebody lies: ``flat_foot_weight`` draws ankle and subtalar joint to neutral
    instead; whatever solves a recording sets it
    """
    hyperextension_weight: float = 3.3e-3
    """m^2/rad^2: 5 mm of marker error against 5 degrees, of what a knee of legsim's own leg is
    overextended beyond 10 degrees
    """
    tolerance: float = 1e-9
    """m: converged when no free coordinate's gradient, over the root of its own curvature, exceeds
    this
    """
    max_iterations: int = 200
    """of one frame; a frame that has not converged by then is counted in the report"""
    strides: tuple[int, ...] = (64, 8, 1)
    """frames between those solved first, from scratch; then ever closer ones, each started between
    solved neighbors
    """

    def __post_init__(self) -> None:
        strengths = {f"prior {f.name}": getattr(self.strengths, f.name) for f in fields(_USUAL)}
        tasks = {f"task of {task.coordinate}": task.weight for task in self.tasks}
        markers = {f"marker {name}": weight for name, weight in self.marker_weights.items()}
        for what, weight in {**markers, **tasks, **strengths}.items():
            if not 0 <= weight < float("inf"):
                raise LegsimError(
                    f"inverse kinematics: the weight of {what} is {weight:g}; give 0 or more"
                )
        for what, entries in (("task", self.tasks), ("lock", self.locked)):
            names = [entry.coordinate for entry in entries]
            for name in names:
                if names.count(name) > 1:
                    raise LegsimError(f"inverse kinematics: {name} has two {what}s; keep one")
            for entry in entries:
                if entry.value is not None and not math.isfinite(entry.value):
                    raise LegsimError(
                        f"inverse kinematics: the value of the {what} of {entry.coordinate} is "
                        f"{entry.value}; give a finite one, or none for the default"
                    )

    def settled(self, own: tuple[CoordinatePrior, ...]) -> "IkOptions":
        """The options with priors by their strengths: the model's ``own`` where none are given."""
        priors = own if self.priors is None else self.priors
        return replace(
            self,
            priors=tuple(
                replace(p, weight=p.weight * self.strengths.of(p.coordinate)) for p in priors
            ),
            flat_foot_weight=self.flat_foot_weight * self.strengths.flat_foot,
            hyperextension_weight=self.hyperextension_weight * self.strengths.hyperextension,
            strengths=PriorStrengths(),
        )


_USUAL = PriorStrengths()
