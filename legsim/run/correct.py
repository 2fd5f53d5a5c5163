"""Corrections of a measured scan: volumes, motions, pictures and a report, without any truth."""

import csv
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from legsim import __version__, config, view
from legsim.config.measured_scan import MeasuredScanConfig
from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import key_of, sha256, write_text
from legsim.core.progress import OnProgress, silent
from legsim.correction.method import CorrectionMethod
from legsim.correction.rigid import sensor_path
from legsim.deformation.plausibility import FARTHEST
from legsim.evaluation import similarity
from legsim.evaluation.regions import cylinder
from legsim.geometry import attenuation_range
from legsim.geometry.volume import NamedVolume, VolumeGrid
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl import failures
from legsim.opencl.device import Device, open_device
from legsim.report import measured_page, page, scan_page
from legsim.report.measured_page import Sharpness
from legsim.run import code, measured, measured_aids, measured_beads, methods, reconstruction
from legsim.run.corrected import Reconstructed, Reconstructor
from legsim.run.folder import RunFolder, commit
from legsim.run.measured import MeasuredScan
from legsim.run.methods import MethodInputs
from legsim.scan import coverage
from legsim.scene.slices import VolumeSlices
from legsim.scene.values import MeasuredScene

_OF_THE_GRID = ("like", "shape_zyx", "spacing_mm", "center_mm")
_OF_THE_COUNTS = ("i0", "air", "flat", "dark", "bad_pixels")

BASELINE = "uncorrected"
"""method that always runs, with which the others are compared"""


@dataclass(frozen=True, slots=True)
class CorrectResult:
    """What a correction left."""

    folder: Path
    sharpness: tuple[Sharpness, ...]
    notes: tuple[str, ...]

    def columns(self) -> tuple[str, ...]:
        """Column names of :meth:`rows`."""
        return measured_page.SHARPNESS_COLUMNS

    def rows(self) -> list[tuple[str, ...]]:
        """Formats the sharpness and the motion of each method."""
        return [one.row(self.sharpness[0]) for one in self.sharpness]

    def lines(self) -> list[str]:
        """Notes on the inputs, and where the results are."""
        volumes = ", ".join(f"volume-{one.method}.mha" for one in self.sharpness)
        return [
            *self.notes,
            f"report: {self.folder / 'report.html'}",
            f"in {self.folder}: {volumes}",
        ]


def correct(
    scan: Path | str | MeasuredScanConfig,
    names: Sequence[str] | str,
    out: Path | str,
    *,
    folder: Path | str = ".",
    device: str | None = None,
    on_progress: OnProgress = silent,
) -> CorrectResult:
    """Corrects a measured scan by each method and reconstructs it; finished stages are kept.

    The uncorrected scan is always reconstructed too.

    Args:
        scan: a SCAN.toml, or its settings.
        names: methods, or one, as in methods.run of a run: the package's own, installed ones, or
            path/to/file.py:function.
        out: folder of the results; made where it is missing. It must not hold the inputs.
        folder: to which the files of given settings are relative; a SCAN.toml's is its own.
        device: part of an OpenCL device's name, or "cpu" or "gpu"; None for the fastest.
        on_progress: is called with the name of the stage, steps done and total steps.

    Raises:
        LegsimError: files that cannot be used, or methods that need what is not there.

    >>> correct("run/scan.toml", ["rigid"], "corrected").sharpness
    """
    wanted = [names] if isinstance(names, str) else names
    out, names = Path(out), tuple(dict.fromkeys([BASELINE, *wanted]))
    methods.check_names(names, "--method")
    on_progress("reading", 0, 1)
    if isinstance(scan, MeasuredScanConfig):
        read = measured.assemble(scan, Path(folder))
    else:
        read = measured.load_measured_scan(scan)
    reconstruction.check(read.settings.reconstruction)
    _check_out(out, read.inputs)
    opened = open_device(device)
    built = _build(names, read, opened)
    on_progress("reading", 1, 1)
    about = _about(read, opened)
    with failures.reported(opened.label), RunFolder(out, about, kind="correct") as made:
        given = Reconstructor(made, read.settings.reconstruction, read.grid, opened, on_progress)
        key = key_of(_key_of(read), code.fingerprint("correct"), opened.arithmetic)
        key = key_of(key, measured_aids.fingerprint(read))
        worn = measured_aids.as_worn(read)
        corrected = tuple(
            given.of(
                name,
                key_of(key, methods.fingerprint(name)),
                lambda m=method, s=worn if name in methods.FIND_START else read.seen: m(s),
            )
            for name, method in built.items()
        )
        _write_motions(made, read, corrected)
        sharpness = _sharpness(made, read, corrected)
        notes = (*read.notes, *(note for one in corrected for note in one.notes))
        notes = (*notes, *measured_aids.reliance(read, names), *measured_aids.doubts(read, names))
        notes = (*notes, *_implausible(sharpness, corrected))
        _present(given, key, read, corrected, sharpness, notes)
        return CorrectResult(out, sharpness, notes)


