"""A sensor on soft tissue: its signals when it swings on the skin as a damped oscillator.

The tissue below a strap is a spring and a damper between bone and sensor. The sensor's mass hangs
on it, driven by the specific force of the point of the bone below it, and its inertia by the bone's
rotation. The shift's own Coriolis terms (twice the angular rate times its speed, 1 % of the swing
in a held squat) are left out. The truth stays the rigid sensor's: this changes signals only.

How soft tissue swings: Wakeling and Nigg (2001, J Appl Physiol 90:412-420) measured free vibrations
on quadriceps, tibialis anterior and triceps surae. Frequency and damping grow with the force of the
muscle and are greater normal to the skin than along the segment, hence the axes. Soft tissues of
legs that stand on a shaker resonate between 10 and 65 Hz (Wakeling, Nigg and Rozitis 2002, J Appl
Physiol 93:1093-1103).
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.imu.processes import settled_response
from legsim.imu.signals import ImuSignals

_ALL_AXES = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class SkinMount:
    """How a sensor is held."""

    frequency_hz: float
    """undamped resonance; 5 to 15 Hz on the muscles of thigh and calf, above 20 Hz over bone"""
    damping: float
    """of critical: 1 does not overshoot"""
    amplitude: float = 1.0
    """share of the oscillator's swing: 0 is fixed to the bone, 1 is the full swing"""
    axes: tuple[float, float, float] = _ALL_AXES
    """of that share along the sensor's own x, y, z"""
    turn_amplitude: float = 0.0
    """share of the swing by which the sensor turns: 0 turns with the bone"""
    turn_frequency_hz: float = 10.0
    """undamped resonance of the turn, with the same damping"""
    turn_axes: tuple[float, float, float] = _ALL_AXES
    """of the turn's share about the sensor's own x, y, z"""

    def __post_init__(self) -> None:
        resonances = (self.frequency_hz, self.turn_frequency_hz, self.damping)
        if not (np.isfinite(resonances).all() and min(resonances) > 0):
            raise LegsimError(
                "soft tissue needs frequencies and a damping above 0; got "
                f"{self.frequency_hz:g} Hz, {self.turn_frequency_hz:g} Hz of turns and "
                f"{self.damping:g}"
            )
        shares = (self.amplitude, self.turn_amplitude, *self.axes, *self.turn_axes)
        if not (np.isfinite(shares).all() and min(shares) >= 0):
            wrong = next(share for share in shares if not (np.isfinite(share) and share >= 0))
            raise LegsimError(f"the amplitude of soft tissue must not be negative; got {wrong:g}")

    @property
    def moves(self) -> bool:
        """Whether a sensor reads anything else than on the bone."""
        return self.amplitude > 0 or self.turn_amplitude > 0


@dataclass(frozen=True, slots=True, eq=False)
class TissueMotion:
    """Signals of swinging sensors, and how far they swing."""

    signals: ImuSignals
    shift: FloatArray
    """(n, k, 3) m from the sensor's mean position in the strap, along the sensor's axes"""
    turn: FloatArray
    """(n, k, 3) rotation vectors, rad, of the sensor from its mean orientation in the strap"""

    def __post_init__(self) -> None:
        shape = self.signals.specific_force.shape
        for name in ("shift", "turn"):
            object.__setattr__(
                self, name, frozen(f"TissueMotion.{name}", getattr(self, name), shape)
            )


