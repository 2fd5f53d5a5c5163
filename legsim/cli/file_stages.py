"""One stage at a time, from files to files: the work of `legsim convert`, `project`, `reconstruct`,
`evaluate`, `geometry` and `view`.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from legsim import config, view
from legsim.cli import volume_stages
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import write_text
from legsim.core.memory import in_words
from legsim.core.progress import OnProgress
from legsim.deformation import plausibility as motion_plausibility
from legsim.deformation.files import load_motion
from legsim.deformation.models import Motion
from legsim.evaluation import regions as evaluation_regions
from legsim.evaluation import regridding, similarity
from legsim.evaluation.regions import Region
from legsim.evaluation.scaling import Scaling
from legsim.evaluation.similarity import Scores
from legsim.evaluation.ssim import Window
from legsim.geometry import (
    attenuation_range,
    image_files,
    plausibility,
    projection_images,
    scan_files,
)
from legsim.geometry import files as geometry_files
from legsim.geometry.attenuation_range import AttenuationRange
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.counts import THICKEST
from legsim.geometry.files import GeometryFile
from legsim.geometry.projection_images import RawLayout
from legsim.geometry.scan_files import ScanFiles
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.mocap import files as mocap_files
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.opencl.device import open_device
from legsim.phantom import files as phantom_files
from legsim.phantom.files import PhantomFile
from legsim.reconstruction import fdk
from legsim.run import c_arm
from legsim.run import reconstruction as run_reconstruction
from legsim.run.grids import WantedGrid
from legsim.scan import acquisition, coverage

_OF_THE_BEAM = ("scan.spectrum.", "scan.detector.", "seed=")


@dataclass(frozen=True, slots=True)
class GeometryOptions:
    """How to read a geometry file of another toolkit; None: the file says it."""

    columns: int | None = None
    rows: int | None = None
    pixel_mm: tuple[float, float] | None = None
    """(between columns, between rows)"""
    format: str | None = None
    up: str = "y"
    """the file's axis that becomes world's vertical"""

    def read(self, path: Path) -> GeometryFile:
        """The geometry of the file, read so."""
        return geometry_files.read_geometry(
            path,
            columns=self.columns,
            rows=self.rows,
            pixel_mm=self.pixel_mm,
            format=self.format,
            up=self.up,
        )


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """How to read projections of a scanner; None: the file says it."""

    i0: float | None = None
    air: str | None = None
    """columns and rows that see no object, "X0:X1,Y0:Y1\""""
    flat: Path | None = None
    dark: Path | None = None
    bad_pixels: Path | None = None
    raw: str | None = None
    """layout of a file without a header, as in "U16:620x480x248\""""
    pixel_mm: tuple[float, float] | None = None
    origin_mm: tuple[float, float] | None = None
    turn_rows: bool = False
    line_integrals: bool = False

    def read(self, projections: Path, geometry: Path, reading: GeometryOptions) -> ScanFiles:
        """The scan of two files."""
        raw = None if self.raw is None else RawLayout.parsed(self.raw)
        counts = projection_images.read_counts(
            i0=self.i0,
            air=self.air,
            flat=self.flat,
            dark=self.dark,
            bad=self.bad_pixels,
            raw=raw,
        )
        return scan_files.read_scan(
            projections,
            geometry,
            counts=counts,
            raw=raw,
            pixel_mm=self.pixel_mm,
            origin_mm=self.origin_mm,
            turn_rows=self.turn_rows,
            line_integrals=self.line_integrals,
            format=reading.format,
            up=reading.up,
        )


def project(
    phantom_file: Path,
    geometry_file: Path,
    out: Path,
    *,
    reading: GeometryOptions,
    energy_kev: float,
    settings: tuple[str, ...] = (),
    repair: bool = False,
    device: str | None,
    on_progress: OnProgress,
) -> list[str]:
    """Line integrals of the meshes of a PHANTOM.toml; returns lines to print. ``settings`` as of a
    run, of beam and detector only.
    """
    foreign = [s for s in settings if not s.strip().startswith(_OF_THE_BEAM)]
    if foreign:
        raise LegsimError(
            f"--set {foreign[0]}: `legsim project` uses scan.spectrum.<key>, scan.detector.<key> "
            "and seed only; leave it out"
        )
    read_by = config.load_settings(overrides=settings)
    how = c_arm.imaging(read_by.scan)
    described = reading.read(geometry_file)
    geometry = described.geometry
    read = phantom_files.read(phantom_file, energy_kev=energy_kev, repair=repair)
    phantom = read.phantom
    opened = open_device(device)
    drawing = np.random.default_rng(read_by.seed)
    projections = acquisition.project(
        phantom, geometry, opened, how, drawing, progress=partial(on_progress, "projecting")
    )
    image_files.save_projections(out, projections)
    values = projections.line_integrals
    return [
        *described.notes,
        *read.remarks,
        *_remarks(read, geometry, largest=float(values.max())),
        f"{len(geometry)} views of {geometry.shape_vu[1]}x{geometry.shape_vu[0]} pixels, "
        f"{len(phantom.parts)} parts, on {opened.label}",
        f"line integrals from {values.min():.4g} to {values.max():.4g}",
        f"projections: {out}",
    ]


