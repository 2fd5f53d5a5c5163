"""The run folder: a manifest vouches for what is done.

A stage has a key, a hash of all that decides its output. Where the manifest holds the same key and the files still have the
recorded sha256, the stage is skipped.
"""

import csv
import hashlib
import io
import json
import os
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from legsim import memory
from legsim.arrays import FloatArray
from legsim.errors import LegsimError, at
from legsim.geometry import VolumeGrid
from legsim.motion_paths import Motion
from legsim.motions import ControlPointMotion, FieldMotion
from legsim.signals import ImuSignals, RigidMotion, SegmentPoses
from legsim.stage_store import StageStore
from legsim.whole_files import PREFIX, whole, write_text

SCHEMA = 2
_ABANDONED_S = 3600.0
"""after which a partial file that nobody writes to is taken for left behind"""


def sha256(path: Path) -> str:
    """Hex digest of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def key_of(*parts: Any) -> str:
    """A hash of JSON-able parts: the key of a stage."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _remove_leftovers(folder: Path) -> None:
    """Deletes what killed processes left half written; what was written to within the hour may be another process's that lives."""
    for leftover in folder.glob(f"{PREFIX}*"):
        with suppress(FileNotFoundError):
            if time.time() - leftover.stat().st_ctime > _ABANDONED_S:
                leftover.unlink()


