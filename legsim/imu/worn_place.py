"""Where on its segment a measured sensor sits, by what its accelerometer reads of the turns.

At a place r further (sensor's axes) a rigid segment with the angular velocity w and acceleration w'
has the specific force f + w' x r + w x (w x r). A movement that turns a segment shows the place;
a person who stands does not. What a small error d of the mounting adds, d x f, is solved for too.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.imu.recording import ImuRecording
from legsim.imu.shared_time import MOVEMENT_HZ, at, band_passed, overlap, rms

_BLOCKS = 8
"""parts of the recording, each left out once for the spread: errors last longer than a sample"""

_SURE = 3.0
"""spreads by which a shift is none of chance"""

_FAR_M = 0.03
"""m: sensors are placed by hand, and skin moves, by less"""

_KNOWN_M = 0.03
"""spread (m, along the worst axis) beyond which a movement does not tell the place"""

_WORTH = 0.9
"""of the difference that is left at the better place, at most"""


@dataclass(frozen=True, slots=True, eq=False)
class WornPlace:
    """Place that fits a sensor's readings best, from the predicted sensor's place."""

    shift: FloatArray
    """(3,) m in the predicted sensor's axes"""
    spread: FloatArray
    """(3,) m, one standard deviation, by leaving out each eighth of the recording"""
    left: float
    """m/s^2 RMS of the specific force's difference in 0.2 to 6 Hz, at the predicted place"""
    left_there: float
    """the same at the better place"""

    @property
    def is_elsewhere(self) -> bool:
        """Whether the movement tells the place, and it is not the predicted one."""
        length = float(np.linalg.norm(self.shift))
        spread = float(np.linalg.norm(self.spread))
        known = float(self.spread.max()) < _KNOWN_M
        far = length > max(_FAR_M, _SURE * spread)
        return known and far and self.left_there < _WORTH * self.left


def find_place(predicted: ImuRecording, measured: ImuRecording, *, step: float) -> WornPlace:
    """Finds the place on the segment where the specific force agrees best.

    Args:
        predicted: of a place on the segment.
        measured: by the predicted one's clock, in its axes.
        step: s between the times that are compared.

    Raises:
        LegsimError: recordings that overlap by less than 3 s.
    """
    times = overlap(predicted, measured, step)
    rate, force = at(predicted, times, "rate"), at(predicted, times, "force")
    turn = transforms.cross_matrix(rate)
    by_shift = transforms.cross_matrix(at(predicted, times, "rate", derivative=1)) + turn @ turn
    columns = np.concatenate([by_shift, -transforms.cross_matrix(force)], -1)
    wanted = at(measured, times, "force") - force
    known, sought = (band_passed(v, times, MOVEMENT_HZ) for v in (columns, wanted))
    found = _solved(known, sought)
    parts = np.array_split(np.arange(len(times)), _BLOCKS)
    left_out = np.stack(
        [_solved(np.delete(known, part, 0), np.delete(sought, part, 0)) for part in parts]
    )
    # the jackknife's variance
    spread = np.sqrt((_BLOCKS - 1) * left_out.var(0))
    return WornPlace(found[:3], spread[:3], rms(sought), rms(sought - known @ found))


def _solved(known: FloatArray, sought: FloatArray) -> FloatArray:
    """Least squares over all times and axes."""
    flat = known.reshape(-1, known.shape[-1])
    return np.asarray(np.linalg.lstsq(flat, sought.ravel(), rcond=None)[0], float)
