"""Samples that no sensor takes: axes that never change, lone spikes, gaps filled by lines."""

import numpy as np

from legsim.core.values import FloatArray

_AXES = ("angular velocity", "acceleration")

_FILLED, _STRAIGHT = 6, 0.01
"""samples at least on a line, and share of the usual second difference up to which they are"""

_OFF_LINE, _GOES = 0.02, 10.0
"""of what a stretch goes, by which all of it is off the line between its ends at most; times that,
which three axes go at least"""

_FINE = 0.1
"""of the usual second difference, up to which digits are fine"""

_ALONE = 10.0
"""times the next greatest, by which a lone sample is off the line of its neighbors"""

_LEAST_RATE, _LEAST_FORCE = float(np.radians(100.0)), 15.0
"""rad/s and m/s^2, below which a spike does no harm"""


def odd_notes(name: str, times: FloatArray, readings: FloatArray) -> tuple[str, ...]:
    """Describes what is odd in angular velocities and specific forces (n, 6) at times (n,) s."""
    return (
        *_dead(name, readings),
        *_spikes(name, times, readings),
        *_filled(name, times, readings),
    )


def _dead(name: str, readings: FloatArray) -> tuple[str, ...]:
    """Doubts axes that read one value throughout."""
    dead = [k for k in range(6) if not np.ptp(readings[:, k])]
    axes = " and ".join(f"{_AXES[k // 3]} along {'xyz'[k % 3]}" for k in dead)
    said = f"In doubt: sensor {name}: its {axes} never changes: check the columns, or the sensor."
    return (said,) if dead else ()


def _spikes(name: str, times: FloatArray, readings: FloatArray) -> tuple[str, ...]:
    """Doubts a sample of one instrument that is far off its neighbors, as no other one is."""
    notes = []
    for what, unit, factor, columns, least in (
        (_AXES[0], "deg/s", float(np.degrees(1.0)), slice(0, 3), _LEAST_RATE),
        (_AXES[1], "m/s2", 1.0, slice(3, 6), _LEAST_FORCE),
    ):
        own = readings[:, columns]
        off = np.abs(own[1:-1] - 0.5 * (own[:-2] + own[2:])).max(-1)
        k = int(np.argmax(off))
        others = np.delete(off, slice(max(k - 1, 0), k + 2))
        if off[k] > max(least, _ALONE * float(others.max(initial=0.0))):
            notes.append(
                f"In doubt: sensor {name}: one {what} at {times[k + 1]:.3f} s is "
                f"{factor * off[k]:.4g} {unit} off those beside it, as no other is: if it is a "
                "fault, leave its cells empty."
            )
    return tuple(notes)


def _filled(name: str, times: FloatArray, readings: FloatArray) -> tuple[str, ...]:
    """Doubts stretches in which all six readings lie on straight lines, as a filled gap's do."""
    bent = np.abs(np.diff(readings, 2, axis=0))
    usual = np.median(bent, axis=0)
    if not usual.all():
        return ()
    digit = np.array([np.diff(np.unique(v)).min() for v in readings.T])
    # where digits are fine, a line is one to within their rounding
    within = np.where(digit < _FINE * usual, np.maximum(_STRAIGHT * usual, 2.1 * digit), 0.0)
    straight = (bent <= within).all(-1) & (within > 0).all()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], straight, [False]]).astype(int)))
    first, count = edges[::2], edges[1::2] - edges[::2]
    goes = [
        n >= _FILLED and _goes_straight(readings[k : k + n + 2], digit)
        for k, n in zip(first, count, strict=True)
    ]
    long = np.array(goes, bool)
    if not long.any():
        return ()
    first, count = first[long], count[long]
    k = int(np.argmax(count))
    seconds = float(times[first[k] + count[k] + 1] - times[first[k]])
    return (
        f"In doubt: sensor {name}: {count.sum()} of {len(times)} samples lie on straight lines "
        "between others, as where lost ones were filled; the longest stretch is "
        f"{1e3 * seconds:.0f} ms at {times[first[k]]:.3f} s. Export without interpolation, so that "
        "what was lost is known.",
    )


def _goes_straight(stretch: FloatArray, digit: FloatArray) -> bool:
    """Whether readings (n, 6) go on lines from their first to their last, as a filled gap does.

    Those of a sensor at rest go nowhere, however little they are bent beside those in motion, and
    those that are held are not filled.
    """
    goes = np.abs(stretch[-1] - stretch[0])
    off = np.abs(stretch - np.linspace(stretch[0], stretch[-1], len(stretch))).max(0)
    straight = off <= np.maximum(_OFF_LINE * goes, 1.1 * digit)
    return bool(straight.all() and (goes > _GOES * off).sum() > 2)
