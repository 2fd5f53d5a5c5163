"""From a motion file to a person that moves: cleaned markers, a scaled leg, joint coordinates, and
a report on each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from legsim.core import resources
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.kinematics import (
    inverse_kinematics,
    marker_sites,
    on_osim_model,
    osim_scaling,
    scaling,
    smoothing,
)
from legsim.kinematics.inverse_kinematics import Solution
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.scaling import Scaling
from legsim.kinematics.skeleton import SegmentScales
from legsim.mocap import cleaning as mocap_cleaning
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets, opensim
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.files import load_markers, read_markers
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_Result = TypeVar("_Result")

_LARGEST_EXTENSION_DEG = 20.0


@dataclass(frozen=True, slots=True)
class _Reading:
    """How marker files are read and cleaned: the keyword arguments of :func:`solve_kinematics`."""

    marker_map: str | Path
    unit: str | None
    up: str | None
    filter_hz: float
    longest_gap: float
    marker_noise: float


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
            "give a .trc, .c3d, .mot or .sto file",
        ) from None


def files_read(
    recording: str | Path,
    *,
    marker_map: str | Path = "auto",
    scale_from: str | Path | None = None,
    model: str | Path | None = None,
    scale_file: str | Path | None = None,
) -> tuple[Path, ...]:
    """The files that :func:`solve_kinematics` reads: recording, scaling trial, own marker map,
    model, scale file.

    Raises:
        LegsimError: one of them is not there.
    """
    path = find_recording(recording)
    files = [path, _scaling_source(path, scale_from)]
    _check_there(model, scale_file)
    files += [Path(given) for given in (model, scale_file) if given]
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
    model: str | Path | None = None,
    scale_file: str | Path | None = None,
    filter_coordinates: bool = False,
) -> MovingLeg:
    """Reads a recording, cleans it, scales the leg model to the person and solves for joint angles.

    Coordinates (.mot, .sto) are taken as they are, unless ``filter_coordinates``.

    Args:
        recording: a motion file, or the name of one that ships with legsim.
        marker_map: a TOML file, the name of a shipped marker set, or "auto" for the shipped one
            that covers the file.
        unit: of lengths, "m", "cm" or "mm"; None believes the header.
        up: vertical axis of the laboratory, "x", "y" or "z"; None finds it.
        filter_hz: cut-off of the markers' zero-phase Butterworth filter; 0 leaves them as they are.
        longest_gap: s, longer gaps are not bridged.
        marker_noise: m, RMS of a marker's white noise per axis: joint angles are filtered further,
            as low as that hides.
        scale_from: recording that the model is scaled from. None: the person's active squats for
            legsim's own recordings, else ``recording`` itself.
        model: an OpenSim model (.osim) whose legs are used instead of legsim's own, with its
            markers and as large as it is.
        scale_file: OpenSim's scale factors (.xml) for the generic leg, or for ``model``.
        filter_coordinates: low-pass joint coordinates of a .mot or .sto too.

    Raises:
        LegsimError: anything that a careful person would object to, with file, place and fix.

    >>> person = solve_kinematics("subject01/squat_60.trc")
    >>> person.name, len(person.trajectories.times)
    ('squat_60.trc', 2400)
    """
    path = find_recording(recording)
    reading = _Reading(marker_map, unit, up, filter_hz, longest_gap, marker_noise)
    _check_one_size(path, scale_from, model, scale_file)
    low_pass_hz = filter_hz if filter_coordinates else 0.0
    _check_there(model, scale_file)
    if model is not None:
        return _on_model(reading, path, model, scale_file, low_pass_hz)
    if mocap_files.kind(path) in ("storage", "csv"):
        loaded = mocap_files.load_recording(path)
        if isinstance(loaded, JointTrajectories):
            scaled = None if scale_from is None else find_recording(scale_from)
            return _from_coordinates(loaded, path, scaled, scale_file, reading, low_pass_hz)
    # a trial that is scaled from another may go without the landmarks that only scaling needs
    given = scale_from or scale_file
    measured, cleaning, notes = _cleaned(reading, path, required=() if given else PAPER_ROLES)
    scaled_from = Path(scale_file) if scale_file else _scaling_source(path, scale_from)
    same = scale_file or scaled_from == path
    reference = measured if same else _cleaned(reading, scaled_from)[0]
    sites = marker_sites.load()
    if scale_file:
        fitted, said = _given_scales(scale_file, sites, measured)
        notes = (*notes, *said)
    else:
        fitted = _named(path, lambda: scaling.fit(LegModel.load(), reference, sites))
    leg = LegModel.load(fitted.scales)
    placed = fitted.sites
    loose = marker_sites.calibrated_roles() & set(measured.marker_names)
    if loose:
        placed = inverse_kinematics.calibrate(leg, reference, placed, loose)
    solution = _named(path, lambda: inverse_kinematics.solve(leg, measured, placed))
    how = _Fitting(fitted, scaled_from.name, notes)
    return _solved(reading, path, leg, solution, measured, placed, cleaning, how)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitting:
    """How the person's size was found."""

    scaling: Scaling
    source: str
    notes: tuple[str, ...]


