"""What sensors on a leg read, by bands of frequency: the same numbers of a real recording and of
the virtual subjects.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.imu.sensors import default_sensors
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import simulate
from legsim.kinematics.joint_splines import JointSplines
from tools.virtual_subjects.statistics import Truth

BANDS = ((0.2, 6.0), (6.0, 12.0), (12.0, 40.0))
"""Hz: sway and unrest, tremor, vibration of muscles and skin"""
LONG_AXIS = 1
"""of a segment: y, upwards"""
EDGE = 0.5
"""s at both ends that are left out, where filters and splines have nothing to go by"""


@dataclass(frozen=True, slots=True)
class Readings:
    """Root mean squares of a sensor's vectors in each of BANDS."""

    rate_deg_s: tuple[float, ...]
    acceleration_mg: tuple[float, ...]
    long_share: float
    """share of the mean squared rate in the first band that is about the segment's long axis"""


@dataclass(frozen=True, slots=True)
class Measured:
    """Least and most of several sensors of one segment."""

    rate_deg_s: tuple[tuple[float, float], ...]
    """in each of BANDS"""
    acceleration_mg: tuple[tuple[float, float], ...]
    long_share: tuple[float, float]
    correlation: tuple[float, float]
    """of left and right rates"""


STANDING = {
    "shank": Measured(
        ((0.51, 0.70), (0.17, 0.30), (0.19, 0.36)),
        ((2.25, 3.36), (1.73, 2.49), (2.80, 3.78)),
        (0.36, 0.72),
        (0.24, 0.62),
    ),
    "thigh": Measured(
        ((1.14, 1.32), (0.45, 0.70), (0.35, 0.53)),
        ((6.53, 6.92), (4.13, 5.58), (3.79, 4.63)),
        (0.78, 0.90),
        (0.79, 0.79),
    ),
}
"""One person who stands still: the first 10 s of gait-tech/gaittoolbox@5f22592, data/sample/rawimu
(subject S02), by :func:`readings` and :func:`correlation`; two sensors on each shank, one on each
thigh, Xsens MTw at 100 Hz, their x along the segment. Sensor noise and soft tissue are in it.
"""


def readings(
    rate: FloatArray, force: FloatArray, rate_hz: float, long_axis: int = LONG_AXIS
) -> Readings:
    """Of one sensor: angular velocity (n, 3) rad/s and specific force (n, 3) m/s^2."""
    slow = banded(rate, BANDS[0], rate_hz)
    return Readings(
        tuple(float(np.degrees(length_rms(banded(rate, band, rate_hz)))) for band in BANDS),
        tuple(1e3 / STANDARD_GRAVITY * length_rms(banded(force, band, rate_hz)) for band in BANDS),
        float(np.square(slow[:, long_axis]).sum() / np.square(slow).sum()),
    )


def correlation(left: FloatArray, right: FloatArray, rate_hz: float) -> float:
    """Of the rates (n, 3) of two like sensors on both legs in the first band: their scalar product
    over their lengths.
    """
    a, b = (banded(rate, BANDS[0], rate_hz) for rate in (left, right))
    return float((a * b).sum() / np.sqrt(np.square(a).sum() * np.square(b).sum()))


def banded(values: FloatArray, band: tuple[float, float], rate_hz: float) -> FloatArray:
    """(m, 3) of (n, 3) in a band (Hz): 2nd-order Butterworth, zero phase, without its ends."""
    edge = round(EDGE * rate_hz)
    sections = butter(2, band, btype="band", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(sections, values - values.mean(0), axis=0))[edge:-edge]


def length_rms(vectors: FloatArray) -> float:
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt(np.square(vectors).sum(-1).mean()))


def on_bones(truth: Truth) -> ImuSignals:
    """Signals of the default sensors on both legs, fixed to the true bones: shank and thigh, left,
    then right.
    """
    sensors = (*default_sensors("left"), *default_sensors("right"))
    times = truth.trajectories.times
    return inner(simulate(truth.leg, JointSplines(truth.trajectories), sensors, times))


def inner(signals: ImuSignals) -> ImuSignals:
    """The same signals without their ends, where splines swing."""
    times = signals.times
    kept = (times > times[0] + EDGE) & (times < times[-1] - EDGE)
    rate, force = signals.angular_velocity[kept], signals.specific_force[kept]
    return ImuSignals(times[kept], signals.sensor_names, rate, force, signals.sensors)


def of_signals(signals: ImuSignals) -> dict[str, Readings]:
    """Readings of each sensor, by its name."""
    rate_hz = (len(signals.times) - 1) / float(np.ptp(signals.times))
    return {name: readings(*signals.sensor(name), rate_hz) for name in signals.sensor_names}


def sides_correlated(signals: ImuSignals, segment: str) -> float:
    """Correlation of the rates of a segment's left and right sensor, as ``shank_l``."""
    rate_hz = (len(signals.times) - 1) / float(np.ptp(signals.times))
    left, right = (signals.sensor(f"{segment}_{side}")[0] for side in "lr")
    return correlation(left, right, rate_hz)


def spread(signals: Sequence[ImuSignals], segment: str) -> Measured:
    """Least and most of both legs' sensors on a segment in some recordings."""
    found = [of_signals(each)[f"{segment}_{side}"] for each in signals for side in "lr"]
    return Measured(
        tuple(_range([r.rate_deg_s[k] for r in found]) for k in range(len(BANDS))),
        tuple(_range([r.acceleration_mg[k] for r in found]) for k in range(len(BANDS))),
        _range([r.long_share for r in found]),
        _range([sides_correlated(each, segment) for each in signals]),
    )


def _range(values: list[float]) -> tuple[float, float]:
    return min(values), max(values)


def table(columns: dict[str, dict[str, Measured]]) -> list[str]:
    """Markdown rows: what a sensor reads by segment and band, beside each other by column."""
    rows = ["| sensor | band (Hz) | " + " | ".join(columns) + " |"]
    rows.append("|---|---|" + "---|" * len(columns))
    bands = [f"{low:g}-{high:g}" for low, high in BANDS]

    def add(what: str, band: str, cells: list[tuple[float, float]]) -> None:
        texts = (f"{low:.2f}-{high:.2f}" for low, high in cells)
        rows.append(f"| {what} | {band} | {' | '.join(texts)} |")

    for segment in STANDING:
        of = [column[segment] for column in columns.values()]
        for k, band in enumerate(bands):
            add(f"{segment} rate (deg/s)", band, [m.rate_deg_s[k] for m in of])
        for k, band in enumerate(bands):
            add(f"{segment} accelerometer (mg)", band, [m.acceleration_mg[k] for m in of])
        add(f"{segment} rate about its long axis (share)", bands[0], [m.long_share for m in of])
        add(f"{segment} rate, left with right (correlation)", bands[0], [m.correlation for m in of])
    return rows
