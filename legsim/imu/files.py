"""Files of sensors: legsim's own imu.csv, text exports of Xsens, and OpenSim's storage."""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.imu import table_rows, tables
from legsim.imu.recording import ImuRecording
from legsim.imu.signals import ImuSignals
from legsim.imu.table_layout import SensorColumns, TableLayout
from legsim.imu.units import AccelerationUnit, AngularVelocityUnit
from legsim.mocap import files as mocap_files
from legsim.mocap.c3d_analog import load_analog
from legsim.mocap.cells import number

_IMU_COLUMNS = ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s")

_TITLE = 40
"""characters of a line that announces a block, at most"""

_XSENS_FORCE = ("Acc_X", "Acc_Y", "Acc_Z")
_XSENS_RATE_OF_TURN = ("Gyr_X", "Gyr_Y", "Gyr_Z")
_XSENS_COUNTERS = ("PacketCounter", "Counter")
"""names of the packets' numbers, of MT Manager 4 and of 2"""

_XSENS_CLOCK = re.compile(r"\b(PacketCounter|Counter|SampleTimeFine)\b")

_XSENS_ALONE = re.compile(
    r"\b(PacketCounter|SampleTimeFine)\b|"
    r"\bCounter\b.*\b(Gyr_X|Mag_X|FreeAcc_X|Euler_X|Quat_\w|Mat\[1\])"
)
"""in its names where no acceleration is; others count too"""

_XSENS_RATE = re.compile(
    r"(?im)(?:^|//)[^\w\n]*(?:update|output|sampl(?:e|ing)|acquisition) ?(?:rate|frequency)"
    r"[^\w\n]*(\d+(?:[.,]\d+)?)(?:[ \t]*hz\b|[^\w\n]*$)"
)
"""the rate in a line of a header"""

_FORCES = re.compile(r"(?i)(?<!free)acc|\ba[xyz]\b")
"""in names of columns, however an export spells them"""

_RATES = re.compile(r"(?i)gyr|\b[gw][xyz]\b")

_RECORDING = {
    "TRC": r"\A",
    "Motive's CSV": r"\A",
    "Qualisys' TSV": r"\A",
    "Nexus' CSV": r"\A\W*trajectories",
    "CSV": r"\A\W*time_s(,[^,\n]*_(m|rad))+\W*$",
}
"""formats that may hold markers or joint angles, and what of a text says that it does: Nexus writes
sensors too, and many a table begins with time_s
"""

_XSENS_PERIOD = 1 << 16

_STO_FORCE = ("linear_acceleration", "linearaccelerations", "accelerometer_signal", "accel")
_STO_RATE = ("angular_velocity", "angularvelocity", "gyroscope_signal", "gyro")


def save_imu(path: Path, signals: ImuSignals) -> None:
    """Writes ``time_s, <sensor>_ax_m_s2 … <sensor>_gz_rad_s``.

    These are specific force and angular velocity in the sensor frame. Numbers have their shortest
    exact text.
    """
    header = [
        "time_s",
        *(f"{name}_{column}" for name in signals.sensor_names for column in _IMU_COLUMNS),
    ]
    values = np.concatenate([signals.specific_force, signals.angular_velocity], -1).reshape(
        len(signals.times), -1
    )
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(
        [repr(v) for v in row] for row in np.column_stack([signals.times, values]).tolist()
    )
    files.write_text(path, stream.getvalue())


def _numbers(path: Path, line: int, row: list[str], count: int) -> list[float]:
    try:
        numbers = [_number(cell) for cell in row]
    except ValueError as error:
        raise file_error(path, str(error), "repair the line", place=f"line {line}") from error
    if len(numbers) != count:
        problem = f"holds {len(numbers)} numbers instead of {count}"
        raise file_error(path, problem, "repair the line", place=f"line {line}")
    return numbers


def _number(text: str) -> float:
    """The number in a cell, NaN in any spelling.

    Raises:
        ValueError: other text, or a number beyond any signal.
    """
    value = number(text)
    if value is None:
        raise ValueError(f"{text[:40]!r} is no number of a signal")
    return value


def load_imu(path: Path) -> ImuSignals:
    """Reads the file that :func:`save_imu` writes, to the last bit."""
    try:
        header, *table = csv.reader(files.read(path, "IMU"), strict=True)
    except csv.Error as error:
        raise file_error(path, f"is not an IMU table ({error})", "make it again") from error
    rows = [_numbers(path, k, row, len(header)) for k, row in enumerate(table, 2) if row]
    names = _own_names(header)
    if names is None or not rows:
        raise file_error(
            path,
            "is not an IMU table",
            f"expected the columns time_s, <sensor>_{_IMU_COLUMNS[0]} … "
            f"<sensor>_{_IMU_COLUMNS[-1]}",
            place="line 1",
        )
    values = np.array(rows, float)
    signals = values[:, 1:].reshape(len(values), len(names), 2, 3)
    return ImuSignals(values[:, 0], names, signals[:, :, 1], signals[:, :, 0])


