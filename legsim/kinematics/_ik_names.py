"""Options of inverse kinematics for one recording: names of markers by role, tasks of a file
beneath those that are given, and a word on what finds no place.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError
from legsim.kinematics import ik_tasks
from legsim.kinematics.ik_options import CoordinateTask, IkOptions
from legsim.kinematics.ik_tasks import IkTaskSet
from legsim.kinematics.leg import Leg
from legsim.kinematics.on_osim_model import short
from legsim.mocap.labels import MarkerMap, find_labels


@dataclass(frozen=True, slots=True)
class Tasks:
    """Options as they were given, and the task set of their file."""

    options: IkOptions
    file: IkTaskSet | None

    @classmethod
    def read(cls, options: IkOptions) -> "Tasks":
        """Reads the options' ``tasks_file``; errors as of
        :func:`legsim.kinematics.ik_tasks.read`.
        """
        given = str(options.tasks_file)
        return cls(options, ik_tasks.read(Path(given)) if given else None)

    def marker_weights(
        self, marker_map: MarkerMap, labels: Sequence[str], known: Collection[str]
    ) -> tuple[dict[str, float], tuple[str, ...]]:
        """Weights by role, and notes.

        A role that several labels play has the mean of their weights, and 0 where one of them has.
        A file that weighs markers leaves out those that it does not name, as OpenSim does.

        Args:
            marker_map: which labels play which role.
            labels: of the recording.
            known: roles that a recording might have.

        Raises:
            LegsimError: a name is no role and no label that plays one.
        """
        found = marker_map.found_in(labels)
        given, unknown = _by_role(self.options.marker_weights, found, known, labels, rest=None)
        if unknown:
            raise LegsimError(_unknown(unknown, found, known, labels))
        absent = [n for n in self.options.marker_weights if n in known and n not in found]
        notes = [f"weights of markers that this recording lacks: {short(absent)}"] if absent else []
        if self.file is None or not self.file.markers:
            return {**given, **{n: self.options.marker_weights[n] for n in absent}}, tuple(notes)
        by_file, nobody = _by_role(self.file.markers, found, known, labels, rest=0.0)
        nobody += [n for n in self.file.markers if n in known and n not in found]
        name = self.file.file
        if nobody:
            notes.append(f"{name}: tasks of markers that are not on these legs: {short(nobody)}")
        weights = {**by_file, **given}
        named = {*self.options.marker_weights, *self.file.markers}
        told = {*_labels_of(named, found, known, labels).values()}
        idle = [r for r in found if weights[r] == 0]
        untold = [r for r in idle if r not in named and not told.intersection(found[r])]
        if untold:
            notes.append(f"{name}: no task, so left out: {short(untold)}")
        return weights, tuple(notes)

    def coordinates(self, leg: Leg) -> tuple[IkOptions, tuple[str, ...]]:
        """The options with the file's tasks of this leg's coordinates beneath their own, and notes;
        weights of markers are left out.
        """
        options = replace(self.options, marker_weights={}, tasks_file="")
        notes = [f"locked: {short([lock.coordinate for lock in options.locked])}"]
        notes = notes if options.locked else []
        if self.file is not None:
            known, of_file = leg.coordinate_names, self.file.coordinates
            others = [t.coordinate for t in of_file if t.coordinate not in known]
            notes += self.file.notes
            if others:
                notes.append(
                    f"{self.file.file}: tasks of what is no free coordinate of the legs: "
                    f"{short(others)}"
                )
            tasks = {t.coordinate: t for t in of_file if t.coordinate in known}
            tasks |= {t.coordinate: t for t in options.tasks}
            options = replace(options, tasks=tuple(tasks.values()))
        return options, (*notes, *_task_notes(leg, options.tasks))


def _task_notes(leg: Leg, tasks: Sequence[CoordinateTask]) -> list[str]:
    """What is pulled, and a warning on values that the joint cannot have."""
    pulled = [task for task in tasks if task.weight > 0]
    if not pulled:
        return []
    notes = [f"pulled by tasks: {short([f'{t.coordinate} ({t.weight:g})' for t in pulled])}"]
    ranges = dict(zip(leg.coordinate_names, leg.coordinate_ranges, strict=True))
    for task in pulled:
        joint = task.coordinate in leg.coordinate_names[leg.pelvis_coordinates :]
        low, high = ranges[task.coordinate] if joint else (-np.inf, np.inf)
        if task.value is not None and not low <= task.value <= high:
            by, unit = (1e3, "mm") if task.coordinate in leg.shifts else (np.degrees(1.0), "deg")
            notes.append(
                f"warning: the task of {task.coordinate} pulls to {by * task.value:.4g} {unit}, "
                f"beyond its range of {by * low:.4g} to {by * high:.4g} {unit}"
            )
    return notes


def left_out(weights: Mapping[str, float]) -> tuple[str, ...]:
    """Roles of weight 0."""
    return tuple(role for role, weight in weights.items() if weight == 0)


def _by_role(
    given: Mapping[str, float],
    found: Mapping[str, tuple[str, ...]],
    known: Collection[str],
    labels: Sequence[str],
    *,
    rest: float | None,
) -> tuple[dict[str, float], list[str]]:
    """Weight of each found role that is given one, and names that nobody has; ``rest`` is that of
    labels without.
    """
    by_label = _labels_of(given, found, known, labels)
    playing = (label for names in found.values() for label in names)
    own = {} if rest is None else dict.fromkeys(playing, rest)
    own |= {label: given[name] for name, label in by_label.items()}
    weights = {}
    for role, names in found.items():
        parts = [own[label] for label in names if label in own]
        if role in given:
            weights[role] = given[role]
        elif parts:
            weights[role] = 0.0 if min(parts) == 0 else float(np.mean(parts))
    return weights, [name for name in given if name not in known and name not in by_label]


def _labels_of(
    names: Collection[str],
    found: Mapping[str, tuple[str, ...]],
    known: Collection[str],
    labels: Sequence[str],
) -> dict[str, str]:
    """Name to label, of the names that are no role and of the labels that play one. What ends are
    shared is told by all ``labels`` of the recording: those of one role share their side.
    """
    playing = {label for own in found.values() for label in own}
    by_name = find_labels([name for name in names if name not in known], labels)
    return {name: label for name, label in by_name.items() if label in playing}


def _unknown(
    unknown: Sequence[str],
    found: Mapping[str, tuple[str, ...]],
    known: Collection[str],
    labels: Sequence[str],
) -> str:
    """The error line of names that are no marker of the legs."""
    idle = find_labels(unknown, labels)
    why = "plays no role on the legs" if unknown[0] in idle else "is no marker"
    used = sorted({label for names in found.values() for label in names} - set(found))
    others = [role for role in known if role not in found]
    more = f"; known too: {', '.join(others)}" if others else ""
    return (
        f"weight of {', '.join(unknown)}: {unknown[0]} {why}; give roles "
        f"{', '.join(found)}{' or labels ' if used else ''}{', '.join(used)}{more}"
    )
