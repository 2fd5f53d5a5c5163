"""What one real sensor recorded, checked for units that cannot be."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import butter, sosfiltfilt

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.imu.axes_order import axes_doubt, tilt_doubt
from legsim.imu.losses import clipped_note, held_note
from legsim.imu.odd_samples import odd_notes

FEWEST = 16
"""samples that say something"""

_PACKETS = 0.02
"""least share of steps that are between packets, where samples arrive in packets"""

_RATES_HZ = (10.0, 20e3)
"""sampling rates that sensors on a body have"""

_USUAL_HZ = (25.0, 2000.0)
"""those that most have"""

_CLOCKS = {"ns": 1e-9, "ticks of 100 ns": 1e-7, "us": 1e-6, "ms": 1e-3, "days": 86400.0}
"""s per unit of what writes times"""

_AT_REST = (0.75 * STANDARD_GRAVITY, 1.35 * STANDARD_GRAVITY)
"""median magnitude of the specific force of a person who stands, squats or walks"""

_FASTEST = np.radians(2000.0)
"""rad/s, the widest range of common gyroscopes"""

_FEW = 0.05
"""share of samples that may stand for lost ones"""

_CALM_SHARE = 0.1
"""of the samples: those at which a sensor turns least, where it feels little but gravity"""

_OFF = 0.05
"""of gravity, by which a calm accelerometer may be off without a note"""

_PUSHED, _FAST = -1.5, 2.0
"""ratios of gravity's turn by both instruments beyond which what the sensor feels is not gravity"""

_TURNS_S = 10.0
"""s of a recording in which 48 orders of axes do not fit by chance"""

_TILTING_HZ = 0.6
"""below it a leg about its ankle tilts more against gravity than it accelerates"""

_CLEARLY = 0.6
"""correlation of gravity's turning in accelerometer and gyroscope above which their ratio counts"""

_FASTEST_BIAS = np.radians(25.0)
"""rad/s: gyroscopes are off by less, uncorrected ones too (20 deg/s, MPU-6050 data sheet)"""

_FAR, _STILL = 1.0, np.radians(30.0)
"""rad by which a gyroscope has gravity turn, and within which an accelerometer sees it"""

_SWAY, _UNLIKE = 0.3, 10.0
"""m/s^2 of gravity's sway by a gyroscope, beyond any noise, and times that of the accelerometer"""

_CALM = 1.0
"""m/s^2 of deviation of somebody who stands"""


@dataclass(frozen=True, slots=True, eq=False)
class ImuRecording:
    """Signals of one sensor, by its own clock, in its own frame."""

    name: str
    times: FloatArray
    """(n,) s, by the sensor's clock; gaps are left out"""
    angular_velocity: FloatArray
    """(n, 3) rad/s"""
    specific_force: FloatArray
    """(n, 3) m/s^2, +9.80665 upwards at rest"""
    notes: tuple[str, ...] = field(default=())
    """what was found in the file: lost packets, gaps"""

    def __post_init__(self) -> None:
        times = increasing_times(f"times of sensor {self.name!r}", self.times)
        object.__setattr__(self, "times", times)
        for name in ("angular_velocity", "specific_force"):
            values = frozen(f"{name} of sensor {self.name!r}", getattr(self, name), (len(times), 3))
            if not np.isfinite(values).all():
                row = int(np.argmin(np.isfinite(values).all(-1)))
                raise LegsimError(
                    f"{name} of sensor {self.name!r} is not a number at {times[row]:g} s; leave "
                    "that sample out"
                )
            object.__setattr__(self, name, values)

    def __repr__(self) -> str:
        seconds = self.times[-1] - self.times[0]
        return (
            f"ImuRecording({self.name}: {len(self.times)} samples over {seconds:.4g} s, "
            f"{self.rate_hz:.4g} Hz)"
        )

    @property
    def readings(self) -> FloatArray:
        """(n, 6) angular velocity and specific force."""
        return np.concatenate([self.angular_velocity, self.specific_force], -1)

    @property
    def rate_hz(self) -> float:
        """Samples per second, by the median step."""
        return 1.0 / float(np.median(np.diff(self.times)))

    @property
    def is_mostly_gaps(self) -> bool:
        """Whether nine tenths of its time have no sample."""
        return self.rate_hz * float(self.times[-1] - self.times[0]) > 10 * len(self.times)

    def named(self, name: str) -> "ImuRecording":
        """The same recording under another name."""
        return replace(self, name=name)

    def without_bias(self, rate: ArrayLike, force: ArrayLike) -> "ImuRecording":
        """The same samples less what the instruments read too much: (3,) rad/s and (3,) m/s^2."""
        return replace(
            self,
            angular_velocity=self.angular_velocity - np.asarray(rate, float),
            specific_force=self.specific_force - np.asarray(force, float),
        )

    def shifted(self, seconds: float) -> "ImuRecording":
        """The same samples, ``seconds`` later."""
        return replace(self, times=self.times + seconds)


