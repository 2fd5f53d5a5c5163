"""Effect of a sensor's white noise on the estimated motion: the cells of the paper's Table 2.

Maier et al. 2022, Section 3.2: the motion estimated from noisy signals is compared with the
noise-free estimate. The RMSE over the views is taken per axis, for translations and for rotations,
and averaged over the three axes and over repeated draws of the noise. The translation compared here
is the sensor's own, which does not depend on the world's origin.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.imu import calibration, strapdown
from legsim.imu.noise import ImuNoise, add_noise
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.strapdown import Scheme


@dataclass(frozen=True, slots=True)
class Drift:
    """RMSE over the views, mean of three axes."""

    translation: float
    """m"""
    rotation: float
    """rad"""


def deviation(found: FloatArray, clean: FloatArray) -> Drift:
    """Compares two estimates world_from_sensor (v, 4, 4) of the same views."""
    away = found[:, :3, 3] - clean[:, :3, 3]
    turned = transforms.vector_from_rotation(
        found[:, :3, :3] @ np.swapaxes(clean[:, :3, :3], -1, -2)
    )
    return Drift(*(float(np.sqrt((errors**2).mean(0)).mean()) for errors in (away, turned)))


def estimate(
    signals: ImuSignals, start: SensorStart, views: FloatArray, scheme: Scheme
) -> FloatArray:
    """Poses (v, 4, 4) of the first sensor; the start is leveled where there was a rest."""
    level = start
    if signals.rest_force is not None:
        level = calibration.leveled(start, signals.rest_force[0])
    samples = signals.samples(signals.sensor_names[0])
    return strapdown.integrate(*samples, level, views, scheme=scheme)


def deviations(
    clean: ImuSignals,
    start: SensorStart,
    views: FloatArray,
    noise: ImuNoise,
    scheme: Scheme,
    seeds: Sequence[int | Sequence[int]],
) -> tuple[Drift, ...]:
    """Deviations for one draw of the noise per seed, on the first sensor's signals.

    The same seeds give the same draws at every level of noise.
    """
    reference = estimate(clean, start, views, scheme)
    drawn = (add_noise(clean, noise, np.random.default_rng(seed)) for seed in seeds)
    return tuple(deviation(estimate(s, start, views, scheme), reference) for s in drawn)
