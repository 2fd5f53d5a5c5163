"""Sensors in a table: which columns are which, in which units, by which clock.

A table is of text, or the analog channels of a C3D file, whose clock is that of its markers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.imu import (
    joining,
    losses,
    moments,
    other_clock,
    packets,
    recording,
    same_times,
    turns,
    units,
)
from legsim.imu.column_units import (
    ByColumn,
    check_gravity,
    check_names,
    force_scale,
    rate_scale,
)
from legsim.imu.recording import ImuRecording, check_steady, checked
from legsim.imu.table_layout import ONE_CLOCK, SensorColumns, TableLayout
from legsim.imu.table_rows import Column, RowsOf, is_named, number_in, read_rows
from legsim.imu.units import AccelerationUnit, AngularVelocityUnit, TimeUnit
from legsim.mocap.c3d_analog import load_analog

Units = tuple[AccelerationUnit, AngularVelocityUnit]

_DOUBT = "In doubt: "

_FEW = 6
"""names of channels of one kind in an error"""


@dataclass(frozen=True, slots=True)
class _Vectors:
    """One quantity of all sensors of a table, in SI."""

    times: FloatArray
    """(n,) s"""
    values: tuple[FloatArray, ...]
    """(n, 3) per sensor; NaN where a cell is empty"""
    notes: tuple[str, ...]
    """oddities of the file"""
    rows: turns.Numbered | None = None
    """lines of the rows, and the packets' numbers, or what else is their clock; None for a C3D"""


def load(
    path: Path | str, layout: TableLayout, *, angular_velocity_file: Path | None = None
) -> tuple[ImuRecording, ...]:
    """Reads the sensors of a table: comma, semicolon, tab or blanks between columns.

    Lines above the row of names are passed over, and so is a row of units below it. Rows in which a
    sensor has no numbers (lost packets) are left out and noted.

    Args:
        path: of the table.
        layout: what its columns are.
        angular_velocity_file: a second table, of the same clock, with the angular velocities; None
            where they are in the first. Where their times are others, the slower instrument is put
            on the times of the faster one by cubic splines, which is noted.

    Raises:
        LegsimError: missing columns, cells that are no numbers, times that do not increase, units
            that cannot be or that contradict the table's own.
    """
    path = Path(path)
    forces = [s.acceleration for s in layout.sensors]
    rates = [s.angular_velocity for s in layout.sensors]
    if layout.rows_by is not None:
        return _in_turn(path, layout, layout.rows_by)
    if angular_velocity_file is None and layout.angular_velocity_time is None:
        _check_apart(path, layout)
        both = _read(path, layout, forces, rates)
        count = len(forces)
        made = [
            recording_of(path, sensor.name, both.times, both.values[count + k], both.values[k])
            for k, sensor in enumerate(layout.sensors)
        ]
        return _noted(made, both.notes)
    force = _read(path, layout, forces, [])
    other = angular_velocity_file or path
    rate = _read(
        other, replace(layout, time=layout.angular_velocity_time or layout.time), [], rates
    )
    _check_counted(path, layout, {str(path): len(force.times), str(other): len(rate.times)})
    made = []
    for k, sensor in enumerate(layout.sensors):
        pair = (force.times, force.values[k]), (rate.times, rate.values[k])
        made.append(_merged(path, sensor.name, *pair))
    return _noted(made, (*force.notes, *rate.notes))


def _merged(
    path: Path, name: str, force: tuple[FloatArray, FloatArray], rate: tuple[FloatArray, FloatArray]
) -> ImuRecording:
    """The checked recording of two instruments with times of their own."""
    try:
        return checked(joining.merged(name, force, rate))
    except LegsimError as error:
        raise _in_file(path, error) from error


