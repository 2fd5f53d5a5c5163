"""The configured sensors and their noise, in SI units."""

from dataclasses import replace

import numpy as np

from legsim import config
from legsim.config import ImuConfig, NoiseConfig
from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.imu.noise import ImuNoise, add_noise
from legsim.imu.sensors import Sensor
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import simulate_imu
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration
from legsim.kinematics.moving_leg import MovingLeg


def sensors(settings: ImuConfig) -> tuple[Sensor, ...]:
    """Builds the configured sensors in SI units."""
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
    """Builds the configured oscillator between a bone and what is attached to it."""
    return SkinMount(settings.frequency_hz, settings.damping, settings.amplitude)


def _mount(settings: config.SkinMountConfig) -> SkinMount:
    """Builds the configured hold of a sensor on the skin."""
    return replace(
        skin_mount(settings),
        axes=settings.axes,
        turn_amplitude=settings.turn_amplitude,
        turn_frequency_hz=settings.turn_frequency_hz,
        turn_axes=settings.turn_axes,
    )


def _vibration(settings: config.VibrationConfig) -> Vibration:
    return Vibration(
        1e-3 * STANDARD_GRAVITY * settings.acceleration_mg,
        settings.acceleration_band_hz,
        settings.acceleration_axes,
        float(np.radians(settings.angular_velocity_deg_per_s)),
        settings.angular_velocity_band_hz,
        settings.angular_velocity_axes,
    )


def _vibrations(settings: ImuConfig) -> list[Vibration]:
    """Builds the vibration of each sensor."""
    return [_vibration(s.vibration or settings.vibration) for s in settings.sensors]


def vibrate(settings: ImuConfig) -> bool:
    """Whether the signals before noise depend on the run's seed."""
    return any(vibration.moves for vibration in _vibrations(settings))


def skin_sentences(settings: ImuConfig) -> tuple[str, ...]:
    """Describes what skin and muscle do to the sensors; nothing where the bone holds them."""
    swinging = [
        s.name for s in settings.sensors if _mount(s.soft_tissue or settings.soft_tissue).moves
    ]
    shaken = [(s.name, s.vibration or settings.vibration) for s in settings.sensors]
    vibrating = [
        f"{name} by {v.acceleration_mg:g} mg and {v.angular_velocity_deg_per_s:g} deg/s RMS"
        for name, v in shaken
        if _vibration(v).moves
    ]
    sentences = []
    if swinging:
        sentences.append(f"Sensors swing on soft tissue: {', '.join(swinging)}.")
    if vibrating:
        sentences.append(f"Muscle and skin shake the sensors: {', '.join(vibrating)}.")
    return tuple(sentences)


def sense(
    person: MovingLeg, settings: ImuConfig, rng: np.random.Generator | None = None
) -> ImuSignals:
    """Simulates the configured sensors without noise; ``rng`` draws their vibration."""
    return simulate_imu(
        person,
        sensors(settings),
        rate_hz=settings.rate_hz,
        skin_mount=[_mount(s.soft_tissue or settings.soft_tissue) for s in settings.sensors],
        vibration=_vibrations(settings),
        clock_offset=settings.clock_offset_s,
        rng=rng,
    )


def noise_of(settings: NoiseConfig, *, imu_rate_hz: float, view_rate_hz: float) -> ImuNoise | None:
    """Builds the configured noise; None for sensors without noise."""
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
    """Adds the configured noise to the signals."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    return signals if noise is None else add_noise(signals, noise, rng)


def noise_sentence(settings: ImuConfig, *, view_rate_hz: float) -> str:
    """Describes the noise in SI units on single samples, with its convention."""
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
        f"{np.degrees(turn):.3g} deg/s RMS per sample, and biases of "
        f"{settings.noise.acceleration_bias_mg:g} mg and "
        f"{settings.noise.angular_velocity_bias_deg_per_s:g} deg/s between sensors."
    )
