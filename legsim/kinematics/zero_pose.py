"""A static trial's mean pose as the zero of the joint angles."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error, printable
from legsim.core.values import FloatArray, frozen
from legsim.kinematics import from_coordinates, inverse_kinematics, on_osim_model
from legsim.kinematics.from_coordinates import named
from legsim.kinematics.from_recording import find_recording
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg, ZeroPose
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import cleaning as mocap_cleaning
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets
from legsim.mocap.coordinates import RawCoordinates
from legsim.mocap.labels import MarkerMap
from legsim.mocap.static_trial import as_static
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_STILL = np.radians(5.0)
"""rad of standard deviation beyond which a static trial is none"""


def with_zero(
    person: MovingLeg,
    recording: str | Path,
    *,
    marker_map: str | Path = "auto",
    unit: str | None = None,
    up: str | None = None,
    filter_hz: float = 6.0,
    longest_gap: float = 2.0,
    in_degrees: bool | None = None,
) -> MovingLeg:
    """The same person with the mean pose of a static trial as the zero of the joint angles.

    The movement itself stays as it is; :meth:`MovingLeg.from_zero` gives the angles from that pose.
    The trial is solved on the person's leg, with the same places of markers and options of inverse
    kinematics. The pelvis' heading and place have no zero.

    Args:
        person: from a recording of markers, or of coordinates.
        recording: the static trial: markers, or joint coordinates of the same model.
        marker_map: as in :func:`legsim.kinematics.from_recording.solve_kinematics`, like the rest.

    Raises:
        LegsimError: as there, or the trial holds markers and the person's recording did not.
    """
    path = find_recording(recording)
    raw = mocap_files.read_raw(path)
    if isinstance(raw, RawCoordinates):
        found, notes = _coordinates(path, raw, person, unit=unit, in_degrees=in_degrees)
    elif person.fit is None:
        raise file_error(
            path,
            "holds markers, but the recording joint coordinates",
            "give a zero of joint coordinates",
        )
    else:
        mocap_files.refuse_options(path, {"angles": in_degrees}, "markers, not joint coordinates")
        motion, notes = mocap_files.read_markers(path, unit=unit, up=up)
        chosen = _marker_map(person, motion, marker_map)
        measured, _ = named(
            path,
            lambda: mocap_cleaning.clean(
                as_static(motion),
                chosen,
                filter_hz=filter_hz,
                longest_gap_s=longest_gap,
                required=(),
            ),
        )
        found = _solved(path, person, measured)
    zero = ZeroPose(
        printable(path.name),
        len(found.times),
        person.leg.coordinate_names,
        _mean(person.leg, found),
    )
    said = f"zero of the joint angles: the mean pose of {zero.file} ({zero.frames} frames)"
    notes = (said, *(f"{zero.file}: {note}" for note in notes), *_moving_note(zero, person, found))
    return replace(person, zero=zero, notes=(*person.notes, *notes))


def _coordinates(
    path: Path, raw: RawCoordinates, person: MovingLeg, *, unit: str | None, in_degrees: bool | None
) -> tuple[JointTrajectories, tuple[str, ...]]:
    """Coordinates of a file on the person's leg, and notes."""
    leg = person.leg
    if isinstance(leg, OsimLeg):
        loaded, notes = raw.to_plausible_motion(
            in_degrees=in_degrees, unit=unit, rotations=leg.rotations(raw.names), lengths=leg.shifts
        )
        _, found, said = named(path, lambda: on_osim_model.coordinates(leg, loaded))
        return found, (*notes, *said)
    assert isinstance(leg, LegModel)
    recording = mocap_files.resolve(path, raw, unit=unit, in_degrees=in_degrees)
    moved = from_coordinates.moving_leg(recording, path, leg, knees_turned=person.knees_turned)
    return moved.trajectories, moved.notes


def _marker_map(person: MovingLeg, motion: MarkerTrajectories, marker_map: str | Path) -> MarkerMap:
    """The map of the markers that the person's leg has places for."""
    assert person.fit is not None
    sites = person.fit.sites
    if not isinstance(person.leg, LegModel):
        return MarkerMap.one_to_one(person.name, sites.names, sites.names, sites.segments)
    chosen = (
        marker_sets.guess(motion.marker_names, required=())
        if marker_map == "auto"
        else marker_sets.load(str(marker_map))
    )
    return chosen.without(set(chosen.roles) - set(sites.names))


def _solved(path: Path, person: MovingLeg, measured: MarkerTrajectories) -> JointTrajectories:
    assert person.fit is not None
    sites, options = person.fit.sites, person.fit.options
    used = sites.only([name for name in sites.names if name in measured.marker_names])
    solution = named(path, lambda: inverse_kinematics.solve(person.leg, measured, used, options))
    return solution.trajectories


def _mean(leg: Leg, found: JointTrajectories) -> FloatArray:
    """(c,) mean of each coordinate, 0 for the pelvis' heading and place and for those not found."""
    values = np.zeros(len(leg.coordinate_names))
    for k, name in enumerate(leg.coordinate_names):
        placed = k == leg.heading or (k < leg.pelvis_coordinates and name in leg.shifts)
        if name in found.coordinate_names and not placed:
            values[k] = float(found.coordinate(name).mean())
    return frozen("zero pose", values, (None,))


def _moving_note(zero: ZeroPose, person: MovingLeg, found: JointTrajectories) -> tuple[str, ...]:
    """A word where somebody moves in the static trial."""
    spread = {
        name: float(found.coordinate(name).std())
        for name in person.leg.coordinate_names[person.leg.pelvis_coordinates :]
        if name in found.coordinate_names and name not in person.leg.shifts
    }
    most = max(spread, key=spread.__getitem__)
    if spread[most] <= _STILL:
        return ()
    return (
        f"warning: the person moves in {zero.file}: {most} by {np.degrees(spread[most]):.1f} deg "
        "RMS about its mean; give a trial of quiet standing",
    )