def _in_turn(path: Path, layout: TableLayout, rows_by: Column) -> tuple[ImuRecording, ...]:
    """Sensors of a table in which sensors or instruments take turns."""
    pairs = [_turns_of(path, layout, sensor, rows_by) for sensor in layout.sensors]
    texts = [(s.acceleration_rows, s.angular_velocity_rows) for s in layout.sensors]
    read = [one for of in zip(texts, pairs, strict=True) for one in zip(*of, strict=True)]
    _check_counted(path, layout, {text: len(vectors.times) for text, vectors in read})
    later, said = _in_order(layout, dict(read))
    if layout.rate_hz is not None:
        put = [_later(one, later.get(text, 0.0), layout.rate_hz) for text, one in read]
        pairs = list(zip(put[::2], put[1::2], strict=True))
    made = [
        recording_of(path, sensor.name, rate.times, rate.values[-1], force.values[0])
        if sensor.acceleration_rows == sensor.angular_velocity_rows
        else _merged(
            path, sensor.name, (force.times, force.values[0]), (rate.times, rate.values[0])
        )
        for sensor, (force, rate) in zip(layout.sensors, pairs, strict=True)
    ]
    notes = [*(note for _, one in read for note in one.notes), *_of_file(path, said)]
    return _noted(made, tuple(dict.fromkeys(notes)))


def _in_order(
    layout: TableLayout, read: Mapping[str, _Vectors]
) -> tuple[Mapping[str, float], tuple[str, ...]]:
    """Packets that the rows of each text begin later than the first of all, and notes."""
    rows = {text: one.rows for text, one in read.items() if one.rows is not None}
    if layout.rate_hz is None or len(rows) < 2:
        return {}, ()
    if layout.counter is None:
        lines = {text: lines for text, (lines, _) in rows.items()}
        return {}, turns.out_of_turn(lines, layout.rate_hz)
    return turns.first_packets(rows, layout.counter_period)


def _of_file(path: Path, said: Sequence[str]) -> tuple[str, ...]:
    """Sentences that name the file, behind the doubt that they may begin with."""
    parted = [one.removeprefix(_DOUBT) for one in said]
    return tuple(
        f"{_DOUBT * (one != rest)}{path.name}: {rest}."
        for one, rest in zip(said, parted, strict=True)
    )


def _later(one: _Vectors, count: float, rate_hz: float) -> _Vectors:
    """The same rows, so many packets later; times of equal packets stay equal to the last bit."""
    return replace(one, times=(np.rint(one.times * rate_hz) + count) / rate_hz)


def _turns_of(
    path: Path, layout: TableLayout, sensor: SensorColumns, rows_by: Column
) -> tuple[_Vectors, _Vectors]:
    """A sensor's accelerations and angular velocities; one and the same where rows hold both."""
    force_rows, rate_rows = (
        RowsOf(rows_by, text) for text in (sensor.acceleration_rows, sensor.angular_velocity_rows)
    )
    if force_rows == rate_rows:
        both = _read(path, layout, [sensor.acceleration], [sensor.angular_velocity], force_rows)
        return both, both
    return (
        _read(path, layout, [sensor.acceleration], [], force_rows),
        _read(path, layout, [], [sensor.angular_velocity], rate_rows),
    )


def _check_counted(path: Path, layout: TableLayout, rows: Mapping[str, int]) -> None:
    """Refuses instruments with unlike numbers of ``rows`` where these alone are their clock: one
    that is slower, or lost some, would be squeezed in time.
    """
    by_rows = layout.time is None and layout.counter is None and layout.rate_hz is not None
    if by_rows and len(set(rows.values())) > 1:
        counts = ", ".join(f"{count} of {name!r}" for name, count in rows.items())
        raise file_error(
            path,
            f"its instruments have unlike numbers of rows ({counts}), so rate_hz does not say when "
            "each row was taken",
            "give the column of times (time) or of the packets' numbers (counter)",
        )


def _check_apart(path: Path, layout: TableLayout) -> None:
    """Refuses columns that hold both quantities, row by row."""
    for sensor in layout.sensors:
        both = (sensor.acceleration, sensor.angular_velocity)
        signed = _signed(path, layout, both)
        if set.intersection(*({signed[c][1] for c in columns} for columns in both)):
            raise file_error(
                path,
                f"sensor {sensor.name!r} has columns that are accelerations and angular velocities",
                "name others, or give the column that says which each row is (rows_by, with "
                "acceleration_rows and angular_velocity_rows of each sensor)",
            )


