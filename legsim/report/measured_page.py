"""The page of `legsim correct`: sharpness before and after, motions and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from legsim import figures
from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction.method import Scan
from legsim.deformation.models import Motion
from legsim.report.page import FileNote, PageSection, Picture, ReportContent, Table
from legsim.scene.values import MeasuredScene

if TYPE_CHECKING:
    from legsim.figures import Figure

SHARPNESS_COLUMNS = (
    "method",
    "gradient entropy",
    "change",
    "farthest (mm)",
    "turned (deg)",
    "seconds",
)

_ENTROPY = (
    "Gradient entropy in nats, in the cylinder about the middle of the grid that all views see: "
    "blur and streaks raise it, so that below 0 is sharper. It knows no truth: a correction can be "
    "sharp and wrong. Farthest and turned: the largest motion of the middle of the grid, and the "
    "largest rotation, against the first view."
)


@dataclass(frozen=True, slots=True)
class Sharpness:
    """How sharp one method's volume is, and how far its motion goes."""

    method: str
    gradient_entropy: float
    """nats"""
    farthest_mm: float | None
    """largest shift of the middle of the grid; None without motion"""
    turned_deg: float | None
    """largest rotation"""
    seconds: float

    def row(self, baseline: Sharpness) -> tuple[str, ...]:
        """Formats the numbers beside those of the uncorrected scan."""
        change = self.gradient_entropy - baseline.gradient_entropy
        return (
            self.method,
            f"{self.gradient_entropy:.4f}",
            "–" if self is baseline else f"{change:+.4f}",
            "–" if self.farthest_mm is None else f"{self.farthest_mm:.2f}",
            "–" if self.turned_deg is None else f"{self.turned_deg:.3f}",
            f"{self.seconds:.1f}",
        )


def largest_turn(matrices: FloatArray) -> float:
    """Largest rotation in degrees of (v, 4, 4)."""
    return float(np.degrees(transforms.rotation_angle(matrices[:, :3, :3]).max()))


def measured_figures(
    scene: MeasuredScene, motions: Sequence[tuple[str, Motion]], center: Sequence[float]
) -> tuple[tuple[str, str, Figure], ...]:
    """Draws (file stem, caption, figure) of every picture of a measured scan."""
    pictures = [
        (
            "slices",
            "Axial slices 5 cm below and above the middle of the grid, and the sagittal slice "
            "through it, one column per method.",
            figures.slices(scene.slices),
        ),
        ("projections", "Projections through the scan.",
         figures.projection_montage(scene.projections)),
    ]  # fmt: skip
    if motions:
        pictures.append(
            (
                "motions",
                "Where each method has the middle of the grid, against the first view.",
                figures.motion_paths(motions, np.array(center)),
            )
        )
    if scene.imu.sensor_names:
        pictures.append(("imu", "What the sensors read.", figures.imu_curves(scene.imu)))
    return tuple(pictures)


def measured_report(
    scan: Scan,
    sharpness: Sequence[Sharpness],
    pictures: Sequence[Picture],
    notes: Sequence[str],
    provenance: Sequence[tuple[str, str]],
) -> ReportContent:
    """Builds the page; the first of ``sharpness`` is the uncorrected scan."""
    table = Table(
        "Sharpness and motion",
        SHARPNESS_COLUMNS,
        tuple(one.row(sharpness[0]) for one in sharpness),
        _ENTROPY,
    )
    seconds = np.ptp(scan.times)
    rows, columns = scan.projections.geometry.shape_vu
    summary = (
        f"{len(scan.times)} views of {columns}x{rows} pixels in {seconds:.1f} s; sensors: "
        f"{', '.join(scan.signals.sensor_names) or 'none'}.",
        *notes,
    )
    moved = [one.method for one in sharpness if one.farthest_mm is not None]
    return ReportContent(
        title="Correction of a measured scan",
        summary=summary,
        sections=(
            PageSection("Image quality", tables=(table,), figures=tuple(pictures[:2])),
            PageSection("Motion", figures=tuple(pictures[2:])),
        ),
        provenance=tuple(provenance),
        files=(
            *(FileNote(f"volume-{s.method}.mha", "attenuation, 1/mm") for s in sharpness),
            *(FileNote(f"motion-{m}.csv", "one matrix per view, mm") for m in moved),
            FileNote("recording.rrd", "everything over time; open with `legsim view`"),
            FileNote("manifest.json", "versions, device, seconds and sha256 of every file"),
        ),
    )
