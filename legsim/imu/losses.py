"""What a recording lost, by its times and by readings that stand still.

One rule for both: a stretch without readings is one whether its samples are left out, or are there
as copies of the last one. It counts from the first sample on, and nothing is known of the motion
within one of more than 0.1 s.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray

LONG_GAP = 0.1
"""s; motion of 6 Hz cannot be interpolated over more"""

_CHANCE = 1e-6
"""by which digits of a sensor at rest may repeat as long as that"""

_MOVING_FORCE, _MOVING_RATE = 0.3, 0.1
"""m/s^2 and rad/s of deviation of a sensor that moves: at rest all digits may repeat"""

_MOSTLY_LONG = 0.75
"""share of runs of more than one repeat, from which on they are not by chance"""

_FEWEST, _SLOWER = 16, 0.05
"""repeats, and least share of them, of a sensor that is read faster than it measures"""

_DIGIT = 1.5
"""smallest differences of readings, within which they are a digit apart at most"""

_CLIPPED, _JUMP = 3, 4.0
"""samples in a row at an extreme, and digits by which readings that are cut off jump to it: those
of a smooth peak come near it first"""

_LEAST_RATE, _LEAST_FORCE = float(np.radians(100.0)), 15.0
"""rad/s and m/s^2 that the least ranges of such sensors hold (125 deg/s, 2 g)"""

_APART_S, _APART = 0.5, 0.05
"""s, and share of a recording, by which one instrument may end before the other"""

_QUANTITIES, _ALL = ("angular velocities", "accelerations"), "readings"

_TOGETHER, _WINDOW, _EVENLY = 8, 16, 0.8
"""repeats, and readings at least, of which it is asked whether they came evenly, and share of such
windows that must"""


_LONGER, _ROUNDING = 2.5, 1.6
"""usual steps beyond which one is longer than by rounding; largest spread about a straight line of
rounded times, in what their steps differ by: 1, and 1.5 where two samples share a time"""


def gap_note(name: str, times: FloatArray) -> tuple[str, ...]:
    """Describes gaps in a sensor's times (n,) s; nothing where there is none."""
    steps = np.diff(times)
    step = float(np.median(steps))
    # a sample that is late makes a long step beside a short one, and none is lost
    around = np.convolve(np.pad(steps, 1, constant_values=step), np.ones(3), "valid")
    lost = np.clip(np.minimum(np.rint(steps / step) - 1, np.rint(around / step) - 3), 0, None)
    usual = steps <= _LONGER * step
    if lost.any() and _are_rounded(steps, usual):
        lost = np.where(usual, 0, np.rint(steps / steps[usual].mean()) - 1)
    if not lost.any():
        return ()
    longest = int(np.argmax(steps))
    return (
        f"Sensor {name}: {lost.sum():.0f} of {len(times) + lost.sum():.0f} samples are missing, "
        f"the longest gap is {_stretch(float(steps[longest]), float(times[longest]))}.",
    )


def ends_note(name: str, rate: FloatArray, force: FloatArray) -> tuple[str, ...]:
    """Doubts times (n,) and (m,) s of angular velocities and accelerations, of one table, of which
    one ends long before the other; nothing where they end together.

    Columns of another rate, with times of their own, end there if they are taken for rows.
    """
    first, last = sorted((float(rate[-1]), float(force[-1])))
    whole = last - min(float(rate[0]), float(force[0]))
    if last - first < max(_APART_S, _APART * whole):
        return ()
    earlier, later = _QUANTITIES if rate[-1] < force[-1] else _QUANTITIES[::-1]
    return (
        f"In doubt: sensor {name}: its {earlier} end {last - first:.3g} s before its {later}, as "
        "columns of another rate do: if the table has a column of times for each, give time and "
        "angular_velocity_time.",
    )


def _are_rounded(steps: FloatArray, usual: NDArray[np.bool_]) -> bool:
    """Whether the ``usual`` of the steps (n,) differ as an even clock's do in rounded times:
    shorter and longer ones so alternate that times stay within the rounding of a straight line.
    """
    least, most = steps[usual].min(), steps[usual].max()
    longer = float((steps[usual] > 0.5 * (least + most)).mean())
    rarer = min(longer, 1 - longer)
    if rarer * len(steps) < _FEWEST:
        return False
    times = np.cumsum(np.where(usual, steps, steps[usual].mean()))
    size = max(_WINDOW, int(np.ceil(_TOGETHER / rarer)))
    if len(times) < 2 * size:
        return False
    off = np.ptp(_off_lines(_windows(times, size)), axis=1)
    return bool((off < _ROUNDING * (most - least)).mean() > _EVENLY)