def _noted(made: Sequence[ImuRecording], notes: tuple[str, ...]) -> tuple[ImuRecording, ...]:
    """The same sensors, the first with the notes of the file."""
    first, *others = made
    return (replace(first, notes=(*notes, *first.notes)), *others)


def _read(
    path: Path,
    layout: TableLayout,
    forces: Sequence[tuple[Column, Column, Column]],
    rates: Sequence[tuple[Column, Column, Column]],
    only: RowsOf | None = None,
) -> _Vectors:
    """Accelerations, then angular velocities; of some rows alone where ``only`` says which."""
    signed = _signed(path, layout, [*forces, *rates])
    of_force, of_rate = ([signed[c][1] for v in kind for c in v] for kind in (forces, rates))
    try:
        if path.suffix.lower() == ".c3d":
            found = _of_channels(path, layout, [*of_force, *of_rate])
        else:
            found = _of_text(path, layout, [*of_force, *of_rate], only)
        if only is None:
            check_names(of_force, of_rate, found.names)
        scale = {
            **dict.fromkeys(of_force, force_scale(layout, *found.units_of(of_force))),
            **dict.fromkeys(of_rate, rate_scale(layout, *found.units_of(of_rate))),
        }
    except LegsimError as error:
        raise _in_file(path, error) from error
    vectors = tuple(
        np.stack([sign * scale[c] * found.columns[c] for sign, c in (signed[c] for c in three)], -1)
        for three in (*forces, *rates)
    )
    try:
        for three, force in zip(forces, vectors, strict=False):
            check_gravity([signed[c][1] for c in three], found.names, force)
    except LegsimError as error:
        raise _in_file(path, error) from error
    return _Vectors(found.times, vectors, found.notes, found.rows)


def _signed(
    path: Path, layout: TableLayout, vectors: Sequence[tuple[Column, Column, Column]]
) -> Mapping[Column, tuple[float, Column]]:
    """Sign and column of each one that is asked for; "-ax" is the table's own where it has it.

    Raises:
        LegsimError: a column that is twice in one vector.
    """
    asked = [column for three in vectors for column in three]
    names = [c for c in (layout.time, layout.counter, *asked) if isinstance(c, str)]
    plain = [name for name in names if name[:1] != "-"]
    signed = {c: _sign(c) for c in asked}
    for name in names:
        if name in signed and signed[name][0] < 0 and _has(path, name, plain):
            signed[name] = 1.0, name
    for three in vectors:
        if len({signed[c][1] for c in three}) < len(three):
            raise file_error(
                path,
                f"{', '.join(map(str, three))} has one column twice",
                "give those of x, y and z",
            )
    return signed


def _has(path: Path, name: str, others: Sequence[str]) -> bool:
    if path.suffix.lower() == ".c3d":
        return name in load_analog(path).labels
    return is_named(path, name, others)


def _sign(column: Column) -> tuple[float, Column]:
    """1 or -1, and the column itself, of one that may be meant with the other sign, as "-ax"."""
    if isinstance(column, int):
        return (-1.0, -column) if column < 0 else (1.0, column)
    return (-1.0, column[1:]) if column[:1] == "-" and column[1:] else (1.0, column)


@dataclass(frozen=True, slots=True)
class _Found:
    """Columns as a file has them."""

    times: FloatArray
    """(n,) s"""
    columns: Mapping[Column, FloatArray]
    """(n,) each, in its own unit"""
    stated: ByColumn
    """unit that the file states"""
    hints: ByColumn
    """unit at the end of its name, where nothing is stated"""
    names: Mapping[Column, str]
    """name of each column, where it has one"""
    notes: tuple[str, ...] = ()
    """oddities of the file"""
    rows: turns.Numbered | None = None
    """lines of the rows of text, and the packets' numbers or what else is their clock"""

    def units_of(self, columns: Sequence[Column]) -> tuple[ByColumn, ByColumn]:
        """Units of some columns that the file states, and that their names hint."""
        return {c: self.stated[c] for c in columns}, {c: self.hints[c] for c in columns}


