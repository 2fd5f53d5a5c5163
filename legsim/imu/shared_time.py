"""Two recordings on the time that both share, as they are and in a band of frequencies."""

from typing import Literal

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.bridging import bridged
from legsim.imu.recording import ImuRecording

Quantity = Literal["rate", "force"]

MOVEMENT_HZ = (0.2, 6.0)
"""band of the movement: markers are filtered to 6 Hz"""

MOVING = float(np.radians(20))
"""rad/s RMS of the angular velocity in that band: a person who stands has 1 degree per second"""

HIGHEST = 0.45
"""of the sampling rate: above it a band is not measured"""

SHORTEST = 3.0
"""s of overlap in which the lag of a clock can be found"""

SHORTEST_KNOWN = 0.5
"""s of overlap of clocks that are known"""


def shared_s(a: ImuRecording, b: ImuRecording) -> float:
    """Seconds that both share; negative between recordings apart."""
    first, last = max(a.times[0], b.times[0]), min(a.times[-1], b.times[-1])
    return float(last - first)


def overlap(a: ImuRecording, b: ImuRecording, step: float) -> FloatArray:
    """Even times (n,) that both share.

    Raises:
        LegsimError: less than 0.5 s.
    """
    first = max(a.times[0], b.times[0])
    seconds = shared_s(a, b)
    if seconds < SHORTEST_KNOWN:
        raise short(a, b, SHORTEST_KNOWN)
    return first + step * np.arange(int(seconds / step + 1e-6) + 1)


def short(markers: ImuRecording, sensor: ImuRecording, wanted: float) -> LegsimError:
    """The refusal of recordings that share less than ``wanted`` seconds, with what helps."""
    a, b = markers.times, sensor.times
    problem = (
        f"sensor {sensor.name} recorded {b[0]:.13g} to {b[-1]:.13g} s, the markers {a[0]:g} to "
        f"{a[-1]:g} s: they share less than {wanted:g} s"
    )
    offset = "clock_offset_s (the sensor's clock minus the markers') in a TOML about its file"
    if min(a[-1] - a[0], b[-1] - b[0]) >= wanted:
        return LegsimError(f"{problem}; give {offset}")
    if wanted == SHORTEST_KNOWN or min(a[-1] - a[0], b[-1] - b[0]) < SHORTEST_KNOWN:
        return LegsimError(f"{problem}, too little for any comparison; record a longer trial")
    return LegsimError(
        f"{problem}, too little to find the lag of its clock; record a longer trial, or state "
        f"{offset}: a trial of {SHORTEST_KNOWN:g} s will then do (0 where both have one clock)"
    )


def at(
    recording: ImuRecording, times: FloatArray, quantity: Quantity, derivative: int = 0
) -> FloatArray:
    """Values (n, 3), or their derivative, by a cubic spline; held beyond the ends."""
    inside = np.clip(times, recording.times[0], recording.times[-1])
    values = recording.angular_velocity if quantity == "rate" else recording.specific_force
    return make_interp_spline(*bridged(recording.times, values, inside), k=3)(inside, nu=derivative)


def in_band(
    recording: ImuRecording, times: FloatArray, band_hz: tuple[float, float], quantity: Quantity
) -> FloatArray:
    """Values (n, 3) at even times in a band."""
    return band_passed(at(recording, times, quantity), times, band_hz)


def band_passed(values: FloatArray, times: FloatArray, band_hz: tuple[float, float]) -> FloatArray:
    """Values (n, ...) at even times through a zero-phase Butterworth band-pass of second order."""
    rate_hz = 1 / float(np.median(np.diff(times)))
    high = min(band_hz[1], HIGHEST * rate_hz)
    sections = butter(2, [band_hz[0], high], "bandpass", fs=rate_hz, output="sos")
    # mirrored over three periods at each end: scipy's short odd padding lets a movement that begins
    # at an end ring through the filter, by a third of what a standing person does in 11 s
    pad = min(len(times) - 1, int(3 * rate_hz / band_hz[0]))
    return sosfiltfilt(sections, values - values.mean(0), axis=0, padtype="even", padlen=pad)


def rms(vectors: FloatArray) -> float:
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(-1).mean()))
