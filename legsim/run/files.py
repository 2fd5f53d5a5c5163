"""Joint centers, marker errors and segment poses as files of a run folder."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core.files import save_npz, write_text
from legsim.core.values import FloatArray
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


def save_poses(path: Path, poses: SegmentPoses) -> None:
    """Writes poses.npz: times, segment_names, world_from_segment."""
    save_npz(
        path,
        times=poses.times,
        segment_names=np.array(poses.segment_names),
        world_from_segment=poses.world_from_segment,
    )
