"""Values for the recording and the figures: skeleton, surfaces, sensors."""

from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen, increasing_times
from legsim.geometry.cone_beam import Projections
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import JointCenters, SegmentPoses
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.scene.slices import VolumeSlices


@dataclass(frozen=True, slots=True, eq=False)
class SegmentMesh:
    """A surface that moves rigidly with one segment."""

    name: str
    segment: str
    vertices: FloatArray
    """(p, 3) m, in the segment's frame"""
    triangles: np.ndarray
    """(t, 3) int32"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "vertices", frozen(f"mesh {self.name!r} vertices", self.vertices, (None, 3))
        )
        object.__setattr__(
            self,
            "triangles",
            frozen(f"mesh {self.name!r} triangles", self.triangles, (None, 3), np.int32),
        )


@dataclass(frozen=True, slots=True, eq=False)
class MovingSurface:
    """A surface that deforms: the skin at some of the views."""

    name: str
    times: FloatArray
    """(k,) s"""
    vertices: Float32Array
    """(k, p, 3) m float32, in world"""
    triangles: np.ndarray
    """(t, 3) int32"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "times", increasing_times(f"surface {self.name!r} times", self.times)
        )
        shape = (len(self.times), None, 3)
        object.__setattr__(
            self,
            "vertices",
            frozen(f"surface {self.name!r} vertices", self.vertices, shape, np.float32),
        )
        object.__setattr__(
            self,
            "triangles",
            frozen(f"surface {self.name!r} triangles", self.triangles, (None, 3), np.int32),
        )


BONES = (
    ("hip_r", "hip_l"),
    ("hip_r", "pelvis"),
    ("hip_l", "pelvis"),
    *(
        (f"{a}_{side}", f"{b}_{side}")
        for side in "rl"
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ),
    *(
        (f"{a}_{side}", f"{b}_{side}")
        for side in "rl"
        for a, b in (("ankle", "calcn"), ("calcn", "toes"), ("toes", "ankle"))
    ),
)
"""joint centers, and origins of gait2392's segments, that a line connects in the skeleton

Missing ones are left out.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ReplayScene:
    """A replayed recording.

    Values that a run does not have (markers of a coordinate file, for instance) are None or empty.
    """

    name: str
    trajectories: JointTrajectories
    poses: SegmentPoses
    joint_centers: JointCenters
    imu: ImuSignals | None = None
    sensor_poses: SegmentPoses | None = None
    """world_from_sensor over time, with the sensors as the segments"""
    measured: MarkerTrajectories | None = None
    modelled: MarkerTrajectories | None = None
    """positions of the same markers on the solved model at the same times"""
    segment_meshes: tuple[SegmentMesh, ...] = ()
    bones: tuple[tuple[str, str], ...] = BONES
    shifts: tuple[str, ...] = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
    """names of the coordinates in m; all others are angles"""
    floor_height: float = 0.0
    """m, world y of the floor"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "segment_meshes", tuple(self.segment_meshes))
        if not np.array_equal(self.poses.times, self.joint_centers.times):
            raise LegsimError("joint centers and segment poses must have the same times")
        unknown = sorted(
            {mesh.segment for mesh in self.segment_meshes} - set(self.poses.segment_names)
        )
        if unknown:
            raise LegsimError(
                f"meshes of segments without a pose: {', '.join(unknown)}; known: "
                f"{', '.join(self.poses.segment_names)}"
            )
        if self.modelled is not None and (
            self.measured is None
            or self.modelled.marker_names != self.measured.marker_names
            or not np.array_equal(self.modelled.times, self.measured.times)
        ):
            raise LegsimError("modeled markers need measured ones with the same names and times")

    def angles(self) -> tuple[str, ...]:
        """Names of the coordinates in rad."""
        return tuple(n for n in self.trajectories.coordinate_names if n not in self.shifts)

    def bone_lines(self) -> FloatArray:
        """Both ends of each bone, (n, b, 2, 3) m in world, at the times of the joint centers."""
        places = {
            name: self.joint_centers.positions_world[:, k]
            for k, name in enumerate(self.joint_centers.names)
        }
        places |= {
            name: self.poses.of(name)[:, :3, 3]
            for name in self.poses.segment_names
            if name not in places
        }
        lines = [
            np.stack([places[a], places[b]], 1)
            for a, b in self.bones
            if a in places and b in places
        ]
        return np.stack(lines, 1) if lines else np.empty((len(self.joint_centers.times), 0, 2, 3))

    def marker_residuals(self) -> FloatArray | None:
        """Distances (n, m) in m from measured to modeled marker.

        NaN where not seen; None without markers of both kinds.
        """
        if self.measured is None or self.modelled is None:
            return None
        return np.linalg.norm(
            self.modelled.positions_world - self.measured.positions_world, axis=-1
        )


@dataclass(frozen=True, slots=True, eq=False)
class ScanScene:
    """A simulated scan: its replay, its projections and slices of its volumes."""

    replay: ReplayScene
    projections: Projections
    surfaces: tuple[MovingSurface, ...] = ()
    slices: tuple[VolumeSlices, ...] = ()
    """of its volumes, the motion-free one first"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "surfaces", tuple(self.surfaces))
        object.__setattr__(self, "slices", tuple(self.slices))


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredScene:
    """A measured scan: its projections, slices of its volumes and what its sensors read."""

    projections: Projections
    imu: ImuSignals
    """without any sensor where none was read"""
    slices: tuple[VolumeSlices, ...]
    """of its volumes"""
    sensor_poses: SegmentPoses | None = None
    """world_from_sensor at the views, with the sensors as the segments"""