def save_rest(path: Path, signals: ImuSignals) -> None:
    """Writes ``sensor, ax_m_s2, ay_m_s2, az_m_s2``: the mean specific force of the rest."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["sensor", *_IMU_COLUMNS[:3]])
    rest = np.empty((0, 3)) if signals.rest_force is None else signals.rest_force
    for name, force in zip(signals.sensor_names, rest, strict=True):
        writer.writerow([name, *(repr(float(v)) for v in force)])
    files.write_text(path, stream.getvalue())


def load_rest(path: Path, names: Sequence[str]) -> FloatArray:
    """Reads the (k, 3) m/s^2 that :func:`save_rest` writes, in the order of ``names``."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = {row[0]: row[1:] for row in list(csv.reader(stream))[1:]}
    if not set(names) <= rows.keys():
        raise file_error(path, "lacks a sensor", "run again; the file is written by the run")
    return np.array([rows[name] for name in names], float)


def _own_names(header: list[str]) -> tuple[str, ...] | None:
    """Sensors of the header of an imu.csv; None for another header."""
    suffix = f"_{_IMU_COLUMNS[0]}"
    names = tuple(column.removesuffix(suffix) for column in header[1::6])
    expected = ["time_s", *(f"{name}_{column}" for name in names for column in _IMU_COLUMNS)]
    return names if names and header == expected else None


