"""Whether accelerometer and gyroscope have the same axes: gravity must turn in both alike.

Tables with columns in another order, or with signs of another handedness, are read without a word.
The slow part of the specific force turns against the angular velocity, f' = -w x f. That holds for
one order and one set of signs of the gyroscope's axes, as far as the sensor turned about them.
"""

import itertools

import numpy as np
from scipy.signal import butter, sosfiltfilt

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray

_FITS, _MISFITS, _BETTER = 0.8, 0.4, 0.4
"""correlation from which another order fits, up to which the given one does not, and their least
difference"""

_TILTED, _AS_STRONG, _STRENGTH_HZ = 0.08, 0.12, 1.5
"""rad of a tilt, share of its square by which the force may change in strength (what is pushed has
0.35), and below which frequency"""

_UNRELATED = 0.5
"""correlation up to which a gyroscope knows nothing of a tilt"""

_ALIKE, _AS_FAST = 0.95, (0.87, 1.15)
"""correlation from which the ratio of a tilt by both instruments counts, and what it may be: the
scales of cheap ones are off by 3 %"""

_RATIO = (0.4, 1.6)
"""of gravity's turn by both instruments, where the sensor is tilted rather than pushed"""

_STRIDE_HZ = 10.0
"""samples per second that the slow part needs"""


def axes_doubt(
    name: str, rate_hz: float, rate: FloatArray, force: FloatArray, low: FloatArray
) -> tuple[str, ...]:
    """A sentence where gravity turns as by the gyroscope with its axes in another order alone.

    Args:
        name: of the sensor.
        rate_hz: of the samples, which are even.
        rate: (n, 3) rad/s.
        force: (n, 3) m/s^2.
        low: second-order sections of the band in which a leg tilts.
    """
    by_axis, seen = _turns(rate_hz, rate, force, low)
    power = float((seen**2).sum())
    shared = np.einsum("ijnk,nk->ij", by_axis, seen)
    fits = [
        (*_fit(by_axis, shared, power, order, signs), order, signs)
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    given = next(one[0] for one in fits if one[2:] == ((0, 1, 2), (1.0, 1.0, 1.0)))
    correlation, ratio, order, signs = max(fits)
    better = correlation > max(_FITS, given + _BETTER) and given < _MISFITS
    if not (better and _RATIO[0] < ratio < _RATIO[1]):
        return ()
    axes = ", ".join(f"{'-' * (s < 0)}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
    return (
        f"In doubt: sensor {name}: gravity turns in its accelerometer as by its gyroscope with the "
        f"axes ({axes}) of it (correlation {correlation:.2f}), not as they are ({given:.2f}): "
        "check the order and the signs of the columns of both.",
    )


def tilt_doubt(
    name: str, rate_hz: float, rate: FloatArray, force: FloatArray, low: FloatArray
) -> tuple[str, ...]:
    """A sentence where the accelerometer tilts and the gyroscope knows nothing of it, as where its
    columns are angles or another instrument's, or has it otherwise as fast, as where the sampling
    rate is another; arguments as those of :func:`axes_doubt`.

    What pushes a sensor aside so that it seems to tilt by an angle makes the force stronger, by
    half its square; a tilt leaves it as strong as gravity.
    """
    turned = sosfiltfilt(low, -np.cumsum(np.cross(rate, force), axis=0) / rate_hz, axis=0)
    up = force.mean(0) / np.linalg.norm(force.mean(0))
    turned, seen = (v - np.outer(v @ up, up) for v in (turned, sosfiltfilt(low, force, axis=0)))
    angle = float(np.sqrt((seen**2).sum(-1).mean())) / STANDARD_GRAVITY
    slow = butter(2, min(_STRENGTH_HZ, 0.4 * rate_hz), fs=rate_hz, output="sos")
    strength = float(sosfiltfilt(slow, np.linalg.norm(force, axis=-1)).std()) / STANDARD_GRAVITY
    if angle < _TILTED or strength > _AS_STRONG * angle**2:
        return ()
    power = float(np.sqrt((turned**2).sum() * (seen**2).sum()))
    correlation = float((turned * seen).sum()) / power if power > 0 else 0.0
    ratio = float((turned * seen).sum()) / float((turned**2).sum()) if power > 0 else 1.0
    if correlation > _ALIKE and not _AS_FAST[0] < ratio < _AS_FAST[1]:
        return (
            f"In doubt: sensor {name}: its accelerometer sees it tilt {ratio:.2f} times as fast as "
            "its gyroscope does: check the sampling rate, and the scale of the gyroscope.",
        )
    if abs(correlation) > _UNRELATED:
        return ()
    return (
        f"In doubt: sensor {name}: by its accelerometer it tilts by {np.degrees(angle):.0f} deg "
        f"RMS, of which its gyroscope knows nothing (correlation {correlation:.2f}): check that "
        "those columns are angular velocities, and of the same sensor and time.",
    )


def _turns(
    rate_hz: float, rate: FloatArray, force: FloatArray, low: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gravity's turn (3, 3, m, 3) about each axis by each column of the gyroscope, and as the
    accelerometer sees it (m, 3).
    """
    every = max(1, int(rate_hz / _STRIDE_HZ))
    # the cross product with an axis may come last: filter and sum are linear
    summed = [
        sosfiltfilt(low, np.cumsum(column[:, None] * force, axis=0) / rate_hz, axis=0)[::every]
        for column in rate.T
    ]
    by_axis = np.array([[-np.cross(axis, one) for one in summed] for axis in np.eye(3)])
    return by_axis, sosfiltfilt(low, force, axis=0)[::every]


def _fit(
    by_axis: FloatArray,
    shared: FloatArray,
    power: float,
    order: tuple[int, ...],
    signs: tuple[float, ...],
) -> tuple[float, float]:
    """Correlation and ratio of both for the gyroscope's axes in that order, with those signs."""
    turn = sum(s * by_axis[i, j] for i, (j, s) in enumerate(zip(order, signs, strict=True)))
    own = float(np.square(turn).sum())
    both = float(sum(s * shared[i, j] for i, (j, s) in enumerate(zip(order, signs, strict=True))))
    return (both / np.sqrt(own * power), both / own) if own > 0 and power > 0 else (0.0, 1.0)