class RunFolder:
    """A folder of results with its manifest."""

    def __init__(self, path: Path, about: dict[str, Any], store: StageStore | None = None) -> None:
        """Opens or makes the folder; ``about`` (version, device, config hash ...) heads the manifest.

        What ``store`` holds of finished stages is taken from there, and what is finished here is left there for other folders.

        Raises:
            LegsimError: the folder cannot be made or written to.
        """
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            trial = path / f"{PREFIX}{os.getpid()}-test"
            trial.write_bytes(b"")
            trial.unlink()
        except OSError as error:
            raise at(path, f"cannot be written to ({error.strerror})", "choose another folder with --out") from error
        _remove_leftovers(path)
        self._stages: dict[str, Any] = self._read().get("stages", {})
        self._store = store
        self.about = about
        """What heads the manifest."""

    def _read(self) -> dict[str, Any]:
        manifest = self.path / "manifest.json"
        if not manifest.exists():
            return {}
        try:
            content = json.loads(manifest.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise at(manifest, f"is not a manifest ({error})", "delete the file, or choose another folder with --out") from error
        return content if isinstance(content, dict) and content.get("schema") == SCHEMA else {}

    def done(self, stage: str, key: str) -> bool:
        """Whether the manifest vouches for the stage (same key, all its files there and unchanged), or the store has it."""
        entry = self._stages.get(stage)
        if entry is not None and entry["key"] == key and self._unchanged(entry):
            return True
        found = None if self._store is None else self._store.fetch(stage, key, self.path)
        if self._store is None or found is None:
            return False
        if not self._unchanged(found):
            self._store.drop(stage, key)
            return False
        self._stages[stage] = found
        self.write_manifest()
        return True

    def _unchanged(self, entry: dict[str, Any]) -> bool:
        return all((self.path / name).is_file() and sha256(self.path / name) == f["sha256"] for name, f in entry["files"].items())

    @contextmanager
    def stage(self, stage: str, key: str, files: Sequence[str]) -> Iterator[None]:
        """Runs a stage that writes ``files`` and then enters them in the manifest with their time, memory and hash."""
        start = time.perf_counter()
        memory.begin_peak()
        yield
        seconds, peak = round(time.perf_counter() - start, 3), memory.peak_mebibytes()
        entries = {name: {"sha256": sha256(self.path / name), "bytes": (self.path / name).stat().st_size} for name in files}
        self._stages[stage] = {"key": key, "seconds": seconds, "peak_mib": peak and round(peak), "files": entries}
        self.write_manifest()
        if self._store is not None:
            self._store.keep(stage, key, self._stages[stage], self.path)

    def seconds(self, stage: str) -> float:
        """How long the stage took when it was computed."""
        return float(self._stages[stage]["seconds"])

    def has(self, file: str) -> bool:
        """Whether some finished stage wrote the file."""
        return any(file in entry["files"] for entry in self._stages.values())

    def hash_of(self, file: str) -> str:
        """The recorded sha256 of a file that some stage wrote."""
        return next(entry["files"][file]["sha256"] for entry in self._stages.values() if file in entry["files"])

    def write_manifest(self) -> None:
        """Writes manifest.json as things stand."""
        content = {"schema": SCHEMA, **self.about, "stages": self._stages}
        write_text(self.path / "manifest.json", json.dumps(content, indent=1) + "\n")


@dataclass(frozen=True, slots=True)
class FinishedStage:
    """What a manifest tells of a stage."""

    stage: str
    key: str
    seconds: float
    peak_mib: float | None


def finished_stages(folder: Path) -> tuple[FinishedStage, ...]:
    """Every stage that the folder's manifest vouches for; none where there is no manifest."""
    path = folder / "manifest.json"
    entries = json.loads(path.read_text("utf-8"))["stages"] if path.is_file() else {}
    return tuple(FinishedStage(stage, e["key"], e["seconds"], e["peak_mib"]) for stage, e in entries.items())


def _csv_text(header: Sequence[str], rows: FloatArray) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([repr(float(v)) for v in row] for row in rows)
    return stream.getvalue()


def save_joint_centers(path: Path, times: FloatArray, names: Sequence[str], positions: FloatArray) -> None:
    """``time_s, hip_l_x_m, …`` in world; positions (n, j, 3)."""
    header = ["time_s", *(f"{name}_{axis}_m" for name in names for axis in "xyz")]
    write_text(path, _csv_text(header, np.column_stack([times, positions.reshape(len(times), -1)])))


_IMU_COLUMNS = ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s")


def save_imu(path: Path, signals: ImuSignals) -> None:
    """``time_s, <sensor>_ax_m_s2 … <sensor>_gz_rad_s``: specific force and angular velocity in the sensor frame."""
    header = ["time_s", *(f"{name}_{column}" for name in signals.sensor_names for column in _IMU_COLUMNS)]
    values = np.concatenate([signals.specific_force, signals.angular_velocity], -1).reshape(len(signals.times), -1)
    write_text(path, _csv_text(header, np.column_stack([signals.times, values])))


def load_imu(path: Path) -> ImuSignals:
    """The inverse of :func:`save_imu`."""
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = list(csv.reader(stream))
    suffix = f"_{_IMU_COLUMNS[0]}"
    names = tuple(column.removesuffix(suffix) for column in header[1::6])
    if header != ["time_s", *(f"{name}_{column}" for name in names for column in _IMU_COLUMNS)] or not rows:
        raise at(
            path,
            "is not an IMU table",
            f"expected the columns time_s, <sensor>_{_IMU_COLUMNS[0]} … <sensor>_{_IMU_COLUMNS[-1]}",
            place="line 1",
        )
    values = np.array(rows, float)
    signals = values[:, 1:].reshape(len(values), len(names), 2, 3)
    return ImuSignals(values[:, 0], names, signals[:, :, 1], signals[:, :, 0])


def save_poses(path: Path, poses: SegmentPoses) -> None:
    """poses.npz: times, segment_names, world_from_segment."""
    _save_npz(path, times=poses.times, segment_names=np.array(poses.segment_names), world_from_segment=poses.world_from_segment)


def load_poses(path: Path) -> SegmentPoses:
    """The inverse of :func:`save_poses`."""
    with np.load(path, allow_pickle=False) as data:
        return SegmentPoses(data["times"], tuple(data["segment_names"].tolist()), data["world_from_segment"])


def save_motion(path: Path, motion: Motion) -> None:
    """motion-<method>.npz: times and moved_from_reference; or reference and moved points; or displacements with their grid."""
    if isinstance(motion, RigidMotion):
        _save_npz(path, times=motion.times, moved_from_reference=motion.moved_from_reference)
    elif isinstance(motion, ControlPointMotion):
        _save_npz(path, times=motion.times, reference=motion.reference, moved=motion.moved)
    else:
        grid = motion.grid
        placed = {"grid_spacing_xyz": np.array(grid.spacing_xyz), "grid_center": np.array(grid.center)}
        _save_npz(path, times=motion.times, displacements=motion.displacements, **placed)


def load_motion(path: Path) -> Motion:
    """The inverse of :func:`save_motion`: what the file holds says which kind of motion it is.

    Raises:
        LegsimError: not such a file.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            return _motion(data)
    except FileNotFoundError:
        raise at(path, "no such file", "give a motion-<method>.npz") from None
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise at(path, f"is not a motion file ({error})", "expected an .npz with times (v,) and moved_from_reference (v, 4, 4)") from None
    except LegsimError as error:
        raise at(path, str(error), "mend the file") from None


def _motion(data: Mapping[str, np.ndarray]) -> Motion:
    if "moved" in data:
        return ControlPointMotion(data["times"], data["reference"], data["moved"])
    if "displacements" in data:
        nodes, spacing, center = data["displacements"], data["grid_spacing_xyz"].tolist(), data["grid_center"].tolist()
        return FieldMotion(data["times"], VolumeGrid(nodes.shape[1:4], tuple(spacing), tuple(center)), nodes)
    return RigidMotion(data["times"], data["moved_from_reference"])


def _save_npz(path: Path, **arrays: np.ndarray) -> None:
    with whole(path) as partial, partial.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
