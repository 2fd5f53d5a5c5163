"""Marker trajectories as a file gives them, and the one border where they become meters in world.

Readers of marker files fill a :class:`RawMarkers`; its :meth:`RawMarkers.to_motion` converts unit
and axes, for all formats alike.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.mocap.vertical import WORLD_FROM_LAB, Vertical, guessed, stated

UNITS_PER_METER = {
    "m": 1.0,
    "dm": 10.0,
    "cm": 100.0,
    "mm": 1000.0,
    "in": 1 / 0.0254,
    "ft": 1 / 0.3048,
}

_UNIT_NAMES = {
    **{unit: unit for unit in UNITS_PER_METER},
    # "mete" and the like: capture systems cut the word at four letters
    **dict.fromkeys(("meter", "meters", "metre", "metres", "mete", "metr"), "m"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres", "mill"), "mm"),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres", "cent"), "cm"),
    **dict.fromkeys(("decimeter", "decimeters", "decimetre", "decimetres"), "dm"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("foot", "feet"), "ft"),
}


@dataclass(frozen=True, slots=True, eq=False)
class RawMarkers:
    """Marker trajectories in the unit and axes of their file."""

    path: str
    times: FloatArray
    """(n,) s"""
    labels: tuple[str, ...]
    positions: FloatArray
    """(n, m, 3) in ``unit`` along the file's axes; NaN in all three where a marker is not seen"""
    unit: str
    """as the file says it, empty if it does not"""
    up: str
    """lab axis that points up ("y", "-z", ...) as the file says it, empty if it does not"""
    usual_up: str
    """lab axis that points up in most files of this format"""
    notes: tuple[str, ...] = ()
    """what a careful reader noticed and put right, one line each"""

    def __post_init__(self) -> None:
        shape = (len(self.times), len(self.labels), 3)
        object.__setattr__(self, "times", frozen("RawMarkers.times", self.times, (None,)))
        positions = frozen("RawMarkers.positions", not_seen_as_nan(self.positions), shape)
        needless = _needless_twins(self.labels, positions)
        if needless:
            kept = [k for k in range(len(self.labels)) if k not in needless]
            names = ", ".join(dict.fromkeys(self.labels[k] for k in needless))
            note = f"there twice under one name, never seen or an exact copy, left out: {names}"
            object.__setattr__(self, "labels", tuple(self.labels[k] for k in kept))
            object.__setattr__(self, "notes", (*self.notes, note))
            positions = frozen("RawMarkers.positions", positions[:, kept], (None, len(kept), 3))
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "labels", distinct(self.labels))

    def resolved_unit(self, unit: str | None = None) -> str:
        """A key of ``UNITS_PER_METER``: ``unit`` where given, what the file says otherwise.

        Raises:
            LegsimError: no unit is given and the file names none, or one that is not known.
        """
        said = unit if unit is not None else self.unit
        name = _UNIT_NAMES.get(said.strip().strip(".").lower())
        if name is None:
            problem = (
                f"unit {said!r} is not one of {', '.join(UNITS_PER_METER)}"
                if said.strip()
                else "the file does not say its unit of length"
            )
            raise file_error(
                self.path,
                problem,
                "give the unit, as in --set motion.unit=mm (in Python: unit='mm')",
                place="unit",
            )
        return name

    def resolved_up(self, up: str | None = None, *, unit: str | None = None) -> str:
        """The axis of :meth:`vertical`."""
        return self.vertical(up, unit=unit).axis

    def vertical(self, up: str | None = None, *, unit: str | None = None) -> Vertical:
        """Which lab axis points up: ``up`` where given, else the file's word or the format's habit
        as far as the markers bear it out, with the reason.

        Raises:
            LegsimError: ``up`` is not the name of an axis, or the markers speak against the file.
        """
        if up is not None:
            if up.lower() not in WORLD_FROM_LAB:
                raise file_error(
                    self.path,
                    f"up = {up!r} is no axis",
                    f"give one of {', '.join(WORLD_FROM_LAB)}",
                    place="up",
                )
            return Vertical(up.lower(), "as given")
        meters = self.positions / UNITS_PER_METER[self.resolved_unit(unit)]
        try:
            if self.up:
                return stated(meters, self.labels, self.up)
            return guessed(meters, self.labels, self.usual_up)
        except LegsimError as error:
            raise LegsimError(f"{self.path} (up): {error}") from None

    def to_motion(self, *, unit: str | None = None, up: str | None = None) -> MarkerTrajectories:
        """The markers in meters in world; errors as of :meth:`oriented`."""
        return self.oriented(unit=unit, up=up)[0]

    def oriented(
        self, *, unit: str | None = None, up: str | None = None
    ) -> tuple[MarkerTrajectories, Vertical]:
        """The markers in meters in world, and which axis of the file is up there; ``unit`` and
        ``up`` override what the file says.

        Raises:
            LegsimError: the unit is unknown, no marker is ever seen, or the times do not increase.
        """
        if np.isnan(self.positions).all():
            problem = f"none of its {len(self.labels)} markers is seen at any time"
            raise file_error(
                self.path,
                problem,
                "export the trial again with its marker trajectories",
                place="data",
            )
        meters = self.positions / UNITS_PER_METER[self.resolved_unit(unit)]
        vertical = self.vertical(up, unit=unit)
        rotation = WORLD_FROM_LAB[vertical.axis]
        # a signed permutation, not a product: exact, and without negative zeros or NaN spreading
        # between axes
        source, sign = np.abs(rotation).argmax(1), rotation.sum(1)
        world = meters[..., source] * sign
        try:
            return MarkerTrajectories(self.times, self.labels, world), vertical
        except LegsimError as error:
            raise file_error(
                self.path, str(error), "repair the time column, or export the trial again"
            ) from error