def lost(force: FloatArray) -> NDArray[np.bool_]:
    """(n, 1) where specific forces (n, 3) are exactly 0, 0, 0.

    Loggers write so what they lost; integrated it would be a free fall.
    """
    return np.asarray((force == 0).all(-1, keepdims=True))


def without_lost(rate: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angular velocities and specific forces (n, 3) with NaN where the sample was lost."""
    gone = lost(force)
    return np.where(gone, np.nan, rate), np.where(gone, np.nan, force)


def enough(samples: int) -> bool:
    """Whether so many samples say something."""
    return samples >= FEWEST


def checked(recording: ImuRecording) -> ImuRecording:
    """The recording with a note on readings that stand still, refused in other units than m/s^2,
    rad/s and s, as far as a body can tell.

    Raises:
        LegsimError: the line names the quantity, what it reads and the fix.
    """
    check_plausible(recording)
    held = held_note(recording.name, recording.times, recording.readings)
    cut = clipped_note(recording.name, recording.readings)
    odd = odd_notes(recording.name, recording.times, recording.readings)
    return replace(recording, notes=(*recording.notes, *held, *cut, *odd, *_doubts(recording)))


def check_steady(name: str, times: FloatArray) -> None:
    """Refuses times (n,) s at which packets of several samples arrived: short steps within a
    packet, and packets as evenly as the samples were taken.

    Raises:
        LegsimError: with the rate that the times have over all.
    """
    steps = np.diff(times)
    if len(steps) < FEWEST or (steps <= 0).any():
        return
    within = float(np.quantile(steps, 0.3))
    # few long steps are pauses, not packets
    if within > 0.5 * steps.mean() or (steps > 2 * within).mean() < _PACKETS:
        return
    rows = np.arange(len(times))
    line = np.polynomial.Polynomial.fit(rows, times, 1)
    if np.abs(times - line(rows)).max() > steps.max():
        return
    raise LegsimError(
        f"the times of sensor {name!r} are those of delivery, in bursts: samples "
        f"{1e3 * within:.3g} ms apart, and {1e3 * steps.max():.3g} ms between bursts; leave the "
        f"column of times out, and give rate_hz, about {1 / line.convert().coef[1]:.4g}"
    )


def check_plausible(recording: ImuRecording) -> None:
    """Refuses signals in other units than m/s^2, rad/s and s, as far as a body can tell.

    Raises:
        LegsimError: the line names the quantity, what it reads and the fix.
    """
    where = f"sensor {recording.name!r}"
    if len(recording.times) < FEWEST:
        raise LegsimError(
            f"{where} has {len(recording.times)} samples; at least {FEWEST} are needed, record "
            "longer"
        )
    if not _RATES_HZ[0] <= recording.rate_hz <= _RATES_HZ[1]:
        raise LegsimError(
            f"{where} has {recording.rate_hz:.4g} samples per second, which no such sensor takes; "
            f"{_clock_fix(recording)}"
        )
    _check_force(where, recording)
    _check_rate(where, recording)


def _clock_fix(recording: ImuRecording) -> str:
    """What helps where times are not in the unit that they are said to be in."""
    if (np.diff(recording.times) == 1).all():
        return "its times count the samples: leave the column of times out, and give rate_hz"
    usual = [
        f"{unit} taken for s have {rate:.4g} per second"
        for unit, seconds in _CLOCKS.items()
        if _USUAL_HZ[0] <= (rate := recording.rate_hz / seconds) <= _USUAL_HZ[1]
    ]
    guess = f": {', '.join(usual)}" if usual else ""
    return f"state the unit of the times (s, ms, us or ns), convert them to it, or the rate{guess}"


def _doubts(recording: ImuRecording) -> tuple[str, ...]:
    """What does not fit gravity, and may yet be so."""
    notes, where = [], f"In doubt: sensor {recording.name}"
    magnitudes = np.linalg.norm(recording.specific_force, axis=-1)
    read = float(np.median(magnitudes))
    share = read / STANDARD_GRAVITY - 1
    if float(recording.specific_force.std(0).max()) < _CALM and abs(share) > _OFF:
        notes.append(
            f"{where} reads {read:.2f} m/s2 while it is calm, {100 * share:+.0f} % off gravity: "
            "check the unit and scale of its acceleration, or calibrate it."
        )
    scale, correlation = gyroscope_scale(recording)
    pushed = correlation < -_CLEARLY and scale < _PUSHED
    other_scale = pushed or (correlation > _CLEARLY and scale > _FAST)
    if other_scale:
        notes.append(
            f"{where}: its accelerometer sees gravity turn {scale:.2g} times as fast as its "
            "gyroscope does, as where the sampling rate or a scale is wrong, or where it was "
            "pushed about rather than tilted."
        )
    even = _evenly(recording)
    if even is not None and recording.times[-1] - recording.times[0] >= _TURNS_S:
        ordered = axes_doubt(recording.name, recording.rate_hz, *even)
        if not (ordered or other_scale):
            notes += tilt_doubt(recording.name, recording.rate_hz, *even)
        notes += ordered
    return tuple(notes)


def _check_force(where: str, recording: ImuRecording) -> None:
    magnitudes = np.linalg.norm(recording.specific_force, axis=-1)
    turning = np.linalg.norm(recording.angular_velocity, axis=-1)
    calm = turning <= np.quantile(turning, _CALM_SHARE)
    # of a foot that runs, only the calm part feels about gravity
    found = [float(np.median(of)) for of in (magnitudes, magnitudes[calm])]
    if any(_AT_REST[0] <= size <= _AT_REST[1] for size in found):
        return
    for magnitude in found:
        _refuse_unit(where, magnitude)
    magnitude = found[0]
    gone = (
        "gravity was removed: export the calibrated acceleration with gravity in it"
        if magnitude < 0.5 * STANDARD_GRAVITY
        else "check unit and columns of the acceleration"
    )
    raise LegsimError(
        f"{where}: the acceleration's magnitude is {magnitude:.4g} in the median, not about 9.81 "
        f"m/s2; {gone}"
    )


def _refuse_unit(where: str, magnitude: float) -> None:
    """Refuses a magnitude that is that of gravity in another unit."""
    guesses = (
        ("g", 1.0, "state its unit as g"),
        ("mg", 1e3, "state its unit as mg"),
        ("m/s2 multiplied by 9.81 once more", STANDARD_GRAVITY**2, "state its unit as m/s2"),
        ("g read as mg", STANDARD_GRAVITY * 1e-3, "state its unit as g"),
    )
    for unit, at_rest, fix in guesses:
        if 0.75 * at_rest <= magnitude <= 1.35 * at_rest:
            raise LegsimError(
                f"{where}: the acceleration's magnitude is {magnitude:.4g} in the median, not "
                f"about 9.81 m/s2: it is {unit}; {fix}"
            )


def _check_rate(where: str, recording: ImuRecording) -> None:
    rate = recording.angular_velocity
    if not np.ptp(rate, axis=0).any():
        raise LegsimError(f"{where}: the gyroscope reads one value throughout; check its columns")
    fastest = float(np.linalg.norm(rate, axis=-1).max())
    if fastest > _FASTEST:
        raise LegsimError(
            f"{where}: the angular velocity reaches {np.degrees(fastest):.4g} deg/s, beyond the "
            f"2000 deg/s of such sensors; {_rate_fix(recording)}"
        )
    scale, correlation = gyroscope_scale(recording)
    if correlation < -_CLEARLY and scale >= _PUSHED:
        raise LegsimError(
            f"{where}: gravity turns the other way in the accelerometer than by the gyroscope; "
            'turn the signs of the angular velocity (columns as "-gx"), or, where the axes are '
            "left-handed, the sign of one axis of both; or the columns of both are not in the "
            "order x, y, z"
        )
    if correlation > _CLEARLY and not 0.1 < scale < 10:
        unit = "rad/s" if scale > 10 else "deg/s"
        raise LegsimError(
            f"{where}: the accelerometer sees gravity turn {scale:.3g} times as fast as the "
            f"gyroscope does; state the unit of the angular velocity as {unit}, or check its "
            "columns"
        )
    _check_still(where, recording)


def _rate_fix(recording: ImuRecording) -> str:
    """What helps where angular velocities are beyond all sensors: in most samples, or in a few."""
    beyond = np.linalg.norm(recording.angular_velocity, axis=-1) > _FASTEST
    if beyond.mean() > _FEW:
        return "state its unit as deg/s, or check its columns"
    first = float(recording.times[np.argmax(beyond)])
    return (
        f"it does so in {beyond.sum()} of {len(beyond)} samples, from {first:.13g} s on: leave "
        "their cells empty where they stand for lost packets; else state its unit as deg/s"
    )


def _check_still(where: str, recording: ImuRecording) -> None:
    """Refuses a gyroscope by which gravity turns far where the accelerometer sees it stay."""
    force = recording.specific_force
    up = force.mean(0) / np.linalg.norm(force.mean(0))
    mean = recording.angular_velocity.mean(0)
    tilting = float(np.linalg.norm(mean - (mean @ up) * up))
    turn = tilting * float(recording.times[-1] - recording.times[0])
    upright = np.quantile(force @ up / np.linalg.norm(force, axis=-1), 0.05) > np.cos(_STILL)
    gyroscope, seen = (float(np.sqrt((v**2).mean())) for v in _gravity_turns(recording))
    drifts = upright and tilting > _FASTEST_BIAS and turn > _FAR
    # of somebody who runs, what shakes the sensor makes up for most of the gyroscope's part
    calm = float(force.std(0).max()) < _CALM
    sways = calm and gyroscope > max(_SWAY, _UNLIKE * seen)
    if drifts or sways:
        by = f"{np.degrees(tilting):.0f} deg/s on end" if drifts else "many times as far"
        raise LegsimError(
            f"{where}: by the gyroscope gravity turns {by}, and the accelerometer does not see "
            "it; state the unit of the angular velocity as deg/s, or check its columns"
        )


def gyroscope_scale(recording: ImuRecording) -> tuple[float, float]:
    """How fast gravity turns in the accelerometer over how fast it does by the gyroscope.

    Returns the ratio, 1 for signals in SI, and the correlation of the two sides, low where the
    sensor hardly tilts.
    """
    gyroscope, seen = _gravity_turns(recording)
    power, shared = float((gyroscope**2).sum()), float((gyroscope * seen).sum())
    both = np.sqrt(power * float((seen**2).sum()))
    return (shared / power, shared / both) if both > 0 else (1.0, 0.0)


def _gravity_turns(recording: ImuRecording) -> tuple[FloatArray, FloatArray]:
    """The slow part of the specific force (n, 3) by the gyroscope, and by the accelerometer; zeros
    where the recording does not show them.

    Slow turns of a leg tilt it more than they accelerate it: f' = -w x f.
    """
    even = _evenly(recording)
    if even is None:
        return np.zeros((1, 3)), np.zeros((1, 3))
    rate, force, low = even
    turned = -np.cumsum(np.cross(rate, force), axis=0) / recording.rate_hz
    return sosfiltfilt(low, turned, axis=0), sosfiltfilt(low, force, axis=0)


def _evenly(recording: ImuRecording) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Angular velocity and specific force (n, 3) at even times, and the filter of slow turns; None
    where the recording does not show them.
    """
    rate_hz = recording.rate_hz
    count = rate_hz * (recording.times[-1] - recording.times[0])
    # of a recording that is mostly gaps nothing is known between its samples
    if count <= 63 or recording.is_mostly_gaps or rate_hz < 4 * _TILTING_HZ:
        return None
    times = np.arange(recording.times[0], recording.times[-1], 1 / rate_hz)
    low = butter(2, [0.1, _TILTING_HZ], "bandpass", fs=rate_hz, output="sos")
    rate, force = (
        np.stack([np.interp(times, recording.times, values[:, k]) for k in range(3)], -1)
        for values in (recording.angular_velocity, recording.specific_force)
    )
    return rate, force, low
