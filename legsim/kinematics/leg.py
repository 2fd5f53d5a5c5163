"""What the chain needs of a leg, whichever model it is."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import Kinematics, SensorMotion
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import JointCenters, SegmentPoses, SegmentScales
from legsim.mocap.trajectories import JointTrajectories


class Leg(Protocol):
    """A pelvis with two legs, moved by c coordinates; 13 segments in the order of SEGMENTS.

    :class:`legsim.kinematics.leg_model.LegModel` is legsim's own,
    :class:`legsim.kinematics.osim_leg.OsimLeg` a user's OpenSim model.
    """

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """The c coordinates in the order of every (n, c) array; those of the pelvis first."""
        ...

    @property
    def coordinate_ranges(self) -> FloatArray:
        """(c, 2) lowest and highest value; infinite where the model sets no bound."""
        ...

    @property
    def default_coordinates(self) -> FloatArray:
        """(c,) the model's own posture."""
        ...

    @property
    def shifts(self) -> tuple[str, ...]:
        """Names of the coordinates in m; all others are in rad."""
        ...

    @property
    def pelvis_coordinates(self) -> int:
        """How many coordinates, the first ones, move the pelvis in world."""
        ...

    @property
    def heading(self) -> int | None:
        """Column of the coordinate that turns the pelvis about the vertical; None without one."""
        ...

    @property
    def moves(self) -> np.ndarray:
        """(c, 13) whether a coordinate moves a segment by its :class:`Kinematics`."""
        ...

    @property
    def scales(self) -> SegmentScales:
        """Sizes of the segments over the generic leg's: the phantom's."""
        ...

    def values_of(self, trajectories: JointTrajectories) -> FloatArray:
        """Values (n, c) in the model's order."""
        ...

    def segment_poses(self, trajectories: JointTrajectories) -> SegmentPoses:
        """Pose of every segment at every time."""
        ...

    def joint_centers(self, poses: SegmentPoses) -> JointCenters:
        """Hip, knee and ankle centers."""
        ...

    def thigh_length(self, side: str) -> float:
        """m, from hip center to knee center with the knee straight."""
        ...

    def shank_length(self, side: str) -> float:
        """m, from knee center to ankle center."""
        ...

    def kinematics(self, values: ArrayLike) -> Kinematics:
        """Poses and coordinate screws for values (n, c)."""
        ...

    def posture(self, hip: float, knee: float, ankle: float) -> FloatArray:
        """Coordinates (c,) with both legs bent: turns (rad) about the axis to the right."""
        ...

    def pelvis_values(self, world_from_pelvis: FloatArray) -> FloatArray:
        """The pelvis' coordinates (n, p) at which it is nearest to poses (n, 4, 4)."""
        ...

    def marker_positions(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Where the markers are in world, (n, m, 3)."""
        ...

    def marker_jacobians(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Derivatives (n, m, 3, c) of the marker positions by the coordinates."""
        ...

    def attached_motion(
        self,
        values: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        *,
        segment: str,
        segment_from_sensor: ArrayLike,
    ) -> SensorMotion:
        """What a sensor fixed to ``segment`` goes through, exactly."""
        ...

    def complete(self, trajectories: JointTrajectories) -> JointTrajectories:
        """The same motion with the coordinates that the model holds or couples, for OpenSim."""
        ...
