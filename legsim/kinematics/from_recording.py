"""From a motion file to a person that moves: cleaned markers, a scaled leg, joint coordinates, and
a report on each.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim.core import resources
from legsim.core.errors import LegsimError, file_error, printable
from legsim.core.files import is_file
from legsim.kinematics import (
    _stance,
    from_coordinates,
    ik_tasks,
    inverse_kinematics,
    late_markers,
    marker_sites,
    on_osim_model,
    osim_registration,
    osim_scaling,
    registration,
    scaling,
    smoothing,
    uncertainty,
)
from legsim.kinematics._ik_names import Tasks
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics._marker_reading import Reading, by_own_names, by_role, labels_beside
from legsim.kinematics._planted_feet import Pegs
from legsim.kinematics.from_coordinates import moving_leg, named
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.inverse_kinematics import Solution
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.registration import Registration
from legsim.kinematics.scaling import Scaling
from legsim.kinematics.skeleton import SegmentScales
from legsim.mocap import files as mocap_files
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.coordinates import RawCoordinates
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories


def find_recording(file: str | Path) -> Path:
    """The path of a motion file: as given, or one that ships with legsim under motions/.

    Raises:
        LegsimError: it is neither.
    """
    if is_file(file):
        return Path(file)
    try:
        return resources.motion_file(str(file))
    except LegsimError:
        folder = os.path.isdir(file)
        raise file_error(
            file,
            "is a folder" if folder else "no such motion file, here or among the shipped ones",
            f"give a {mocap_files.known_suffixes()} file" + " that is in it" * folder,
        ) from None


def files_read(
    recording: str | Path,
    *,
    marker_map: str | Path = "auto",
    scale_from: str | Path | None = None,
    model: str | Path | None = None,
    marker_set: str | Path | None = None,
    scale_file: str | Path | None = None,
    tasks_file: str | Path | None = None,
) -> tuple[Path, ...]:
    """The files that :func:`solve_kinematics` reads: recording, scaling trial, own marker map,
    model, marker set, scale file, tasks.

    Raises:
        LegsimError: one of them is not there.
    """
    path = find_recording(recording)
    files = [path, _scaling_source(path, scale_from)]
    _check_there(model, marker_set, scale_file)
    files += [Path(given) for given in (model, marker_set, scale_file) if given]
    files += ik_tasks.files_of(tasks_file) if tasks_file else ()
    if str(marker_map).endswith(".toml") and is_file(marker_map):
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
    marker_set: str | Path | None = None,
    scale_file: str | Path | None = None,
    scale_model: bool = False,
    filter_coordinates: bool = False,
    in_degrees: bool | None = None,
    register: bool = True,
    ik: IkOptions | None = None,
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
        model: an OpenSim model (.osim) whose legs are used instead of legsim's own, with its
            markers and as large as it is.
        marker_set: OpenSim's marker set (.xml) for ``model``: markers that replace the model's own
            of their names, and further ones.
        scale_file: OpenSim's scale factors (.xml) for the generic leg, or for ``model``.
        scale_model: scale ``model`` to the person by its own markers, and place these where the
            person wears them; from ``scale_from`` where that is given.
        filter_coordinates: low-pass joint coordinates of a .mot, .sto or .csv too.
        in_degrees: whether the angles of a .mot or .sto are in degrees; None believes the header
            as far as the angles bear it out.
        register: find the person's lengths, hip centers and the places of the markers together with
            the poses; else the leg stays as scaled and markers where the model has them. Not where
            ``model`` or ``scale_file`` give the size.
        ik: weights of markers, tasks and locks of coordinates, priors. They hold for the recording
            that the person is scaled from too, except that a weight of 0 leaves a marker out of
            ``recording`` alone.

    Raises:
        LegsimError: anything that a careful person would object to, with file, place and fix.

    >>> person = solve_kinematics("subject01/squat_60.trc")
    >>> person.name, len(person.trajectories.times)
    ('squat_60.trc', 2400)
    """
    path = find_recording(recording)
    tasks = Tasks.read(ik or IkOptions())
    reading = Reading(marker_map, unit, up, filter_hz, longest_gap, marker_noise)
    _check_settings(path, scale_from, model, marker_set, scale_file, scale_model)
    _check_there(model, marker_set, scale_file)
    own = None if model is None else _OwnModel(model, marker_set, scale_file, scale_model)
    low_pass_hz = filter_hz if filter_coordinates else 0.0
    raw = mocap_files.read_raw(path)
    if isinstance(raw, RawCoordinates):
        given = {"ik": None if tasks.options == IkOptions() else tasks.options}
        mocap_files.refuse_options(path, given, "joint coordinates, which are not solved for")
        scaled = None if scale_from is None else find_recording(scale_from)
        if scaled is None:
            _refuse_marker_options(path, reading, filter_coordinates)
        if own is not None:
            leg, notes = _model_for_coordinates(reading, path, own, scaled)
            return from_coordinates.on_model(
                path, raw, leg, notes, low_pass_hz, unit=unit, in_degrees=in_degrees
            )
        found = mocap_files.resolve(
            path, raw, unit=unit, up=None if scaled else up, in_degrees=in_degrees
        )
        leg, sized = _sized_leg(reading, scaled, scale_file)
        found = replace(found, notes=(*sized, *found.notes))
        return moving_leg(found, path, leg, low_pass_hz=low_pass_hz)
    mocap_files.refuse_options(path, {"angles": in_degrees}, "markers, not joint coordinates")
    if own is not None:
        if str(marker_map) != "auto":
            raise file_error(
                path,
                "motion.marker_map says which markers play the roles of legsim's own leg, and a "
                "model's markers are found by their names",
                "leave it out, or give --marker-set with the recording's labels",
                place="settings",
            )
        source = find_recording(scale_from) if scale_from else path
        return _markers_on_model(reading, path, raw, own, tasks, source if scale_model else None)
    return _markers_on_own_leg(
        reading, path, raw, tasks, scale_from=scale_from, scale_file=scale_file, register=register
    )


