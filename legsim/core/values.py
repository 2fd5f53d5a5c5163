"""Read-only arrays and unique names, which every value type of the package stores."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from legsim.core.errors import LegsimError

FloatArray = NDArray[np.float64]

Float32Array = NDArray[np.float32]

LARGEST = 1e30
"""beyond any length, angle, time or attenuation in any unit; squares of it are still numbers"""

_LEAST_STEP = 1e-12
"""s between two times; less is no clock's"""


def frozen(
    name: str, values: ArrayLike, shape: Sequence[int | None], dtype: DTypeLike = np.float64
) -> NDArray:
    """Returns ``values`` as a C-ordered, read-only array of ``dtype``.

    Copies unless it already is one. ``shape`` lists the expected lengths, None for any.

    Raises:
        LegsimError: the number of axes or a length differs.
    """
    source = np.asarray(values, dtype=dtype)
    if source.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, source.shape, strict=True)
    ):
        expected = tuple("any" if n is None else n for n in shape)
        raise LegsimError(f"{name} has shape {source.shape}; expected {expected}")
    # memory that is not an array's (a file's, a buffer's) may be written by others
    owned = source.base is None or (
        isinstance(source.base, np.ndarray) and not source.base.flags.writeable
    )
    if owned and source.flags.c_contiguous and not source.flags.writeable:
        return source
    array = np.array(source, order="C")
    array.flags.writeable = False
    return array


def plain_numbers(name: str, values: ArrayLike) -> NDArray:
    """Returns ``values`` as an array of real numbers that nothing hides.

    Raises:
        LegsimError: complex numbers, text, objects, lists of different lengths, or a masked array
            that masks any.
    """
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise LegsimError(f"{name} is a masked array; fill what it masks, as by values.filled(0)")
    try:
        source = np.asarray(values)
    except ValueError as error:
        raise LegsimError(f"{name} holds lists of different lengths; give one shape") from error
    if source.dtype.kind not in "fiub":
        raise LegsimError(f"{name} holds {source.dtype} values; give real numbers")
    return source


def positive(name: str, value: float, *, zero: bool = False) -> float:
    """Returns a size as a number.

    Raises:
        LegsimError: it is none, not finite, or not above 0; ``zero`` is allowed on demand.
    """
    try:
        size = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise LegsimError(f"{name} is {value!r}; expected a number") from error
    if not (np.isfinite(size) and (size > 0 or (zero and size == 0))):
        least = "not negative" if zero else "positive"
        raise LegsimError(f"{name} is {size:g}; it must be finite and {least}")
    return size


def whole_counts(name: str, values: Sequence[float]) -> tuple[int, ...]:
    """Counts along axes, as whole numbers.

    Raises:
        LegsimError: one is not a whole number.
    """
    try:
        counts = tuple(int(n) for n in values)
    except (TypeError, ValueError, OverflowError) as error:
        raise LegsimError(f"{name} is {values!r}; expected whole numbers") from error
    if any(n != count for n, count in zip(values, counts, strict=True)):
        raise LegsimError(f"{name} is {tuple(values)}; expected whole numbers")
    return counts


def frozen_owned(array: NDArray) -> NDArray:
    """Marks a new array read-only without a copy, for large volumes and projections."""
    array.flags.writeable = False
    return array


def increasing_times(name: str, values: ArrayLike) -> FloatArray:
    """Returns times (n,) in seconds as a read-only array, finite and strictly increasing.

    Raises:
        LegsimError: a time is not finite, beyond :data:`LARGEST`, or not after the one before by a
            picosecond.
    """
    times = frozen(name, values, (None,))
    if not within(times):
        raise LegsimError(
            f"{name} holds a time that is not a number, or too large a one, at index "
            f"{int(np.argmin(np.abs(times) <= LARGEST))}"
        )
    steps = np.diff(times)
    if (steps < _LEAST_STEP).any():
        k = int(np.argmax(steps < _LEAST_STEP))
        raise LegsimError(
            f"{name} must increase strictly, by a picosecond or more; sample {k + 1} "
            f"({times[k + 1]:g} s) comes {steps[k]:.3g} s after sample {k}"
        )
    return times


def within(values: NDArray) -> bool:
    """Whether all numbers are finite and none is beyond :data:`LARGEST`."""
    return bool((np.abs(values) <= LARGEST).all())


def unique_names(kind: str, names: Sequence[str]) -> tuple[str, ...]:
    names = tuple(names)
    doubles = sorted({n for n in names if names.count(n) > 1})
    if doubles:
        raise LegsimError(f"{kind} names must differ; repeated: {', '.join(doubles)}")
    return names


def index_of(kind: str, names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise LegsimError(f"unknown {kind} {name!r}; known: {', '.join(names)}")
    return names.index(name)


def to_nanometers(meters: FloatArray) -> FloatArray:
    """The lengths in m, rounded so that a file of millimeters with six decimals holds the same
    numbers, to the last bit.

    >>> to_nanometers(np.array([0.1234567894]))
    array([0.12345679])
    """
    return 1e-3 * in_millimeters(meters)


def in_millimeters(meters: FloatArray) -> FloatArray:
    """Millimeters of lengths in m, to six decimals: :func:`to_nanometers` is what they read as."""
    return np.round(1e3 * meters, 6)
