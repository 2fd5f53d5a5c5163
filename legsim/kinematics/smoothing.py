"""What a low-pass leaves of the cameras' noise, and a further low-pass that takes away no more than
that.

Two derivatives turn rests of marker noise into accelerations that no sensor on the leg would read:
white noise of 0.2 mm at 120 Hz leaves
0.06 mm behind the usual 6 Hz filter, and that is 5 mg. So coordinates solved from markers are
  filtered once more before anything is
differentiated, as low as the noise hides: where a person stands still this takes the tremble out,
where one walks it does nothing, because there a lower cut-off would move the markers farther than
their noise could.
"""

import numpy as np

from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories

CUTOFFS_HZ = (3.0, 3.5, 4.0, 4.5, 5.0)
"""tried from the lowest; people who hold still sway below 2 Hz"""

_ORDER = 4
"""of each pass: 2 Hz passes a cut-off of 3 Hz within 4 %"""

_PEAK = 5.0


def left_by_filter(noise: float, filter_hz: float, rate_hz: float) -> tuple[float, float]:
    """RMS that white noise of RMS ``noise`` keeps behind the marker filter, per axis: of the value,
    and of its second derivative per s^2.

    The integrals of the two-pass gain 1 / (1 + (f / f_c)^4) squared, as such and times (2 pi f)^4,
    over the density 2 noise^2 / rate.
    """
    density = 2 * noise**2 / rate_hz
    value = 3 * np.pi * np.sqrt(2) / 16 * filter_hz * density
    second = (2 * np.pi) ** 4 * np.pi * np.sqrt(2) / 16 * filter_hz**5 * density
    return float(np.sqrt(value)), float(np.sqrt(second))


def smooth_below_noise(
    leg: Leg,
    trajectories: JointTrajectories,
    sites: MarkerSites,
    *,
    noise: float,
    filter_hz: float,
) -> tuple[JointTrajectories, float]:
    """Coordinates filtered as low as the noise of the markers hides, and the cut-off in Hz; as they
    are, and 0, where none fits.

    The lowest of ``CUTOFFS_HZ`` is taken that moves every marker of the model, in RMS per axis over
    the recording, by no more than what ``filter_hz`` left of ``noise``, and nowhere by more than
    five times that, as noise itself would not.

    Args:
        leg: the model that the coordinates (n, 20) belong to.
        trajectories: solved from markers that were filtered at ``filter_hz``, evenly sampled.
        sites: the markers.
        noise: m, RMS of a marker's white noise per axis.
        filter_hz: 0 where the markers were not filtered; then nothing is filtered here.
    """
    times, values = trajectories.times, leg.values_of(trajectories)
    rate = (len(times) - 1) / float(times[-1] - times[0])
    allowed, _ = left_by_filter(noise, filter_hz, rate)
    before, still = leg.marker_positions(values, sites), np.ptp(values, axis=0) == 0
    for cutoff in CUTOFFS_HZ if noise > 0 else ():
        if cutoff < filter_hz:
            # a filter leaves rounding on what stands still, such as locked coordinates
            calm = np.where(still, values, low_pass(values, rate, cutoff, order=_ORDER))
            moved = leg.marker_positions(calm, sites) - before
            if (
                np.sqrt((moved**2).mean((0, 2))).max() <= allowed
                and np.abs(moved).max() <= _PEAK * allowed
            ):
                return JointTrajectories(times, leg.coordinate_names, calm), cutoff
    return trajectories, 0.0