def _solved(
    reading: _Reading,
    path: Path,
    leg: Leg,
    solution: Solution,
    measured: MarkerTrajectories,
    placed: MarkerSites,
    cleaning: CleaningReport,
    how: _Fitting,
) -> MovingLeg:
    """The moving person of a solution, its coordinates filtered as low as marker noise hides."""
    names = solution.modelled.marker_names
    shown = MarkerTrajectories(
        measured.times, names, np.stack([measured.marker(n) for n in names], 1)
    )
    settled, settled_hz = smoothing.smooth_below_noise(
        leg,
        solution.trajectories,
        placed.only(names),
        noise=reading.marker_noise,
        filter_hz=reading.filter_hz,
    )
    fit = MarkerFit(
        shown,
        solution.modelled,
        placed.only(names),
        cleaning,
        how.scaling,
        solution.report,
        how.source,
        settled_hz,
    )
    return MovingLeg(path.name, leg, settled, fit, how.notes)


def _on_model(
    reading: _Reading,
    path: Path,
    model: str | Path,
    scale_file: str | Path | None,
    low_pass_hz: float,
) -> MovingLeg:
    """The recording on the user's own OpenSim model."""
    leg, notes = on_osim_model.load(model, scale_file)
    if mocap_files.kind(path) == "storage":
        loaded = opensim.load(path, rotations=leg.rotations())
        return _coordinates_on_model(leg, loaded, path, notes, low_pass_hz)
    if mocap_files.kind(path) == "csv":
        table = mocap_files.load_recording(path)
        if isinstance(table, JointTrajectories):
            return _coordinates_on_model(leg, table, path, notes, low_pass_hz)
    raw, read_notes = _read(path, unit=reading.unit, up=reading.up)
    own, sites, said = _named(path, lambda: on_osim_model.marker_map(leg, raw.marker_names))
    measured, cleaning = _named(
        path,
        lambda: mocap_cleaning.clean(
            raw,
            own,
            filter_hz=reading.filter_hz,
            longest_gap_s=reading.longest_gap,
            required=(),
        ),
    )
    sites = sites.only([name for name in sites.names if name in measured.marker_names])
    size = _named(path, lambda: on_osim_model.size_note(sites, measured))
    leg, locked = on_osim_model.held_leg(leg)
    config = on_osim_model.replay_config(leg, sites)
    solution = _named(path, lambda: inverse_kinematics.solve(leg, measured, sites, config))
    known = _Fitting(
        Scaling(leg.scales, sites, ()),
        leg.model.path.name,
        (*read_notes, *notes, *said, *size, *locked),
    )
    return _solved(reading, path, leg, solution, measured, sites, cleaning, known)


def _coordinates_on_model(
    leg: OsimLeg,
    loaded: JointTrajectories,
    path: Path,
    notes: tuple[str, ...],
    low_pass_hz: float,
) -> MovingLeg:
    """Coordinates of a file on the user's own model, as they are."""
    leg, moved, said = _named(path, lambda: on_osim_model.coordinates(leg, loaded))
    turns = [n for n in leg.coordinate_names[leg.pelvis_coordinates :] if n not in leg.shifts]
    _check_angles(path, moved, turns)
    values = moved.values
    if low_pass_hz > 0:
        values = _named(path, lambda: smoothing.low_pass(values, loaded.times, low_pass_hz))
    return MovingLeg(
        path.name,
        leg,
        JointTrajectories(loaded.times, leg.coordinate_names, values),
        None,
        (*notes, *said, *_gap_note(loaded.times)),
    )


def _check_there(model: str | Path | None, scale_file: str | Path | None) -> None:
    """Refuses a model or scale file that is not there."""
    for given, what in ((model, "an OpenSim model (.osim)"), (scale_file, "a scale file (.xml)")):
        if given and not Path(given).is_file():
            raise file_error(given, "no such file", f"give {what}")


def _check_one_size(
    path: Path,
    scale_from: str | Path | None,
    model: str | Path | None,
    scale_file: str | Path | None,
) -> None:
    """Refuses a size that is given twice."""
    if scale_from and (model or scale_file):
        other = "motion.model" if model else "motion.scale_file"
        raise file_error(
            path,
            f"its person's size is given twice, by motion.scaling_file and {other}",
            "leave motion.scaling_file out",
            place="settings",
        )


def _scales_of(scale_file: str | Path) -> tuple[SegmentScales, tuple[str, ...]]:
    """Scales of legsim's own leg by a scale file, and notes."""
    factors = osim_scaling.read(scale_file)
    return _named(Path(scale_file), lambda: osim_scaling.segment_scales(factors))


def _given_scales(
    scale_file: str | Path, sites: MarkerSites, measured: MarkerTrajectories
) -> tuple[Scaling, tuple[str, ...]]:
    """Factors of a scale file, and the recording's markers on the scaled segments."""
    factors, notes = _scales_of(scale_file)
    known = sites.only([name for name in measured.marker_names if name in sites.names])
    return Scaling(factors, known.scaled(factors), ()), notes


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
    raw, notes = _read(path, unit=reading.unit, up=reading.up)

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

    return *_named(path, cleaned), notes


