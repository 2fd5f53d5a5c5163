"""What the stages of a run share: the moving person, and where a stage reads its settings and leaves its files."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from legsim.arrays import FloatArray
from legsim.artifacts import RunFolder
from legsim.config import RunConfig
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry
from legsim.imu import JointSplines, Sensor
from legsim.leg_phantom import LegPhantom
from legsim.opencl import Device
from legsim.recovery import Recovery
from legsim.signals import SegmentPoses

OnProgress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class ScannedLeg:
    """The moving person, as every stage after the first needs it."""

    recovery: Recovery
    splines: JointSplines
    sensors: tuple[Sensor, ...]
    poses: SegmentPoses
    """of the segments at the views"""
    phantom: LegPhantom
    geometry: ConeBeamGeometry

    def __post_init__(self) -> None:
        if not np.array_equal(self.poses.times, self.geometry.times):
            raise LegsimError("a scanned leg's poses are those at the views: give them at the times of the geometry")

    @property
    def times(self) -> FloatArray:
        """(v,) s of the views."""
        return self.geometry.times


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Where a stage works."""

    settings: RunConfig
    folder: RunFolder
    device: Device
    scan_key: str
    """of all that decides the projections"""
    on_progress: OnProgress
