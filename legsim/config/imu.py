"""Settings of the inertial sensors."""

from typing import Literal

from pydantic import Field

from legsim.config.tree import ConfigSection


class SensorConfig(ConfigSection):
    """One inertial sensor on a segment."""

    name: str = Field(pattern=r"^[^\x00-\x1f\x7f]*\S[^\x00-\x1f\x7f]*$")
    segment: str
    distance_mm: float
    """from the segment's proximal joint (its origin) down the segment"""
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """further offset along the segment's x, y, z"""
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """rotation vector of the sensor's axes against the segment's"""


class NoiseConfig(ConfigSection):
    """Noise of the sensors, drawn from the run's seed.

    Each kind reads its own numbers; defaults are the BMI160's.
    """

    kind: Literal["none", "density", "rms", "paper"] = "none"
    acceleration_ug_per_sqrt_hz: float = Field(default=180.0, ge=0)
    """density"""
    angular_velocity_deg_per_s_per_sqrt_hz: float = Field(default=0.007, ge=0)
    """density"""
    acceleration_mg: float = Field(default=1.8, ge=0)
    """rms"""
    angular_velocity_deg_per_s: float = Field(default=0.07, ge=0)
    """rms"""
    bandwidth_hz: float = Field(default=100.0, gt=0)
    """bandwidth in which the RMS was measured"""
    f_a: float | Literal["none"] = 0.0
    """paper: the accelerometer's RMS is divided by 10^f_a; "none" is no noise"""
    f_g: float | Literal["none"] = 0.0
    """paper: the same for the gyroscope"""
    convention: Literal["SI", "per-sample"] = "SI"
    """paper: "per-sample" leaves out the time steps, which reproduces the published numbers"""
    acceleration_bias_mg: float = Field(default=0.0, ge=0)
    """standard deviation between sensors; applies to every kind except none"""
    angular_velocity_bias_deg_per_s: float = Field(default=0.0, ge=0)


class SoftTissueConfig(ConfigSection):
    """A damped oscillator between a bone and what is attached to it."""

    amplitude: float = Field(default=0.0, ge=0)
    """share of the oscillator's swing: 0 is fixed to the bone, 1 is the full swing"""
    frequency_hz: float = Field(default=10.0, gt=0)
    damping: float = Field(default=0.25, gt=0)
    """of critical"""


class ImuConfig(ConfigSection):
    """The sensors; defaults are the paper's."""

    rate_hz: float = Field(default=120.0, gt=0)
    clock_offset_s: float = 0.0
    """the sensors' clock minus the C-arm's: what happens at t is stamped t plus this

    No method knows it.
    """
    soft_tissue: SoftTissueConfig = SoftTissueConfig()
    """how the sensors swing on the skin; the truth is that of sensors fixed to the bone"""
    noise: NoiseConfig = NoiseConfig()
    sensors: tuple[SensorConfig, ...] = Field(
        default=(
            SensorConfig(name="shank_l", segment="tibia_l", distance_mm=140),
            SensorConfig(name="thigh_l", segment="femur_l", distance_mm=250),
        ),
        min_length=1,
    )