def _read(
    path: Path, *, unit: str | None, up: str | None
) -> tuple[MarkerTrajectories, tuple[str, ...]]:
    """The markers, and a word on unit and vertical as they were read and on what the reader put
    right.
    """
    if mocap_files.kind(path) == "csv":
        return load_markers(path), ()
    raw = read_markers(path)
    return raw.to_motion(unit=unit, up=up), (
        f"lengths in {raw.resolved_unit(unit)}, {raw.resolved_up(up, unit=unit)} up",
        *raw.notes,
    )


def _named(path: Path, compute: Callable[[], _Result]) -> _Result:
    """Puts the file's name before what a stage that knows no files objects to."""
    try:
        return compute()
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def _from_coordinates(
    loaded: JointTrajectories,
    path: Path,
    scaled_from: Path | None,
    scale_file: str | Path | None,
    reading: _Reading,
    low_pass_hz: float,
) -> MovingLeg:
    leg, sized = LegModel.load(), ()
    if scaled_from is not None:
        reference, _, _ = _cleaned(reading, scaled_from)
        leg = LegModel.load(scaling.fit(leg, reference, marker_sites.load()).scales)
    elif scale_file is not None:
        factors, sized = _scales_of(scale_file)
        leg = LegModel.load(factors)
    else:
        sized = (
            "put on legsim's generic leg, thigh "
            f"{1e2 * leg.thigh_length('r'):.1f} cm and shank {1e2 * leg.shank_length('r'):.1f} cm: "
            "give --model, --scale-file or motion.scaling_file for the person's own",
        )
    completed, filled = _with_feet(loaded)
    values, turned = _with_our_knee_sign(
        _named(path, lambda: leg.values_of(completed)), loaded.coordinate_names
    )
    turns = [name for name in COORDINATES if not name.startswith("pelvis")]
    _check_angles(path, JointTrajectories(loaded.times, COORDINATES, values), turns)
    if low_pass_hz > 0:
        values = _named(path, lambda: smoothing.low_pass(values, loaded.times, low_pass_hz))
    return MovingLeg(
        path.name,
        leg,
        JointTrajectories(loaded.times, leg.coordinate_names, values),
        None,
        (*sized, *filled, *turned, *_gap_note(loaded.times)),
    )


def _with_feet(loaded: JointTrajectories) -> tuple[JointTrajectories, tuple[str, ...]]:
    """Subtalar and toe joints at zero where a model had none, and a note; whatever else is missing
    stays so.
    """
    lacking = [
        name
        for name in COORDINATES
        if name.startswith(("subtalar", "mtp")) and name not in loaded.coordinate_names
    ]
    if not lacking:
        return loaded, ()
    values = np.hstack([loaded.values, np.zeros((len(loaded.times), len(lacking)))])
    completed = JointTrajectories(loaded.times, (*loaded.coordinate_names, *lacking), values)
    return completed, (f"the file has no {', '.join(lacking)}: taken as 0",)


def _check_angles(path: Path, moved: JointTrajectories, turns: Sequence[str]) -> None:
    """Refuses joints turned by more than half a turn: degrees that the header calls radians."""
    for name in turns:
        angles = moved.coordinate(name)
        beyond = np.flatnonzero(np.abs(angles) > np.pi)
        if len(beyond):
            angle, time = np.degrees(angles[beyond[0]]), moved.times[beyond[0]]
            raise file_error(
                path,
                f"{name} is {angle:.0f} degrees at {time:g} s, which no joint can be",
                "if its angles are in degrees, write inDegrees=yes into the header",
                place="coordinates",
            )


def _gap_note(times: FloatArray) -> tuple[str, ...]:
    """A word on samples left out, across which the curves are only guessed."""
    steps = np.diff(times)
    if len(steps) == 0 or steps.max() <= 2.5 * np.median(steps):
        return ()
    k = int(steps.argmax())
    return (
        f"{steps[k]:.3g} s are missing after {times[k]:g} s (elsewhere a sample every "
        f"{np.median(steps):.3g} s): bridged by splines",
    )


def _with_our_knee_sign(
    values: FloatArray, file_names: tuple[str, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Knee angles negative in flexion, as in gait2392, and a note where the file had them the other
    way round.

    Rajagopal2016 and its kin count flexion positive: they have a patella coordinate
    (knee_angle_r_beta), or bend where no knee of gait2392 can (its limit is 10 degrees of
    extension).
    """
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    bends = np.degrees(values[:, knees])
    rajagopal = "knee_angle_r_beta" in file_names or (
        bends.max() > _LARGEST_EXTENSION_DEG and bends.max() > -bends.min()
    )
    if not rajagopal:
        return values, ()
    turned = values.copy()
    turned[:, knees] *= -1
    return turned, (
        "knee angles were positive in flexion (as in Rajagopal2016); their sign was turned to "
        "gait2392's",
    )
