"""Marker files read and cleaned: by role for legsim's own leg, by a user's model's own names."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError
from legsim.kinematics import (
    _osim_exchanged,
    exchanged_labels,
    marker_sites,
    on_osim_model,
)
from legsim.kinematics._ik_names import Tasks, left_out
from legsim.kinematics.from_coordinates import named
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import cleaning as mocap_cleaning
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets, planar
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.labels import PAPER_ROLES, MarkerMap
from legsim.mocap.static_trial import as_static
from legsim.mocap.trajectories import MarkerTrajectories


@dataclass(frozen=True, slots=True)
class Reading:
    """How marker files are read and cleaned: keyword arguments of
    :func:`legsim.kinematics.from_recording.solve_kinematics`.
    """

    marker_map: str | Path
    unit: str | None
    up: str | None
    filter_hz: float
    longest_gap: float
    marker_noise: float


def by_role(
    reading: Reading,
    path: Path,
    required: Sequence[str] = PAPER_ROLES,
    tasks: Tasks | None = None,
    content: mocap_files.RawRecording | None = None,
    *,
    static: bool = False,
    beside: Sequence[str] = (),
) -> tuple[MarkerTrajectories, CleaningReport, tuple[str, ...], dict[str, float]]:
    """The markers by role, what was done to them, what there is to say about the file, and the
    weights that ``tasks`` give; roles of weight 0 are left out. ``content`` is the file's, where it
    has been read. A ``static`` trial may be one frame. ``beside`` are the labels of the trial that
    the person is scaled from, where that is another one.
    """
    raw, notes = mocap_files.read_markers(path, unit=reading.unit, up=reading.up, raw=content)
    raw = as_static(raw) if static else raw

    def cleaned() -> tuple[MarkerTrajectories, CleaningReport, tuple[str, ...], dict[str, float]]:
        flat = planar.objections(raw.positions_world)
        chosen = _map(reading, raw.marker_names, required, beside)
        # a mean of two markers that are used themselves would count them twice
        shown = np.asarray(np.isfinite(raw.positions_world).all(-1).any(0))
        seen = [name for name, here in zip(raw.marker_names, shown, strict=True) if here]
        chosen = chosen.without(chosen.means_in(seen))
        weights, said = {}, ()
        if tasks is not None:
            known = marker_sites.load().names
            weights, said = tasks.marker_weights(chosen, raw.marker_names, known)
            needed = [role for role in left_out(weights) if role in required]
            if needed:
                raise LegsimError(
                    f"a weight of 0 leaves out {', '.join(needed)}, which scaling needs: give "
                    "them a weight, or another recording to scale from (motion.scaling_file)"
                )
        markers, report = mocap_cleaning.clean(
            raw,
            chosen.without(left_out(weights)),
            filter_hz=reading.filter_hz,
            longest_gap_s=reading.longest_gap,
            required=required,
        )
        on = {role: chosen.segment(role) for role in markers.marker_names}
        called = {r.role: r.labels[0] for r in report.roles if len(r.labels) == 1}
        exchanged = exchanged_labels.notes(markers, on, called)
        return markers, report, (*flat, *said, *exchanged), weights

    markers, report, said, weights = named(path, cleaned)
    return markers, report, (*notes, *report.notes, *said), weights


def labels_beside(reading: Reading, path: Path, shown: mocap_files.RawRecording) -> tuple[str, ...]:
    """Labels of the trial that the person is scaled from, whose content is ``shown``.

    Raises:
        LegsimError: no shipped marker set covers them; named here, where the file is known.
    """
    labels = tuple(mocap_files.labels_of(shown))
    if reading.marker_map == "auto" and labels:
        named(path, lambda: marker_sets.guess(labels))
    return labels


def _map(
    reading: Reading, labels: Sequence[str], required: Sequence[str], beside: Sequence[str]
) -> MarkerMap:
    """The marker map that is given, or the shipped one that covers the labels."""
    if reading.marker_map != "auto":
        return marker_sets.load(str(reading.marker_map))
    if beside:
        return marker_sets.guess_beside(labels, beside)
    return marker_sets.guess(labels, required=required)


def by_own_names(
    reading: Reading,
    path: Path,
    leg: OsimLeg,
    tasks: Tasks,
    content: mocap_files.RawRecording | None = None,
    *,
    static: bool = False,
) -> tuple[MarkerTrajectories, MarkerSites, CleaningReport, tuple[str, ...]]:
    """A recording's markers by the names of a user's model, their places on it, what was done to
    them, and notes. A ``static`` trial may be one frame.
    """
    raw, read_notes = mocap_files.read_markers(path, unit=reading.unit, up=reading.up, raw=content)
    raw = as_static(raw) if static else raw
    flat = named(path, lambda: planar.objections(raw.positions_world))
    own, sites, said = named(path, lambda: on_osim_model.marker_map(leg, raw.marker_names))
    weights, weighed = named(
        path, lambda: tasks.marker_weights(own, raw.marker_names, leg.marker_sites()[0].names)
    )
    own = own.without(left_out(weights))
    measured, cleaning = named(
        path,
        lambda: mocap_cleaning.clean(
            raw, own, filter_hz=reading.filter_hz, longest_gap_s=reading.longest_gap, required=()
        ),
    )
    named(path, lambda: on_osim_model.check_unit(sites, measured))
    named(path, lambda: on_osim_model.check_sides(sites, measured))
    named(path, lambda: _osim_exchanged.check(sites, measured))
    sites = sites.only([name for name in sites.names if name in measured.marker_names])
    on = dict(zip(sites.names, sites.segments, strict=True))
    exchanged = exchanged_labels.notes(measured, on, {})
    return (
        measured,
        sites.weighted(weights),
        cleaning,
        (*read_notes, *cleaning.notes, *flat, *said, *weighed, *exchanged),
    )
