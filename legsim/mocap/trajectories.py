"""Values over time: markers, joint coordinates, segment poses, IMU signals, rigid motion. Time is
the first axis, in seconds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray, frozen, increasing_times, index_of, unique_names

_ROUNDING_S = 2e-5
"""s"""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTrajectories:
    """Marker trajectories; a marker that is not seen is NaN in all three coordinates."""

    times: FloatArray
    """(n,) s"""
    marker_names: tuple[str, ...]
    positions_world: FloatArray
    """(n, m, 3) m, in world"""

    def __repr__(self) -> str:
        seconds = self.times[-1] - self.times[0]
        count = len(self.marker_names)
        return (
            f"MarkerTrajectories({count} markers, {len(self.times)} samples over {seconds:.4g} s)"
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("Motion.times", self.times))
        object.__setattr__(self, "marker_names", unique_names("marker", self.marker_names))
        shape = (len(self.times), len(self.marker_names), 3)
        object.__setattr__(
            self, "positions_world", frozen("Motion.positions_world", self.positions_world, shape)
        )

    @property
    def rate_hz(self) -> float:
        """Mean sampling rate."""
        return (len(self.times) - 1) / float(self.times[-1] - self.times[0])

    def marker(self, name: str) -> FloatArray:
        """Positions (n, 3) of one marker in world."""
        return self.positions_world[:, index_of("marker", self.marker_names, name)]


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectories:
    """Independent coordinates of the leg model over time, under OpenSim's names."""

    times: FloatArray
    """(n,) s"""
    coordinate_names: tuple[str, ...]
    values: FloatArray
    """(n, c) rad, and m for pelvis_tx, pelvis_ty, pelvis_tz"""

    def __repr__(self) -> str:
        seconds = self.times[-1] - self.times[0]
        count = len(self.coordinate_names)
        shape = f"{count} coordinates, {len(self.times)} samples"
        return f"JointTrajectories({shape} over {seconds:.4g} s)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("JointTrajectories.times", self.times))
        object.__setattr__(
            self, "coordinate_names", unique_names("coordinate", self.coordinate_names)
        )
        shape = (len(self.times), len(self.coordinate_names))
        object.__setattr__(self, "values", frozen("JointTrajectories.values", self.values, shape))

    def coordinate(self, name: str) -> FloatArray:
        """Values (n,) of one coordinate."""
        return self.values[:, index_of("coordinate", self.coordinate_names, name)]


def written_twice(times: FloatArray) -> NDArray[np.intp]:
    """Indices of the samples that do not come after the one before, or so little after it that
    both are one, written twice: by a thousandth of the usual step, and by less than any rounding.
    """
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.flatnonzero(steps <= max(min(1e-3 * usual, _ROUNDING_S), 0.0)) + 1


def late_cure(times: FloatArray, k: int) -> str:
    """What to do about sample ``k`` of (n,) times s, which does not come after the one before: a
    time that goes back by several samples begins another trial.
    """
    steps = np.diff(times)
    forward = steps[steps > 0]
    if len(forward) and times[k] < times[k - 1] - 2 * np.median(forward):
        return "another trial begins there: split the file, or repair the time column"
    return "delete the repeated row or repair the time column"