def described(path: Path, given: Mapping[str, Any]) -> Path | MeasuredScanConfig:
    """The scan of a command line: a SCAN.toml by itself, or projections with these options.

    ``given`` are keys of :class:`MeasuredScanConfig`, its grid and its counts, with paths.

    Raises:
        LegsimError: options beside a SCAN.toml, or projections without a geometry.
    """
    if path.suffix.lower() == ".toml":
        if given:
            option = f"--{next(iter(given)).replace('_', '-')}"
            raise file_error(path, f"already says all; {option} is beside it", "put it there")
        return path
    if "geometry" not in given:
        raise file_error(
            path, "has no geometry", "give --geometry FILE, or a SCAN.toml that names both"
        )
    named = {key: _as_text(value) for key, value in given.items()}
    grid, counts = (
        {key: named.pop(key) for key in keys if key in named}
        for keys in (_OF_THE_GRID, _OF_THE_COUNTS)
    )
    whole = {"projections": str(path), **named, "grid": grid, "counts": counts}
    return config.validated(MeasuredScanConfig, whole, None)


def _as_text(value: Any) -> Any:
    """Paths as text, alone or in a list."""
    if isinstance(value, list):
        return [_as_text(one) for one in value]
    return str(value) if isinstance(value, Path) else value


def _check_out(out: Path, inputs: Sequence[Path]) -> None:
    """Refuses a folder that holds inputs, or results of another command."""
    inside = [path for path in inputs if path.resolve().parent == out.resolve()]
    if inside:
        raise file_error(
            out, f"holds {inside[0].name}, which is read", "choose another folder with --out"
        )
    if (out / "config.toml").exists():
        raise file_error(
            out, "is the folder of a simulated run", "choose another folder with --out"
        )


def _build(names: Sequence[str], scan: MeasuredScan, device: Device) -> dict[str, CorrectionMethod]:
    """Builds every method, or reports in one line all that is missing for them."""
    wanted = scan.settings.methods
    shank = next((s for s in scan.segments.values() if s.startswith("tibia")), "tibia_l")
    given = MethodInputs(
        sensor=measured.followed(scan),
        scheme=wanted.scheme,
        device=device,
        nodes=scan.grid.coarse(1e-3 * wanted.node_mm),
        scanned_shank=shank,
        truth=None,
        beads=None,
        priors=measured_aids.priors(scan),
        fused_fiducials=measured_aids.fiducials(scan),
    )
    built: dict[str, CorrectionMethod] = {}
    missing = []
    for name in names:
        lacking = _missing(name, given.sensor, scan)
        try:
            if lacking:
                raise LegsimError(lacking)
            built[name] = methods.build(name, _with_beads(name, given, scan))
        except LegsimError as error:
            missing.append(str(error))
    if missing:
        raise LegsimError("; ".join(missing))
    return built


def _with_beads(name: str, given: MethodInputs, scan: MeasuredScan) -> MethodInputs:
    """The inputs of one method with the beads that it takes."""
    if name == "marker-based":
        return replace(given, beads=measured_beads.of_all(scan))
    if name == "fused-beads":
        return replace(given, fused_beads=measured_beads.of_sensor(scan, given.sensor))
    if name == "articulated-beads":
        return replace(given, beaded_leg=measured_beads.of_leg(scan))
    return given