def held_note(name: str, times: FloatArray, readings: FloatArray) -> tuple[str, ...]:
    """Describes angular velocities and specific forces (n, 6) that repeat at a beat, or in
    stretches longer than chance has them, both or one of them; nothing where there is neither.
    """
    repeats = (np.diff(readings, axis=0) == 0).reshape(-1, 2, 3).all(-1)
    rate_hz = 1 / float(np.median(np.diff(times)))
    beats = [_at_a_beat(repeats[:, k]) for k in range(2)]
    if any(beats):
        what = _ALL if all(beats) else _QUANTITIES[beats.index(True)]
        own = rate_hz * float(1 - repeats[:, beats].mean(0).max())
        return (
            f"Sensor {name}: its {what} change {own:.3g} times per second, evenly, and are there "
            f"at {rate_hz:.3g} Hz, as where a sensor is read faster than it measures; what moves "
            "faster is not in them: log it at its own rate.",
        )
    same = repeats.all(-1)
    runs = _stretches(same)
    held = [_beyond_chance(same, *one, rate_hz) for one in zip(*runs, strict=True)]
    if any(held):
        return _held(name, _ALL, times, *runs, np.array(held, bool))
    notes = []
    for k, (what, least) in enumerate(zip(_QUANTITIES, (_MOVING_FORCE, _MOVING_RATE), strict=True)):
        other = readings[:, 3:] if k == 0 else readings[:, :3]
        first, count = _stretches(repeats[:, k])
        spread = [other[a : a + n + 1].std(0).max() for a, n in zip(first, count, strict=True)]
        moving = np.array(spread) > least
        first, count = first[moving], count[moving]
        own = readings[:, :3] if k == 0 else readings[:, 3:]
        held = _beyond_others(count) & ~_within_a_digit(own, first, count)
        notes += _held(name, what, times, first, count, held)
    return tuple(notes)