def load_recordings(
    path: Path | str,
    *,
    rate_hz: float | None = None,
    acceleration_unit: AccelerationUnit | None = None,
    angular_velocity_unit: AngularVelocityUnit | None = None,
) -> tuple[ImuRecording, ...]:
    """Reads the sensors of a file that says itself what its columns are.

    These are legsim's imu.csv, text exports of Xsens (PacketCounter, Acc_X …, Gyr_X …; m/s^2 and
    rad/s of MT Manager, deg/s of a DOT) and OpenSim's .sto of vectors. Other tables need a layout
    (:func:`legsim.imu.tables.load`).

    Args:
        path: the file. An Xsens file's sensor is named after the file.
        rate_hz: for an Xsens file without a line "Update Rate".
        acceleration_unit: of an Xsens file or a .sto that was written in another one.
        angular_velocity_unit: the same.

    Raises:
        LegsimError: another kind of file; what :func:`legsim.imu.tables.load` raises.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".sto":
        return _load_sto(path, (acceleration_unit or "m/s2", angular_velocity_unit or "rad/s"))
    if ending == ".c3d":
        raise _names_wanted(path)
    lines = table_rows.table_lines(path)
    names = _own_names(table_rows.cells_of(lines[0], ","))
    if names is not None:
        return tables.load(path, _own_layout(names))
    columns = _xsens_columns(lines)
    if columns and (_XSENS_CLOCK.search(" ".join(columns)) or _XSENS_RATE.search(_head(lines))):
        layout = _xsens_layout(path, lines, rate_hz, acceleration_unit, angular_velocity_unit)
        return tables.load(path, layout)
    raise _unknown(path, lines)


def _names_wanted(path: Path) -> LegsimError:
    """The refusal of a C3D file by itself: only its user knows which channels are sensors."""
    labels = load_analog(path).labels
    return file_error(
        path,
        f"has {len(labels)} analog channels: {tables.some_channels(labels)}",
        "name those of each sensor in a small TOML and give that (docs/formats.md, Sensors)",
    )


def _own_layout(names: Sequence[str]) -> TableLayout:
    """Columns of an imu.csv."""
    columns = [[f"{name}_{column}" for column in _IMU_COLUMNS] for name in names]
    sensors = tuple(
        SensorColumns(name, (ax, ay, az), (gx, gy, gz))
        for name, (ax, ay, az, gx, gy, gz) in zip(names, columns, strict=True)
    )
    return TableLayout(sensors, time="time_s")


def _xsens_columns(lines: Sequence[str]) -> dict[str, str]:
    """Columns of an export of Xsens by their names without unit; none where there is no Acc_X."""
    for line in lines[:50]:
        for delimiter in ",;\t ":
            cells = table_rows.cells_of(line, delimiter)
            columns = {re.sub(r"\s*[(\[].*", "", cell): cell for cell in cells}
            if "Acc_X" in columns:
                return columns
    return {}


def _xsens_layout(
    path: Path,
    lines: Sequence[str],
    rate_hz: float | None,
    acceleration_unit: AccelerationUnit | None,
    angular_velocity_unit: AngularVelocityUnit | None,
) -> TableLayout:
    """Columns, units and clock of an export of Xsens; what is given goes before its header."""
    columns = _xsens_columns(lines)
    lacking = [name for name in (*_XSENS_FORCE, *_XSENS_RATE_OF_TURN) if name not in columns]
    if lacking:
        raise file_error(
            path,
            f"is an export of Xsens without {', '.join(lacking)}",
            "export it again with accelerations and the rate of turn, or calibrated inertial data",
        )
    counter = next((columns[name] for name in _XSENS_COUNTERS if name in columns), None)
    if counter is None:
        raise file_error(
            path,
            "is an export of Xsens without the packets' numbers (PacketCounter)",
            "export it again with them, or give rate_hz and the columns in a small TOML "
            "(docs/formats.md, Sensors)",
        )
    dot = _is_dot(lines)
    ax, ay, az = (columns[name] for name in _XSENS_FORCE)
    gx, gy, gz = (columns[name] for name in _XSENS_RATE_OF_TURN)
    return TableLayout(
        (SensorColumns(path.stem, (ax, ay, az), (gx, gy, gz)),),
        acceleration_unit,
        angular_velocity_unit or ("deg/s" if dot else None),
        rate_hz=_xsens_rate(path, lines) if rate_hz is None else rate_hz,
        counter=counter,
        counter_period=1 << 32 if dot else _XSENS_PERIOD,
    )


def _unknown(path: Path, lines: Sequence[str]) -> LegsimError:
    """The refusal of a table that does not say itself what it holds."""
    begun = "\n".join(lines[:20])
    forms = (form.name for form in mocap_files.FORMATS if form.begins(begun.encode()))
    motion = next(forms, "")
    if motion in _RECORDING and re.search(f"(?im){_RECORDING[motion]}", begun):
        return file_error(
            path,
            f"holds no signals of sensors, but a recording ({motion})",
            "give it as the motion, and the sensors' own file here",
        )
    named = next((line for line in lines[:50] if _XSENS_ALONE.search(line)), None)
    if named is not None and not _FORCES.search(named):
        turned = "" if _RATES.search(named) else " and angular velocities (Gyr_X, …)"
        return file_error(
            path,
            f"is an export of Xsens without accelerations (Acc_X, …){turned}",
            "export it again with calibrated inertial data, of a DOT in such a payload mode: "
            "orientations and free accelerations lack gravity",
        )
    cure = "describe its columns in a small TOML and give that (docs/formats.md, Sensors)"
    if _has_blocks(lines):
        cure = (
            "its instruments are in blocks, one below the other: split the file, and give both "
            "parts in a small TOML (file, angular_velocity_file; docs/formats.md, Sensors)"
        )
    problem = "is no imu.csv of legsim, no text export of Xsens and no .sto"
    return file_error(path, problem, cure, place="line 1")


def _has_blocks(lines: Sequence[str]) -> bool:
    """Whether lines of text announce accelerations and, apart from these, angular velocities."""
    titles = [line.strip().lower() for line in lines if not any(c.isdigit() for c in line)]
    short = [title for title in titles if len(title) < _TITLE]
    force = any(title.startswith("accel") for title in short)
    return force and any(title.startswith(("gyro", "angular", "rotation")) for title in short)


def _head(lines: Sequence[str]) -> str:
    """Lines among which the header of an export lies."""
    return "\n".join(lines[:50])


def _is_dot(lines: Sequence[str]) -> bool:
    """Whether an Xsens table is of a DOT, as DeviceTag or OutputRate in its header say.

    Its angular velocities are in deg/s, not in rad/s, and its counter has 32 bits (Xsens DOT user
    manual XD0502P, revision E, sections 4.2.2 and 4.2.5).
    """
    return re.search(r"(?im)^\W*(device ?tag|output ?rate)\b", _head(lines)) is not None


def _xsens_rate(path: Path, lines: Sequence[str]) -> float:
    """Samples per second, as the header says."""
    said = _XSENS_RATE.search(_head(lines))
    if said is None:
        raise file_error(
            path,
            'has no line "Update Rate"',
            "give rate_hz (and of a DOT angular_velocity_unit, deg/s) in a TOML that names this "
            "file, or export it with its header",
        )
    return float(said[1].replace(",", "."))


def _load_sto(path: Path, units: tables.Units) -> tuple[ImuRecording, ...]:
    """Reads OpenSim's tables of vectors: one file of both kinds, or one beside the other."""
    columns = _sto_columns(path)
    if not {"force", "rate"} <= {kind for _, kind in columns}:
        partner = _sto_partner(path)
        columns |= _sto_columns(partner)
    names = [name for name, kind in columns if kind == "force" and (name, "rate") in columns]
    if not names:
        raise file_error(
            path,
            "has no sensor with acceleration and angular velocity",
            "name columns <sensor>|linear_acceleration and <sensor>|angular_velocity, or files "
            "_linearAccelerations.sto and _angularVelocity.sto",
        )
    made = []
    for name in names:
        (times, force), (other, rate) = columns[name, "force"], columns[name, "rate"]
        if not np.array_equal(times, other):
            raise file_error(
                path, f"sensor {name!r} has other times in its two files", "export both together"
            )
        made.append(tables.recording_of(path, name, times, *tables.in_si(rate, force, units)))
    return tuple(made)


