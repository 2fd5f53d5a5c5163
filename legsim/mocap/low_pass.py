"""The zero-phase Butterworth low-pass of markers and joint coordinates."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray


def low_pass(values: FloatArray, rate_hz: float, cutoff_hz: float, *, order: int = 2) -> FloatArray:
    """Values (n, c) at even times through a Butterworth low-pass, forwards and backwards.

    Zero phase, -6 dB at ``cutoff_hz``. Each stretch of rows without NaN is filtered by itself.

    Args:
        values: (n, c), of any unit.
        rate_hz: sampling rate.
        cutoff_hz: cut-off of each of the two passes.
        order: of each pass.

    Raises:
        LegsimError: the cut-off does not lie between 0 and half the sampling rate.
    """
    if not 0 < cutoff_hz < rate_hz / 2:
        raise LegsimError(
            f"a filter of {cutoff_hz:g} Hz does not fit samples at {rate_hz:g} Hz; choose one "
            f"below {rate_hz / 2:g} Hz"
        )
    sections = signal.butter(order, cutoff_hz, fs=rate_hz, output="sos")
    result = values.copy()
    for first, last in runs(np.isfinite(values).all(1)):
        length = last - first + 1
        # three periods of the cut-off mirrored at each end leave no trace of the filter's start
        pad = min(length - 1, int(3 * rate_hz / cutoff_hz))
        if length > 1:
            result[first : last + 1] = signal.sosfiltfilt(
                sections, values[first : last + 1], axis=0, padlen=pad
            )
    return result


def runs(flags: ArrayLike) -> list[tuple[int, int]]:
    """(first, last) index of each run of True in (n,)."""
    edges = np.flatnonzero(np.diff(np.r_[False, np.asarray(flags, bool), False].astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
