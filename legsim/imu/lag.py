"""The lag of a sensor's clock: where its angular velocity agrees best with the predicted one.

Agreement is the sum of the singular values of the cross-covariance of both, over their norms: the
best that any rotation of the sensor reaches, so that its mounting does not matter.
"""

import numpy as np
from scipy.signal import correlate

from legsim.core.values import FloatArray
from legsim.imu.recording import ImuRecording
from legsim.imu.shared_time import (
    MOVEMENT_HZ,
    MOVING,
    SHORTEST,
    in_band,
    overlap,
    rms,
    shared_s,
    short,
)

REACH = 1.0
"""s, the largest lag that is searched around a clock that is about right"""

_ROUNDS, _SETTLED = 30, 2e-5
"""of the search for the lag, which is settled when a round changes it by less, in s"""

_SHARED = 0.5
"""part of the shorter recording that both must share: short parts agree by chance"""

_FAR = 0.8
"""correlation from which a lag anywhere in the recordings is believed"""


def find_lag(
    predicted: ImuRecording, measured: ImuRecording, *, step: float, reach: float = REACH
) -> tuple[float, float]:
    """Lag (s) of the measured clock at which the rates agree best, and their correlation.

    Repeated on what both share at the lag found so far: the ends of the shared time are alike in
    both only where that is right. A reach of 0 gives the correlation of clocks that are known.

    Raises:
        LegsimError: an overlap of less than 3 s, of 0.5 s where the reach is 0.
    """
    if reach > 0 and shared_s(predicted, measured) < SHORTEST:
        raise short(predicted, measured, SHORTEST)
    lag, correlation = 0.0, 0.0
    for _ in range(_ROUNDS):
        more, correlation = _lag_once(predicted, measured.shifted(-lag), step, reach)
        lag += more
        if abs(more) < _SETTLED:
            break
    return lag, correlation


def _lag_once(
    predicted: ImuRecording, measured: ImuRecording, step: float, reach: float
) -> tuple[float, float]:
    """Lag (s) and correlation on the time that both share now."""
    times = overlap(predicted, measured, step)
    ours, theirs = (in_band(r, times, MOVEMENT_HZ, "rate") for r in (predicted, measured))
    span = min(int(np.ceil(reach / step)), len(times) // 2)
    shared = np.stack(
        [[correlate(theirs[:, j], ours[:, i], mode="same") for j in range(3)] for i in range(3)]
    )
    middle = len(times) // 2
    near = np.moveaxis(shared[..., middle - span : middle + span + 1], -1, 0)
    power = float(np.sqrt((ours**2).sum() * (theirs**2).sum()))
    if power == 0:  # a gyroscope that is off agrees with nothing
        return 0.0, 0.0
    shifts, scores = np.arange(-span, span + 1)[: len(near)], _best_agreement(near) / power
    enough = (shifts == 0) | (
        _shared_at(predicted, measured, np.asarray(step * shifts, float)) >= SHORTEST + step
    )
    shifts, scores = shifts[enough], scores[enough]
    k = int(np.argmax(scores))
    lag = float(shifts[k])
    if 0 < k < len(scores) - 1:  # the top of the parabola through three neighbors
        before, at, after = scores[k - 1 : k + 2]
        lag += 0.5 * (before - after) / (before - 2 * at + after)
    return lag * step, float(scores[k])


def _shared_at(predicted: ImuRecording, measured: ImuRecording, lags: FloatArray) -> FloatArray:
    """Seconds (n,) that both share when each lag is taken off the measured clock."""
    first = np.maximum(predicted.times[0], measured.times[0] - lags)
    return np.minimum(predicted.times[-1], measured.times[-1] - lags) - first


def _best_agreement(covariances: FloatArray) -> FloatArray:
    """Largest trace (n,) of R C over all rotations R, for (n, 3, 3)."""
    left, values, right = np.linalg.svd(covariances)
    values[:, 2] *= np.sign(np.linalg.det(left @ right))
    return values.sum(-1)


def find_far_lag(
    predicted: ImuRecording, measured: ImuRecording, *, step: float
) -> tuple[float, float] | None:
    """Lag (s) and correlation of recordings of different starts, or of unrelated clocks.

    Every lag at which they share half of the shorter one is tried. None where there is no movement,
    or no lag at which it clearly agrees.
    """
    if predicted.is_mostly_gaps or measured.is_mostly_gaps:
        return None
    begun = float(measured.times[0] - predicted.times[0])
    ours, theirs = (_whole(r, step) for r in (predicted, measured))
    if min(rms(ours), rms(theirs)) < MOVING:
        return None
    shared = np.stack(
        [[correlate(theirs[:, j], ours[:, i], mode="full") for j in range(3)] for i in range(3)]
    )
    shifts = np.arange(1 - len(ours), len(theirs))
    norms = np.sqrt(_shared_power(ours, theirs, shifts, of_theirs=False))
    norms *= np.sqrt(_shared_power(ours, theirs, shifts, of_theirs=True))
    first, last = np.maximum(0, -shifts), np.minimum(len(ours), len(theirs) - shifts)
    least = max(_SHARED * min(len(ours), len(theirs)), SHORTEST / step + 2)
    enough = last - first >= least
    scores = np.where(enough, _best_agreement(np.moveaxis(shared, -1, 0)) / norms, 0)
    best = int(np.argmax(scores))
    if scores[best] < _FAR:
        return None
    coarse = begun + float(shifts[best]) * step
    more, correlation = find_lag(predicted, measured.shifted(-coarse), step=step, reach=0.1)
    return coarse + more, correlation


def _whole(recording: ImuRecording, step: float) -> FloatArray:
    """Angular velocity (n, 3) of a whole recording in the band of movements."""
    count = int((recording.times[-1] - recording.times[0]) / step + 1e-6) + 1
    return in_band(recording, recording.times[0] + step * np.arange(count), MOVEMENT_HZ, "rate")


def _shared_power(
    ours: FloatArray, theirs: FloatArray, shifts: np.ndarray, *, of_theirs: bool
) -> FloatArray:
    """Sum of squares of the part that both share at each shift: ours k beside theirs k + shift."""
    first, last = np.maximum(0, -shifts), np.minimum(len(ours), len(theirs) - shifts)
    if of_theirs:
        first, last = first + shifts, last + shifts
    values = theirs if of_theirs else ours
    power = np.concatenate([[0.0], np.cumsum((values**2).sum(-1))])
    return np.maximum(power[last] - power[first], 1e-12)
