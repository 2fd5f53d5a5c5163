"""Units of sensors' tables: their factors to SI, and how loggers spell them."""

import math
import re
from collections.abc import Mapping
from typing import Literal

from legsim.core.constants import STANDARD_GRAVITY

AccelerationUnit = Literal["m/s2", "g", "mg"]
AngularVelocityUnit = Literal["rad/s", "deg/s", "mdeg/s"]
TimeUnit = Literal["s", "ms", "us", "ns", "date-time"]

ACCELERATION: Mapping[AccelerationUnit, float] = {
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": 1e-3 * STANDARD_GRAVITY,
}
"""m/s^2 per unit"""

ANGULAR_VELOCITY: Mapping[AngularVelocityUnit, float] = {
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "mdeg/s": 1e-3 * math.pi / 180,
}
"""rad/s per unit"""

SECONDS: Mapping[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "date-time": 1.0}
"""s per unit; dates and times are read as seconds"""

_SECOND = ("s", "sec", "secs", "second", "seconds")

_PER_SECOND = tuple(form.format(s) for s in _SECOND for form in ("/{}", ".{}-1", "*{}-1", "{}-1"))

_PER_SECOND_SQUARED = (
    *(form.format(s) for s in _SECOND for form in ("/{}2", "/({}2)", ".{}-2", "*{}-2", "{}-2")),
    *(f"/{s}/{s}" for s in _SECOND),
)

_QUANTITIES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "m/s2": (("m", "meter", "meters", "metre", "metres"), _PER_SECOND_SQUARED),
    "rad/s": (("rad", "rads", "radian", "radians"), _PER_SECOND),
    "deg/s": (("deg", "degs", "degree", "degrees", "°"), _PER_SECOND),
    "mdeg/s": (("mdeg", "mdegs", "millideg", "millidegs", "millidegree", "millidegrees", "m°"),
               _PER_SECOND),
}  # fmt: skip
"""spellings of what a unit counts, and of by what it is divided"""

_SPELLED: Mapping[str, tuple[str, ...]] = {
    "g": ("g", "gs", "g0", "gn"),
    "mg": ("mg", "milli-g"),
    "deg/s": ("dps",),
    "mdeg/s": ("mdps",),
    "s": _SECOND,
    "ms": ("ms", "msec", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "microsec", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds"),
}

_UNITS = {spelling: unit for unit, spellings in _SPELLED.items() for spelling in spellings} | {
    above + below: unit
    for unit, (counted, by) in _QUANTITIES.items()
    for above in counted
    for below in by
}

_SIGNS = str.maketrans({
    "²": "2", "¹": "1", "⁻": "-", "\N{MINUS SIGN}": "-",
    **dict.fromkeys("·⋅∙•", "."), **dict.fromkeys("˚º∘", "°"),
    **dict.fromkeys("^\"'’", ""),
})  # fmt: skip
"""signs of one look, and what stands in no unit"""

_BRACKETS = re.compile(r"[(\[]((?:[^()\[\]]|\([^()]*\))*)[)\]]\s*\d*\s*$")

_LIKE_A_UNIT = re.compile(
    r"^(?:[a-zµμ°]{1,8}\s*)?/\s*\(?\s*(?:s|ms|min|h|hr|lsb|sec)\b|[°²]|\^-?[12]|[a-z]-[12]$"
    r"|\b(?:milli|micro)?(?:deg|degrees?|rad|radians?|g|gravity|gravities)\s*(?:/|per\b)"
    r"|^(?:[uµμ]g|gal|cm|mm|[uµμmk]?v|min|h|hrs?|hz|rpm|rps|dps|rad|deg|degrees?|lsb|counts?"
    r"|hours?|minutes?|ticks?|samples?|frames?)$"
)


def known(text: str) -> str | None:
    """The unit that a text is, by any common spelling; None for other text."""
    return _UNITS.get(_plain(text))


def _plain(text: str) -> str:
    bare = re.sub(r"\s|\*\*", "", text.lower().translate(_SIGNS)).strip(".")
    bare = re.sub(r"(seconds?|secs?|s)squared", "s2", bare)
    return re.sub(r"per(?=s)", "/", bare)


def stated(text: str) -> str | None:
    """The unit that a text is or that one of its words is, the text itself where it is another
    unit; None where it is none.
    """
    words = [unit for word in re.split(r"[\s,;]+", text) if len(word) > 1 and (unit := known(word))]
    if found := known(text) or next(iter(words), None):
        return found
    return text.strip() if _LIKE_A_UNIT.search(text.lower().strip()) else None


def is_known(unit: str) -> bool:
    """Whether :func:`stated` gave one of the units that are read."""
    return unit in ACCELERATION or unit in ANGULAR_VELOCITY or unit in SECONDS


_RUN_TOGETHER: Mapping[str, str] = {
    "ms2": "m/s2", "mss": "m/s2", "mps2": "m/s2", "mpss": "m/s2",
    "rads": "rad/s", "radps": "rad/s", "degs": "deg/s", "degps": "deg/s",
}  # fmt: skip
"""units in names, in which no sign parts what is counted from by what it is divided"""

_LONGEST = 4
"""words of a unit at the end of a name, as in Gyro_X_deg_per_s"""


def hinted(column: str) -> str | None:
    """The known unit that the last words of a name are, as in "gyro_x_dps", "ax_m/s/s" or
    "Accel X,mG".

    A name is weaker evidence than brackets: "acc_g" may be of any unit.
    """
    words = re.split(r"[_,\s]+", column.strip())
    for count in range(min(_LONGEST, len(words) - 1), 0, -1):
        last = words[-count:]
        run = "".join(last).lower()
        if unit := known("/".join(last)) or known(run) or _RUN_TOGETHER.get(run):
            return unit
    return None


def of_name(column: str) -> str | None:
    """The unit in brackets at the end of a name, else that of its last words; None without."""
    return in_name(column) or hinted(column)


def seconds_of(unit: str) -> float | None:
    """s per unit of time; None where it is none of :data:`SECONDS`."""
    return next((factor for known_one, factor in SECONDS.items() if known_one == unit), None)


def in_name(column: str) -> str | None:
    """What :func:`stated` says of the brackets at the end of a column's name, as in "Gyr X
    (deg/s)"; None without.
    """
    found = _BRACKETS.search(column)
    return stated(found[1]) if found else None