def _markers_on_own_leg(
    reading: Reading,
    path: Path,
    raw: mocap_files.RawRecording,
    tasks: Tasks,
    *,
    scale_from: str | Path | None,
    scale_file: str | Path | None,
    register: bool,
) -> MovingLeg:
    """A recording of markers on legsim's own leg, as large as the person."""
    # a trial that is scaled from another may go without the landmarks that only scaling needs
    given = scale_from or scale_file
    options, said = named(path, lambda: tasks.coordinates(LegModel.load()))
    scaled_from = Path(scale_file) if scale_file else _scaling_source(path, scale_from)
    same = scale_file or scaled_from == path
    shown = None if same else mocap_files.read_raw(scaled_from)
    measured, cleaning, notes, weights = by_role(
        reading,
        path,
        required=() if given else PAPER_ROLES,
        tasks=tasks,
        content=raw,
        beside=() if shown is None else labels_beside(reading, scaled_from, shown),
    )
    notes = (*notes, *said)
    reference = measured if same else by_role(reading, scaled_from, content=shown, static=True)[0]
    sites = marker_sites.load().weighted({r: w for r, w in weights.items() if w > 0})
    if scale_file:
        fitted, said = _given_scales(scale_file, sites, measured)
        notes = (*notes, *said)
    else:
        fitted = named(path, lambda: scaling.fit(LegModel.load(), reference, sites))
    leg = LegModel.load(fitted.scales)
    placed = fitted.sites
    loose = marker_sites.calibrated_roles() & set(measured.marker_names)
    if loose:
        placed = named(
            path, lambda: inverse_kinematics.calibrate(leg, reference, placed, loose, options)
        )
    registered = None
    if register and not scale_file:
        registered = named(
            scaled_from, lambda: registration.register(leg, reference, placed, options)
        )
        leg, placed, options = registered.leg, registered.sites, registered.config
        notes = (*notes, *registered.notes())
    # feet stand elsewhere in another recording
    pegs = registered.pegs if registered and same else None
    solution = named(
        path, lambda: inverse_kinematics.solve(leg, measured, placed, options, pegs=pegs)
    )
    how = _Fitting(fitted, scaled_from.name, notes, options, registered, pegs)
    return _solved(reading, path, leg, solution, measured, placed, cleaning, how)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitting:
    """How the person's size was found."""

    scaling: Scaling
    source: str
    notes: tuple[str, ...]
    options: IkOptions
    registration: Registration | None = None
    pegs: Pegs | None = None


