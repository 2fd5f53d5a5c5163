"""Values about one person's legs: scale factors of the segments, where markers sit on them, joint centers over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.arrays import FloatArray, frozen, increasing_times
from legsim.errors import LegsimError

SEGMENTS = (
    "pelvis",
    *(f"{part}_{side}" for side in "rl" for part in ("femur", "patella", "tibia", "talus", "calcn", "toes")),
)
"""Bodies of the leg model in its order, under OpenSim's names."""

JOINT_CENTERS = ("hip_l", "knee_l", "ankle_l", "hip_r", "knee_r", "ankle_r")
"""Names and order of the joint centers."""


@dataclass(frozen=True, slots=True, eq=False)
class SegmentScales:
    """How a person's segments differ in size from the generic model's, by OpenSim's scaling rules."""

    factors: FloatArray
    """(13, 3) factors along x, y, z of each segment in the order of SEGMENTS"""
    mass: float | None = None
    """kg of the whole body: every generic mass times one factor; None: each mass times the product of its segment's factors"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "factors", frozen("SegmentScales.factors", self.factors, (len(SEGMENTS), 3)))
        if not (np.isfinite(self.factors) & (self.factors > 0)).all():
            raise LegsimError(f"scale factors must be positive numbers; got {self.factors.tolist()}")
        if self.mass is not None and not self.mass > 0:
            raise LegsimError(f"a body mass must be positive; got {self.mass} kg")

    @classmethod
    def uniform(cls, factor: float = 1.0, *, mass: float | None = None) -> "SegmentScales":
        """The generic model, larger or smaller by one factor."""
        return cls(np.full((len(SEGMENTS), 3), factor), mass)

    def of(self, segment: str) -> FloatArray:
        """Factors (3,) of one segment."""
        return self.factors[segment_index(segment)]


@dataclass(frozen=True, slots=True, eq=False)
class MarkerSites:
    """Where markers sit on the segments of one model."""

    names: tuple[str, ...]
    segments: tuple[str, ...]
    """(m,) segment that carries each marker"""
    positions: FloatArray
    """(m, 3) m, in the frame of that segment"""
    weights: FloatArray
    """(m,) weight of the squared distance in the least squares of :mod:`legsim.replay`"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "segments", tuple(self.segments))
        if len(set(self.names)) != len(self.names):
            raise LegsimError(f"names of marker sites must differ; got {', '.join(self.names)}")
        for segment in self.segments:
            segment_index(segment)
        object.__setattr__(self, "positions", frozen("MarkerSites.positions", self.positions, (len(self.names), 3)))
        object.__setattr__(self, "weights", frozen("MarkerSites.weights", self.weights, (len(self.names),)))
        if len(self.segments) != len(self.names):
            raise LegsimError(f"{len(self.names)} marker sites need as many segments; got {len(self.segments)}")
        if not (self.weights >= 0).all():
            raise LegsimError(f"marker weights must not be negative; got {self.weights.tolist()}")

    def position(self, name: str) -> FloatArray:
        """Position (3,) of one site in its segment's frame."""
        return self.positions[self.index(name)]

    def index(self, name: str) -> int:
        """Row of one site."""
        if name not in self.names:
            raise LegsimError(f"no marker site named {name!r}; there are: {', '.join(self.names)}")
        return self.names.index(name)

    def only(self, names: Sequence[str]) -> "MarkerSites":
        """The named sites, in the order of ``names``."""
        rows = [self.index(name) for name in names]
        return MarkerSites(tuple(names), tuple(self.segments[k] for k in rows), self.positions[rows], self.weights[rows])

    def scaled(self, scales: SegmentScales) -> "MarkerSites":
        """The same places on the scaled segments."""
        factors = scales.factors[[segment_index(s) for s in self.segments]].reshape(-1, 3)
        return MarkerSites(self.names, self.segments, self.positions * factors, self.weights)


@dataclass(frozen=True, slots=True, eq=False)
class JointCenters:
    """Centers of the hips, knees and ankles over time."""

    times: FloatArray
    """(n,) s"""
    positions_world: FloatArray
    """(n, 6, 3) m, in the order of JOINT_CENTERS"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("JointCenters.times", self.times))
        shape = (len(self.times), len(JOINT_CENTERS), 3)
        object.__setattr__(self, "positions_world", frozen("JointCenters.positions_world", self.positions_world, shape))

    @property
    def names(self) -> tuple[str, ...]:
        """The six names, in order."""
        return JOINT_CENTERS

    def of(self, name: str) -> FloatArray:
        """Positions (n, 3) in world of one center, for instance ``knee_l``."""
        if name not in JOINT_CENTERS:
            raise LegsimError(f"no joint center named {name!r}; there are: {', '.join(JOINT_CENTERS)}")
        return self.positions_world[:, JOINT_CENTERS.index(name)]


def segment_index(segment: str) -> int:
    """Place of a segment in SEGMENTS.

    Raises:
        LegsimError: there is no such segment; the message lists them.
    """
    if segment not in SEGMENTS:
        raise LegsimError(f"no segment named {segment!r}; there are: {', '.join(SEGMENTS)}")
    return SEGMENTS.index(segment)
