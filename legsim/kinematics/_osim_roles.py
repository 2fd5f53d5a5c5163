"""Which body of an OpenSim model plays which segment of legsim's leg, by its name."""

import re
from collections.abc import Sequence

from legsim.core.errors import LegsimError
from legsim.kinematics.skeleton import SEGMENTS

_WORDS = {
    "pelvis": ("pelvis", "hips", "hip"),
    "femur": ("femur", "thigh", "upperleg"),
    "patella": ("patella", "pat"),
    "tibia": ("tibia", "shank", "tibfib", "lowerleg", "shin"),
    "talus": ("talus",),
    "calcn": ("calcn", "calcaneus", "calc", "foot", "hindfoot"),
    "toes": ("toes", "toe", "forefoot", "phalanges"),
}
"""Part of a segment's name, and words that bodies are called by, the most usual first"""

_SIDES = {"r": "r", "right": "r", "l": "l", "left": "l"}

NEEDED = ("pelvis", "femur_r", "tibia_r", "femur_l", "tibia_l")
"""Segments that a model must have; a foot too, as talus or calcn"""


def bodies_by_segment(bodies: Sequence[str]) -> dict[str, str]:
    """Name of the body that plays each segment, for those that the model has.

    Raises:
        LegsimError: a needed segment is missing; the message lists the bodies.
    """
    found: dict[str, tuple[int, str]] = {}
    for body in _sided(bodies):
        segment, rank = _segment_of(body)
        if segment and (segment not in found or rank < found[segment][0]):
            found[segment] = rank, body
    own = dict(zip(_sided(bodies), bodies, strict=True))
    chosen = {segment: own[found[segment][1]] for segment in SEGMENTS if segment in found}
    missing = [segment for segment in NEEDED if segment not in chosen]
    missing += [
        f"talus_{side} or calcn_{side}"
        for side in "rl"
        if not {f"talus_{side}", f"calcn_{side}"} & chosen.keys()
    ]
    if missing:
        raise LegsimError(
            f"no body is named like {', '.join(missing)}; there are: {', '.join(bodies)}; a model "
            "of two legs is needed"
        )
    return chosen


def _sided(bodies: Sequence[str]) -> tuple[str, ...]:
    """The names with a side: of femur and lfemur the one without is the right one's (Arnold et al.
    2010's model).
    """
    left = {body[1:] for body in bodies if body[:1] == "l" and body[1:] in bodies}
    return tuple(
        f"{body}_r" if body in left else f"{body[1:]}_l" if body[1:] in left else body
        for body in bodies
    )


def _segment_of(body: str) -> tuple[str, int]:
    """(segment, rank of the word) that a body's name tells; empty where it tells none."""
    words = [w for w in re.split(r"[_\W]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", body)) if w]
    words = [word.lower() for word in words]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    name = "".join(word for word in words if word not in _SIDES)
    for part, known in _WORDS.items():
        if name in known and len(sides) == (0 if part == "pelvis" else 1):
            segment = part if part == "pelvis" else f"{part}_{sides[0]}"
            return segment, known.index(name)
    return "", 0
