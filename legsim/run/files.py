"""Joint centers, IMU signals and segment poses as files of a run folder."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.files import save_npz, write_text
from legsim.core.values import FloatArray
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import MarkerTrajectories


def _csv_text(header: Sequence[str], rows: FloatArray) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([repr(float(v)) for v in row] for row in rows)
    return stream.getvalue()


def save_joint_centers(
    path: Path, times: FloatArray, names: Sequence[str], positions: FloatArray
) -> None:
    """Writes ``time_s, hip_l_x_m, …`` in world; positions (n, j, 3)."""
    header = ["time_s", *(f"{name}_{axis}_m" for name in names for axis in "xyz")]
    write_text(path, _csv_text(header, np.column_stack([times, positions.reshape(len(times), -1)])))


def save_marker_errors(
    path: Path, measured: MarkerTrajectories, modelled: MarkerTrajectories
) -> None:
    """Writes OpenSim's storage of inverse kinematics' errors, frame by frame.

    Columns are total squared error (m^2), RMS and largest (m) over the markers seen, then each
    marker's distance; NaN where it is not seen.
    """
    away = np.linalg.norm(measured.positions_world - modelled.positions_world, axis=-1)
    seen = np.isfinite(away)
    square = np.where(seen, away, 0.0) ** 2
    total, count = square.sum(1), seen.sum(1)
    rms = np.sqrt(total / np.where(count > 0, count, np.nan))
    largest = np.where(count > 0, np.where(seen, away, -1.0).max(1), np.nan)
    columns = ("total_squared_error", "marker_error_RMS", "marker_error_max")
    names = ("time", *columns, *measured.marker_names)
    rows = np.column_stack([measured.times, total, rms, largest, away]).tolist()
    lines = [
        "Model Marker Errors from IK",
        "version=1",
        f"nRows={len(rows)}",
        f"nColumns={len(names)}",
        "inDegrees=no",
        "endheader",
        "\t".join(names),
        *("\t".join("NaN" if v != v else repr(v) for v in row) for row in rows),
    ]
    write_text(path, "\n".join(lines) + "\n")


_IMU_COLUMNS = ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s")


def save_imu(path: Path, signals: ImuSignals) -> None:
    """Writes ``time_s, <sensor>_ax_m_s2 … <sensor>_gz_rad_s``.

    These are specific force and angular velocity in the sensor frame.
    """
    header = [
        "time_s",
        *(f"{name}_{column}" for name in signals.sensor_names for column in _IMU_COLUMNS),
    ]
    values = np.concatenate([signals.specific_force, signals.angular_velocity], -1).reshape(
        len(signals.times), -1
    )
    write_text(path, _csv_text(header, np.column_stack([signals.times, values])))


def load_imu(path: Path) -> ImuSignals:
    """Reads the file that :func:`save_imu` writes.

    Raises:
        LegsimError: other columns, or a line that is not as long or holds no number; the line names
            it.
    """
    try:
        header, *rows = csv.reader(files.read(path, "IMU"), strict=True)
    except csv.Error as error:
        raise file_error(path, f"is not an IMU table ({error})", "make it again") from error
    rows = [(line, row) for line, row in enumerate(rows, start=2) if row]
    suffix = f"_{_IMU_COLUMNS[0]}"
    names = tuple(column.removesuffix(suffix) for column in header[1::6])
    if (
        header != ["time_s", *(f"{name}_{column}" for name in names for column in _IMU_COLUMNS)]
        or not rows
    ):
        raise file_error(
            path,
            "is not an IMU table",
            f"expected the columns time_s, <sensor>_{_IMU_COLUMNS[0]} … "
            f"<sensor>_{_IMU_COLUMNS[-1]}",
            place="line 1",
        )
    values = np.array([_numbers(path, line, row, len(header)) for line, row in rows])
    signals = values[:, 1:].reshape(len(values), len(names), 2, 3)
    return ImuSignals(values[:, 0], names, signals[:, :, 1], signals[:, :, 0])


def _numbers(path: Path, line: int, row: list[str], count: int) -> list[float]:
    try:
        numbers = [float(cell) for cell in row]
    except ValueError as error:
        raise file_error(path, str(error), "repair the line", place=f"line {line}") from error
    if len(numbers) != count:
        problem = f"holds {len(numbers)} numbers instead of {count}"
        raise file_error(path, problem, "repair the line", place=f"line {line}")
    return numbers


def save_rest(path: Path, signals: ImuSignals) -> None:
    """Writes ``sensor, ax_m_s2, ay_m_s2, az_m_s2``: the mean specific force of the rest."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["sensor", *_IMU_COLUMNS[:3]])
    rest = np.empty((0, 3)) if signals.rest_force is None else signals.rest_force
    for name, force in zip(signals.sensor_names, rest, strict=True):
        writer.writerow([name, *(repr(float(v)) for v in force)])
    write_text(path, stream.getvalue())


def load_rest(path: Path, names: Sequence[str]) -> FloatArray:
    """Reads the (k, 3) m/s^2 that :func:`save_rest` writes, in the order of ``names``."""
    with path.open(encoding="utf-8", newline="") as stream:
        rows = {row[0]: row[1:] for row in list(csv.reader(stream))[1:]}
    if not set(names) <= rows.keys():
        raise file_error(path, "lacks a sensor", "run again; the file is written by the run")
    return np.array([rows[name] for name in names], float)


def save_poses(path: Path, poses: SegmentPoses) -> None:
    """Writes poses.npz: times, segment_names, world_from_segment."""
    save_npz(
        path,
        times=poses.times,
        segment_names=np.array(poses.segment_names),
        world_from_segment=poses.world_from_segment,
    )