def _remarks(read: PhantomFile, geometry: ConeBeamGeometry, largest: float) -> list[str]:
    """What a user may not expect of a projected phantom."""
    carried = [
        part.name
        for part, segment in zip(read.phantom.parts, read.segments, strict=True)
        if segment is not None
    ]
    lines = (
        [
            "parts that move with a segment rest here, where their files have them: "
            f"{', '.join(carried)}"
        ]
        if carried
        else []
    )
    if largest > THICKEST:
        lines.append(
            f"In doubt: line integrals go up to {largest:.4g}, but no body reaches {THICKEST:g}: "
            "check the unit of the meshes, and attenuation_per_mm"
        )
    if largest <= 0:
        points = np.concatenate([part.vertices for part in read.phantom.parts])
        middle, center = (
            np.round(1e3 * p, 1).tolist()
            for p in ((points.min(0) + points.max(0)) / 2, geometry.rotation_center())
        )
        lines.append(
            f"no ray meets anything: the phantom's middle is at {middle} mm in world, the scan's "
            f"at {center} mm"
        )
    return lines


def reconstruct(
    projections_file: Path,
    geometry_file: Path,
    out: Path,
    *,
    motion: Path | None,
    like: Path | None,
    shape_zyx: tuple[int, int, int] | None,
    spacing_mm: tuple[float, float, float] | None,
    center_mm: tuple[float, float, float] | None,
    options: Mapping[str, Any] | None = None,
    images: ImageOptions = ImageOptions(),
    reading: GeometryOptions = GeometryOptions(),
    device: str | None,
    on_progress: OnProgress,
) -> list[str]:
    """Reconstructs a projection file; returns lines to print. ``options`` are keys of
    :class:`config.ReconstructionConfig`; of ``reading`` the format and the vertical are used.
    """
    settings = run_reconstruction.from_options(options or {})
    read = images.read(projections_file, geometry_file, reading)
    projections, geometry = read.projections, read.geometry
    grid, chosen = WantedGrid(like, shape_zyx, spacing_mm, center_mm).of(geometry)
    moved = None if motion is None else load_motion(motion)
    if motion is not None and moved is not None and len(moved.times) != len(geometry):
        raise file_error(
            motion,
            f"moves {len(moved.times)} views, but the geometry has {len(geometry)}",
            "give the motion of this scan",
        )
    doubts = _of_motion(motion, moved, read)
    opened = open_device(device)
    need = (
        run_reconstruction.needed_bytes(settings, geometry, grid, motion=moved, device=opened)
        + projections.line_integrals.nbytes
    )
    by_slabs = settings.algorithm == "fdk" and out.suffix.lower() == ".mha"
    volume_bytes = 4 * math.prod(grid.shape_zyx)
    memory = f"{in_words(need)} of memory" + (
        "" if by_slabs else f" and {in_words(volume_bytes)} for the volume"
    )
    found = AttenuationRange()
    progress = partial(on_progress, f"reconstructing ({memory}; {in_words(volume_bytes)} of disk)")
    if by_slabs:
        with image_files.volume_writer(out, grid) as writer:
            for first, slab in fdk.fdk_slabs(
                projections,
                grid,
                motion=moved,
                options=run_reconstruction.fdk_options(settings),
                device=opened,
                progress=progress,
            ):
                found.add(slab)
                writer.write(first, slab)
    else:
        volume = run_reconstruction.reconstruct(
            settings, projections, grid, motion=moved, device=opened, progress=progress
        )
        found.add(volume.attenuation)
        image_files.save_volume(out, volume)
    voxels = "x".join(str(n) for n in grid.shape_zyx)
    return [
        *read.notes,
        *chosen,
        *run_reconstruction.remarks(settings, projections),
        *(f"In doubt: {line}" for line in (*doubts, found.objection()) if line),
        f"{voxels} voxels (z, y, x) from {len(geometry)} views by {settings.algorithm} on "
        f"{opened.label}",
        f"took {memory}" + (", the volume went to disk slab by slab" if by_slabs else ""),
        f"volume (1/mm): {out}",
    ]


def _of_motion(path: Path | None, motion: Motion | None, scan: ScanFiles) -> tuple[str, ...]:
    """What is doubtful about a motion beside the views, whose times not all formats say."""
    if path is None or motion is None:
        return ()
    geometry = scan.geometry
    try:
        return motion_plausibility.objections(
            motion, geometry.rotation_center(), geometry.times if scan.timed else None
        )
    except LegsimError as error:
        raise file_error(path, str(error), "correct the file") from None


