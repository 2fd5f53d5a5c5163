"""The page of `legsim replay`: residuals of markers, ranges of coordinates, and pictures."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from legsim import figures
from legsim.imu import plausibility as imu_plausibility
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap.cleaning import CleaningReport
from legsim.report.page import FileNote, PageSection, Picture, ReportContent, Table
from legsim.scene.values import ReplayScene

if TYPE_CHECKING:
    from legsim.figures import Figure


REPLAY_FILES = (
    FileNote("recording.rrd", "everything over time; open with `legsim view` or the rerun viewer"),
    FileNote("coordinates.mot", "joint coordinates, for OpenSim"),
    FileNote("coordinates_from_zero.mot", "joint coordinates from the static trial's mean pose"),
    FileNote("joint_centres.csv", "hip, knee and ankle centers in world, m"),
    FileNote("poses.npz", "segment poses"),
    FileNote("imu.csv", "what the sensors read, in their own frames"),
    FileNote("scaled_model.osim", "the leg in this person's size, with markers, for OpenSim"),
    FileNote("scale_factors.xml", "factors of the bodies, for OpenSim's scale tool"),
    FileNote("model_markers.trc", "where the model has the markers"),
    FileNote("marker_errors.sto", "distances of measured from modeled markers, by frame, m"),
)
"""of a replay, and among those of a run"""


def replay_figures(scene: ReplayScene) -> tuple[tuple[str, str, Figure], ...]:
    """Draws (file stem, caption, figure) of the motion itself."""
    pictures = [
        (
            "joint-angles",
            "Joint angles over the recording, by the model's signs.",
            figures.joint_angles(scene.trajectories, scene.angles()),
        ),
        (
            "sway",
            "How far the joint centers deviate from their means.",
            figures.sway(scene.joint_centers),
        ),
    ]
    if scene.measured is not None:
        pictures.append(
            (
                "markers",
                "Distance between measured markers and the model's.",
                figures.marker_residuals(scene),
            )
        )
    return tuple(pictures)


def replay_files(recovered: MovingLeg) -> tuple[FileNote, ...]:
    """Lists the files that a replay leaves of this person.

    A user's own model has no scaled model unless it was scaled; without markers there are no marker
    files.
    """
    leg = recovered.leg
    left_out = set() if isinstance(leg, OsimLeg) and leg.model.factors else {"scale_factors.xml"}
    if left_out and not isinstance(leg, LegModel):
        left_out.add("scaled_model.osim")
    left_out |= {"coordinates_from_zero.mot"} if recovered.zero is None else set()
    left_out |= {"model_markers.trc", "marker_errors.sto"} if recovered.fit is None else set()
    return tuple(note for note in REPLAY_FILES if note.name not in left_out)


def replay_report_lines(recovered: MovingLeg, out: Path) -> list[str]:
    """Formats the output of `legsim replay`."""
    files = ", ".join(note.name for note in replay_files(recovered))
    return [
        *recovered.lines(),
        f"report: {out / 'report.html'}",
        f"files: {files} in {out}",
        f"to look around: {shlex.join(['legsim', 'view', str(out)])}",
    ]


def still(scene: ReplayScene) -> bytes:
    """Draws the PNG of the body in the middle of the recording."""
    return figures.png(figures.still(scene, _middle(scene)))


def content(
    recovered: MovingLeg,
    scene: ReplayScene,
    posture: bytes,
    provenance: Sequence[tuple[str, str]],
    further: Sequence[PageSection] = (),
) -> ReportContent:
    """Builds the page's content.

    ``posture`` is the :func:`still`; all other figures are drawn here. ``further`` sections are
    put at the end.
    """
    seen = f"The middle of the recording, {_middle(scene):.2f} s."
    curves = (
        []
        if scene.imu is None
        else [("imu", "What the sensors read, by their own clock.", figures.imu_curves(scene.imu))]
    )
    fit = recovered.fit
    marker_sections = [] if fit is None else [PageSection("Markers", tables=_marker_tables(fit))]
    return ReportContent(
        title=f"Replay of {recovered.name}",
        summary=tuple(recovered.lines()),
        sections=(
            PageSection("Posture", figures=(Picture(seen, posture, seen),)),
            *marker_sections,
            PageSection("Joint coordinates", tables=(coordinate_table(recovered),)),
            PageSection("Curves", figures=_drawn([*replay_figures(scene), *curves])),
            *further,
        ),
        provenance=tuple(provenance),
        files=(
            *replay_files(recovered),
            FileNote("kinematics.json", "the numbers of this page"),
            FileNote("manifest.json", "versions, seconds and sha256 of every file"),
        ),
        warnings=(
            *recovered.warnings,
            *(() if scene.imu is None else imu_plausibility.objections(scene.imu)),
            *(() if fit is None else warnings(fit)),
        ),
    )


def _middle(scene: ReplayScene) -> float:
    return float(np.mean(scene.trajectories.times[[0, -1]]))


def marker_table(fit: MarkerFit) -> Table:
    """Builds one row per marker: its distance from the model, and its repairs."""
    ik, times = fit.ik, fit.measured.times
    rows = []
    for k, name in enumerate(ik.marker_names):
        cleaned = fit.cleaning.of(name)
        seen = ik.marker_seen[k] > 0
        rows.append(
            (
                name,
                ", ".join(cleaned.labels),
                f"{1e3 * ik.marker_rms[k]:.1f}" if seen else "–",
                f"{1e3 * ik.marker_worst[k]:.1f}" if seen else "–",
                f"{ik.marker_worst_frame[k]} ({times[ik.marker_worst_frame[k]]:.2f} s)"
                if seen
                else "–",
                *(
                    str(count)
                    for count in (
                        cleaned.missing,
                        cleaned.jumps_removed,
                        cleaned.filled,
                        cleaned.rebuilt,
                        cleaned.left_missing,
                    )
                ),
                f"{cleaned.longest_gap_s:.2f}",
            )
        )
    heads = (
        "role",
        "labels",
        "RMS (mm)",
        "worst (mm)",
        "worst frame",
        "missing",
        "jumps removed",
        "filled",
        "rebuilt",
        "left out",
    )
    return Table(
        "Markers",
        (*heads, "longest gap (s)"),
        tuple(rows),
        "RMS and worst: distance to the model. Missing, jumps, filled, rebuilt, left out: "
        "samples. Rebuilt ones, among the filled, come "
        "from other markers on the same segment; left out ones stayed unseen for the solver. "
        "Frames count from 0.",
    )


def coordinate_table(recovered: MovingLeg) -> Table:
    """Builds one row per coordinate: its range, and what decides it."""
    fit = recovered.fit
    rows, spread = [], recovered.standard_deviations()
    for k, row in enumerate(recovered.ranges()):
        cells = (
            row.name,
            row.unit,
            *(f"{v:.2f}" for v in (row.mean, row.rms, row.lowest, row.highest)),
        )
        rate = (f"{row.highest_rate:.1f}", str(row.highest_rate_frame))
        rate = (*rate, *_from_zero(recovered, k, row.mean))
        known = (
            ()
            if fit is None
            else (
                f"{spread[k]:.1f}",
                f"{fit.ik.coordinate_share[k]:.2f}",
                str(fit.ik.coordinate_at_limit[k]),
                str(fit.ik.coordinate_by_prior[k]),
            )
        )
        rows.append((*cells, *rate, *known))
    heads = (
        "coordinate",
        "unit",
        "mean",
        "RMS about it",
        "lowest",
        "highest",
        "fastest (per s)",
        "at frame",
    )
    own, zero = isinstance(recovered.leg, LegModel), recovered.zero
    if zero is not None:
        heads = (*heads, f"mean in {zero.file}", "mean from there")
    note = "Knee flexion is negative, as in gait2392." if own else "By the signs of the model."
    if fit is None:
        return Table("Joint coordinates", heads, tuple(rows), note)
    shares = (
        " Standard deviation: what errors and places of the markers, and the priors, leave open. "
        "Decided by markers: 1 where the markers alone decide it, 0 where priors, tasks or locks "
        "do. Frames by prior: those that show fewer than three markers of that foot, or none on "
        "the toes."
    )
    return Table(
        "Joint coordinates",
        (*heads, "standard deviation", "decided by markers", "frames at limit", "frames by prior"),
        tuple(rows),
        note + shares,
    )


def _from_zero(recovered: MovingLeg, row: int, mean: float) -> tuple[str, ...]:
    """Cells of a coordinate's zero, and of its mean from there, where there is one."""
    if recovered.zero is None:
        return ()
    factor = 1e3 if recovered.ranges()[row].unit == "mm" else np.degrees(1.0)
    value = factor * float(recovered.zero.values[row])
    return f"{value:.2f}", f"{mean - value:.2f}"


