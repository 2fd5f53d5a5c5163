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

_SPELLED: Mapping[str, tuple[str, ...]] = {
    "m/s2": ("m/s2", "m/s/s", "m/(s2)", "ms-2", "m.s-2", "m*s-2", "m/sec2", "meter/s2",
             "meters/s2", "meters/sec2", "metre/s2"),
    "g": ("g", "gs", "g0", "gn"),
    "mg": ("mg", "milli-g"),
    "rad/s": ("rad/s", "rads/s", "rad/sec", "rads-1", "rad.s-1", "rad*s-1", "radians/s",
              "radian/s", "radians/sec"),
    "deg/s": ("deg/s", "dps", "°/s", "º/s", "deg/sec", "degs/s", "degree/s", "degrees/s",
              "degrees/sec", "deg.s-1", "deg*s-1", "°/sec"),
    "mdeg/s": ("mdeg/s", "mdps", "m°/s"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds"),
}  # fmt: skip

_UNITS = {spelling: unit for unit, spellings in _SPELLED.items() for spelling in spellings}

_BRACKETS = re.compile(r"[(\[]((?:[^()\[\]]|\([^()]*\))*)[)\]]\s*\d*\s*$")


def known(text: str) -> str | None:
    """The unit that a text is, by any common spelling; None for other text."""
    plain = re.sub(r"\s|\^|\*\*", "", text.replace("²", "2").replace("⁻", "-")).strip("\"'")
    return _UNITS.get(plain.lower())


def in_name(column: str) -> str | None:
    """The unit in the brackets at the end of a column's name, as in "Gyr X (deg/s)"; else None."""
    found = _BRACKETS.search(column)
    return known(found[1]) if found else None
