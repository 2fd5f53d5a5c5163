"""Ramp filters of FDK and their windows."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy import fft

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray

Window = Literal["ram-lak", "shepp-logan", "hann"]

Redundancy = Literal["parker", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterOptions:
    """How projections are filtered."""

    window: Window = "shepp-logan"
    """apodization of the ramp: ram-lak (none), shepp-logan (as the paper) or hann (smoothest)"""
    water_attenuation: float | None = 20.0
    """1/m, of the cylinder that continues a cut-off object; None leaves projections cut off. About
    20 is tissue at 60 to 70 keV.
    """
    redundancy: Redundancy = "parker"
    """weights of lines measured more than once; "none" counts every view half, as in a full turn"""

    def __post_init__(self) -> None:
        if self.window not in get_args(Window):
            raise LegsimError(
                f"filter window {self.window!r} is unknown; there are: "
                f"{', '.join(get_args(Window))}"
            )
        if self.redundancy not in get_args(Redundancy):
            raise LegsimError(
                f"redundancy weights {self.redundancy!r} are unknown; there are: "
                f"{', '.join(get_args(Redundancy))}"
            )
        if self.water_attenuation is not None and not 0 < self.water_attenuation < np.inf:
            raise LegsimError(
                f"water_attenuation is {self.water_attenuation}; expected a positive, finite "
                "number in 1/m, or None to switch it off"
            )


def ramp_kernel(count: int) -> FloatArray:
    """(2 count - 1,) Ram-Lak ramp at -count + 1 … count - 1 pixels (Kak and Slaney, 3.3)."""
    k = np.abs(np.arange(-count + 1, count))
    kernel = np.where(k % 2 == 1, -1.0 / (np.pi * np.maximum(k, 1)) ** 2, 0.0)
    kernel[count - 1] = 0.25
    return kernel


def shepp_logan_kernel(count: int) -> FloatArray:
    """(2 count - 1,) Shepp and Logan's filter (1974), -2 / (pi^2 (4 k^2 - 1)), as the ramp."""
    k = np.arange(-count + 1, count, dtype=float)
    return -2.0 / (np.pi**2 * (4.0 * k**2 - 1.0))


def filter_response(reach: int, window: Window) -> tuple[int, Float32Array]:
    """(n, real response (n // 2 + 1,)) for linear convolution over ``reach`` samples.

    The length n avoids wrapping; building the kernel in space keeps the level that a ramp sampled
    in frequency loses at 0.
    """
    length: int = fft.next_fast_len(2 * reach - 1, True)  # type: ignore[assignment, arg-type]
    kernel = shepp_logan_kernel(reach) if window == "shepp-logan" else ramp_kernel(reach)
    wrapped = np.zeros(length)
    wrapped[np.arange(-reach + 1, reach)] = kernel
    response = np.real(np.asarray(fft.rfft(wrapped)))
    if window == "hann":
        response = response * (0.5 + 0.5 * np.cos(2 * np.pi * fft.rfftfreq(length)))
    return length, response.astype(np.float32)
