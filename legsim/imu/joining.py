"""Instruments of one sensor, and several sensors, on the times of one clock."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, increasing_times
from legsim.imu import recording
from legsim.imu.bridging import MOST, bridged, wide_steps
from legsim.imu.losses import gap_note
from legsim.imu.recording import ImuRecording
from legsim.imu.signals import ImuSignals


def merged(
    name: str, force: tuple[FloatArray, FloatArray], rate: tuple[FloatArray, FloatArray]
) -> ImuRecording:
    """Makes one recording of two instruments with times of their own.

    Args:
        name: of the sensor.
        force: times (n,) s and specific forces (n, 3) m/s^2; samples that are NaN are left out.
        rate: times (m,) s, of the same clock, and angular velocities (m, 3) rad/s.

    Raises:
        LegsimError: times that do not increase, or that do not overlap.
    """
    felt = np.where(recording.lost(force[1]), np.nan, force[1])
    seen = [
        (times[known], values[known])
        for times, values in ((force[0], felt), rate)
        for known in (np.isfinite(values).all(-1),)
    ]
    if not all(recording.enough(len(times)) for times, _ in seen):
        raise LegsimError(
            f"sensor {name!r} has fewer than {recording.FEWEST} samples; record longer"
        )
    for times, _ in seen:
        increasing_times(f"times of sensor {name!r}", times)
        recording.check_steady(name, times)
    notes = tuple(dict.fromkeys(note for times, _ in seen for note in gap_note(name, times)))
    first, last = max(t[0] for t, _ in seen), min(t[-1] for t, _ in seen)
    both = [(t[k], v[k]) for t, v in seen for k in ((t >= first) & (t <= last),)]
    if recording.enough(len(both[0][0])) and np.array_equal(both[0][0], both[1][0]):
        seen = both
    else:
        times = _shared_times([times for times, _ in seen])
        if not recording.enough(len(times)):
            spans = " and ".join(f"{t[0]:.10g} to {t[-1]:.10g} s" for t, _ in seen)
            raise LegsimError(
                f"accelerations and angular velocities of sensor {name!r} hardly overlap in time: "
                f"{spans}; give files of one recording, by one clock"
            )
        force_at, rate_at = (_at(own, values, times) for own, values in seen)
        known = np.isfinite(force_at).all(-1) & np.isfinite(rate_at).all(-1)
        times = times[known]
        seen = [(times, force_at[known]), (times, rate_at[known])]
        notes += (
            f"Sensor {name}: accelerations and angular velocities have times of their own; both "
            "are put on those of the faster by cubic splines.",
        )
    return ImuRecording(name, seen[0][0], seen[1][1], seen[0][1], notes)


@dataclass(frozen=True, slots=True, eq=False)
class JoinedSignals:
    """Several recordings as one set, with notes for the report."""

    signals: ImuSignals
    notes: tuple[str, ...]


def join(recordings: Sequence[ImuRecording]) -> JoinedSignals:
    """Joins recordings of one clock; samples are kept as they are where all have the same times.

    Otherwise all are put on the times of the fastest, within what all cover, by cubic splines; a
    longer gap of a sensor is marked as lost (NaN).

    Raises:
        LegsimError: no recording, names that repeat, recordings that do not overlap.
    """
    if not recordings:
        raise LegsimError("there is no sensor to join; give at least one recording")
    names = tuple(r.name for r in recordings)
    fastest = max(recordings, key=lambda r: r.rate_hz)
    if all(np.array_equal(r.times, fastest.times) for r in recordings):
        times, notes = fastest.times, ()
        sampled = [(r.angular_velocity, r.specific_force) for r in recordings]
    else:
        times = _shared_times([r.times for r in recordings])
        if not recording.enough(len(times)):
            spans = [f"{r.name} {r.times[0]:.13g} to {r.times[-1]:.13g} s" for r in recordings]
            raise LegsimError(
                f"the sensors do not overlap in time: {', '.join(spans)}; give each clock's offset "
                "(clock_offset_s)"
            )
        sampled = [
            tuple(_at(r.times, values, times) for values in (r.angular_velocity, r.specific_force))
            for r in recordings
        ]
        notes = (
            f"Sensors {', '.join(names)} sample at different times: put on those of "
            f"{fastest.name} by cubic splines, {times[0]:.13g} to {times[-1]:.13g} s.",
        )
    rate, force = (np.stack([one[k] for one in sampled], 1) for k in range(2))
    there = np.isfinite(force).any((1, 2))
    signals = ImuSignals(times[there], names, rate[there], force[there])
    return JoinedSignals(signals, (*(n for r in recordings for n in r.notes), *notes))


def _shared_times(clocks: Sequence[FloatArray]) -> FloatArray:
    """Times (n,) of the fastest of the ``clocks``, within what all of them cover; where it has a
    longer gap and others have samples, they are even, or those of the other with the most samples
    there where even ones would be too many.
    """
    first, last = max(times[0] for times in clocks), min(times[-1] for times in clocks)
    fastest = min(clocks, key=lambda times: float(np.median(np.diff(times))))
    step = float(np.median(np.diff(fastest)))
    parts = [fastest]
    for k in np.flatnonzero(wide_steps(fastest)):
        begin, end = fastest[k : k + 2]
        within = max((times[(times > begin) & (times < end)] for times in clocks), key=len)
        missing = np.rint((end - begin) / step) - 1
        even = len(within) and missing <= MOST
        parts.append(np.linspace(begin, end, int(missing) + 2)[1:-1] if even else within)
    whole = np.sort(np.concatenate(parts))
    return whole[(whole >= first) & (whole <= last)]


def _at(own: FloatArray, values: FloatArray, times: FloatArray) -> FloatArray:
    """Values (n, 3) at the times (n,) ``own``, by cubic splines at other times (m,); NaN in longer
    gaps, of which nothing is known.
    """
    found = make_interp_spline(*bridged(own, values, times), k=3)(times)
    after = np.clip(np.searchsorted(own, times), 1, len(own) - 1)
    inside = (times > own[after - 1]) & (times < own[after]) & wide_steps(own)[after - 1]
    return np.where(inside[:, None], np.nan, found)
