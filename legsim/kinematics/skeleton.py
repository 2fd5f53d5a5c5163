"""Values about one person's legs: scale factors of the segments, where markers sit on them, joint
centers over time.
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times, index_of, unique_names

SEGMENTS = (
    "pelvis",
    *(
        f"{part}_{side}"
        for side in "rl"
        for part in ("femur", "patella", "tibia", "talus", "calcn", "toes")
    ),
)
"""Bodies of the leg model in its order, under OpenSim's names."""

JOINT_CENTERS = ("hip_l", "knee_l", "ankle_l", "hip_r", "knee_r", "ankle_r")
"""Names and order of the joint centers."""

_CENTER_SEGMENT = {"hip": "femur", "knee": "tibia", "ankle": "talus"}


@dataclass(frozen=True, slots=True, eq=False)
class SegmentScales:
    """How a person's segments differ in size from the generic model's, by OpenSim's scaling
    rules.
    """

    factors: FloatArray
    """(13, 3) factors along x, y, z of each segment in the order of SEGMENTS"""
    mass: float | None = None
    """kg of the whole body: every generic mass times one factor; None: each mass times the product
    of its segment's factors
    """

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "factors", frozen("SegmentScales.factors", self.factors, (len(SEGMENTS), 3))
        )
        if not (np.isfinite(self.factors) & (self.factors > 0)).all():
            raise LegsimError(
                f"scale factors must be positive numbers; got {self.factors.tolist()}"
            )
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
class JointCenters:
    """Centers of the hips, knees and ankles over time."""

    times: FloatArray
    """(n,) s"""
    positions_world: FloatArray
    """(n, 6, 3) m, in the order of JOINT_CENTERS"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("JointCenters.times", self.times))
        shape = (len(self.times), len(JOINT_CENTERS), 3)
        object.__setattr__(
            self,
            "positions_world",
            frozen("JointCenters.positions_world", self.positions_world, shape),
        )

    @classmethod
    def of_segments(cls, poses: "SegmentPoses") -> "JointCenters":
        """The origins of femur, tibia and talus."""
        names = [name.rsplit("_", 1) for name in JOINT_CENTERS]
        origins = [poses.of(f"{_CENTER_SEGMENT[joint]}_{side}")[:, :3, 3] for joint, side in names]
        return cls(poses.times, np.stack(origins, 1))

    @property
    def names(self) -> tuple[str, ...]:
        """The six names, in order."""
        return JOINT_CENTERS

    def of(self, name: str) -> FloatArray:
        """Positions (n, 3) in world of one center, for instance ``knee_l``."""
        if name not in JOINT_CENTERS:
            raise LegsimError(
                f"no joint center named {name!r}; there are: {', '.join(JOINT_CENTERS)}"
            )
        return self.positions_world[:, JOINT_CENTERS.index(name)]


def segment_index(segment: str) -> int:
    """Place of a segment in SEGMENTS.

    Raises:
        LegsimError: there is no such segment; the message lists them.
    """
    if segment not in SEGMENTS:
        raise LegsimError(f"no segment named {segment!r}; there are: {', '.join(SEGMENTS)}")
    return SEGMENTS.index(segment)


@dataclass(frozen=True, slots=True, eq=False)
class SegmentPoses:
    """Pose of every segment (OpenSim body) at every time."""

    times: FloatArray
    """(n,) s"""
    segment_names: tuple[str, ...]
    world_from_segment: FloatArray
    """(n, s, 4, 4)"""

    def __repr__(self) -> str:
        return f"SegmentPoses({len(self.segment_names)} segments at {len(self.times)} times)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("SegmentPoses.times", self.times))
        object.__setattr__(self, "segment_names", unique_names("segment", self.segment_names))
        shape = (len(self.times), len(self.segment_names), 4, 4)
        object.__setattr__(
            self,
            "world_from_segment",
            frozen("SegmentPoses.world_from_segment", self.world_from_segment, shape),
        )

    def of(self, segment: str) -> FloatArray:
        """world_from_segment (n, 4, 4) of one segment."""
        return self.world_from_segment[:, index_of("segment", self.segment_names, segment)]

    def knee_flexion(self, side: str) -> FloatArray:
        """(n,) rad by which the knee of ``side`` ("r" or "l") is bent, whatever a model's sign."""
        femur, tibia = (self.of(f"{part}_{side}")[:, :3, :3] for part in ("femur", "tibia"))
        turn = np.swapaxes(femur, 1, 2) @ tibia
        return -np.arctan2(turn[:, 1, 0], turn[:, 0, 0])

    def held_at(self, index: int) -> "SegmentPoses":
        """The motion-free counterpart: the pose of sample ``index`` at every time."""
        held = np.broadcast_to(self.world_from_segment[index], self.world_from_segment.shape)
        return replace(self, world_from_segment=held)
