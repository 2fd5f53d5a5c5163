"""Times of a TRC file's rows, by its time column, frame numbers and rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.mocap._stated_times import full_times, last_digit
from legsim.mocap.trajectories import late_cure, written_twice

_SLOWEST_HZ = 2.0
"""no marker is followed so slowly"""

SAME_RATE = 0.02
"""by which two rates differ that are the same"""

_OTHER_UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 60.0: "minutes"}
"""seconds per unit"""


@dataclass(frozen=True, slots=True, eq=False)
class TimeColumn:
    """What the rows of a file say about their times."""

    lines: Sequence[int]
    """line number of each row, counted from 1"""
    frames: Sequence[int]
    texts: Sequence[str]
    stated: FloatArray
    """(n,) in the column's unit; NaN where a row has no time"""


def row_times(path: Path, rate: float, column: TimeColumn) -> tuple[FloatArray, tuple[str, ...]]:
    """Times (n,) s, and notes on what is unusual about them.

    The column's times are taken, unless they are multiples of 1 / ``rate``, or even at another rate
    or on a grid, stated with few digits: then these.

    Raises:
        LegsimError: the times do not increase.
    """
    frames = np.array(column.frames, float)
    unit, notes = _seconds(column.stated, frames, rate)
    stated = column.stated * unit
    if np.isnan(stated).all():
        times, said = (
            (frames - frames[0]) / rate,
            ("no row has a time: times are from the frame numbers and DataRate",),
        )
        _check_increase(path, times, column)
        return times, (*said, *_frame_notes(times, frames, rate, timed=False))
    known = ~np.isnan(stated)
    # by how much the column's last digit counts, in seconds
    step = last_digit(column.texts) * unit
    if not known.all():
        notes = (
            *notes,
            f"{int((~known).sum())} rows have no time: filled from their frame numbers",
        )
    times = _even_times(stated, frames, known, rate, step)
    if times is None:
        stated[~known] = np.interp(frames[~known], frames[known], stated[known])
        times = full_times(stated, step, rate)
    _check_increase(path, times, column)
    return times, (*notes, *_frame_notes(times, frames, rate, timed=True))


def _check_increase(path: Path, times: FloatArray, column: TimeColumn) -> None:
    """Refuses rows at the time of the row before, to within what rounding explains."""
    late = written_twice(times)
    if late.size == 0:
        return
    k, step = int(late[0]), times[late[0]] - times[late[0] - 1]
    after, before = (column.texts[i] or f"{times[i]:g}" for i in (k, k - 1))
    raise file_error(
        path,
        f"time {after} does not come after {before}"
        if step <= 0
        else f"time {after} comes only {step:.2g} s after {before}",
        late_cure(times, k),
        place=f"line {column.lines[k]}",
    )


def _seconds(stated: FloatArray, frames: FloatArray, rate: float) -> tuple[float, tuple[str, ...]]:
    """Seconds in a unit of the time column, and a note where it is in another one, by which it goes
    from frame to frame as the rate says, or counts frames.
    """
    between = np.diff(frames)
    if len(stated) > 1 and rate > _SLOWEST_HZ and (np.diff(stated) == between).all():
        said = f"the time column counts frames: times are from it and DataRate ({rate:g} Hz)"
        return 1 / rate, (said,)
    steps = np.diff(stated) / np.where(between > 0, between, np.nan)
    usual = np.nanmedian(steps) if np.isfinite(steps).any() else np.nan
    name, seconds = unit_of(float(usual), rate)
    return seconds, (f"the time column is in {name}",) if name else ()


def unit_of(step: float, rate: float) -> tuple[str, float]:
    """Unit other than seconds in which a time column goes on by ``step`` at ``rate`` (Hz), and
    seconds per unit; none and 1 where there is none.
    """
    fitting = (u for u in _OTHER_UNITS.items() if abs(step * u[0] * rate - 1) <= SAME_RATE)
    seconds, name = next(fitting, (1.0, ""))
    return name, seconds


def _frame_notes(
    times: FloatArray, frames: FloatArray, rate: float, *, timed: bool
) -> tuple[str, ...]:
    """Notes on frame numbers that skip or return, and on a time column of another rate than the
    header's.
    """
    if len(times) < 2:
        return ()
    steps = np.diff(frames)
    if (steps != 1).any():
        return (_skips(times, frames, rate, timed=timed),)
    slow, fast = 1 / np.quantile(np.diff(times), [0.95, 0.05])
    if fast > 1.5 * slow:
        return (f"the rate varies between {slow:.3g} and {fast:.3g} Hz by the time column",)
    found = (len(times) - 1) / (times[-1] - times[0])
    if found <= _SLOWEST_HZ:
        return (
            f"warning: a sample every {1 / found:.3g} s: no movement is followed so slowly, see "
            "whether the times are in seconds",
        )
    if abs(found / rate - 1) < SAME_RATE:
        return ()
    return (f"the header says {rate:g} Hz, the time column {found:.4g} Hz, which is taken",)


def _skips(times: FloatArray, frames: FloatArray, rate: float, *, timed: bool) -> str:
    """Note on frame numbers that are not consecutive: how many are left out, where, and whether
    the times leave them out too.
    """
    steps = np.diff(frames)
    first = int(np.flatnonzero(steps != 1)[0])
    where = f"after frame {frames[first]:g} ({times[first]:.4g} s)"
    if (steps < 1).any():
        k = int(np.flatnonzero(steps < 1)[0])
        return (
            f"frame numbers return from {frames[k]:g} to {frames[k + 1]:g} at "
            f"{times[k + 1]:.4g} s; the times are taken"
        )
    missing, gaps = int((steps - 1).sum()), int((steps > 1).sum())
    widest = int(steps.argmax())
    most = (
        f", most {steps[widest] - 1:g} after frame {frames[widest]:g} ({times[widest]:.4g} s)"
        if gaps > 1
        else ""
    )
    missed = (
        f"{missing} of {frames[-1] - frames[0] + 1:g} frames are left out in {gaps} "
        f"place{'s'[: gaps - 1]}, first {where}{most}"
    )
    span = (frames[-1] - frames[0]) / rate
    if not timed or abs((times[-1] - times[0]) - span) <= max(0.1 * missing, 0.75) / rate:
        return missed
    return (
        f"{missed}, but the times run on as if none were missing; the times are taken (empty the "
        "time column to have the frame numbers taken)"
    )


def _even_times(
    stated: FloatArray, frames: FloatArray, known: np.ndarray, rate: float, step: float
) -> FloatArray | None:
    """frame / rate where it explains every stated time to one unit of its last digit, and that
    digit hides something; else None.
    """
    if len(stated) < 2 or (np.diff(frames) != 1).any():
        return None
    count = frames - frames[0]
    starts = (frames[0] - 1, stated[known][0] * rate - count[known][0])
    candidates = [(start + count) / rate for start in starts]
    errors = [float(np.abs(stated - even)[known].max()) for even in candidates]
    # times stated in full are kept to the last bit
    if errors[1] <= 1e-9:
        return None if known.all() else candidates[1]
    # beyond three quarters of a sample the column tells of something else than rounding, unless
    # its digits are coarser than that
    tolerance = 1.001 * step if 1 / rate < 0.9 * step else min(1.001 * step, 0.75 / rate)
    return next(
        (even for even, error in zip(candidates, errors, strict=True) if error <= tolerance), None
    )