def _of_text(
    path: Path, layout: TableLayout, wanted: Sequence[Column], only: RowsOf | None
) -> _Found:
    if layout.time is None and layout.rate_hz is None:
        raise LegsimError(ONE_CLOCK)
    asked = [*(c for c in (layout.time, layout.counter) if c is not None), *wanted]
    found = read_rows(path, asked, only)
    stated = dict(zip(asked, found.units, strict=True))
    hints = dict(zip(asked, found.hints, strict=True))
    cells = list(zip(*(row for _, row in found.rows), strict=True))
    lines = [number for number, _ in found.rows]
    columns = {
        c: np.array([number_in(path, n, t, c) for n, t in zip(lines, cells[k], strict=True)])
        for k, c in enumerate(asked)
        if c != layout.time
    }
    unit: TimeUnit = "s"
    if layout.time is not None:
        unit = layout.time_unit or _time_unit(stated[layout.time], hints[layout.time], cells[0])
        columns[layout.time] = units.SECONDS[unit] * _moments(
            path, lines, cells[0], layout.time, unit
        )
    ticks, present = _ticks(columns, layout, len(lines))
    numbered = np.array(lines, float)[present], ticks
    rows = np.stack([columns[c][present] for c in wanted], -1)
    read = np.isfinite(rows).any(-1)
    if layout.time is not None and read.any():  # rows of events are no samples
        ticks, rows = ticks[read], rows[read]
    ticks, rows, again = same_times.without_repeats(ticks, rows)
    ticks, rows, twice = same_times.joined(ticks, rows)
    said = again + twice
    if layout.time is not None:
        ticks, anew = same_times.going_on(ticks, units.SECONDS[unit])
        said += anew
        same_times.check_order(ticks)
        times, more = same_times.spread(ticks)
        said += more
    else:
        rate_hz = layout.rate_hz or 1.0
        sent = ticks if layout.counter is None else packets.unwrapped(ticks, layout.counter_period)
        whose = {t for s in layout.sensors for t in (s.acceleration_rows, s.angular_velocity_rows)}
        said += packets.sparse_note(sent, rate_hz, len(whose))
        others = [name for name in found.names if name not in asked]
        said += other_clock.rate_doubts(path, others, only, rate_hz, float(sent[-1] - sent[0]))
        times = sent / rate_hz
    notes = _of_file(path, said)
    kept = {c: rows[:, k] for k, c in enumerate(wanted)}
    names = {c: _name(c, found.names) for c in wanted}
    return _Found(times, kept, stated, hints, names, notes, numbered)


def _name(column: Column, names: Sequence[str]) -> str:
    if isinstance(column, str):
        return column
    return names[column - 1] if column <= len(names) else ""


def _of_channels(path: Path, layout: TableLayout, wanted: Sequence[Column]) -> _Found:
    for name in ("time", "rate_hz", "counter", "rows_by"):
        if getattr(layout, name) is not None:
            raise LegsimError(f"the channels of a C3D file have its clock; leave {name} out")
    found = load_analog(path)
    at = {column: _channel(path, found.labels, column) for column in wanted}
    return _Found(
        found.times,
        {column: found.values[:, k] for column, k in at.items()},
        {column: units.stated(found.units[k]) for column, k in at.items()},
        dict.fromkeys(at),
        {column: found.labels[k] for column, k in at.items()},
        tuple(f"{path.name}: {note}" for note in found.notes),
    )


def _channel(path: Path, labels: Sequence[str], column: Column) -> int:
    """Index of a channel by its label, or by its number from 1 on."""
    fitting = (
        [column - 1] * (1 <= column <= len(labels))
        if isinstance(column, int)
        else [k for k, label in enumerate(labels) if label == column]
    )
    if len(fitting) == 1:
        return fitting[0]
    problem = f"has {len(fitting)} analog channels {column!r} (of {some_channels(labels)})"
    raise file_error(path, problem, "name one of them, or give its number (the first is 1)")


def some_channels(labels: Sequence[str]) -> str:
    """Few names of channels for an error, those that sound like sensors first, and a count."""
    kinds = [[k for k in labels if word in k.lower()] for word in ("gyr", "acc")]
    shown = [name for kind in kinds for name in kind[:_FEW]]
    shown += [name for name in labels if name not in shown][: max(2 * _FEW - len(shown), 0)]
    others = len(labels) - len(shown)
    return ", ".join(shown) + f" and {others} others" * (others > 0)


