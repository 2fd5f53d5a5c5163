"""Marker trajectories as a file gives them, and the one border where they become meters in world.

Readers of marker files fill a :class:`RawMarkers`; its :meth:`RawMarkers.to_motion` converts unit
and axes, for all formats alike.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen
from legsim.mocap.trajectories import MarkerTrajectories

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

WORLD_FROM_LAB = {
    "y": np.eye(3),
    "-y": np.diag([1.0, -1.0, -1.0]),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "-x": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}
"""Rotation that brings the lab axis named by the key to world's y; z up is (x, y, z) -> (x, z,
-y).
"""

FLOOR_BAND = (-0.15, 0.45)
"""m: where the lowest marker of somebody is whose lab has its origin in the floor; above 0.3 m
without markers on the feet
"""

MIN_HEIGHT = 0.25
"""m: markers that spread less than this along an axis tell nothing about what is up"""

STANDING = 1.0
"""m: markers this high over the floor belong to somebody who stands"""

_LEVELS = (
    r"toe|toe(tip|lat|med)|hee|heel|cal|calc|calcn|mt[1-5]|m[ft]?h[1-5]|d[1-5]m|\dmeta|foot|ank|ankle|ankle(lat|med|medial)|[lm]?mal|hal|rft|lft",
    r"kne|knee|knee(lat|med|medial)|[lm]?fc|[lm]fe|tubtib|suppat|tta",
    r"asis|psis|asi|psi|eias|eas|eips|eps|v?sacral|sacr|sacrum|fwt|bwt",
    r"c7|t[1-9]|t1[0-2]|clav|ster|strn|sternum|shoulder|sho|acr|acromion|acromium|ac|ij|px|xiph|clavicle",
    r"fhd|bhd|head|tete|temp|tophead|ariel",
)
"""names of markers from the feet up, without side and punctuation, of the common marker sets"""


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
        object.__setattr__(
            self,
            "positions",
            frozen("RawMarkers.positions", not_seen_as_nan(self.positions), shape),
        )
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
                f"unit {said!r} is not one of m, cm, mm"
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
        """A key of ``WORLD_FROM_LAB``: ``up`` where given, else what the names and places of the
        markers show, else the file's word or the format's habit, unless the floor plainly lies
        elsewhere.

        Capture systems write their screen axes without looking: recordings of somebody standing are
        in circulation that call
        -z up, or z where x is.

        Raises:
            LegsimError: ``up`` is not the name of an axis.
        """
        if up is not None:
            if up.lower() not in WORLD_FROM_LAB:
                raise file_error(
                    self.path,
                    f"up = {up!r} is no axis",
                    f"give one of {', '.join(WORLD_FROM_LAB)}",
                    place="up",
                )
            return up.lower()
        meters = self.positions / UNITS_PER_METER[self.resolved_unit(unit)]
        return up_by_names(meters, self.labels) or up_by_floor(
            meters, self.up or self.usual_up, said=bool(self.up)
        )

    def to_motion(self, *, unit: str | None = None, up: str | None = None) -> MarkerTrajectories:
        """The markers in meters in world; ``unit`` and ``up`` override what the file says.

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
        rotation = WORLD_FROM_LAB[self.resolved_up(up, unit=unit)]
        # a signed permutation, not a product: exact, and without negative zeros or NaN spreading
        # between axes
        source, sign = np.abs(rotation).argmax(1), rotation.sum(1)
        world = meters[..., source] * sign
        try:
            return MarkerTrajectories(self.times, self.labels, world)
        except LegsimError as error:
            raise file_error(
                self.path, str(error), "repair the time column, or export the trial again"
            ) from error


def not_seen_as_nan(positions: FloatArray) -> FloatArray:
    """Copy of (n, m, 3) with NaN in all three coordinates where one is not finite or all are
    exactly 0.
    """
    positions = np.array(positions, float)
    unseen = ~np.isfinite(positions).all(-1) | (positions == 0).all(-1)
    positions[unseen] = np.nan
    return positions


