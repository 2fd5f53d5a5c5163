"""Joint coordinates as splines in time, and segment poses at any time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, increasing_times
from legsim.kinematics.leg import Leg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import JointTrajectories

_ROUNDING = 1e-9
"""s by which a time may lie outside the recording: clocks written as text"""


@dataclass(frozen=True, slots=True, eq=False)
class JointSplines:
    """Quintic splines through every sample of the joint coordinates: four continuous derivatives,
    two of them used.

    Raises:
        LegsimError: fewer than six samples, or a sample that is not a number.
    """

    trajectories: JointTrajectories
    _spline: BSpline

    def __init__(self, trajectories: JointTrajectories) -> None:
        count, values = len(trajectories.times), trajectories.values
        if count < 6:
            raise LegsimError(
                f"the motion has {count} samples; splines with accelerations need at least 6: "
                "record longer"
            )
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            name = trajectories.coordinate_names[column]
            raise LegsimError(
                f"coordinate {name} is not a number at {trajectories.times[row]:g} s; fill or cut "
                "the gap first"
            )
        object.__setattr__(self, "trajectories", trajectories)
        object.__setattr__(self, "_spline", make_interp_spline(trajectories.times, values, k=5))

    def at(
        self, times: ArrayLike, coordinate_names: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values, rates and accelerations, each (n, c), of the named coordinates at any times (n,)
        of the recording.

        Raises:
            LegsimError: a time before the first or after the last sample, or a coordinate that was
                not recorded.
        """
        times = np.asarray(times, float)
        first, last = self.trajectories.times[[0, -1]]
        if len(times) and not (
            times.min() >= first - _ROUNDING and times.max() <= last + _ROUNDING
        ):
            raise LegsimError(
                f"times from {times.min():g} to {times.max():g} s are wanted of a motion recorded "
                f"from {first:g} to {last:g} s; "
                "choose a start and a length of the scan inside it"
            )
        known = self.trajectories.coordinate_names
        missing = [name for name in coordinate_names if name not in known]
        if missing:
            raise LegsimError(
                f"the motion lacks the coordinates {', '.join(missing)}; it has: {', '.join(known)}"
            )
        columns = [known.index(name) for name in coordinate_names]
        inside = np.clip(times, first, last)
        return (
            self._spline(inside)[:, columns],
            self._spline(inside, 1)[:, columns],
            self._spline(inside, 2)[:, columns],
        )


def segment_poses_at(leg: Leg, splines: JointSplines, times: ArrayLike) -> SegmentPoses:
    """Poses of all segments at any times of the recording, such as those of the views; no pose is
    interpolated.
    """
    times = increasing_times("view times", times)
    names = leg.coordinate_names
    return leg.segment_poses(JointTrajectories(times, names, splines.at(times, names)[0]))
