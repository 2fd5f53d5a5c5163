"""What a run or a replay shows: the scene for recording and figures, the pictures, and the words and tables of the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from legsim import figures, imu, side_by_side, whole_files
from legsim.anatomy import JOINT_CENTERS
from legsim.arrays import FloatArray
from legsim.evaluation import Metrics
from legsim.geometry import Projections
from legsim.imu import JointSplines, Sensor
from legsim.leg_phantom import LegPhantom
from legsim.recovery import Recovery
from legsim.report import FileNote, Picture, ReportContent, Section, Table
from legsim.residuals import Residual
from legsim.scene import MovingSurface, NamedVolume, ReplayScene, ScanScene, SegmentMesh, SlicePlanes
from legsim.signals import ImuSignals, RigidMotion, SegmentPoses
from legsim.spread import spread

if TYPE_CHECKING:
    from legsim.figures import Figure

_SHOWN_SURFACES = ("skin", "patella_cortex", "femur_cortex", "tibia_cortex", "fibula_cortex")
_AXIAL_OFFSET = 0.05
"""m below and above the knee center of the axial slices"""
REPLAY_FILES = (
    FileNote("recording.rrd", "everything over time; open with `legsim view` or the rerun viewer"),
    FileNote("coordinates.mot", "joint coordinates, for OpenSim"),
    FileNote("joint_centres.csv", "hip, knee and ankle centers in world, m"),
    FileNote("poses.npz", "segment poses"),
    FileNote("imu.csv", "what the sensors read, in their own frames"),
)
"""of a replay, and among those of a run"""


@dataclass(frozen=True, slots=True)
class MethodResult:
    """One row of the table."""

    method: str
    metrics: Metrics
    residual_mm: float | None
    """RMS over the views at femur and tibia of the motion that was not undone; None for the motion-free scan and for warped images"""
    seconds: float
    """estimation and reconstruction"""
    residuals: tuple[Residual, ...] = ()
    """the same by bone and at the skin, with degrees and pixels"""

    @property
    def residual_px(self) -> float:
        """RMS over the bones of where the images see them beside where the method has them."""
        bones = [r.pixels for r in self.residuals if r.structure != "skin"]
        return float(np.sqrt(np.mean(np.square(bones)))) if bones else float("nan")


def replay_scene(
    recovered: Recovery, splines: JointSplines, sensors: tuple[Sensor, ...], signals: ImuSignals, phantom: LegPhantom
) -> ReplayScene:
    """Skeleton with bones, markers, sensors and curves."""
    poses = recovered.leg.segment_poses(recovered.trajectories)
    fit = recovered.fit
    return ReplayScene(
        name=recovered.name,
        trajectories=recovered.trajectories,
        poses=poses,
        joint_centers=recovered.leg.joint_centers(poses),
        imu=signals,
        sensor_poses=imu.sensor_poses(recovered.leg, splines, sensors, recovered.trajectories.times),
        measured=None if fit is None else fit.measured,
        modelled=None if fit is None else fit.modelled,
        segment_meshes=_bones(phantom),
        floor_height=_floor(poses),
    )


def _bones(phantom: LegPhantom) -> tuple[SegmentMesh, ...]:
    """The outer surface of each bone, in the frame of its segment."""
    meshes = []
    for part, segment in zip(phantom.phantom.parts, phantom.segments, strict=True):
        if part.name.rsplit("_", 1)[0] in _SHOWN_SURFACES[1:]:
            meshes.append(SegmentMesh(part.name, segment, phantom.in_segment(part.name), part.triangles))
    return tuple(meshes)


def _floor(poses: SegmentPoses) -> float:
    """Height of the soles: 2 cm below the lower toe joint, the median over the recording."""
    return float(np.median(np.minimum(poses.of("toes_l")[:, 1, 3], poses.of("toes_r")[:, 1, 3]))) - 0.02


def scan_scene(
    replay: ReplayScene, phantom: LegPhantom, poses: SegmentPoses, projections: Projections, volumes: Sequence[NamedVolume], every: int = 8
) -> ScanScene:
    """The replay with skin, C-arm, projections and slices; skin at every ``every``-th view."""
    knee = replay.joint_centers.positions_world[:, JOINT_CENTERS.index("knee_l")].mean(0)
    views = np.arange(0, len(poses.times), every)
    posed = [phantom.posed(poses.world_from_segment[view], poses.segment_names) for view in views]
    surfaces = [
        MovingSurface(part.name, poses.times[views], np.stack([p[k] for p in posed]).astype(np.float32), part.triangles)
        for k, part in enumerate(phantom.phantom.parts)
        if part.name.startswith("skin")
    ]
    center = volumes[0].volume.grid.center if volumes else knee
    return ScanScene(
        replay=replay,
        projections=projections,
        surfaces=tuple(surfaces),
        volumes=tuple(volumes),
        planes=slice_planes(center),
    )


def slice_planes(center: Sequence[float] | FloatArray) -> SlicePlanes:
    """Below and above ``center`` (3,), which is the knee's, and sagittal through it."""
    _, y, z = (float(c) for c in center)
    return SlicePlanes(y - _AXIAL_OFFSET, y + _AXIAL_OFFSET, z)


