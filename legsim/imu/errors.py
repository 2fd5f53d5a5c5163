"""The errors of a sensor that one can buy, as its data sheet states them: one field per term.

An accelerometer and a gyroscope have the same terms, so that one class serves both. Values are
those of a population of sensors: what differs from sensor to sensor or from start to start (biases,
scale, misalignment) is a standard deviation. A term of size 0 is off.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray

TERMS: dict[str, tuple[str, ...]] = {
    "white-noise": ("noise_density",),
    "turn-on-bias": ("turn_on_bias",),
    "instability": ("instability",),
    "random-walk": ("random_walk",),
    "scale": ("scale_error",),
    "misalignment": ("misalignment",),
    "g-sensitivity": ("g_sensitivity",),
    "temperature": ("bias_per_kelvin", "scale_per_kelvin"),
    "quantisation": ("bits",),
    "saturation": ("full_scale",),
    "low-pass": ("bandwidth_hz",),
}
"""names of the terms, and the fields that switch them on"""


@dataclass(frozen=True, slots=True)
class TriadErrors:
    """Errors of three axes: an accelerometer (unit m/s^2) or a gyroscope (unit rad/s)."""

    noise_density: float = 0.0
    """unit per sqrt(Hz), one-sided"""
    turn_on_bias: float = 0.0
    """unit; standard deviation of the constant that is drawn each time the sensor is started"""
    instability: float = 0.0
    """unit; the lowest Allan deviation, as data sheets have it"""
    instability_time: float = 0.0
    """s; 0 is flicker noise (1/f), else the correlation time of a first-order Gauss-Markov process

    Both have ``instability`` as the flat part, or the top, of their own Allan deviation.
    """
    random_walk: float = 0.0
    """unit per sqrt(s); the walk's variance is its square times the time"""
    scale_error: float = 0.0
    """of 1; standard deviation per axis"""
    misalignment: float = 0.0
    """of 1; standard deviation of what one axis reads of another (cross-axis sensitivity)"""
    g_sensitivity: float = 0.0
    """unit per m/s^2 of specific force; each of the nine elements. Of gyroscopes alone."""
    bias_per_kelvin: float = 0.0
    """unit per K; standard deviation per axis"""
    scale_per_kelvin: float = 0.0
    """of 1 per K; standard deviation per axis"""
    full_scale: float = 0.0
    """unit; the greatest reading. 0: no limit."""
    bits: int = 0
    """of the whole range, from -full_scale to full_scale; 0: no rounding"""
    bandwidth_hz: float = 0.0
    """-3 dB of the sensor's own low-pass, a Butterworth filter; 0: none"""
    filter_order: int = 2
    """of that filter"""

    def __post_init__(self) -> None:
        for field in fields(self):
            size = getattr(self, field.name)
            if not (np.isfinite(size) and size >= 0):
                raise LegsimError(
                    f"{field.name} of a sensor must be finite and not negative; got {size:g}"
                )
        if self.bits and not (self.full_scale > 0 and self.bits <= 32):
            raise LegsimError(
                f"a sensor of {self.bits} bits needs its full scale, and at most 32 bits; "
                f"got a full scale of {self.full_scale:g}"
            )
        if not 1 <= self.filter_order <= 8:
            raise LegsimError(f"the low-pass of a sensor has order 1 to 8; got {self.filter_order}")

    @property
    def step(self) -> float:
        """Size of one bit, in the unit; 0 where readings are not rounded."""
        return 2 * self.full_scale / 2**self.bits if self.bits else 0.0

    def sample_rms(self, rate_hz: float) -> float:
        """White noise of single samples taken at ``rate_hz``: density x sqrt(rate / 2)."""
        return self.noise_density * float(np.sqrt(rate_hz / 2))

    def without(self, terms: Sequence[str]) -> "TriadErrors":
        """The same sensor, these terms switched off.

        Raises:
            LegsimError: an unknown term; the message lists the known ones.
        """
        off = {name: 0 for term in terms for name in _fields_of(term)}
        if off.get("full_scale") == 0:
            # what has no range has no bits either
            off["bits"] = 0
        return replace(self, **off)

    def only(self, terms: Sequence[str]) -> "TriadErrors":
        """The same sensor with these terms alone; full scale stays where bits do."""
        for term in terms:
            _fields_of(term)
        kept = set(terms) | ({"saturation"} if "quantisation" in terms else set())
        return self.without([term for term in TERMS if term not in kept])


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors of an inertial sensor."""

    accelerometer: TriadErrors = TriadErrors()
    gyroscope: TriadErrors = TriadErrors()

    def __post_init__(self) -> None:
        if self.accelerometer.g_sensitivity:
            raise LegsimError("g-sensitivity is of gyroscopes: give it to the gyroscope")

    def without(self, *terms: str) -> "SensorErrors":
        """Switches terms off by name, in both.

        Raises:
            LegsimError: an unknown term; the message lists the known ones.

        >>> sensor_errors("bmi160").without("turn-on-bias", "temperature")
        """
        return SensorErrors(self.accelerometer.without(terms), self.gyroscope.without(terms))

    def only(self, *terms: str) -> "SensorErrors":
        """Keeps these terms alone, in both."""
        return SensorErrors(self.accelerometer.only(terms), self.gyroscope.only(terms))


@dataclass(frozen=True, slots=True)
class TemperatureCourse:
    """Temperature of the sensors over a recording, against that of their calibration."""

    seconds: tuple[float, ...] = (0.0,)
    """from the recording's first sample, increasing"""
    kelvin: tuple[float, ...] = (0.0,)
    """straight between these points, constant outside them"""

    def __post_init__(self) -> None:
        if len(self.seconds) != len(self.kelvin) or not self.seconds:
            raise LegsimError(
                f"a temperature course has {len(self.seconds)} times and {len(self.kelvin)} "
                "temperatures; give one temperature per time"
            )
        if not (np.isfinite(self.seconds).all() and np.isfinite(self.kelvin).all()):
            raise LegsimError("a temperature course holds a number that is not finite")
        if (np.diff(self.seconds) <= 0).any():
            raise LegsimError("the times of a temperature course must increase")

    def at(self, seconds: FloatArray) -> FloatArray:
        """Temperature (n,) in K at ``seconds`` (n,) after the first sample."""
        return np.interp(seconds, self.seconds, self.kelvin)


def _fields_of(term: str) -> tuple[str, ...]:
    if term not in TERMS:
        raise LegsimError(f"unknown error term {term!r} of a sensor; known: {', '.join(TERMS)}")
    return TERMS[term]
