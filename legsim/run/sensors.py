"""The configured sensors and their noise, in SI units."""

from dataclasses import replace

import numpy as np

from legsim import config
from legsim.config import ImuConfig, NoiseConfig
from legsim.core import transforms
from legsim.imu import simulation
from legsim.imu import skin_mount as imu_skin_mount
from legsim.imu.noise import ImuNoise, add_noise
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import Sensor
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.moving_leg import MovingLeg


def sensors(settings: ImuConfig) -> tuple[Sensor, ...]:
    """The configured sensors in SI units."""
    return tuple(
        Sensor(
            s.name,
            s.segment,
            1e-3 * s.distance_mm,
            1e-3 * np.array(s.offset_mm),
            transforms.rotation_from_vector(np.radians(s.rotation_deg)),
        )
        for s in settings.sensors
    )


def skin_mount(settings: config.SoftTissueConfig) -> SkinMount:
    return SkinMount(settings.frequency_hz, settings.damping, settings.amplitude)


def sense(
    recovered: MovingLeg, splines: JointSplines, placed: tuple[Sensor, ...], settings: ImuConfig
) -> ImuSignals:
    """What the sensors read from the first to the last sample of the recording, swinging on soft
    tissue and by their own clock.

    ``clock_offset_s`` is the sensors' clock less the recording's, which is the C-arm's: the times
    of the signals are shifted by it, and whoever takes them for the C-arm's looks up the movement
    that much too early. Poses and views stay in the recording's time.
    """
    first, last = recovered.trajectories.times[[0, -1]]
    times = (
        first
        + np.arange(int(np.floor((last - first) * settings.rate_hz + 1e-6)) + 1) / settings.rate_hz
    )
    signals = simulation.simulate(recovered.leg, splines, placed, np.minimum(times, last))
    if settings.soft_tissue.amplitude > 0:
        signals = imu_skin_mount.swing(signals, skin_mount(settings.soft_tissue)).signals
    return replace(signals, times=signals.times + settings.clock_offset_s)


def noise_of(settings: NoiseConfig, *, imu_rate_hz: float, view_rate_hz: float) -> ImuNoise | None:
    """The configured noise; None for clean sensors."""
    if settings.kind == "none":
        return None
    if settings.kind == "density":
        plain = ImuNoise.from_density(
            acceleration_ug_per_sqrt_hz=settings.acceleration_ug_per_sqrt_hz,
            angular_velocity_deg_per_s_per_sqrt_hz=settings.angular_velocity_deg_per_s_per_sqrt_hz,
        )
    elif settings.kind == "rms":
        plain = ImuNoise.from_rms(
            acceleration_mg=settings.acceleration_mg,
            angular_velocity_deg_per_s=settings.angular_velocity_deg_per_s,
            bandwidth_hz=settings.bandwidth_hz,
        )
    else:
        plain = ImuNoise.paper(
            acceleration_exponent=None if settings.f_a == "none" else settings.f_a,
            angular_velocity_exponent=None if settings.f_g == "none" else settings.f_g,
            imu_rate_hz=imu_rate_hz,
            projection_rate_hz=view_rate_hz,
            convention=settings.convention,
        )
    return plain.with_bias(
        acceleration_mg=settings.acceleration_bias_mg,
        angular_velocity_deg_per_s=settings.angular_velocity_bias_deg_per_s,
    )


def noisy(
    signals: ImuSignals, settings: ImuConfig, *, view_rate_hz: float, rng: np.random.Generator
) -> ImuSignals:
    """The signals as the configured sensors read them."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    return signals if noise is None else add_noise(signals, noise, rng)


def noise_sentence(settings: ImuConfig, *, view_rate_hz: float) -> str:
    """What the noise is, in SI units on single samples, with the convention it was read by."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    if noise is None:
        return "IMU signals are free of noise."
    force, turn = noise.sample_rms(settings.rate_hz)
    ladder = (
        f", f_a = {settings.noise.f_a}, f_g = {settings.noise.f_g}"
        if settings.noise.kind == "paper"
        else ""
    )
    return (
        f"IMU signals carry white noise ({settings.noise.kind}{ladder}; {noise.convention} "
        f"convention) of {force:.3g} m/s^2 and "
        f"{np.degrees(turn):.3g} deg/s RMS a sample, and biases of "
        f"{settings.noise.acceleration_bias_mg:g} mg and "
        f"{settings.noise.angular_velocity_bias_deg_per_s:g} deg/s between sensors."
    )