def _within_a_digit(
    own: FloatArray, first: NDArray[np.intp], count: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Which runs of ``count`` (m,) repeats an instrument of readings (n, 3) begins and ends by a
    digit at most: that is coarse digits in a slow motion. A reading that was held jumps at its end.
    """
    digit = np.array([np.diff(np.unique(v)).min(initial=np.inf) for v in own.T])
    before, after = np.maximum(first - 1, 0), np.minimum(first + count + 1, len(own) - 1)
    jump = np.maximum(np.abs(own[before] - own[first]), np.abs(own[after] - own[first]))
    return np.asarray((jump <= _DIGIT * digit).all(-1))


def _beyond_others(count: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which runs of ``count`` (n,) repeats of one instrument, while the other one moves, are longer
    than others have by chance.

    Runs by chance get rarer from one repeat on by an even ratio; where few are that short, none is
    by chance.
    """
    goes_on = 1 - float((count == 1).mean()) if count.size else 0.0
    ratio = goes_on if 0.5 < goes_on < _MOSTLY_LONG else 0.5
    return np.asarray(len(count) * ratio ** (count - 1.0) < _CHANCE)


def _held(
    name: str,
    what: str,
    times: FloatArray,
    first: NDArray[np.intp],
    count: NDArray[np.intp],
    held: NDArray[np.bool_],
) -> tuple[str, ...]:
    """Describes the stretches of repeats (n,) that are ``held``."""
    if not held.any():
        return ()
    first, count = first[held], count[held]
    seconds = times[np.minimum(first + count + 1, len(times) - 1)] - times[first]
    longest = int(np.argmax(seconds))
    of = f"all {what}" if what == _ALL else f"the {what}"
    seconds, begin = float(seconds[longest]), float(times[first[longest]])
    # one instrument alone leaves what the other one says of the motion
    place = _stretch(seconds, begin) if what == _ALL else _place(seconds, begin)
    return (
        f"Sensor {name}: {count.sum()} of {len(times)} samples repeat {of} of the one "
        f"before, as where packets were lost; the longest stretch is {place}.",
    )


def _stretch(seconds: float, begin: float) -> str:
    advice = "; nothing is known of the motion within it" if seconds > LONG_GAP else ""
    return f"{_place(seconds, begin)}{advice}"


def _place(seconds: float, begin: float) -> str:
    return f"{1e3 * seconds:.0f} ms at {begin:.3f} s"


def _stretches(same: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First sample, and number of samples that repeat it, of each stretch of repeats (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    return edges[::2], edges[1::2] - edges[::2]


def _at_a_beat(same: NDArray[np.bool_]) -> bool:
    """Whether samples that repeat, of steps (n,), leave new ones that came at an even rate.

    The n-th new reading is then within a sample of a straight line, whatever the two rates are.
    Readings that repeat by chance wander off it as a random walk does.
    """
    if same.sum() < _FEWEST or same.mean() < _SLOWER:
        return False
    new = np.concatenate([[0], 1 + np.flatnonzero(~same)])
    size = max(_WINDOW, int(np.ceil(_TOGETHER * (1 / same.mean() - 1))))
    if len(new) < 2 * size:
        return False
    windows = _windows(new, size)
    off = _off_lines(windows)
    repeated = windows[:, -1] - windows[:, 0] - (size - 1)
    evenly = (np.ptp(off, axis=1) < 2) & (repeated >= _TOGETHER // 2)
    return bool(evenly.mean() > _EVENLY)


def _windows(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Windows (m, size) of values (n,), a quarter of them apart."""
    return np.lib.stride_tricks.sliding_window_view(values, size)[:: size // 4]


def _off_lines(windows: NDArray[Any]) -> FloatArray:
    """What windows (m, size) of values have beside a straight line each."""
    count = np.arange(windows.shape[1]) - (windows.shape[1] - 1) / 2
    slope = windows @ count / (count @ count)
    return windows - windows.mean(1, keepdims=True) - slope[:, None] * count


def _beyond_chance(same: NDArray[np.bool_], first: int, count: int, rate_hz: float) -> bool:
    """Whether a stretch is longer than repeats by chance are, whose share is that around it:
    readings repeat where a sensor is at rest.
    """
    reach = max(10 * count, round(2 * rate_hz))
    around = same[max(first - reach, 0) : first + count + reach]
    chance = (float(around.sum()) - count) / max(len(around) - count, 1)
    return count > 1 and len(same) * chance**count < _CHANCE


def clipped_note(name: str, readings: FloatArray) -> tuple[str, ...]:
    """Describes angular velocities and specific forces (n, 6) that stay at their extreme while
    other axes change, and leave it by more than a digit or two; nothing where none do.
    """
    notes = []
    for what, factor, unit, columns, least in (
        ("angular velocity", float(np.degrees(1.0)), "deg/s", slice(0, 3), _LEAST_RATE),
        ("acceleration", 1.0, "m/s2", slice(3, 6), _LEAST_FORCE),
    ):
        own = readings[:, columns]
        # three axes that repeat are one reading, held: it says nothing of a range
        new = np.concatenate([[True], (np.diff(own, axis=0) != 0).any(-1)])
        signed = [sign * v for v in own[new].T for sign in (1.0, -1.0)]
        cut = [(_clipped(values), float(values.max())) for values in signed]
        count, extreme = max(cut)
        if count and extreme > least:
            notes.append(
                f"In doubt: sensor {name} stays at {factor * extreme:.4g} {unit} of {what} in "
                f"{count} samples of an axis, as where its range ends; what is beyond is cut off."
            )
    return tuple(notes)


def _clipped(values: FloatArray) -> int:
    """Samples (of n) in runs at the greatest value, into which it jumps."""
    at_most = values == values.max()
    stays = at_most[1:] & at_most[:-1]
    first, count = _stretches(stays)
    long = count >= _CLIPPED - 1
    first, last = first[long], (first + count)[long]
    if not first.size:
        return 0
    beside = np.concatenate([values[np.maximum(first - 1, 0)],
                             values[np.minimum(last + 1, len(values) - 1)]])  # fmt: skip
    digit = float(np.diff(np.unique(values)).min(initial=np.inf))
    jumps = values.max() - beside
    return int(count[long].sum() + len(first)) if np.median(jumps) > _JUMP * digit else 0
