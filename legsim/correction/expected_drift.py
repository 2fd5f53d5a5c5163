"""How far dead reckoning is expected to run away: what a sensor's data sheet and start allow.

A method that only integrates a sensor follows its drift as if the person moved. Whether that is a
hair's breadth or meters is known before the scan: the errors of
:mod:`legsim.correction.error_state`, each one standard deviation, propagated to first order.
"""

import numpy as np

from legsim.correction.fused import SensorPriors, sensor_state
from legsim.correction.method import Scan


def expected_drift(scan: Scan, sensor: str, priors: SensorPriors) -> float:
    """Standard deviation (m) of where the sensor alone carries the knee, RMS over the views.

    Raises:
        LegsimError: an unknown sensor, fewer than three views, or a recording that does not cover
            them.
    """
    state = sensor_state(scan, sensor, priors, clock=0.0)
    knee = scan.projections.geometry.rotation_center()[None]
    by = state.path(np.zeros(state.size)).of_points(knee)
    return float(np.sqrt((by**2).sum((1, 2, 3)).mean()))


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