def _missing(name: str, followed: str, scan: MeasuredScan) -> str:
    """What a method needs that the scan does not have; empty where it has all."""
    sensors = scan.seen.signals.sensor_names
    sensor = methods.rigid_sensor(name) or (followed if name in methods.FOLLOW_ONE else None)
    if sensor is not None and sensor not in sensors:
        if sensor in scan.left_out or (not sensor and scan.left_out):
            which = sensor or scan.left_out[0]
            return (
                f"{name} needs the pose of sensor {which} at the first view: give it as "
                "[imu.sensors.start] in SCAN.toml, or as [sensors.start] in a TOML about its file"
            )
        have = ", ".join(sensors) or "none"
        return (
            f"{name} needs a sensor{f' {sensor!r}' if sensor else ''} (there: {have}): add [[imu]]"
        )
    if name in methods.FOLLOW_JOINTS and not scan.seen.joints:
        return (
            f"{name} needs the joints on the sensors (hip on the thigh's, knee and ankle on the "
            "shank's): give [[joints]] in SCAN.toml"
        )
    return measured_beads.lacking(scan) if name == "articulated-beads" else ""


def _about(scan: MeasuredScan, device: Device) -> dict[str, Any]:
    return {
        "legsim": __version__,
        "commit": commit(),
        "command": "correct",
        "device": device.described,
        "inputs": {str(path.resolve()): sha256(path) for path in scan.inputs},
    }


def _key_of(scan: MeasuredScan) -> str:
    """Key of all numbers that decide the volumes, but the method; files and their names do not."""
    seen, settings, digest = scan.seen, scan.settings, hashlib.sha256()
    geometry, signals = seen.projections.geometry, seen.signals
    arrays = [seen.projections.line_integrals, geometry.matrices, geometry.times, signals.times]
    arrays += [signals.angular_velocity, signals.specific_force]
    arrays += [part for s in seen.starts for part in (s.world_from_sensor, s.velocity)]
    attached = (*seen.joints, seen.ankles)
    arrays += [point.position_sensor for points in attached for point in points]
    arrays += list(scan.knees_on_thighs.values())
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(array.data)
    named = [signals.sensor_names, [[p.sensor for p in points] for points in attached]]
    used = [settings.reconstruction.model_dump(), settings.methods.model_dump()]
    return key_of(__version__, digest.hexdigest(), named, used, astuple(scan.grid))


def _write_motions(
    folder: RunFolder, scan: MeasuredScan, corrected: Sequence[Reconstructed]
) -> None:
    """Writes the rigid part of each motion as a table of one matrix per view."""
    points = _field_points(scan.grid)
    for one in corrected:
        if one.motion is None:
            continue
        label = one.name
        matrices = one.motion.rigid_part(points)

        def write(label: str = label, matrices: np.ndarray = matrices) -> tuple[str, ...]:
            name = f"motion-{label}.csv"
            write_text(folder.path / name, motion_table(scan.seen.times, matrices))
            return (name,)

        folder.cached(f"motion-{label}", key_of(folder.hash_of(f"motion-{label}.npz")), write)


def _field_points(grid: VolumeGrid) -> np.ndarray:
    """(8, 3) m, the corners of the grid's inner half: where a motion's rigid part is taken."""
    half = 0.25 * np.array(grid.shape_zyx[::-1]) * grid.spacing_xyz
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    return np.array(grid.center) + signs * half


def motion_table(times: np.ndarray, matrices: np.ndarray) -> str:
    """CSV of ``view,time_s,r11 … r33,tx_mm,ty_mm,tz_mm``: moved_from_reference of each view."""
    rotation = [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["view", "time_s", *rotation, "tx_mm", "ty_mm", "tz_mm"])
    for view_number, (time, matrix) in enumerate(zip(times, matrices, strict=True)):
        numbers = [float(time), *matrix[:3, :3].ravel().tolist(), *(1e3 * matrix[:3, 3]).tolist()]
        writer.writerow([view_number, *(repr(n) for n in numbers)])
    return stream.getvalue()


def _sharpness(
    folder: RunFolder, scan: MeasuredScan, corrected: Sequence[Reconstructed]
) -> tuple[Sharpness, ...]:
    """Gradient entropy of each volume where all views see it, and how far its motion goes."""
    seen = _field_of_view(scan)
    found = []
    for one in corrected:
        label = one.name
        path = folder.path / f"sharpness-{label}.json"
        hashes = [
            folder.hash_of(name)
            for name in (f"volume-{label}.mha", f"motion-{label}.npz")
            if folder.has(name)
        ]

        def write(one: Reconstructed = one, path: Path = path) -> tuple[str, ...]:
            made = _measure(one, seen, scan.grid, folder.seconds(f"volume-{one.name}"))
            files.write_text(path, json.dumps(asdict(made), indent=1) + "\n")
            return (path.name,)

        folder.cached(path.stem, key_of(hashes, similarity.PROTOCOL), write)
        found.append(Sharpness(**json.loads(path.read_text("utf-8"))))
    return tuple(found)


