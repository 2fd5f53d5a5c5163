"""What a device's failure halfway means to a user, in one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import lazy_loader

from legsim.core.errors import LegsimError

if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = lazy_loader.load("pyopencl")

_FULL = (
    *("MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY"),
    *("INVALID_BUFFER_SIZE", "out of memory"),
)


@contextmanager
def reported(label: str) -> Iterator[None]:
    """Turns a failure of the device in a run into one line.

    Raises:
        LegsimError: the device failed: it has too little memory, was lost, or its driver stopped.
    """
    try:
        yield
    except Exception as error:
        line = explain(error, label)
        if line is None:
            raise
        raise LegsimError(f"{line}; finished stages are kept") from error


def explain(error: Exception, label: str) -> str | None:
    """The line for an error of OpenCL; None for any other error."""
    # without pyopencl loaded the error cannot be its own
    if "pyopencl._cl" not in sys.modules or not isinstance(error, cl.Error):
        return None
    first = " ".join((str(error).strip().splitlines() or [type(error).__name__])[0].split())
    if isinstance(error, cl.MemoryError) or any(word in str(error) for word in _FULL):
        return (
            f"OpenCL device {label}: its memory does not suffice ({first}); end other programs on "
            "it, use a smaller preset or grid, or --device cpu"
        )
    return (
        f"OpenCL device {label} failed ({first}); run this again, with --device cpu if it fails "
        "again (`legsim doctor` checks all devices)"
    )