def _solved(
    reading: Reading,
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
    held, seen = placed.only(names), np.asarray(np.isfinite(shown.positions_world).all(-1))
    if how.pegs is not None:
        held, seen = how.pegs.beside(held), how.pegs.shown_with(seen)
    fit = MarkerFit(
        measured=shown,
        modelled=solution.modelled,
        sites=placed.only(names),
        cleaning=cleaning,
        scaling=how.scaling,
        options=how.options,
        registration=how.registration,
        spread=uncertainty.coordinate_spread(
            Problem(leg, held, _stance.with_feet(how.options, shown, placed)),
            how.registration,
            solution.trajectories.values,
            seen,
        ),
        ik=solution.report,
        scaled_from=printable(how.source),
        settled_hz=settled_hz,
    )
    alone = Problem(leg, placed.only(names), how.options)
    late = late_markers.notes(
        late_markers.find_late(alone, solution.trajectories, shown), fit.labels()
    )
    notes = (*how.notes, *_stance.notes(shown, placed), *late)
    return MovingLeg(printable(path.name), leg, settled, fit, notes)


@dataclass(frozen=True, slots=True)
class _OwnModel:
    """The files of a user's model, and whether it is scaled to the person."""

    path: str | Path
    marker_set: str | Path | None
    scale_file: str | Path | None
    to_person: bool

    def load(self) -> tuple[OsimLeg, tuple[str, ...]]:
        return on_osim_model.load(self.path, self.scale_file, self.marker_set)


def _markers_on_model(
    reading: Reading,
    path: Path,
    raw: mocap_files.RawRecording,
    own: _OwnModel,
    tasks: Tasks,
    sized_from: Path | None,
) -> MovingLeg:
    """A recording of markers on the user's own OpenSim model, scaled to the one of ``sized_from``
    where that is given.
    """
    leg, notes = own.load()
    measured, sites, cleaning, said = by_own_names(reading, path, leg, tasks, raw)
    leg, locked = on_osim_model.held_leg(leg)
    options, tasked = named(path, lambda: tasks.coordinates(leg))
    options = options.settled(on_osim_model.model_priors(leg, sites))
    found = None
    if sized_from is None:
        size = named(path, lambda: on_osim_model.size_note(leg, measured, sites, options))
    else:
        reference, worn = measured, sites
        if sized_from != path:
            reference, worn, *_ = by_own_names(reading, sized_from, leg, tasks, static=True)
        sized = named(sized_from, lambda: osim_registration.fit(leg, reference, worn, options))
        leg, size, found = sized.leg, sized.notes, sized.registration
        sites = leg.marker_sites()[0].only(sites.names).weighted(sites.by_name())
        options = found.config
    solution = named(path, lambda: inverse_kinematics.solve(leg, measured, sites, options))
    known = _Fitting(
        Scaling(leg.scales, sites, ()),
        (sized_from or leg.model.path).name,
        (*notes, *said, *size, *locked, *tasked),
        options,
        found,
    )
    return _solved(reading, path, leg, solution, measured, sites, cleaning, known)


def _model_for_coordinates(
    reading: Reading, path: Path, own: _OwnModel, sized_from: Path | None
) -> tuple[OsimLeg, tuple[str, ...]]:
    """The user's model for a file of coordinates, and notes on it."""
    if sized_from is None:
        given = {"marker_set": own.marker_set, "scale_model": own.to_person or None}
        mocap_files.refuse_options(
            path, given, "joint coordinates, and motion.scaling_file names no markers"
        )
    leg, notes = own.load()
    if sized_from is None:
        return leg, notes
    nothing = Tasks.read(IkOptions())
    reference, sites, *_ = by_own_names(reading, sized_from, leg, nothing, static=True)
    held, _ = on_osim_model.held_leg(leg)
    options = IkOptions().settled(on_osim_model.model_priors(held, sites))
    sized = named(sized_from, lambda: osim_registration.fit(held, reference, sites, options))
    return OsimLeg(sized.leg.model), (*notes, *sized.notes)


def _check_there(
    model: str | Path | None, marker_set: str | Path | None, scale_file: str | Path | None
) -> None:
    """Refuses a model, marker set or scale file that is not there."""
    for given, what in (
        (model, "an OpenSim model (.osim)"),
        (marker_set, "a marker set (.xml)"),
        (scale_file, "a scale file (.xml)"),
    ):
        if given and not is_file(given):
            raise file_error(given, "no such file", f"give {what}")


def _check_settings(
    path: Path,
    scale_from: str | Path | None,
    model: str | Path | None,
    marker_set: str | Path | None,
    scale_file: str | Path | None,
    scale_model: bool,
) -> None:
    """Refuses a size that is given twice, and what is said of a model where none is given."""
    problem = ""
    if marker_set and not model:
        problem = (
            "motion.marker_set puts markers on an OpenSim model, and there is none",
            ("give --model"),
        )
    elif scale_model and not model:
        problem = "motion.scale_model scales an OpenSim model, and there is none", "give --model"
    elif scale_model and scale_file:
        problem = (
            "its person's size is given twice, by motion.scale_model and motion.scale_file",
            "leave one out",
        )
    elif scale_from and (scale_file or (model and not scale_model)):
        other = "motion.scale_file" if scale_file else "motion.model"
        fix = "" if scale_file else ", or scale the model to it by --scale-model"
        problem = (
            f"its person's size is given twice, by motion.scaling_file and {other}",
            f"leave motion.scaling_file out{fix}",
        )
    if problem:
        raise file_error(path, *problem, place="settings")


def _scales_of(scale_file: str | Path) -> tuple[SegmentScales, tuple[str, ...]]:
    """Scales of legsim's own leg by a scale file, and notes."""
    factors = osim_scaling.read(scale_file)
    return named(Path(scale_file), lambda: osim_scaling.segment_scales(factors))


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


def _refuse_marker_options(path: Path, reading: Reading, filter_coordinates: bool) -> None:
    """Refuses what is said about markers where the file holds none, and no other is read."""
    usual = Reading("auto", reading.unit, None, 6.0, 2.0, reading.marker_noise)
    filtered = filter_coordinates or reading.filter_hz in (0.0, usual.filter_hz)
    given = {
        "marker_map": reading.marker_map if reading.marker_map != usual.marker_map else None,
        "up": reading.up,
        "longest_gap_s": reading.longest_gap if reading.longest_gap != usual.longest_gap else None,
        "filter_hz": None if filtered else reading.filter_hz,
    }
    mocap_files.refuse_options(path, given, "joint coordinates, not markers")


def _sized_leg(
    reading: Reading, reference: Path | None, scale_file: str | Path | None
) -> tuple[LegModel, tuple[str, ...]]:
    """The model at the size of the person, and a note where nothing says that size."""
    leg = LegModel.load()
    if reference is not None:
        markers, *_ = by_role(reading, reference, static=True)
        return LegModel.load(scaling.fit(leg, markers, marker_sites.load()).scales), ()
    if scale_file is not None:
        factors, notes = _scales_of(scale_file)
        return LegModel.load(factors), notes
    thigh, shank = (1e2 * length("r") for length in (leg.thigh_length, leg.shank_length))
    return leg, (
        f"put on legsim's generic leg, thigh {thigh:.1f} cm and shank {shank:.1f} cm: "
        "give --model, --scale-file or motion.scaling_file for the person's own",
    )
