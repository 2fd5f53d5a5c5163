"""What every reader must do with every file: give a finite value, or refuse it in one line."""

import contextlib
import os
import signal
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError
from tools.fuzz.readers import Reader

LIMIT_S = 10
"""of a processor for one file, so that other jobs of the machine do not count"""

_WAIT_S = 600
"""for a reader that waits for something and computes nothing"""

READ, REFUSED = "read", "refused"
"""what may become of a file"""


class _TooLongError(BaseException):
    """A reader that does not end; no reader can catch it by ``except Exception``."""


def _stop(*_: object) -> None:
    raise _TooLongError


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """Makes :func:`outcome` end readers that do not end.

    One that hangs outside of Python is ended with its process, by SIGVTALRM.
    """
    before = {number: signal.signal(number, _stop) for number in (signal.SIGPROF, signal.SIGALRM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def libraries_quiet() -> Iterator[None]:
    """Discards what libraries print about each damaged file."""
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def outcome(reader: Reader, path: Path) -> str:
    """What became of a file: :data:`READ`, :data:`REFUSED`, or what must not be, with its place.

    Notes for people, which are UserWarnings, are free; any other warning counts as an error.
    """
    signal.alarm(_WAIT_S)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    signal.setitimer(signal.ITIMER_VIRTUAL, 3 * LIMIT_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", UserWarning)
            value = reader.load(path)
        return unfit(value, reader.may_hold) or READ
    except LegsimError as error:
        return REFUSED if len(str(error).splitlines()) == 1 else f"several lines at {_place(error)}"
    except (Exception, _TooLongError) as error:
        return f"{type(error).__name__} at {_place(error)}"
    finally:
        signal.alarm(0)
        for timer in (signal.ITIMER_PROF, signal.ITIMER_VIRTUAL):
            signal.setitimer(timer, 0)


def _place(error: BaseException) -> str:
    """The last line of legsim that an error passed."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/legsim/" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"


def unfit(value: object, may_hold: str = "", place: str = "value") -> str:
    """Which number of a value is not finite, though ``may_hold`` does not name it; else nothing."""
    if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind in "fc"):
        for name, found in (("nan", np.isnan(value).any()), ("inf", np.isinf(value).any())):
            if found and name not in may_hold:
                return f"{name} in {place}"
        return ""
    if is_dataclass(value):
        parts = [(f"{place}.{f.name}", getattr(value, f.name)) for f in fields(value)]
    elif isinstance(value, dict):
        parts = [(place, part) for part in value.values()]
    elif isinstance(value, (list, tuple)):
        parts = [(place, part) for part in value]
    elif hasattr(value, "__dict__"):
        parts = [(f"{place}.{name}", part) for name, part in vars(value).items()]
    else:
        return ""
    return next((found for name, part in parts if (found := unfit(part, may_hold, name))), "")
