"""Which axis of a laboratory points up.

A file's word goes first, and somebody who lies, leans or sits keeps it: how a body lies in its axes
is no proof against it. Where a format has no word for it (TRC), the axis is guessed, y or z, from
where the body is upright, how it lies, and where the floor is. Where these speak against each
other, or plainly against the file, the user is asked.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.mocap.labels import without_shared_ends

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

_PLAIN = 1.3
"""a body is upright along an axis if its rise along it is this many times that along any other"""

_ACROSS, _ALONG = 0.35, 0.65
"""share of the left-right direction that an axis has: below the one it is across it, above the
other along it
"""

_LEVELS = (
    r"toe|toe(tip|lat|med)|hee|heel|cal|calc|calcn|mt[1-5]|m[ft]?h[1-5]|d[1-5]m|\dmeta|foot|ank|ankle|(ank|ankle)(l|m|lat|med|medial|lateral)|[lm](ank|ankle|ak|ma|mal|mall|m)|mal|hal|rft|lft",
    r"kne|knee|knee(l|m|lat|med|medial|lateral)|[lm](kne|knee|kn|fc|fe|ep|epi|epic|ek|ec|k)|fc|tubtib|suppat|tta",
    r"asis|psis|asi|psi|eias|eas|eips|eps|v?(sacral|sacr|sacrum|sac)|sacrm|s2|fwt|bwt",
    r"c7|t[1-9]|t1[0-2]|clav|ster|strn|sternum|shoulder|sho|acr|acromion|acromium|ac|ij|px|xiph|clavicle",
    r"fhd|bhd|head|tete|temp|tophead|ariel",
)
"""names of markers from the feet up, without side and punctuation, of the common marker sets"""


@dataclass(frozen=True, slots=True)
class Vertical:
    """The lab axis that points up, and why it is taken."""

    axis: str
    """a key of ``WORLD_FROM_LAB``"""
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """How a body lies in the axes of its file."""

    rise: FloatArray
    """(3,) m from its lowest to its highest named part; 0 where names do not tell"""
    feet: FloatArray
    """(3,) m, where the feet are; NaN where no marker is named after them"""
    sideways: FloatArray
    """(3,) share of each axis in its left-right direction; NaN where names do not tell"""
    floor: dict[str, float]
    """height over the floor in m, by the axis taken as up; 0 where the lowest marker is not near
    the origin
    """

    def on_floor(self, axis: str) -> bool:
        """Whether the lowest marker, or the feet, are where the floor is if ``axis`` points up."""
        foot = float(self.feet @ WORLD_FROM_LAB[axis][1])
        return self.floor[axis] > 0 or FLOOR_BAND[0] < foot < FLOOR_BAND[1]

    def upright(self) -> str:
        """The axis along which the body is plainly upright; empty where there is none."""
        axis = int(np.abs(self.rise).argmax())
        others = float(np.abs(np.delete(self.rise, axis)).max())
        if abs(self.rise[axis]) < MIN_HEIGHT or abs(self.rise[axis]) < _PLAIN * others:
            return ""
        return ("" if self.rise[axis] > 0 else "-") + "xyz"[axis]


def stated(positions: FloatArray, labels: Sequence[str], said: str) -> Vertical:
    """The axis ``said`` by the file of markers (n, m, 3) in meters; its opposite where the file has
    the sign wrong, so that somebody would hang head down below the floor.

    Raises:
        LegsimError: a body hangs head down along it, or stands with its feet on the floor along
            another axis that laboratories call up.
    """
    body = _body(positions, labels)
    upright = body.upright()
    stands = upright not in ("", said) and body.on_floor(upright)
    if upright == _opposite(said) and stands:
        return Vertical(
            upright,
            f"the body stands on the floor along it; along {said}, which the file calls up, it "
            "would hang head down below the floor",
        )
    if upright == _opposite(said):
        raise _ask(
            f"the file says {said} is up, but the feet are above the pelvis along it", upright
        )
    if stands and (upright in ("y", "z") or body.floor[said] == 0):
        raise _ask(
            f"the file says {said} is up, but somebody stands along {upright}, with the feet where "
            "the floor would be",
            upright,
        )
    if not upright and body.floor[said] == 0:
        tallest = max(body.floor, key=lambda axis: body.floor[axis])
        if body.floor[tallest] > STANDING:
            raise _ask(
                f"the file says {said} is up, but somebody stands along {tallest}, and no marker "
                f"is near the floor along {said}",
                tallest,
            )
    lies = f"; the body lies along {upright}" if upright not in ("", said) else ""
    return Vertical(said, "as the file says" + lies)


def guessed(positions: FloatArray, labels: Sequence[str], usual: str) -> Vertical:
    """The axis that points up, y or z, in a file of markers (n, m, 3) in meters that does not say
    it; ``usual`` is its format's habit.

    Raises:
        LegsimError: what the markers show fits either, or none.
    """
    other = {"y": "z", "z": "y"}[usual]
    body = _body(positions, labels)
    upright = body.upright()
    if upright == usual or (upright == other and body.on_floor(other)):
        return Vertical(upright, "the body is upright along it")
    if upright == _opposite(usual):
        raise _ask(f"the feet are above the pelvis along {usual}, the usual vertical", upright)
    habit = "as is usual for this format"
    if upright:
        return _lying(body, upright, usual, other, habit)
    if _sits(body, other) and not _sits(body, usual):
        return Vertical(other, "the body sits or leans along it")
    if not np.isnan(body.sideways).any() and _sits(body, usual):
        return Vertical(usual, habit)
    return _by_floor(body, usual, other, habit)


def _lying(body: _Body, upright: str, usual: str, other: str, habit: str) -> Vertical:
    """The vertical of a body that lies along ``upright``: on the back or the face, up is across the
    left-right direction.
    """
    lies = f"; the body lies along {upright}"
    if body.floor[upright] > STANDING and body.floor[usual] == 0:
        raise _ask(
            f"somebody stands along {upright}, and no marker is near the floor along {usual}, the "
            "usual vertical",
            upright,
        )
    free = upright[-1] != other
    across = {axis: body.sideways["xyz".index(axis)] for axis in (usual, other)}
    if not free or np.isnan(across[usual]) or across[usual] < _ACROSS:
        return Vertical(usual, habit + lies)
    if across[other] < _ACROSS:
        raise _ask(
            f"the body lies along {upright}: on its side if {usual} is up, on its back or face if "
            f"{other} is",
            other,
        )
    return Vertical(usual, habit + lies)


def _sits(body: _Body, axis: str) -> bool:
    """Whether the body rises along ``axis`` and has left and right across it."""
    k = "xyz".index(axis)
    return bool(body.rise[k] > 0.1 and not body.sideways[k] > _ACROSS)


def _by_floor(body: _Body, usual: str, other: str, habit: str) -> Vertical:
    """By where markers lie over the floor. Half as much again: arms held out spread as wide as a
    person is tall.

    Raises:
        LegsimError: somebody stands along an axis that is not up in any laboratory.
    """
    tallest = max(body.floor, key=lambda axis: body.floor[axis])
    if body.floor[usual] == 0 and body.floor[tallest] > STANDING and tallest not in (usual, other):
        raise _ask(
            f"somebody stands along {tallest}, and no marker is near the floor along {usual}, the "
            "usual vertical",
            tallest,
        )
    if body.floor[other] > max(MIN_HEIGHT, 1.5 * body.floor[usual]):
        return Vertical(other, "the markers are higher over the floor along it")
    return Vertical(usual, habit)


def _ask(problem: str, axis: str) -> LegsimError:
    """The question which axis is up, with ``axis`` as an example of an answer."""
    return LegsimError(
        f"{problem}; give the axis that points up, as in --set motion.up={axis} (in Python: "
        f"up={axis!r})"
    )


def _opposite(axis: str) -> str:
    return axis[1:] if axis.startswith("-") else f"-{axis}"


def _body(positions: FloatArray, labels: Sequence[str]) -> _Body:
    floor = {
        name: _height_over_floor(positions, WORLD_FROM_LAB[name][1]) for name in WORLD_FROM_LAB
    }
    names = without_shared_ends(labels)
    return _Body(*_rise(positions, names), _sideways(positions, names), floor)


def _rise(positions: FloatArray, labels: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """((3,) m from the lowest to the highest part of the body that markers are named after: feet,
    knees, pelvis, trunk, head, 0 where fewer than four markers or two parts are; (3,) m place of
    the feet, NaN without).
    """
    marked = [
        (k, rank)
        for k, label in enumerate(labels)
        if (rank := level(label)) is not None and np.isfinite(positions[:, k]).all(-1).any()
    ]
    ranks = sorted({rank for _, rank in marked})
    if len(marked) < 4 or len(ranks) < 2:
        return np.zeros(3), np.full(3, np.nan)
    low, high = (
        np.median([np.nanmedian(positions[:, k], axis=0) for k, r in marked if r == rank], axis=0)
        for rank in (ranks[0], ranks[-1])
    )
    return high - low, low if ranks[0] == 0 else np.full(3, np.nan)


def _sideways(positions: FloatArray, labels: Sequence[str]) -> FloatArray:
    """(3,) share of each axis in the direction from left to right, over all pairs of markers that
    are named by side; NaN where there is none. Shares of squares: they hold for somebody who turns.
    """
    sides = [side(label) for label in labels]
    total, spans = np.zeros(3), 0.0
    for k, own in enumerate(sides):
        if own is None or own[0] != "r" or ("l", own[1]) not in sides:
            continue
        across = positions[:, k] - positions[:, sides.index(("l", own[1]))]
        squares = np.nansum(across**2, axis=0)
        total, spans = total + squares, spans + float(squares.sum())
    return total / spans if spans > 0 else np.full(3, np.nan)


def _bare(label: str) -> str:
    return re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].partition("#")[0].lower())


def side(label: str) -> tuple[str, str] | None:
    """("r" or "l", the name without it) of a marker on pelvis or leg; None where its name tells no
    side.
    """
    bare = _bare(label).replace("right", "r").replace("left", "l")
    if _rank(bare) == 2:  # SACR
        return None
    if bare[:1] in ("r", "l") and _rank(bare[1:]) in (0, 1, 2):
        return bare[0], bare[1:]
    if bare[-1:] in ("r", "l") and _rank(bare[:-1]) in (0, 1, 2):
        return bare[-1], bare[:-1]
    return None


def _rank(name: str) -> int | None:
    return next((k for k, pattern in enumerate(_LEVELS) if re.fullmatch(pattern, name)), None)


def level(label: str) -> int | None:
    """Height on the body that a marker's name tells: 0 foot, 1 knee, 2 pelvis, 3 trunk, 4 head;
    None where it tells none.
    """
    bare = _bare(label)
    names = (bare, bare[1:] if bare[:1] in "rl" else bare, bare[:-1] if bare[-1:] in "rl" else bare)
    ranks = [rank for name in names if (rank := _rank(name)) is not None]
    return min(ranks, default=None)


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