def _field_of_view(scan: MeasuredScan) -> np.ndarray:
    """Mask (z, y, x) of the cylinder about the grid's middle that all views see across columns."""
    grid = scan.grid
    nz, _, nx = grid.shape_zyx
    inside = 0.5 * min(nz * grid.spacing_xyz[2], nx * grid.spacing_xyz[0])
    radius = coverage.summarize(scan.seen.projections.geometry).field_radius
    return cylinder(grid, radius if 0 < radius < inside else inside)


def _measure(one: Reconstructed, seen: np.ndarray, grid: VolumeGrid, seconds: float) -> Sharpness:
    motion = one.motion or one.warped_by
    far = turned = None
    if motion is not None:
        center = np.array([grid.center])
        far = 1e3 * float(np.linalg.norm(motion.carry(center)[:, 0] - center, axis=-1).max())
        turned = measured_page.largest_turn(motion.rigid_part(_field_points(grid)))
    entropy = similarity.gradient_entropy(one.load().attenuation, seen)
    return Sharpness(one.name, entropy, far, turned, seconds)


def _implausible(
    sharpness: Sequence[Sharpness], corrected: Sequence[Reconstructed]
) -> tuple[str, ...]:
    """Doubts motions that no person who stands makes, and volumes whose values are no body's."""
    lines = [
        f"In doubt: {one.method} moves the rotation center by {one.farthest_mm:.0f} mm, as nobody "
        "who stands does: check the sensor's start, clock, units and columns."
        for one in sharpness
        if one.farthest_mm is not None and one.farthest_mm > 1e3 * FARTHEST
    ]
    # one volume stands for all: they are of the same images
    values = attenuation_range.objection(corrected[0].load().attenuation)
    return (*lines, *([f"In doubt: {values}."] if values else []))


def _present(
    given: Reconstructor,
    key: str,
    scan: MeasuredScan,
    corrected: Sequence[Reconstructed],
    sharpness: Sequence[Sharpness],
    notes: Sequence[str],
) -> None:
    """Writes pictures, recording and report."""
    folder, on_progress = given.folder, given.on_progress
    lines = (*notes, *_left_out(scan))

    def write() -> tuple[str, ...]:
        on_progress("recording and report", 0, 2)
        scene = measured_scene(
            scan, [VolumeSlices.of(NamedVolume(c.name, c.load())) for c in corrected]
        )
        view.write_measured(folder.path / "recording.rrd", scene)
        on_progress("recording and report", 1, 2)
        moved = [(one.name, one.motion) for one in corrected if one.motion is not None]
        drawn = measured_page.measured_figures(scene, moved, scan.grid.center)
        pictures = scan_page.write_pictures(folder.path / "pictures", drawn)
        provenance = [(what, str(value)) for what, value in folder.about.items()]
        content = measured_page.measured_report(scan.seen, sharpness, pictures, lines, provenance)
        write_text(folder.path / "report.html", page.render(content))
        on_progress("recording and report", 2, 2)
        return "recording.rrd", "report.html", *(picture.file for picture in pictures)

    hashes = [folder.hash_of(f"volume-{one.name}.mha") for one in corrected]
    folder.cached("presentation", key_of(key, hashes, lines, folder.about["inputs"]), write)


def _left_out(scan: MeasuredScan) -> tuple[str, ...]:
    return tuple(f"Sensor {name} has no start and was left out." for name in scan.left_out)


def measured_scene(scan: MeasuredScan, slices: Sequence[VolumeSlices]) -> MeasuredScene:
    """Builds what there is to see of a measured scan; sensors move as their signals say."""
    seen, names = scan.seen, scan.seen.signals.sensor_names
    paths = [sensor_path(seen, name, scan.settings.methods.scheme) for name in names]
    poses = SegmentPoses(seen.times, names, np.stack(paths, 1)) if names else None
    return MeasuredScene(seen.projections, seen.signals, tuple(slices), poses)
