"""Numbers in the cells of a text file, with "not a number" as any program spells it."""

import math
import re

from legsim.core.values import LARGEST

_NAN = re.compile(
    r"""[+-]?(
        nan | nan\([\w\s]*\) | [qs]nan | nan[qs]          # C, with its payload; Fortran; AIX
        | 1\.\#(nan|q\w*|snan\w*|ind\w*|r)                # Windows before 2015, also cut short
        | \#?n/?a\!? | <na> | \#num! | \.nan              # tables, statistics, YAML
        | null | none | missing | undefined
    ) | -{1,3}""",
    re.I | re.X,
)


def number(text: str) -> float | None:
    """The finite number that a cell holds, NaN for any spelling of it, None for anything else:
    infinity and what is beyond any quantity, digits grouped by "_", words.
    """
    try:
        value = float(text)
    except ValueError:
        return math.nan if _NAN.fullmatch(text.strip()) else None
    return None if abs(value) > LARGEST or "_" in text else value


def decimals(text: str) -> int:
    """Digits after the decimal point that are not closing zeros, an exponent counted in."""
    mantissa, _, exponent = text.lower().partition("e")
    digits = len(mantissa.partition(".")[2].rstrip("0"))
    return max(0, digits - int(exponent or 0)) if re.fullmatch(r"[+-]?\d*", exponent) else 0
