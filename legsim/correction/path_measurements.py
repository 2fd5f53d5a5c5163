"""What is measured of a sensor's path besides its signals: who stands, and shadows of metal."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, positive
from legsim.correction.error_state import SensorPath

SHADOW_ERROR_PX = 0.3
"""standard deviation along u and v of a shadow's place, where nothing else is known of it"""

ANKLE_WALK = 2e-4
"""m per root of a second that a coordinate of a standing person's ankle wanders by: twice that of
one who was measured, with the cameras' noise in it
"""

_FEWEST_VIEWS = 3
"""that a bead must be seen in to have a place"""


@dataclass(frozen=True, slots=True, eq=False)
class StandingPrior:
    """Nobody who stands leaves: points at the knee stay within a few millimeters."""

    points: FloatArray
    """(p, 3) m in world at the first view"""
    spread: float = 2e-3
    """m, RMS of each coordinate's displacement over the scan"""
    samples: float = 8.0
    """independent samples in a scan: sway is slow, so that a view says little beside the last"""

    def weight(self, views: int) -> float:
        """Root of the weight of one coordinate of one point in one view."""
        return float(np.sqrt(self.samples / (views * len(self.points)))) / self.spread

    @classmethod
    def at(cls, knee: FloatArray, spread: float = 2e-3, arm: float = 0.03) -> "StandingPrior":
        """Four points of a lower leg around and below a knee; two of them ``arm`` m beside it, so
        that the spread there is what the leg turns by about the vertical.
        """
        places = [[0.0, -0.02, 0.0], [0.0, -0.08, 0.0], [arm, -0.04, 0.0], [0.0, -0.04, arm]]
        return cls(np.asarray(knee) + np.array(places), spread)


@dataclass(frozen=True, slots=True, eq=False)
class StandingFoot:
    """The foot of a person who stands stays: the ankle wanders by fractions of a millimeter.

    A random walk from view to view holds no place over seconds, where a foot may settle, but
    movements that take less: there the gyroscope over a still ankle knows more of the shank than
    its accelerometer.
    """

    ankle_sensor: FloatArray
    """(3,) m, the ankle in the sensor on the shank"""
    walk: float = ANKLE_WALK
    """m per root of a second that a coordinate of the ankle wanders by"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "ankle_sensor", frozen("StandingFoot.ankle_sensor", self.ankle_sensor, (3,))
        )
        positive("StandingFoot.walk", self.walk)

    def steps(
        self, path: SensorPath, views: FloatArray, apart: int = 1
    ) -> tuple[FloatArray, FloatArray]:
        """The ankle's steps (v - apart, 3) between views (v,) s that are so many ``apart``, in
        standard deviations, and their changes (v - apart, 3, n) with the path's errors.
        """
        place = self.ankle_sensor[None]
        firm = 1 / (self.walk * np.sqrt(views[apart:] - views[:-apart]))
        at, by = transforms.apply(path.poses, place)[:, 0], path.of_attached(place)[:, 0]
        steps, changes = at[apart:] - at[:-apart], by[apart:] - by[:-apart]
        return firm[:, None] * steps, firm[:, None, None] * changes


@dataclass(frozen=True, slots=True, eq=False)
class BeadShadows:
    """Shadows of beads on what the sensor is fixed to; their places are unknown."""

    pixels: FloatArray
    """(v, b, 2) (u, v); NaN where unseen"""
    error_px: float = SHADOW_ERROR_PX
    """standard deviation along u and v, of detection and of skin that slides"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "pixels", frozen("BeadShadows.pixels", self.pixels, (None, None, 2))
        )
        positive("BeadShadows.error_px", self.error_px)

    @property
    def placed(self) -> NDArray[np.bool_]:
        """Which beads (b,) are seen often enough to have a place."""
        return np.asarray(np.isfinite(self.pixels).all(-1).sum(0) >= _FEWEST_VIEWS)

    def enough(self) -> "BeadShadows":
        """Only the beads that are seen often enough to have a place.

        Raises:
            LegsimError: there is none.
        """
        kept = self.placed
        if not kept.any():
            raise LegsimError(
                f"none of {len(kept)} beads was found in {_FEWEST_VIEWS} views; use larger beads, "
                "or place them where every view sees them"
            )
        return BeadShadows(self.pixels[:, kept], self.error_px)


@dataclass(frozen=True, slots=True, eq=False)
class FiducialShadows:
    """Shadows of points whose places in the sensor are known."""

    pixels: FloatArray
    """(v, f, 2) (u, v); NaN where unseen"""
    points_sensor: FloatArray
    """(f, 3) m"""
    error_px: float = SHADOW_ERROR_PX
    """standard deviation along u and v"""

    def __post_init__(self) -> None:
        pixels = frozen("FiducialShadows.pixels", self.pixels, (None, None, 2))
        places = frozen("FiducialShadows.points_sensor", self.points_sensor, (pixels.shape[1], 3))
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "points_sensor", places)
        positive("FiducialShadows.error_px", self.error_px)

    def enough(self) -> "FiducialShadows":
        """The same, if they are seen often enough to tell anything.

        Raises:
            LegsimError: they are not.
        """
        views = int(np.isfinite(self.pixels).all(-1).any(-1).sum())
        if views < _FEWEST_VIEWS:
            raise LegsimError(
                f"fiducials of the sensor are seen in {views} views, {_FEWEST_VIEWS} are needed; "
                "place the sensor nearer to the knee, or ask for the paper's detector without "
                'bounds (methods.fiducials.detector = "unbounded")'
            )
        return self
