"""Noise processes of inertial sensors, as causal filters of white noise.

Each process is white noise of variance 1 per sample, convolved with a response h (n,) that starts
with the recording. What a process was before that is the turn-on bias. A linear budget and a
simulation then use the same h.

The bias instability of a data sheet is the flat part of the Allan deviation. Flicker noise of
two-sided density B^2 / (2 pi f) has the Allan deviation B sqrt(2 ln 2 / pi) at every averaging
time (IEEE Std 952-1997, annex C); its filter is that of Kasdin (1995) for a spectrum of 1/f. A
first-order Gauss-Markov process of standard deviation s has a top of 0.6174 s at 1.89 correlation
times.
"""

from typing import Any

import numpy as np
from scipy.signal import cont2discrete, fftconvolve, lfilter

from legsim.core.values import FloatArray
from legsim.imu.errors import TriadErrors

FLICKER_FLOOR = float(np.sqrt(2 * np.log(2) / np.pi))
"""Allan deviation of flicker noise over its coefficient B"""

MARKOV_TOP = 0.6174
"""greatest Allan deviation of a Gauss-Markov process over its standard deviation"""


def instability_response(errors: TriadErrors, count: int, rate_hz: float) -> FloatArray:
    """Response (count,) of the in-run bias: flicker or Gauss-Markov, as ``errors`` has it."""
    if errors.instability_time > 0:
        decay = np.exp(-1 / (rate_hz * errors.instability_time))
        drive = np.sqrt(1 - decay**2) * errors.instability / MARKOV_TOP
        return drive * decay ** np.arange(count)
    return errors.instability / FLICKER_FLOOR * flicker_response(count)


def flicker_response(count: int) -> FloatArray:
    """Kasdin's filter (count,) of 1/f noise: h_0 = 1, h_k = h_{k-1} (k - 1/2) / k."""
    k = np.arange(1, count)
    return np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])


def walk_response(errors: TriadErrors, count: int, rate_hz: float) -> FloatArray:
    """Response (count,) of the random walk of rate or acceleration."""
    return np.full(count, errors.random_walk / np.sqrt(rate_hz))


def coloured(white: FloatArray, response: FloatArray) -> FloatArray:
    """Filters white noise (n, 3) by a response (n,)."""
    return fftconvolve(white, response[:, None], axes=0)[: len(white)]


def low_pass(values: FloatArray, bandwidth_hz: float, order: int, rate_hz: float) -> FloatArray:
    """Filters samples (n, ...) at ``rate_hz`` by an analog Butterworth filter, delay included.

    The input is taken as linear between samples, so that the bandwidth may be above the rate. The
    filter is settled on the first sample.
    """
    step = 2 * np.pi * bandwidth_hz / rate_hz
    if order % 2:
        values = settled_response([1.0], [1.0, 1.0], step, values)
    for k in range(1, order // 2 + 1):
        damping = np.sin((2 * k - 1) * np.pi / (2 * order))
        values = settled_response([1.0], [1.0, 2 * damping, 1.0], step, values)
    return values


def settled_response(
    numerator: list[float], denominator: list[float], step: float, drive: FloatArray
) -> FloatArray:
    """Output (n, ...) of the filter numerator(s) / denominator(s) to a drive (n, ...).

    The drive is linear between samples ``step`` apart; the output is settled at the start.
    """
    # the stubs know only systems of arrays, and leave the number of results open
    system: Any = (numerator, denominator)
    discrete: Any = cont2discrete(system, step, method="foh")
    top, bottom = discrete[:2]
    gain = float(np.sum(top) / np.sum(bottom))
    swung = lfilter(np.ravel(top), bottom, drive - drive[0], axis=0)
    return np.asarray(swung + gain * drive[0], float)