def swing(signals: ImuSignals, tissue: SkinMount) -> TissueMotion:
    """Signals of sensors on soft tissue, from those of the same sensors fixed to the bone.

    The shift u obeys u'' + 2 z w u' + w^2 u = -(f - mean f) with f the rigid sensor's specific
    force, linear between samples; it starts settled under the first sample. The turn r obeys the
    same law of its own w, driven by -(the rigid sensor's angular acceleration). The sensor reads
    f + amplitude u'', seen in axes turned by r, and the rigid rate plus r'.

    Raises:
        LegsimError: samples that are not even, or fewer than four per period of a resonance.
    """
    rate = even_rate(signals)
    driven = signals.specific_force - signals.specific_force.mean(0)
    if tissue.amplitude > 0:
        _require_rate(rate, tissue.frequency_hz)
    second = _response(
        [1.0, 0.0, 0.0], tissue.damping, 2 * np.pi * tissue.frequency_hz / rate, -driven
    )
    force = signals.specific_force + tissue.amplitude * np.asarray(tissue.axes) * second
    felt = replace(signals, specific_force=force)
    turn = np.zeros_like(driven)
    if tissue.turn_amplitude > 0:
        _require_rate(rate, tissue.turn_frequency_hz)
        turn, turning = _turn(signals.angular_velocity, rate, tissue)
        felt = turned(felt, turn, turning)
    return TissueMotion(felt, shift(driven, rate, tissue), turn)


def even_rate(signals: ImuSignals) -> float:
    """Samples per second of signals at even times.

    Raises:
        LegsimError: fewer than two samples, or uneven ones.
    """
    steps = np.diff(signals.times)
    if len(steps) < 1 or np.ptp(steps) > 1e-6:
        raise LegsimError(
            "soft tissue needs signals of two or more samples at even times: simulate the sensors "
            "at a fixed rate"
        )
    return 1 / float(steps.mean())


def turned(signals: ImuSignals, turn: FloatArray, turning: FloatArray) -> ImuSignals:
    """Signals of sensors that turn in their straps by small rotation vectors ``turn`` (n, k, 3),
    rad, at the rates ``turning`` (n, k, 3), rad/s.

    What the turned sensor reads of the bone's own rotation changes by less than the turn times that
    rotation, and is left out.
    """
    rotation = np.swapaxes(transforms.rotation_from_vector(turn), -1, -2)
    force = np.einsum("nkij,nkj->nki", rotation, signals.specific_force)
    return replace(
        signals, angular_velocity=signals.angular_velocity + turning, specific_force=force
    )


def shift(acceleration: FloatArray, rate_hz: float, tissue: SkinMount) -> FloatArray:
    """Shift (n, ..., 3) in m of a mass on the tissue from its rest position.

    Its holder accelerates by ``acceleration`` (n, ..., 3) m/s^2, linear between samples at
    ``rate_hz``. The mass starts settled under the first sample.
    """
    w = 2 * np.pi * tissue.frequency_hz
    # in units of 1/w, so that no coefficient is tiny
    settled = _response([1.0], tissue.damping, w / rate_hz, -acceleration) / w**2
    return tissue.amplitude * np.asarray(tissue.axes) * settled


def _turn(rate: FloatArray, rate_hz: float, tissue: SkinMount) -> tuple[FloatArray, FloatArray]:
    """(turn (n, k, 3) rad, its rate rad/s) of a mount whose bone turns at ``rate`` (n, k, 3)."""
    w = 2 * np.pi * tissue.turn_frequency_hz
    share = tissue.turn_amplitude * np.asarray(tissue.turn_axes)
    drive = -(rate - rate.mean(0))
    turn = _response([1.0, 0.0], tissue.damping, w / rate_hz, drive) / w
    turning = _response([1.0, 0.0, 0.0], tissue.damping, w / rate_hz, drive)
    return share * turn, share * turning


def _require_rate(rate_hz: float, resonance_hz: float) -> None:
    if rate_hz < 4 * resonance_hz:
        raise LegsimError(
            f"soft tissue at {resonance_hz:g} Hz needs signals of at least "
            f"{4 * resonance_hz:g} Hz; got {rate_hz:g} Hz: raise imu.rate_hz"
        )


def _response(numerator: list[float], damping: float, step: float, drive: FloatArray) -> FloatArray:
    """Output (n, ...) of numerator(s) / (s^2 + 2 damping s + 1), settled at the start."""
    return settled_response(numerator, [1.0, 2 * damping, 1.0], step, drive)
