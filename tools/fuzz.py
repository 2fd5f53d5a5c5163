"""Damaged files for every reader: each must be read, or refused by a LegsimError, and nothing else.

Valid files are damaged at random, seeded: bytes, lines and cells are changed, dropped, doubled and
swapped, and replaced by numbers and words that break readers. What a reader raises instead of a
LegsimError, and what takes longer than ten seconds, is counted by place, with the first input that
shows it.

    python -m tools.fuzz trc --inputs 1e5
    python -m tools.fuzz all --inputs 1e4
"""

import contextlib
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import legsim as ls
from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.deformation import files as motion_files
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.imu import files as imu_files
from legsim.imu.signals import ImuSignals
from legsim.kinematics import from_recording, osim_file, osim_scaling
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets
from legsim.run.folder import RunFolder
from legsim.scan import spectrum

LIMIT_S = 10

MEMORY_BYTES = 8 << 30

WORDS = (
    *(b"nan", b"NaN", b"inf", b"-inf", b"1e309", b"-1", b"0", b"1e-320", b"99999999999999999999"),
    *(b"", b" ", b"\t", b",", b"\n", b"\r\n", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", "é∞".encode()),
    *(b'"', b"'", b"[", b"{", b"<", b">", b"&x;", b"%s", b"--", b"1.2.3", b"0x10", b"1,5", b"True"),
)


@dataclass(frozen=True)
class Reader:
    """What reads a file, and how a valid one is made."""

    suffix: str
    make: Callable[[Path], object]
    load: Callable[[Path], object]


def _markers() -> ls.MarkerTrajectories:
    whole = mocap_files.load_markers(from_recording.find_recording("subject01/squat_30.trc"))
    return ls.MarkerTrajectories(
        whole.times[:8], whole.marker_names[:7], whole.positions_world[:8, :7]
    )


def _coordinates() -> ls.JointTrajectories:
    from legsim.kinematics.leg_model import COORDINATES

    values = np.random.default_rng(1).normal(size=(8, len(COORDINATES))) / 10
    return ls.JointTrajectories(np.arange(8) / 60, COORDINATES, values)


def _geometry() -> ls.ConeBeamGeometry:
    return ls.ConeBeamGeometry.circular(
        times=np.arange(5) / 31,
        angles=np.arange(5) / 3,
        source_isocenter=0.785,
        source_detector=1.198,
        shape_vu=(6, 7),
        pixel_pitch=0.01,
    )


def _volume() -> ls.Volume:
    grid = ls.VolumeGrid.cubic(5, 0.01, [0.0, 0.0, 0.0])
    return ls.Volume(grid, np.random.default_rng(1).normal(size=grid.shape_zyx).astype(np.float32))


def _signals() -> ImuSignals:
    drawn = np.random.default_rng(1).normal(size=(2, 9, 2, 3))
    return ImuSignals(np.arange(9) / 120, ("a", "b"), *drawn)


def _motion(path: Path) -> None:
    matrices = np.tile(np.eye(4), (4, 1, 1))
    motion_files.save_motion(path, ls.RigidMotion(np.arange(4) / 31, matrices))


def _copy(source: Path) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(source.read_bytes())


def _manifest(path: Path) -> None:
    with RunFolder(path.parent / "run", {}) as folder:

        def write() -> tuple[str]:
            (folder.path / "a.txt").write_text("a")
            return ("a.txt",)

        folder.cached("one", "k", write)
    path.write_bytes((path.parent / "run/manifest.json").read_bytes())


def _open_manifest(path: Path) -> None:
    (path.parent / "run/manifest.json").write_bytes(path.read_bytes())
    with RunFolder(path.parent / "run", {}) as folder:
        folder.done("one", "k")


def _phantom(path: Path) -> None:
    mesh = path.parent / "part.stl"
    if not mesh.exists():
        import trimesh

        trimesh.creation.icosphere(1, 0.05).export(mesh, file_type="stl_ascii")
    path.write_text('[[part]]\nname = "a"\nfile = "part.stl"\nunit = "m"\nmaterial = "water"\n')


def _mesh(path: Path) -> None:
    _phantom(path.parent / "p.toml")
    path.write_bytes((path.parent / "part.stl").read_bytes())


def _load_mesh(path: Path) -> object:
    (path.parent / "part.stl").write_bytes(path.read_bytes())
    return ls.load_phantom(path.parent / "p.toml")


def _spectrum(path: Path) -> None:
    path.write_text("energy_kev,weight\n" + "".join(f"{k},{k / 9}\n" for k in range(20, 60, 5)))


def _c3d(path: Path) -> None:
    import ezc3d

    written = ezc3d.c3d()
    markers = _markers()
    points = np.ones((4, len(markers.marker_names), len(markers.times)))
    points[:3] = 1e3 * markers.positions_world.transpose(2, 1, 0)
    written["parameters"]["POINT"]["RATE"]["value"] = [120]
    written["parameters"]["POINT"]["LABELS"]["value"] = list(markers.marker_names)
    written["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    written["data"]["points"] = points
    written.write(str(path))


MODELS = resources.model_file("lower_body").parent

READERS = {
    "trc": Reader(".trc", lambda p: ls.save_recording(p, _markers()), ls.load_recording),
    "markers_csv": Reader(".csv", lambda p: ls.save_recording(p, _markers()), ls.load_recording),
    "c3d": Reader(".c3d", _c3d, ls.load_recording),
    "mot": Reader(".mot", lambda p: ls.save_recording(p, _coordinates()), ls.load_recording),
    "angles_csv": Reader(".csv", lambda p: ls.save_recording(p, _coordinates()), ls.load_recording),
    "marker_set": Reader(".toml", _copy(MODELS / "marker_sets/cast.toml"), marker_sets.load),
    "settings": Reader(
        ".toml",
        lambda p: p.write_text(_settings_text(), "utf-8"),
        ls.load_settings,
    ),
    "geometry_json": Reader(
        ".json", lambda p: geometry_files.save_geometry(p, _geometry()), ls.load_geometry
    ),
    "geometry_xml": Reader(
        ".xml",
        lambda p: geometry_files.save_geometry(p, _geometry()),
        lambda p: ls.load_geometry(p, columns=7, rows=6, pixel_mm=10.0),
    ),
    "geometry_txt": Reader(
        ".txt",
        lambda p: np.savetxt(p, _geometry().matrices.reshape(-1, 12)),
        lambda p: ls.load_geometry(p, columns=7, rows=6, pixel_mm=10.0),
    ),
    "geometry_npy": Reader(
        ".npy",
        lambda p: np.save(p, _geometry().matrices),
        lambda p: ls.load_geometry(p, columns=7, rows=6, pixel_mm=10.0),
    ),
    "volume_mha": Reader(".mha", lambda p: ls.save_volume(p, _volume()), ls.load_volume),
    "volume_nifti": Reader(".nii", lambda p: ls.save_volume(p, _volume()), ls.load_volume),
    "projections": Reader(
        ".mha",
        lambda p: image_files.save_projections(
            p, ls.Projections(_geometry(), np.ones((5, 6, 7), np.float32))
        ),
        lambda p: ls.load_projections(p, _geometry()),
    ),
    "imu": Reader(".csv", lambda p: imu_files.save_imu(p, _signals()), imu_files.load_imu),
    "motion": Reader(".npz", _motion, motion_files.load_motion),
    "spectrum": Reader(".csv", _spectrum, spectrum.load),
    "phantom": Reader(".toml", _phantom, ls.load_phantom),
    "mesh": Reader(".stl", _mesh, _load_mesh),
    "osim": Reader(".osim", lambda p: _osim(p), osim_file.read),
    "scales": Reader(".xml", lambda p: p.write_text(_SCALES), osim_scaling.read),
    "manifest": Reader(".json", _manifest, _open_manifest),
}

_SCALES = """<?xml version="1.0"?>
<OpenSimDocument Version="40000"><ScaleSet><objects>
<Scale><scales>1.1 1 0.9</scales><segment>femur_l</segment><apply>true</apply></Scale>
<Scale><scales>1 1.2 1</scales><segment>tibia_l</segment><apply>true</apply></Scale>
</objects></ScaleSet></OpenSimDocument>
"""


def _settings_text() -> str:
    from legsim import config

    return config.dump(config.RunConfig())


def _osim(path: Path) -> None:
    from tests.examples import osim

    path.write_text(osim.version_4(osim.two_legs(), markers=osim.MARKERS))


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four random changes of a file's bytes, lines or cells."""
    for _ in range(rng.integers(1, 5)):
        change = CHANGES[rng.integers(len(CHANGES))]
        data = change(data, rng)
    return data


def _place(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    begin = int(rng.integers(len(data) + 1))
    return begin, min(len(data), begin + int(rng.geometric(0.15)))


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _replace(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:begin] + WORDS[rng.integers(len(WORDS))] + data[end:]


def _drop(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:begin] + data[end:]


def _double(data: bytes, rng: np.random.Generator) -> bytes:
    begin, end = _place(data, rng)
    return data[:end] + data[begin:end] + data[end:]


def _truncate(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Drops, doubles or swaps lines."""
    lines = data.split(b"\n")
    a, b = (int(k) for k in rng.integers(len(lines), size=2))
    kind = rng.integers(3)
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _cell(data: bytes, rng: np.random.Generator) -> bytes:
    """Replaces a cell of a line, between blanks, commas or angle brackets."""
    cells = re.split(rb"([\s,<>=]+)", data)
    cells[2 * int(rng.integers((len(cells) + 1) // 2))] = WORDS[rng.integers(len(WORDS))]
    return b"".join(cells)


CHANGES = (_flip, _flip, _replace, _drop, _double, _truncate, _lines, _cell, _cell, _cell)


class _TooLongError(Exception):
    """A reader that does not end."""


def _stop(*_: object) -> None:
    raise _TooLongError


@contextlib.contextmanager
def _in_memory() -> Iterator[Path]:
    place = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        yield Path(folder)


@contextlib.contextmanager
def _libraries_quiet() -> Iterator[None]:
    """Discards what libraries print about each damaged file."""
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def fuzz(name: str, inputs: int, seed: int) -> tuple[Counter[str], dict[str, bytes]]:
    """Counts what a reader did, and the first input of everything that it must not do.

    Files are read by a child, so that one that ends the process is counted as well.
    """
    reader, found, firsts = READERS[name], Counter[str](), {}
    with _in_memory() as folder:
        path, log = folder / f"file{reader.suffix}", folder / "log"
        reader.make(path)
        valid = path.read_bytes()
        _check_valid(reader, path)
        done = 0
        while done < inputs:
            child = os.fork()
            if child == 0:
                _read_all(reader, path, log, valid, range(done, inputs), seed)
            _, status = os.waitpid(child, 0)
            lines = log.read_text("utf-8").splitlines()
            log.unlink()
            for number, what in (line.split(" ", 1) for line in lines):
                _note(found, firsts, what, valid, seed, int(number))
            done += len(lines)
            if os.WIFSIGNALED(status):
                ended = f"the process ended by signal {os.WTERMSIG(status)}"
                _note(found, firsts, ended, valid, seed, done)
                done += 1
    return found, firsts


def _check_valid(reader: Reader, path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader.load(path)


def _note(
    found: Counter[str], firsts: dict[str, bytes], what: str, valid: bytes, seed: int, k: int
) -> None:
    found[what] += 1
    if what not in ("read", "refused") and what not in firsts:
        firsts[what] = damaged(valid, np.random.default_rng([seed, k]))


def _read_all(
    reader: Reader, path: Path, log: Path, valid: bytes, numbers: range, seed: int
) -> None:
    """Reads damaged files and logs a line for each; ends the process."""
    # what a header asks for by mistake must not fill the machine
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, _stop)
    warnings.simplefilter("ignore")
    with log.open("w", encoding="utf-8", buffering=1) as stream, _libraries_quiet():
        for k in numbers:
            path.write_bytes(damaged(valid, np.random.default_rng([seed, k])))
            signal.alarm(LIMIT_S)
            try:
                reader.load(path)
                what = "read"
            except LegsimError as error:
                what = "refused" if "\n" not in str(error) else "refused in several lines"
            except Exception as error:
                what = _place_of(error)
            finally:
                signal.alarm(0)
            stream.write(f"{k} {what}\n")
    os._exit(0)


def _place_of(error: Exception) -> str:
    """The error, and the last line of legsim that it passed."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/legsim/" in f.filename]
    last = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    return f"{type(error).__name__} at {last}"


def main(
    reader: Annotated[str, typer.Argument(help=f"One of {', '.join(READERS)}; or all.")],
    inputs: Annotated[float, typer.Option(help="Damaged files for each reader.")] = 1e4,
    seed: Annotated[int, typer.Option(help="Of the damage.", min=0)] = 0,
    keep: Annotated[Path | None, typer.Option(help="Folder for inputs that must not be.")] = None,
) -> None:
    """Damages valid files at random and reads them."""
    failed = False
    for name in READERS if reader == "all" else (reader,):
        found, firsts = fuzz(name, int(inputs), seed)
        typer.echo(f"{name}: {found.pop('read', 0)} read, {found.pop('refused', 0)} refused")
        for what, count in found.most_common():
            failed = True
            typer.echo(f"  {count} x {what}")
        if keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            for k, data in enumerate(firsts.values()):
                (keep / f"{name}-{k}{READERS[name].suffix}").write_bytes(data)
        sys.stdout.flush()
    raise typer.Exit(1 if failed else 0)


if __name__ == "__main__":
    typer.run(main)
