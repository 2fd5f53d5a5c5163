"""A sensor on soft tissue: its signals when it swings on the skin as a damped oscillator.

The tissue below a strap is a spring and a damper between bone and sensor. The sensor's mass hangs
on it, driven by the specific force of the point of the bone below it. Only the shift is modeled.
The sensor does not tilt, so the gyroscope reads the bone's rotation. The shift's own Coriolis terms
(twice the angular rate times its speed, 1 % of the swing in a held squat) are left out. The truth
stays the rigid sensor's: this changes signals only.
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.imu.processes import settled_response
from legsim.imu.signals import ImuSignals


@dataclass(frozen=True, slots=True)
class SkinMount:
    """How a sensor is held."""

    frequency_hz: float
    """undamped resonance; 5 to 15 Hz on the muscles of thigh and calf, above 20 Hz over bone"""
    damping: float
    """of critical: 1 does not overshoot"""
    amplitude: float = 1.0
    """share of the oscillator's swing: 0 is fixed to the bone, 1 is the full swing"""

    def __post_init__(self) -> None:
        if not (
            np.isfinite(self.frequency_hz)
            and self.frequency_hz > 0
            and np.isfinite(self.damping)
            and self.damping > 0
        ):
            raise LegsimError(
                f"soft tissue needs a frequency and a damping above 0; got {self.frequency_hz:g} "
                f"Hz and {self.damping:g}"
            )
        if not (np.isfinite(self.amplitude) and self.amplitude >= 0):
            raise LegsimError(
                f"the amplitude of soft tissue must not be negative; got {self.amplitude:g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class TissueMotion:
    """Signals of swinging sensors, and how far they swing."""

    signals: ImuSignals
    shift: FloatArray
    """(n, k, 3) m from the sensor's mean position in the strap, along the sensor's axes"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "shift",
            frozen("TissueMotion.shift", self.shift, self.signals.specific_force.shape),
        )


def swing(signals: ImuSignals, tissue: SkinMount) -> TissueMotion:
    """Signals of sensors on soft tissue, from those of the same sensors fixed to the bone.

    The shift u obeys u'' + 2 z w u' + w^2 u = -(f - mean f) with f the rigid sensor's specific
    force, linear between samples; it starts settled under the first sample. The sensor reads f +
    amplitude u''.

    Raises:
        LegsimError: samples that are not even, or fewer than four per period of the resonance.
    """
    steps = np.diff(signals.times)
    if len(steps) < 1 or np.ptp(steps) > 1e-6:
        raise LegsimError(
            "soft tissue needs signals of two or more samples at even times: simulate the sensors "
            "at a fixed rate"
        )
    rate = 1 / float(steps.mean())
    if rate < 4 * tissue.frequency_hz:
        raise LegsimError(
            f"soft tissue at {tissue.frequency_hz:g} Hz needs signals of at least "
            f"{4 * tissue.frequency_hz:g} Hz; got {rate:g} Hz: "
            "raise imu.rate_hz"
        )
    driven = signals.specific_force - signals.specific_force.mean(0)
    second = settled_response(
        [1.0, 0.0, 0.0], _oscillator(tissue), 2 * np.pi * tissue.frequency_hz / rate, -driven
    )
    felt = replace(signals, specific_force=signals.specific_force + tissue.amplitude * second)
    return TissueMotion(felt, shift(driven, rate, tissue))


def shift(acceleration: FloatArray, rate_hz: float, tissue: SkinMount) -> FloatArray:
    """Shift (n, ...) in m of a mass on the tissue from its rest position.

    Its holder accelerates by ``acceleration`` (n, ...) m/s^2, linear between samples at
    ``rate_hz``. The mass starts settled under the first sample.
    """
    w = 2 * np.pi * tissue.frequency_hz
    # in units of 1/w, so that no coefficient is tiny
    swung = settled_response([1.0], _oscillator(tissue), w / rate_hz, -acceleration)
    return tissue.amplitude * (swung / w**2)


def _oscillator(tissue: SkinMount) -> list[float]:
    return [1.0, 2 * tissue.damping, 1.0]