def warnings(fit: MarkerFit) -> tuple[str, ...]:
    """Lists what a reader should look at first."""
    ik, lines = fit.ik, list[str]()
    if fit.cleaning.never_seen:
        lines.append(f"Never seen: {', '.join(fit.cleaning.never_seen)}.")
    if len(ik.frames_unconverged):
        lines.append(
            f"{len(ik.frames_unconverged)} frames did not converge, the first is frame "
            f"{ik.frames_unconverged[0]}."
        )
    if len(ik.frames_unseen):
        lines.append(
            f"{len(ik.frames_unseen)} frames show no marker and are bridged, the first is frame "
            f"{ik.frames_unseen[0]}."
        )
    if _filled_share(fit.cleaning) > 0.1:
        lines.append(
            f"{100 * _filled_share(fit.cleaning):.0f} % of the samples of a marker were bridged: "
            "see the table."
        )
    return tuple(lines)


def _filled_share(cleaning: CleaningReport) -> float:
    return max(role.filled / max(role.samples, 1) for role in cleaning.roles)


def _marker_tables(fit: MarkerFit) -> tuple[Table, ...]:
    scales = tuple((m.name, f"{1e3 * m.measured:.1f}") for m in fit.scaling.measurements)
    lengths = Table(
        f"Lengths that scaled the model, from {fit.scaled_from}",
        ("length", "measured (mm)"),
        scales,
    )
    tables = (marker_table(fit), lengths) if scales else (marker_table(fit),)
    return *tables, *_registration_tables(fit)


def _registration_tables(fit: MarkerFit) -> tuple[Table, ...]:
    """Where registration has the markers, against where the scaled model has them."""
    found = fit.registration
    if found is None:
        return ()
    rows = []
    for name, place in zip(found.sites.names, found.sites.positions, strict=True):
        off = 1e3 * (place - fit.scaling.sites.position(name))
        rows.append((name, *(f"{x:.1f}" for x in off)))
    note = (
        f"Found together with the poses over {found.frames} frames of {fit.scaled_from}: RMS "
        f"{1e3 * found.rms_before:.1f} mm before, {1e3 * found.rms_after:.1f} mm after. Against "
        "the scaled model's places, along x (forward), y (up) and z (right) of the segment."
    )
    heads = ("role", "x (mm)", "y (mm)", "z (mm)")
    return (Table("Places of the markers", heads, tuple(rows), note),)


def _drawn(pictures: Sequence[tuple[str, str, Figure]]) -> tuple[Picture, ...]:
    return tuple(Picture(caption, figures.png(figure), caption) for _, caption, figure in pictures)
