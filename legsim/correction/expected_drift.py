"""How far dead reckoning is expected to run away: what a sensor's data sheet and start allow.

A method that only integrates a sensor follows its drift as if the person moved. Whether that is a
hair's breadth or meters is known before the scan: the errors of
:mod:`legsim.correction.error_state`, each one standard deviation, propagated to first order.
"""

from dataclasses import replace

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.correction.error_state import ErrorState
from legsim.correction.fused import SensorPriors, sensor_state
from legsim.correction.method import Scan

_SPEED = 2.5
"""1/s, RMS speed of markers over their RMS displacement in 8 s: 1.6 to 3.5 of people who stand or
hold a squat (docs/fusion.md)"""

_TILTS, _LASTING = [0, 2], slice(9, 21)
"""numbers of an ErrorState: tilts of the start; bias, scale and cross-talk of the accelerometer"""


def expected_drift(scan: Scan, sensor: str, priors: SensorPriors) -> float:
    """Standard deviation (m) of where the sensor alone carries the knee, RMS over the views.

    A start that was leveled at rest is tilted by what its accelerometer reads wrongly, and the two
    nearly cancel. The noise of the rest's mean is left out: it is small beside the scan's. A start
    without speed is off by the speed of somebody who stands, not by what an estimate allows for.

    Raises:
        LegsimError: an unknown sensor, fewer than three views, or a recording that does not cover
            them.
    """
    if not scan.start(scan.sensor(sensor)).velocity.any():
        speed = min(priors.start.velocity, _SPEED * priors.spread)
        priors = replace(priors, start=replace(priors.start, velocity=speed))
    leveled = scan.signals.rest_force is not None
    if leveled:
        # per radian, for what the accelerometer's errors make of it
        priors = replace(priors, start=replace(priors.start, tilt=1.0))
    state = sensor_state(scan, sensor, priors, clock=0.0)
    knee = scan.projections.geometry.rotation_center()[None]
    by = state.path(np.zeros(state.size)).of_points(knee)
    if leveled:
        by[..., _LASTING] += by[..., _TILTS] @ _tilts(state)
        by[..., _TILTS] = 0.0
    return float(np.sqrt((by**2).sum((1, 2, 3)).mean()))


def _tilts(state: ErrorState) -> FloatArray:
    """Tilts (2, 12) in rad, about x and z, of a leveled start by its accelerometer's errors.

    Leveling turns what is read at rest upwards, errors and all: the true pose is turned back.
    """
    at_rest = state.force_errors[np.searchsorted(state.times, state.views[0])][
        :, : _LASTING.stop - _LASTING.start
    ]
    aside = state.start.world_from_sensor[:3, :3] @ at_rest / STANDARD_GRAVITY
    return np.stack([aside[2], -aside[0]])


def drift_warning(method: str, scan: Scan, sensor: str, priors: SensorPriors) -> str:
    """One sentence where the drift hides how a person moves who stands; else empty."""
    drift = expected_drift(scan, sensor, priors)
    if drift <= priors.spread:
        return ""
    far = f"{drift:.2g} m" if drift >= 1 else f"{1e3 * drift:.2g} mm"
    return (
        f"{method} follows {sensor} by dead reckoning, which by the sensor's errors and start is "
        f"expected to drift by {far} RMS at the knee over the scan; a knee of a "
        f"person who stands moves by about {1e3 * priors.spread:.2g} mm: the sensor alone does not "
        "determine it (standing and the fused methods find the drift)"
    )
