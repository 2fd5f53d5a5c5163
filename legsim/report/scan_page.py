"""The page of a run: scene for recording and figures, pictures, texts and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from legsim import figures
from legsim.core import files
from legsim.core.values import FloatArray
from legsim.deformation.models import RigidMotion
from legsim.evaluation.scores import MethodResult, spread
from legsim.kinematics.moving_leg import MovingLeg
from legsim.report import published_tables
from legsim.report.page import FileNote, PageSection, Picture, ReportContent, Table
from legsim.report.replay_page import replay_figures, replay_files
from legsim.scene.values import ScanScene

if TYPE_CHECKING:
    from legsim.figures import Figure


def scan_figures(
    scene: ScanScene,
    truth: RigidMotion,
    motions: Sequence[tuple[str, RigidMotion]],
    knee: FloatArray,
) -> tuple[tuple[str, str, Figure], ...]:
    """Draws (file stem, caption, figure) of every picture of a scan."""
    if not scene.slices:
        return ()
    replay = scene.replay
    corrected = scene.slices[1:]
    pictures = [
        (
            "slices",
            "Axial slices 5 cm below and above the knee center, and the sagittal slice through "
            "it, one column per method.",
            figures.slices(scene.slices),
        ),
        (
            "projections",
            "Projections of the moving leg through the scan.",
            figures.projection_montage(scene.projections),
        ),
    ]
    if corrected:
        pictures.insert(
            1,
            (
                "overlay",
                "The motion-free volume in red and each method in green; where they agree it is "
                "yellow.",
                figures.overlay(scene.slices[0], corrected),
            ),
        )
    if motions:
        pictures.append(
            (
                "motion-errors",
                "Distance of each estimated knee center from the true one.",
                figures.motion_errors(truth, motions, knee),
            )
        )
    if replay.imu is not None:
        pictures.append(("imu", "What the sensors read.", figures.imu_curves(replay.imu)))
    return (*pictures, *replay_figures(replay))


def quality(results: Sequence[MethodResult], condition: str) -> tuple[Table, ...]:
    """Builds SSIM and RMSE by method and region, next to the published values.

    Then both to the phantom, where they are known, and gradient entropy. The published values are
    of that block ("30", "60" or "all").
    """
    ssim, rmse = [], []
    for result in results:
        for m in result.metrics.regions:
            ssim.append(
                published_tables.quality_entry(
                    "SSIM", condition, result.method, m.region, spread([m.ssim])
                )
            )
            rmse.append(
                published_tables.quality_entry(
                    "RMSE", condition, result.method, m.region, spread([m.rmse])
                )
            )
    regions = [m.region for m in results[0].metrics.regions]
    entropy = tuple(
        (r.method, *(f"{r.metrics.of(region).gradient_entropy:.3f}" for region in regions))
        for r in results
    )
    return (
        *published_tables.quality_tables(
            ssim,
            rmse,
            f"Table 1, {published_tables.heading(condition)}",
            results[0].metrics.protocol,
        ),
        *_to_phantom(results),
        Table(
            "Sharpness by gradient entropy", ("method", *regions), entropy, published_tables.ENTROPY
        ),
    )


def _to_phantom(results: Sequence[MethodResult]) -> tuple[Table, ...]:
    """SSIM and RMSE to the phantom itself; nothing where one was not compared with it."""
    regions = [m.region for m in results[0].metrics.regions]
    rows = []
    for result in results:
        found = [(m.ssim_phantom, m.rmse_phantom) for m in result.metrics.regions]
        ssim, rmse = zip(*found, strict=True)
        if None in (*ssim, *rmse):
            return ()
        rows.append((result.method, *(f"{v:.3f}" for v in (*ssim, *rmse))))
    heads = (f"{measure} {region}" for measure in ("SSIM", "RMSE") for region in regions)
    note = f"{published_tables.PHANTOM} {results[0].metrics.protocol}"
    return (Table("SSIM and RMSE to the phantom", ("method", *heads), tuple(rows), note),)


def scan_report(
    recovered: MovingLeg,
    results: Sequence[MethodResult],
    pictures: Sequence[Picture],
    summary: Sequence[str],
    provenance: Sequence[tuple[str, str]],
    *,
    side: str = "left",
    views: FloatArray | None = None,
) -> ReportContent:
    """Builds the page of a run.

    ``side`` is the scanned leg's, ``views`` (v,) s its times; None for the whole recording.
    """
    condition = condition_of(recovered, side, views)
    further = _residual_table(results, side)
    images = PageSection(
        "Image quality", tables=(*quality(results, condition), further), figures=tuple(pictures[:3])
    )
    return ReportContent(
        title=f"Scan of {recovered.name}",
        summary=tuple(summary),
        sections=(
            images,
            PageSection("Motion", lines=tuple(recovered.lines()), figures=tuple(pictures[3:])),
        ),
        provenance=tuple(provenance),
        files=(
            *replay_files(recovered),
            FileNote("config.toml", "every setting of this run"),
            FileNote("manifest.json", "versions, device, seconds and sha256 of every file"),
            FileNote("geometry.json", "one 3x4 matrix per view, mm to pixels"),
            FileNote("geometry_rtk.xml", "the same for RTK"),
            FileNote("projections.mha", "line integrals"),
            FileNote("scan.toml", "what a scanner would know; `legsim correct` reads it"),
            FileNote("metrics.json", "the numbers of the tables"),
            *(FileNote(f"volume-{r.method}.mha", "attenuation, 1/mm") for r in results),
        ),
    )


def _residual_table(results: Sequence[MethodResult], side: str) -> Table:
    """Builds the residual motion of each method, by structure, and its time."""
    structures = [r.structure for r in results[0].residuals]
    rows = []
    for result in results:
        left = [(_number(r.mm), _number(r.degrees), _number(r.pixels)) for r in result.residuals]
        rows.append(
            (
                result.method,
                *(cell for cells in left for cell in cells),
                f"{result.residual_px_after_similarity:.2f}",
                f"{result.seconds:.1f}",
            )
        )
    heads = (
        f"{structure} {unit}" for structure in structures for unit in ("(mm)", "(deg)", "(px)")
    )
    note = (
        f"RMS over the views and points of each structure of the {side} knee within the field of "
        "view: how far the method has them from "
        "where they were, by how much it turns a bone in excess, and how far apart the images see "
        "the two. Deformed images have no depth: pixels only. px after similarity: of all bones, "
        "after the constant turn, shift and scale that bring them nearest. Images cannot tell "
        "these three, and they blur nothing."
    )
    return Table(
        "Motion that was not undone, and time",
        ("method", *heads, "px after similarity", "seconds"),
        tuple(rows),
        f"Residual: {note}",
    )


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def condition_of(recovered: MovingLeg, side: str, views: FloatArray | None = None) -> str:
    """Block of the published table to compare with, by the mean bend of the scanned knee.

    Nothing is published of other postures than held squats.
    """
    poses = recovered.leg.segment_poses(recovered.trajectories)
    first, last = (-np.inf, np.inf) if views is None else (views[0], views[-1])
    during = (poses.times >= first) & (poses.times <= last)
    bend = float(np.degrees(poses.knee_flexion(side[0])[during].mean()))
    return "30" if 15 <= bend < 45 else "60" if 45 <= bend <= 75 else "no held squat"


def write_pictures(folder: Path, drawn: Sequence[tuple[str, str, Figure]]) -> list[Picture]:
    """Saves each figure as a PNG in ``folder`` and returns it for the report."""
    folder.mkdir(exist_ok=True)
    pictures = []
    for stem, caption, figure in drawn:
        content = figures.png(figure)
        files.write_bytes(folder / f"{stem}.png", content)
        pictures.append(Picture(caption, content, caption, f"{folder.name}/{stem}.png"))
    return pictures
