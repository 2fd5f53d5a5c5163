"""Vibration of muscle and skin under a sensor: what it reads of a strap that never rests.

Active muscles swell, twitch and vibrate between 5 and 100 Hz (mechanomyogram; Orizio 1993, Crit Rev
Biomed Eng 21:201-243), and the skin over them slides and turns as they do. The mount shifts and
turns by noise in two bands, whatever the bone does. Truth stays the sensor's that is fixed to the
bone, and images do not see it. What the muscles do to the bones is a tremor
(``legsim.kinematics.tremor``).
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.signals import ImuSignals
from legsim.imu.skin_mount import even_rate, turned

_ALL_AXES = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Vibration:
    """How much a mount vibrates; sizes are the root mean square length of the vector."""

    acceleration: float = 0.0
    """m/s^2"""
    acceleration_band_hz: tuple[float, float] = (3.0, 30.0)
    """half-power frequencies; it falls by 6 dB an octave above, by 12 below, so that the mount's
    shift stays bounded
    """
    acceleration_axes: tuple[float, float, float] = _ALL_AXES
    """relative sizes along the sensor's own x, y, z"""
    rate: float = 0.0
    """rad/s"""
    rate_band_hz: tuple[float, float] = (0.5, 5.0)
    """half-power frequencies; it falls by 6 dB an octave on both sides: the turn stays bounded"""
    rate_axes: tuple[float, float, float] = _ALL_AXES
    """relative sizes about the sensor's own x, y, z"""

    def __post_init__(self) -> None:
        if not (np.isfinite([self.acceleration, self.rate]).all()) or (
            min(self.acceleration, self.rate) < 0
        ):
            raise LegsimError(
                "the sizes of a sensor's vibration must not be negative; got "
                f"{self.acceleration:g} m/s^2 and {self.rate:g} rad/s"
            )
        for low, high in (self.acceleration_band_hz, self.rate_band_hz):
            if not 0 < low < high < np.inf:
                raise LegsimError(
                    f"a vibration's band goes from a frequency above 0 to a higher one; got "
                    f"{low:g} to {high:g} Hz"
                )
        for axes in (self.acceleration_axes, self.rate_axes):
            if not (np.isfinite(axes).all() and min(axes) >= 0 and max(axes) > 0):
                raise LegsimError(
                    f"the axes of a vibration are shares of 0 or more, one above 0; got {axes}"
                )

    @property
    def moves(self) -> bool:
        """Whether there is any."""
        return self.acceleration > 0 or self.rate > 0


def vibrate(signals: ImuSignals, vibration: Vibration, rng: np.random.Generator) -> ImuSignals:
    """Adds the vibration of each sensor's own mount.

    A turn of the mount also turns gravity in the sensor's axes. Draws do not depend on the sizes.

    Raises:
        LegsimError: samples that are not even or too few per second for the bands.
    """
    rate_hz, shape = even_rate(signals), signals.specific_force.shape
    for size, (_, high) in (
        (vibration.acceleration, vibration.acceleration_band_hz),
        (vibration.rate, vibration.rate_band_hz),
    ):
        if size > 0 and rate_hz < 3 * high:
            raise LegsimError(
                f"a vibration up to {high:g} Hz needs signals of at least {3 * high:g} Hz; got "
                f"{rate_hz:g} Hz: raise imu.rate_hz or lower the band"
            )
    shaken, turning = rng.standard_normal((2, *shape))
    shake, _ = _noise(shaken, rate_hz, vibration.acceleration_band_hz, integrals=2)
    turn_rate, turn = _noise(turning, rate_hz, vibration.rate_band_hz, integrals=1)
    push = vibration.acceleration * _per_axis(vibration.acceleration_axes)
    twist = vibration.rate * _per_axis(vibration.rate_axes)
    felt = replace(signals, specific_force=signals.specific_force + push * shake)
    return turned(felt, twist * turn, twist * turn_rate)


def _per_axis(axes: tuple[float, float, float]) -> FloatArray:
    """Sizes (3,) whose vector has length 1."""
    return np.asarray(axes, float) / np.linalg.norm(axes)


def _noise(
    white: FloatArray, rate_hz: float, band_hz: tuple[float, float], *, integrals: int
) -> tuple[FloatArray, FloatArray]:
    """(noise, its integral), each (n, ...), of unit expected power in a band, from ``white``.

    The spectrum is that of a 1st-order Butterworth low-pass and of a high-pass of the order
    ``integrals``, whose noise stays bounded when integrated as often. The constant is left out, so
    all have mean 0.
    """
    frequency = np.fft.rfftfreq(len(white), 1 / rate_hz)
    fall, rise = (frequency / band_hz[1]) ** 2, (frequency / band_hz[0]) ** (2 * integrals)
    response = np.sqrt(rise / (1 + rise) / (1 + fall))
    # rfft keeps one of each pair of frequencies
    response /= np.sqrt(2 * np.sum(response**2) / len(white))
    slope = np.concatenate([[1.0], 2j * np.pi * frequency[1:]])
    per_frequency = (-1, *[1] * (white.ndim - 1))
    spectrum = np.fft.rfft(white, axis=0) * response.reshape(per_frequency)
    integral = spectrum / slope.reshape(per_frequency)
    return np.fft.irfft(spectrum, len(white), axis=0), np.fft.irfft(integral, len(white), axis=0)