def _sto_partner(path: Path) -> Path:
    """File of the other quantity, as OpenSim's readers of sensors name them."""
    pairs = (("linearaccelerations", "angularVelocity"), ("angularvelocity", "linearAccelerations"))
    for ending, other in pairs:
        stem = path.stem
        if stem.lower().endswith(ending):
            partner = path.with_name(f"{stem[: -len(ending)]}{other}{path.suffix}")
            if partner.is_file():
                return partner
            raise file_error(
                path, f"holds one of two quantities, and {partner.name} is not beside it",
                "put the other file there",
            )  # fmt: skip
    raise file_error(
        path,
        "does not say whether its vectors are accelerations or angular velocities",
        "name it …_linearAccelerations.sto or …_angularVelocity.sto as OpenSim does",
    )


def _sto_columns(path: Path) -> dict[tuple[str, str], tuple[FloatArray, FloatArray]]:
    """(times (n,), vectors (n, 3)) by sensor and kind, "force" or "rate"."""
    lines = files.read(path, "storage")
    end = next((k for k, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    head = "\n".join(lines[:end])
    if end is None or not re.search(r"(?i)datatype\s*=\s*vec3", head):
        kind = re.search(r"(?i)datatype\s*=\s*(\w+)", head)
        raise file_error(
            path,
            f"holds DataType={kind[1]}" if kind else "has no DataType=Vec3 above endheader",
            "give accelerations and angular velocities, as vectors of three numbers",
            place="header",
        )
    rows = [line.split("\t") for line in lines[end + 1 :] if line.strip()]
    if len(rows) < 2:
        raise file_error(path, "holds no row of vectors", "export it again")
    times, cells = [], []
    for line, row in enumerate(rows[1:], end + 3):
        try:
            times.append(_number(row[0]))
            cells.append([[_number(x) for x in cell.split(",")] for cell in row[1:]])
            if len(row) != len(rows[0]) or any(len(vector) != 3 for vector in cells[-1]):
                raise ValueError(f"{len(row)} cells")
        except ValueError as error:
            raise file_error(
                path, f"is no row of vectors ({error})", "correct it", place=f"line {line}"
            ) from None
    values = np.array(cells).reshape(len(times), -1, 3)
    labels = [_sto_label(label, path.stem) for label in rows[0][1:]]
    names = _sto_names(path, labels)
    return {
        (name, kind): (np.array(times), values[:, k])
        for k, (name, (_, kind)) in enumerate(zip(names, labels, strict=True))
        if kind
    }


def _sto_names(path: Path, labels: Sequence[tuple[str, str]]) -> list[str]:
    """Sensors of columns by the last part of their paths, or by their bodies' where several have
    that part.

    Raises:
        LegsimError: two columns of one quantity have one name.
    """
    last = [(where.rsplit("/", 1)[-1].removesuffix("_imu"), kind) for where, kind in labels]
    names = [
        where.split("/")[-2] if last.count(own) > 1 and "/" in where else own[0]
        for (where, _), own in zip(labels, last, strict=True)
    ]
    of_kind = [(name, kind) for name, (_, kind) in zip(names, labels, strict=True) if kind]
    twice = [name for name, kind in of_kind if of_kind.count((name, kind)) > 1]
    if twice:
        raise file_error(
            path,
            f"has two sensors called {twice[0]!r}",
            "rename one of their columns, or leave it out",
            place="column names",
        )
    return names


def _sto_label(label: str, stem: str) -> tuple[str, str]:
    """(path of the sensor, "force" or "rate") of a column, by its own ending or the file's; "" for
    others.
    """
    name, separator, quantity = label.strip().rpartition("|")
    if not separator:
        name, quantity = label.strip(), stem
    quantity = quantity.lower()
    kind = "force" if quantity.endswith(_STO_FORCE) else "rate" * quantity.endswith(_STO_RATE)
    return name, kind
