"""From a motion file to a person that moves: cleaned markers, a scaled leg, joint coordinates, and
a report on each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import resources
from legsim.core.errors import LegsimError, file_error, printable
from legsim.kinematics import inverse_kinematics, marker_sites, scaling, smoothing
from legsim.kinematics.from_coordinates import moving_leg, named
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.mocap import cleaning as mocap_cleaning
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.coordinates import RawCoordinates
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories


@dataclass(frozen=True, slots=True)
class _Reading:
    """How marker files are read and cleaned: the keyword arguments of :func:`solve_kinematics`."""

    marker_map: str | Path
    unit: str | None
    up: str | None
    filter_hz: float
    longest_gap: float


def find_recording(file: str | Path) -> Path:
    """The path of a motion file: as given, or one that ships with legsim under motions/.

    Raises:
        LegsimError: it is neither.
    """
    if Path(file).is_file():
        return Path(file)
    try:
        return resources.motion_file(str(file))
    except LegsimError:
        raise file_error(
            file,
            "no such motion file, here or among the shipped ones",
            f"give a {mocap_files.known_suffixes()} file",
        ) from None


def files_read(
    recording: str | Path, *, marker_map: str | Path = "auto", scale_from: str | Path | None = None
) -> tuple[Path, ...]:
    """The files that :func:`solve_kinematics` reads: recording, scaling trial, own marker map."""
    path = find_recording(recording)
    files = [path, _scaling_source(path, scale_from)]
    if str(marker_map).endswith(".toml") and Path(marker_map).is_file():
        files.append(Path(marker_map))
    return tuple(files)


def solve_kinematics(
    recording: str | Path,
    *,
    marker_map: str | Path = "auto",
    unit: str | None = None,
    up: str | None = None,
    filter_hz: float = 6.0,
    longest_gap: float = 2.0,
    marker_noise: float = 0.2e-3,
    scale_from: str | Path | None = None,
    filter_coordinates: bool = False,
    in_degrees: bool | None = None,
) -> MovingLeg:
    """Reads a recording, cleans it, scales the leg model to the person and solves for joint angles.

    Coordinates (.mot, .sto) are taken as they are, unless ``filter_coordinates``.

    Args:
        recording: a motion file, or the name of one that ships with legsim.
        marker_map: a TOML file, the name of a shipped marker set, or "auto" for the shipped one
            that covers the file.
        unit: of lengths, "m", "cm" or "mm"; None believes the file.
        up: vertical axis of the laboratory, "x", "y", "z" or one of them with a minus; None
            believes the file, or guesses it from how the body lies.
        filter_hz: cut-off of the markers' zero-phase Butterworth filter; 0 leaves them as they are.
        longest_gap: s, longer gaps are not bridged.
        marker_noise: m, RMS of a marker's white noise per axis: joint angles are filtered further,
            as low as that hides.
        scale_from: recording that the model is scaled from. None: the person's active squats for
            legsim's own recordings, else ``recording`` itself.
        filter_coordinates: low-pass joint coordinates of a .mot, .sto or .csv too.
        in_degrees: whether the angles of a .mot or .sto are in degrees; None believes the header
            as far as the angles bear it out.

    Raises:
        LegsimError: anything that a careful person would object to, with file, place and fix.

    >>> person = solve_kinematics("subject01/squat_60.trc")
    >>> person.name, len(person.trajectories.times)
    ('squat_60.trc', 2400)
    """
    path = find_recording(recording)
    reading = _Reading(marker_map, unit, up, filter_hz, longest_gap)
    raw = mocap_files.read_raw(path)
    if isinstance(raw, RawCoordinates):
        scaled = None if scale_from is None else find_recording(scale_from)
        if scaled is None:
            _refuse_marker_options(path, reading, filter_coordinates)
        found = mocap_files.resolve(
            path, raw, unit=unit, up=None if scaled else up, in_degrees=in_degrees
        )
        low_pass_hz = filter_hz if filter_coordinates else 0.0
        return moving_leg(found, path, _scaled(reading, scaled), low_pass_hz=low_pass_hz)
    mocap_files.refuse_options(path, {"angles": in_degrees}, "markers, not joint coordinates")
    # a trial that is scaled from another may go without the landmarks that only scaling needs
    measured, cleaning, notes = _cleaned(reading, path, required=() if scale_from else PAPER_ROLES)
    scaled_from = _scaling_source(path, scale_from)
    reference = measured if scaled_from == path else _cleaned(reading, scaled_from)[0]
    sites = marker_sites.load()
    fitted = named(path, lambda: scaling.fit(LegModel.load(), reference, sites))
    leg = LegModel.load(fitted.scales)
    placed = fitted.sites
    loose = marker_sites.calibrated_roles() & set(measured.marker_names)
    if loose:
        placed = inverse_kinematics.calibrate(leg, reference, placed, loose)
    solution = named(path, lambda: inverse_kinematics.solve(leg, measured, placed))
    names = solution.modelled.marker_names
    shown = MarkerTrajectories(
        measured.times, names, np.stack([measured.marker(n) for n in names], 1)
    )
    settled, settled_hz = smoothing.smooth_below_noise(
        leg,
        solution.trajectories,
        placed.only(names),
        noise=marker_noise,
        filter_hz=filter_hz,
    )
    fit = MarkerFit(
        shown,
        solution.modelled,
        cleaning,
        fitted,
        solution.report,
        printable(scaled_from.name),
        settled_hz,
    )
    return MovingLeg(printable(path.name), leg, settled, fit, notes)


def _scaling_source(path: Path, scale_from: str | Path | None) -> Path:
    """The recording that the model is scaled from.

    The one that is named; for legsim's own held squats the person's active squats, as in the
    published study; else the recording itself.
    """
    if scale_from:
        return find_recording(scale_from)
    squats = path.with_name("squats.trc")
    own = path.name.startswith("squat_") and path.resolve().is_relative_to(
        resources.motion_file("README.md").resolve().parent
    )
    return squats if own and squats.is_file() else path


def _cleaned(
    reading: _Reading, path: Path, required: Sequence[str] = PAPER_ROLES
) -> tuple[MarkerTrajectories, CleaningReport, tuple[str, ...]]:
    """The markers by role, what was done to them, and what the reader has to say about the file."""
    raw, notes = mocap_files.read_markers(path, unit=reading.unit, up=reading.up)

    def cleaned() -> tuple[MarkerTrajectories, CleaningReport]:
        automatic = reading.marker_map == "auto"
        chosen = (
            marker_sets.guess(raw.marker_names, required=required)
            if automatic
            else marker_sets.load(str(reading.marker_map))
        )
        return mocap_cleaning.clean(
            raw,
            chosen,
            filter_hz=reading.filter_hz,
            longest_gap_s=reading.longest_gap,
            required=required,
        )

    markers, report = named(path, cleaned)
    return markers, report, (*notes, *report.notes)


def _refuse_marker_options(path: Path, reading: _Reading, filter_coordinates: bool) -> None:
    """Refuses what is said about markers where the file holds none, and no other is read."""
    usual = _Reading("auto", reading.unit, None, 6.0, 2.0)
    filtered = filter_coordinates or reading.filter_hz in (0.0, usual.filter_hz)
    given = {
        "marker_map": reading.marker_map if reading.marker_map != usual.marker_map else None,
        "up": reading.up,
        "longest_gap_s": reading.longest_gap if reading.longest_gap != usual.longest_gap else None,
        "filter_hz": None if filtered else reading.filter_hz,
    }
    mocap_files.refuse_options(path, given, "joint coordinates, not markers")


def _scaled(reading: _Reading, reference: Path | None) -> LegModel:
    """The model at the size of the person in another recording; as it comes without one."""
    leg = LegModel.load()
    if reference is None:
        return leg
    markers, _, _ = _cleaned(reading, reference)
    return LegModel.load(scaling.fit(leg, markers, marker_sites.load()).scales)
