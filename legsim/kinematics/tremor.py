"""Tremor of a person's bones, added to a movement whose own tremor was filtered away.

Physiological tremor lies at 8 to 12 Hz, whatever the force (Sutton and Sykes 1967, J Physiol
191:699-711; ankles 6 to 9 Hz: Pozos, Iaizzo and Petry 1982, J Appl Physiol 52:226-230). Markers are
low-passed at 6 Hz and joint angles lower still, so no recording of cameras has it. Every coordinate
trembles for itself, as far as feet that stay on the floor allow: the joints' noise is projected
onto what moves neither heel nor foot's upright axis. A foot may turn about that axis.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS
from legsim.mocap.trajectories import JointTrajectories

_FEET, _SHANKS = ("calcn_r", "calcn_l"), ("tibia_r", "tibia_l")
_UPRIGHT = 0.1
"""m along a foot's upright axis: how its tilt counts against the shift of its heel"""
_SHIFT_SCALE = 0.4
"""m: how a shift of the pelvis counts against 1 rad"""
_LEAST_SHARE = 1e-3
"""of the knees' free acceleration; less is what rounding leaves of legs that cannot move"""
_SAMPLES_PER_PERIOD = 4.0


@dataclass(frozen=True, slots=True)
class Tremor:
    """How much and how fast bones tremble."""

    acceleration: float
    """m/s^2, root mean square length of the knees' acceleration"""
    band_hz: tuple[float, float] = (8.0, 12.0)

    def __post_init__(self) -> None:
        low, high = self.band_hz
        if not (np.isfinite(self.acceleration) and self.acceleration >= 0):
            raise LegsimError(
                f"a tremor's acceleration must not be negative; got {self.acceleration:g} m/s^2"
            )
        if not 0 < low < high < np.inf:
            raise LegsimError(
                f"a tremor's band goes from a frequency above 0 to a higher one; got {low:g} to "
                f"{high:g} Hz"
            )


def trembling(
    leg: Leg, trajectories: JointTrajectories, tremor: Tremor, rng: np.random.Generator
) -> JointTrajectories:
    """The same movement with a tremor on it, scaled to the acceleration asked for exactly.

    Raises:
        LegsimError: samples that are uneven or fewer than four per period of the fastest tremor, a
            recording shorter than two seconds, or a model whose knees cannot move over feet that
            stay.
    """
    rate_hz = _rate(trajectories.times, tremor)
    values = leg.values_of(trajectories)
    noise = _noise(leg, len(values), rate_hz, tremor.band_hz, rng)
    shake = _projected(leg, values, noise)
    free, held = (_knee_acceleration(leg, trajectories.times, values, x) for x in (noise, shake))
    if not held > _LEAST_SHARE * free:
        raise LegsimError(
            "no tremor is possible in this model: its joints leave the knees no way to move while "
            "both feet stay; switch motion.tremor off"
        )
    shake *= tremor.acceleration / held
    moved = np.array(trajectories.values)
    columns = [trajectories.coordinate_names.index(name) for name in leg.coordinate_names]
    moved[:, columns] += shake
    return JointTrajectories(trajectories.times, trajectories.coordinate_names, moved)


def _rate(times: FloatArray, tremor: Tremor) -> float:
    steps = np.diff(times)
    high = tremor.band_hz[1]
    if len(steps) < 2 or times[-1] - times[0] < 2.0:
        raise LegsimError("a tremor needs a recording of 2 s or more; switch motion.tremor off")
    rate_hz = 1 / float(steps.mean())
    if np.ptp(steps) > 0.01 / rate_hz:
        raise LegsimError(
            f"a tremor needs even samples; this recording's steps go from {1e3 * steps.min():.4g} "
            f"to {1e3 * steps.max():.4g} ms: resample it, or switch motion.tremor off"
        )
    if rate_hz < _SAMPLES_PER_PERIOD * high:
        raise LegsimError(
            f"a tremor of up to {high:g} Hz needs a recording of at least "
            f"{_SAMPLES_PER_PERIOD * high:g} Hz; this one has {rate_hz:.4g} Hz: lower "
            "motion.tremor.band_hz or switch it off"
        )
    return rate_hz


def _noise(
    leg: Leg, count: int, rate_hz: float, band_hz: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """(count, c) noise in a band of each coordinate that moves a foot, in rad and _SHIFT_SCALE m,
    with mean 0.
    """
    sections = butter(2, band_hz, "band", fs=rate_hz, output="sos")
    # filtered both ways, so the noise is as loud at its ends as in between only with a margin
    margin = round(rate_hz)
    white = rng.standard_normal((count + 2 * margin, len(leg.coordinate_names)))
    noise = np.asarray(sosfiltfilt(sections, white, axis=0))[margin:-margin]
    feet = [SEGMENTS.index(foot) for foot in _FEET]
    return (noise - noise.mean(0)) * leg.moves[:, feet].any(1)


def _projected(leg: Leg, values: FloatArray, noise: FloatArray) -> FloatArray:
    """The part (n, c) of the noise that leaves both feet where and as upright as they are, in the
    coordinates' own units.
    """
    heels, uprights = np.zeros((2, 3)), np.tile([0.0, _UPRIGHT, 0.0], (2, 1))
    sites = MarkerSites(
        tuple(f"{foot} {end}" for end in ("heel", "upright") for foot in _FEET),
        (*_FEET, *_FEET),
        np.concatenate([heels, uprights]),
        np.ones(4),
    )
    unit = np.array([_SHIFT_SCALE if n in leg.shifts else 1.0 for n in leg.coordinate_names])
    held = leg.marker_jacobians(values, sites).reshape(len(values), 12, -1) * unit
    # a coordinate that trembles not at all must not take part
    held *= noise.any(0)
    square = held @ np.swapaxes(held, -1, -2)
    # the upright's length is fixed already: one of a foot's six rows is no constraint of its own
    square += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(12)
    pull = np.linalg.solve(square, held @ noise[..., None])
    return (noise - (np.swapaxes(held, -1, -2) @ pull)[..., 0]) * unit


def _knee_acceleration(leg: Leg, times: FloatArray, values: FloatArray, shake: FloatArray) -> float:
    """Root mean square length of both knees' acceleration, m/s^2."""
    sites = MarkerSites(_SHANKS, _SHANKS, np.zeros((2, 3)), np.ones(2))
    shift = np.einsum("nmic,nc->nmi", leg.marker_jacobians(values, sites), shake)
    second = make_interp_spline(times, shift, k=5).derivative(2)(times)
    edge = len(times) // 20
    return float(np.sqrt(np.square(second[edge:-edge]).sum(-1).mean()))
