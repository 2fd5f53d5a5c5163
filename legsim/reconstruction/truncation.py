"""Truncated rows extended by a cylinder of water, so that the ramp filter sees no edge."""

import numpy as np

from legsim.core.values import Float32Array

EDGE_COLUMNS = 16
"""columns at either edge of the detector that give value and slope of a cut-off object, half of
the columns at most
"""


def extended_rows(rows: Float32Array, reach: int, water_pixels: float) -> Float32Array:
    """Continues rows (..., n) by ``reach`` columns on both sides, as a water cylinder would.

    The method is that of Hsieh et al. (Med Phys 31, 2004). The cylinder's chord 2 a sqrt(r^2 - (x -
    x0)^2), a being ``water_pixels`` (attenuation times the width of a pixel at the axis), meets the
    edge with the value and slope of a line through the outermost columns. It ends in zero by
    itself; a cosine makes it zero at ``reach`` where it is wider. Edges at or below zero continue
    as zero.
    """
    taper = np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, reach + 1)[1:] ** 2).astype(np.float32)
    edge = min(EDGE_COLUMNS, max(rows.shape[-1] // 2, 1))
    left = _cylinder(rows[..., :edge], reach, water_pixels) * taper
    right = _cylinder(rows[..., : -edge - 1 : -1], reach, water_pixels) * taper
    return np.concatenate([left[..., ::-1], rows, right], -1)


def _cylinder(edge: Float32Array, reach: int, water_pixels: float) -> Float32Array:
    """Continuation (..., reach) beyond edge (..., m), whose first column is the outermost."""
    m = edge.shape[-1]
    k = np.arange(m)
    centered = k - k.mean()
    slope = edge @ (centered / max((centered**2).sum(), 0.5)).astype(np.float32)
    value = np.maximum(edge.mean(-1) - slope * np.float32(k.mean()), 0.0)
    half = (value / np.float32(2 * water_pixels))[..., None]
    # the chord's slope is -2 a (x - x0) / sqrt(...), so the axis lies (half chord) x (slope) / 2 a
    # inwards; here slope points inwards
    inward = half * (slope / np.float32(2 * water_pixels))[..., None]
    beyond = np.arange(1, reach + 1, dtype=np.float32)
    squared = half**2 - beyond * (2 * inward + beyond)
    return np.float32(2 * water_pixels) * np.sqrt(np.maximum(squared, 0.0))