def unit_cure(times_too_long: float) -> str:
    """What to do about lengths that are so many times a person's: which unit to give depends on
    what the file says, so only the factor is stated.
    """
    long = times_too_long > 1
    factor = float(f"{times_too_long if long else 1 / times_too_long:.2g}")
    return (
        f"lengths are about {factor:g} times too {'long' if long else 'short'}: give the unit "
        f"that they are in, one of {', '.join(UNITS_PER_METER)}, as in --set motion.unit=mm (in "
        "Python: unit='mm')"
    )


def not_seen_as_nan(positions: FloatArray) -> FloatArray:
    """Copy of (n, m, 3) with NaN in all three coordinates where one is not finite or all are
    exactly 0.
    """
    positions = np.array(positions, float)
    unseen = ~np.isfinite(positions).all(-1) | (positions == 0).all(-1)
    positions[unseen] = np.nan
    return positions


def _needless_twins(labels: Sequence[str], positions: FloatArray) -> list[int]:
    """Markers (n, m, 3) of a label that is there twice which tell nothing: never seen while the
    other is, or the same as one before.
    """
    needless: list[int] = []
    for label in [label for label, count in Counter(labels).items() if count > 1]:
        twins = [k for k, name in enumerate(labels) if name == label]
        seen = [k for k in twins if np.isfinite(positions[:, k]).any()]
        needless += [k for k in twins if seen and k not in seen]
        needless += [
            k
            for n, k in enumerate(seen)
            if any(
                np.array_equal(positions[:, k], positions[:, other], equal_nan=True)
                for other in seen[:n]
            )
        ]
    return sorted(needless)


def distinct(labels: Sequence[str]) -> tuple[str, ...]:
    """Labels made different: every one of several equal labels gets "#1", "#2", ..., so that none
    is taken for another unnoticed.
    """
    count, seen, result = Counter(labels), Counter(), []
    for label in labels:
        seen[label] += 1
        result.append(f"{label}#{seen[label]}" if count[label] > 1 else label)
    return tuple(result) if len(set(result)) == len(result) else distinct(result)