def distinct(labels: Sequence[str]) -> tuple[str, ...]:
    """Labels made different: every one of several equal labels gets "#1", "#2", ..., so that none
    is taken for another unnoticed.
    """
    count, seen, result = Counter(labels), Counter(), []
    for label in labels:
        seen[label] += 1
        result.append(f"{label}#{seen[label]}" if count[label] > 1 else label)
    return tuple(result) if len(set(result)) == len(result) else distinct(result)


def level(label: str) -> int | None:
    """Height on the body that a marker's name tells: 0 foot, 1 knee, 2 pelvis, 3 trunk, 4 head;
    None where it tells none.
    """
    bare = re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].partition("#")[0].lower())
    names = {bare, bare[1:] if bare[:1] in "rl" else bare, bare[:-1] if bare[-1:] in "rl" else bare}
    return next(
        (
            k
            for k, pattern in enumerate(_LEVELS)
            if any(re.fullmatch(pattern, name) for name in names)
        ),
        None,
    )


def up_by_names(positions: FloatArray, labels: Sequence[str]) -> str:
    """Lab axis that points up, judged by markers (n, m, 3) whose names tell their height on the
    body; empty where that is not plain.

    Feet, knees, pelvis, trunk and head follow each other upwards in somebody who stands, squats,
    sits or walks.
    """
    marked = [
        (k, rank)
        for k, label in enumerate(labels)
        if (rank := level(label)) is not None and np.isfinite(positions[:, k]).all(-1).any()
    ]
    if len(marked) < 4:
        return ""
    ranks = sorted({rank for _, rank in marked})
    centers = np.array(
        [
            np.median(
                [np.nanmedian(positions[:, k], axis=0) for k, r in marked if r == rank], axis=0
            )
            for rank in ranks
        ]
    )
    if len(ranks) < 2:
        return ""
    rise = centers[-1] - centers[0]
    axis = int(np.abs(rise).argmax())
    others = np.abs(np.delete(rise, axis)).max()
    if abs(rise[axis]) < MIN_HEIGHT or abs(rise[axis]) < 1.3 * others:
        return ""
    return ("" if rise[axis] > 0 else "-") + "xyz"[axis]


def up_by_floor(positions: FloatArray, expected: str, *, said: bool) -> str:
    """Lab axis that points up, judged by where markers (n, m, 3) in meters lie on somebody on the
    floor.

    ``expected`` is kept unless its lowest marker is far from 0 while another axis carries a
    standing person. Where it is not ``said`` by the file but only the format's habit, it gives way
    to the other of y and z already if that looks more upright.
    """
    scores = {
        name: _height_over_floor(positions, WORLD_FROM_LAB[name][1])
        for name in ("x", "y", "z", expected)
    }
    best = max(scores, key=lambda name: scores[name])
    if scores[expected] == 0 and scores[best] > STANDING:
        return best
    best = max(("y", "z"), key=lambda name: scores[name])
    # half as much again: arms held out spread as wide as a person is tall
    return (
        best
        if not said and scores[best] > MIN_HEIGHT and scores[best] > 1.5 * scores[expected]
        else expected
    )


def _height_over_floor(positions: FloatArray, axis: FloatArray) -> float:
    """Median height of the markers over the lowest one along ``axis``, in meters; 0 where the
    lowest is not near the floor.
    """
    positions = positions[np.isfinite(positions).all(-1).any(-1)]
    if positions.shape[0] == 0 or positions.shape[1] < 3:
        return 0.0
    along = positions @ axis
    low = np.nanmin(along, axis=1)
    in_band = FLOOR_BAND[0] < np.quantile(low, 0.05) and np.quantile(low, 0.95) < FLOOR_BAND[1]
    return float(np.median(np.nanmax(along, axis=1) - low)) if in_band else 0.0