def evaluate(
    volume_file: Path,
    reference_file: Path,
    out: Path,
    *,
    regions: Path | None,
    register: bool,
    resample: bool = False,
    scaling: Scaling = "reference",
    window: Window = "uniform",
    water_per_mm: float | None = None,
    energy_kev: float | None = None,
) -> Scores:
    """Scores a volume and writes metrics.json. ``resample`` brings the volume onto the reference's
    grid first. Water's attenuation is for folders of DICOM slices.
    """
    volume, reference = (
        volume_stages.read_volume(path, water_per_mm=water_per_mm, energy_kev=energy_kev)[0]
        for path in (volume_file, reference_file)
    )
    chosen = _whole(reference.grid) if regions is None else _labelled(regions, reference)
    apart = attenuation_range.other_unit(volume.attenuation, reference.attenuation)
    if apart is not None:
        raise file_error(volume_file, apart, "give both in one unit, 1/mm")
    if resample:
        brought = regridding.onto(volume, reference.grid)
        volume, chosen = brought.volume, tuple(brought.clipped(region) for region in chosen)
    metrics = similarity.evaluate(
        volume, reference, chosen, register=register, scaling=scaling, window=window
    )
    write_text(
        out,
        json.dumps(
            {
                "volume": str(volume_file),
                "reference": str(reference_file),
                "resampled": resample,
                **asdict(metrics),
            },
            indent=1,
        )
        + "\n",
    )
    return metrics


def _whole(grid: VolumeGrid) -> tuple[Region, ...]:
    nz, _, nx = grid.shape_zyx
    radius = 0.5 * min(nz * grid.spacing_xyz[2], nx * grid.spacing_xyz[0])
    return (Region("cylinder", evaluation_regions.cylinder(grid, radius)),)


def _labelled(path: Path, reference: Volume) -> tuple[Region, ...]:
    labels = image_files.load_labels(path, reference.grid)
    found = np.unique(labels)
    if not (found > 0).any():
        raise file_error(path, "holds no label above 0", "mark each region by a value of its own")
    return tuple(Region(f"label {value}", labels == value) for value in found if value > 0)


def describe_geometry(path: Path, *, reading: GeometryOptions, phantom: Path | None) -> list[str]:
    """The lines of `legsim geometry show`; with a PHANTOM.toml also what of it is cut off."""
    scanned = None if phantom is None else phantom_files.load_phantom(phantom)
    read = reading.read(path)
    summary = coverage.summarize(read.geometry, scanned).lines()
    known = reading.pixel_mm is not None or not read.pixel_open
    found = plausibility.objections(read.geometry, pixel_known=known)
    doubts = [f"In doubt: {line}" for line in found]
    return [*read.notes, *doubts, f"format             {read.format}", *summary]


_WITHOUT_MIRROR = ("rtk", "tigre")


def convert_geometry(
    path: Path,
    out: Path,
    *,
    reading: GeometryOptions,
    to: str | None = None,
    turn_rows: bool = False,
) -> list[str]:
    """Writes a geometry in the format ``to``, or that of the ending of ``out``; returns lines to
    print.

    ``turn_rows`` counts the detector's rows from the other edge, for images whose rows are turned.
    Where the format has no mirror and all views are mirrored, they are turned without it.
    """
    read = reading.read(path)
    geometry, notes = read.geometry, list(read.notes)
    writes = to or ("rtk" if out.suffix.lower() == ".xml" else "")
    if turn_rows:
        geometry = geometry.rows_turned()
        notes.append("rows are counted from the other edge: turn those of the projections too")
        if writes in _WITHOUT_MIRROR and geometry.mirrored().any():
            raise file_error(
                path,
                f"with its rows turned it is mirrored, which {writes} cannot say",
                "leave out --turn-rows here and turn those of the projections, or write matrices",
            )
    elif writes in _WITHOUT_MIRROR and geometry.mirrored().all():
        geometry = geometry.rows_turned()
        notes.append(
            f"the rows of {path.name} run the other way than {writes} has them: they are turned "
            "here, turn those of the projections too"
        )
    geometry_files.save_geometry(out, geometry, format=to)
    return [*notes, f"{len(geometry)} views: {out}"]


def convert_motion(
    path: Path,
    out: Path,
    *,
    unit: str | None,
    up: str | None,
    in_degrees: bool,
    angles: str | None = None,
) -> list[str]:
    """Writes markers or joint coordinates in the format that the ending of ``out`` names; returns
    lines to print.

    ``unit``, ``up`` and ``angles`` override what ``path`` says; ``in_degrees`` is how to write.
    """
    found = mocap_files.read_recording(
        path, unit=unit, up=up, in_degrees=None if angles is None else angles == "degrees"
    )
    recording = found.value
    columns = (
        recording.marker_names
        if isinstance(recording, MarkerTrajectories)
        else recording.coordinate_names
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    mocap_files.save_recording(out, recording, in_degrees=in_degrees)
    what = "markers (m, y up)" if isinstance(recording, MarkerTrajectories) else "joint coordinates"
    return [*found.notes, f"{len(recording.times)} samples of {len(columns)} {what}: {out}"]


def open_recording(folder: Path) -> None:
    """Opens a run's recording in the rerun viewer."""
    recording = folder / "recording.rrd" if folder.is_dir() else folder
    if not recording.is_file():
        raise file_error(
            recording, "no such recording", "give a folder made by `legsim run` or `legsim replay`"
        )
    view.open_viewer(recording)