def scan_figures(
    scene: ScanScene, truth: RigidMotion, motions: Sequence[tuple[str, RigidMotion]], knee: FloatArray
) -> tuple[tuple[str, str, Figure], ...]:
    """(file stem, caption, figure) of everything there is to see of a scan."""
    if scene.planes is None:
        return ()
    replay = scene.replay
    corrected = scene.volumes[1:]
    pictures = [
        (
            "slices",
            "Axial slices 5 cm below and above the knee center, and the sagittal slice through it, one column a method.",
            figures.slices(scene.volumes, scene.planes),
        ),
        ("projections", "Projections of the moving leg through the scan.", figures.projection_montage(scene.projections)),
    ]
    if corrected:
        pictures.insert(
            1,
            (
                "overlay",
                "The motion-free volume in red and each method in green; where they agree it is yellow.",
                figures.overlay(scene.volumes[0], corrected, scene.planes),
            ),
        )
    if motions:
        pictures.append(
            (
                "motion-errors",
                "How far each estimate puts the knee center from where the shank carried it.",
                figures.motion_errors(truth, motions, knee),
            )
        )
    if replay.imu is not None:
        pictures.append(("imu", "What the sensors read.", figures.imu_curves(replay.imu)))
    return (*pictures, *replay_figures(replay))


def replay_figures(scene: ReplayScene) -> tuple[tuple[str, str, Figure], ...]:
    """(file stem, caption, figure) of the movement itself."""
    pictures = [
        (
            "joint-angles",
            "Joint angles over the recording; knee flexion is negative, as in gait2392.",
            figures.joint_angles(scene.trajectories),
        ),
        ("sway", "How far the joint centers stray from their means.", figures.sway(scene.joint_centers)),
    ]
    if scene.measured is not None:
        pictures.append(("markers", "Distance between measured markers and the model's.", figures.marker_residuals(scene)))
    return tuple(pictures)


def quality(results: Sequence[MethodResult], condition: str) -> tuple[Table, Table, Table]:
    """SSIM and RMSE by method and region, beside the printed values of that block ("30", "60" or "all"); gradient entropy."""
    ssim, rmse = [], []
    for result in results:
        for m in result.metrics.regions:
            ssim.append(side_by_side.quality_entry("SSIM", condition, result.method, m.region, spread([m.ssim])))
            rmse.append(side_by_side.quality_entry("RMSE", condition, result.method, m.region, spread([m.rmse])))
    regions = [m.region for m in results[0].metrics.regions]
    entropy = tuple((r.method, *(f"{r.metrics.of(region).gradient_entropy:.3f}" for region in regions)) for r in results)
    return (
        *side_by_side.quality_tables(ssim, rmse, f"Table 1, {side_by_side.heading(condition)}"),
        Table("Sharpness by gradient entropy", ("method", *regions), entropy, side_by_side.ENTROPY),
    )


def scan_report(
    recovered: Recovery,
    results: Sequence[MethodResult],
    pictures: Sequence[Picture],
    summary: Sequence[str],
    provenance: Sequence[tuple[str, str]],
) -> ReportContent:
    """The page of a run."""
    condition = _condition(recovered)
    further = _residual_table(results)
    images = Section("Image quality", tables=(*quality(results, condition), further), figures=tuple(pictures[:3]))
    return ReportContent(
        title=f"Scan of {recovered.name}",
        summary=tuple(summary),
        sections=(images, Section("Motion", lines=tuple(recovered.lines()), figures=tuple(pictures[3:]))),
        provenance=tuple(provenance),
        files=(
            *REPLAY_FILES,
            FileNote("config.toml", "every setting of this run"),
            FileNote("manifest.json", "versions, device, seconds and sha256 of every file"),
            FileNote("geometry.json", "a 3x4 matrix a view, mm to pixels"),
            FileNote("geometry_rtk.xml", "the same for RTK"),
            FileNote("projections.mha", "line integrals"),
            FileNote("metrics.json", "the numbers of the tables"),
            *(FileNote(f"volume-{r.method}.mha", "attenuation, 1/mm") for r in results),
        ),
    )


def _residual_table(results: Sequence[MethodResult]) -> Table:
    """What each method left of the motion, by structure, and its time."""
    structures = [r.structure for r in results[0].residuals]
    rows = []
    for result in results:
        left = [(_number(r.mm), _number(r.degrees), _number(r.pixels)) for r in result.residuals]
        rows.append((result.method, *(cell for cells in left for cell in cells), f"{result.seconds:.1f}"))
    heads = (f"{structure} {unit}" for structure in structures for unit in ("(mm)", "(deg)", "(px)"))
    note = (
        "RMS over the views and points of each structure of the left knee within the field of view: how far the method has them from "
        "where they were, by how much it turns a bone in excess, and how far apart the images see the two. Deformed images know no "
        "depth: pixels alone."
    )
    return Table("Motion that was not undone, and time", ("method", *heads, "seconds"), tuple(rows), f"Residual: {note}")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _condition(recovered: Recovery) -> str:
    """Which block of the printed table to show beside ours: by the mean bend of the scanned knee."""
    bend = -float(np.degrees(recovered.trajectories.coordinate("knee_angle_l").mean()))
    return "30" if 15 <= bend < 45 else "60" if 45 <= bend <= 75 else "all"


def replay_report_lines(recovered: Recovery, out: Path) -> list[str]:
    """What `legsim replay` prints."""
    files = ", ".join(note.name for note in REPLAY_FILES)
    return [*recovered.lines(), f"report: {out / 'report.html'}", f"files: {files} in {out}", f"to look around: legsim view {out}"]


def write_pictures(folder: Path, drawn: Sequence[tuple[str, str, Figure]]) -> list[Picture]:
    """Saves each figure as a PNG in ``folder`` and gives it back for the report."""
    folder.mkdir(exist_ok=True)
    pictures = []
    for stem, caption, figure in drawn:
        content = figures.png(figure)
        whole_files.write_bytes(folder / f"{stem}.png", content)
        pictures.append(Picture(caption, content, caption, f"{folder.name}/{stem}.png"))
    return pictures