def in_si(rate: FloatArray, force: FloatArray, given: Units) -> tuple[FloatArray, FloatArray]:
    """Angular velocities in rad/s and specific forces in m/s^2, from stated units."""
    return units.ANGULAR_VELOCITY[given[1]] * rate, units.ACCELERATION[given[0]] * force


def recording_of(
    path: Path, name: str, times: FloatArray, rate: FloatArray, force: FloatArray
) -> ImuRecording:
    """Builds the checked recording of one sensor; samples that are NaN are left out and noted.

    Raises:
        LegsimError: times that do not increase, few samples, units that cannot be.
    """
    # rows of other sensors, or of a faster instrument, have none of its numbers
    own = np.isfinite(np.concatenate([rate, force], -1)).any(-1)
    rate, force = recording.without_lost(rate, force)
    by_rate, by_force = (np.asarray(np.isfinite(v).all(-1)) for v in (rate, force))
    seen, fewer = by_rate & by_force, min(by_rate.sum(), by_force.sum())
    apart = recording.enough(fewer) and (
        seen.sum() < 0.5 * fewer or _own_rates(times[by_rate], times[by_force])
    )
    if not apart and (not seen.any() or seen.sum() < 0.5 * own.sum()):
        raise file_error(
            path,
            f"sensor {name!r} has numbers in {int(seen.sum())} of {own.sum()} samples",
            "check its columns; where each instrument has times of its own, give time and "
            "angular_velocity_time",
        )
    try:
        if apart:  # rows of accelerations and rows of angular velocities
            return checked(joining.merged(name, (times, force), (times, rate)))
        check_steady(name, times[seen])
        made = checked(ImuRecording(name, times[seen], rate[seen], force[seen]))
        ends = losses.ends_note(name, times[by_rate], times[by_force])
        return replace(made, notes=(*losses.gap_note(name, made.times), *ends, *made.notes))
    except LegsimError as error:
        raise _in_file(path, error) from error


def _own_rates(a: FloatArray, b: FloatArray) -> bool:
    """Whether two instruments with times (n,) and (m,) s sample at different rates."""
    slower, faster = sorted((np.diff(a), np.diff(b)), key=np.median, reverse=True)
    # most steps of the slower are alike, where lost samples leave steps of all lengths
    step = float(np.median(slower))
    return step > 1.5 * float(np.median(faster)) and float((slower < 0.75 * step).mean()) < 0.1


def _time_unit(stated: str | None, hint: str | None, cells: Sequence[str]) -> TimeUnit:
    """Unit of a column of times that nobody gave."""
    if ":" in next(filter(None, cells), ""):
        return "date-time"
    for unit in units.SECONDS:
        if unit == (stated or hint):
            return unit
    if stated is not None:
        raise LegsimError(
            f"the column of times is stated to be in {stated!r}; state time_unit, or convert it"
        )
    return "s"


def _moments(
    path: Path, lines: Sequence[int], cells: Sequence[str], column: Column, unit: TimeUnit
) -> FloatArray:
    """Times (n,) in their unit; NaN where a cell is empty."""
    if unit == "date-time":
        return moments.seconds(path, lines, cells, column)
    return np.array([number_in(path, n, t, column) for n, t in zip(lines, cells, strict=True)])


def _ticks(
    table: Mapping[Column, FloatArray], layout: TableLayout, count: int
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Times (m,) in s, numbers of packets, or numbers of rows, of the rows that have one, and which
    rows (n,) these are.
    """
    column = layout.time if layout.time is not None else layout.counter
    if column is None:
        return np.arange(count, dtype=float), np.ones(count, bool)
    present = np.isfinite(table[column])
    if not present.any():
        fix = " and give rate_hz" if column == layout.time else ""
        raise LegsimError(f"column {column!r} is empty; name another, or leave it out{fix}")
    return table[column][present], present


def _in_file(path: Path, error: LegsimError) -> LegsimError:
    """The same error with the file's name, unless it has it."""
    problem, _, fix = str(error).partition("; ")
    return error if str(path) in problem else file_error(path, problem, fix or "correct it there")
