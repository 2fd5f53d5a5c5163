"""Settings of the inertial sensors."""

from typing import Literal

from pydantic import Field, NonNegativeFloat

from legsim.config.tree import Band, ConfigSection


class SoftTissueConfig(ConfigSection):
    """A damped oscillator between a bone and what is attached to it."""

    amplitude: float = Field(default=0.0, ge=0)
    """share of the oscillator's swing: 0 is fixed to the bone, 1 is the full swing"""
    frequency_hz: float = Field(default=10.0, gt=0)
    damping: float = Field(default=0.25, gt=0)
    """of critical"""


Axes = tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat]


class SkinMountConfig(SoftTissueConfig):
    """How a sensor swings on the skin; the truth is that of a sensor fixed to the bone."""

    axes: Axes = (1.0, 1.0, 1.0)
    """of that share along the sensor's own x, y, z"""
    turn_amplitude: float = Field(default=0.0, ge=0)
    """share of the swing by which the sensor turns: 0 turns with the bone"""
    turn_frequency_hz: float = Field(default=10.0, gt=0)
    """resonance of the turn"""
    turn_axes: Axes = (1.0, 1.0, 1.0)
    """of the turn's share about the sensor's own x, y, z"""


class VibrationConfig(ConfigSection):
    """Vibration of muscle and skin under a sensor, drawn from the run's seed.

    Images do not see it; what moves the bones is motion.tremor. Sizes are the RMS of the vector.
    """

    acceleration_mg: float = Field(default=0.0, ge=0)
    acceleration_band_hz: Band = (3.0, 30.0)
    acceleration_axes: Axes = (1.0, 1.0, 1.0)
    """relative sizes along the sensor's own x, y, z"""
    angular_velocity_deg_per_s: float = Field(default=0.0, ge=0)
    angular_velocity_band_hz: Band = (0.5, 5.0)
    angular_velocity_axes: Axes = (1.0, 1.0, 1.0)
    """relative sizes about the sensor's own x, y, z"""


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
    soft_tissue: SkinMountConfig | None = None
    """this sensor's own, in place of imu.soft_tissue"""
    vibration: VibrationConfig | None = None
    """this sensor's own, in place of imu.vibration"""


class TriadConfig(ConfigSection):
    """Changes to the errors of a triad, in the units of a sensor's file; None leaves its value."""

    scale_error_percent: float | None = Field(default=None, ge=0)
    """standard deviation per axis"""
    misalignment_percent: float | None = Field(default=None, ge=0)
    """what one axis reads of another, standard deviation"""
    scale_percent_per_k: float | None = Field(default=None, ge=0)
    bits: int | None = Field(default=None, ge=0, le=32)
    """of the whole range; 0: no rounding"""
    bandwidth_hz: float | None = Field(default=None, ge=0)
    """-3 dB of the sensor's own low-pass; 0: none"""
    filter_order: int | None = Field(default=None, ge=1, le=8)
    instability_time_s: float | None = Field(default=None, ge=0)
    """0: flicker noise; else the correlation time of a Gauss-Markov process"""


_BIASES = ("acceleration_bias_mg", "angular_velocity_bias_deg_per_s")


class AccelerometerConfig(TriadConfig):
    """Changes to the errors of the accelerometer."""

    noise_density_ug_per_sqrt_hz: float | None = Field(default=None, ge=0)
    turn_on_bias_mg: float | None = Field(default=None, ge=0)
    bias_instability_ug: float | None = Field(default=None, ge=0)
    """the lowest Allan deviation"""
    random_walk_ug_per_sqrt_s: float | None = Field(default=None, ge=0)
    bias_mg_per_k: float | None = Field(default=None, ge=0)
    range_g: float | None = Field(default=None, ge=0)


class GyroscopeConfig(TriadConfig):
    """Changes to the errors of the gyroscope."""

    noise_density_deg_per_s_per_sqrt_hz: float | None = Field(default=None, ge=0)
    turn_on_bias_deg_per_s: float | None = Field(default=None, ge=0)
    bias_instability_deg_per_h: float | None = Field(default=None, ge=0)
    """the lowest Allan deviation"""
    random_walk_deg_per_h_per_sqrt_h: float | None = Field(default=None, ge=0)
    g_sensitivity_deg_per_s_per_g: float | None = Field(default=None, ge=0)
    bias_deg_per_s_per_k: float | None = Field(default=None, ge=0)
    range_deg_per_s: float | None = Field(default=None, ge=0)


WHITE: dict[str, frozenset[str]] = {
    "density": frozenset(
        {"acceleration_ug_per_sqrt_hz", "angular_velocity_deg_per_s_per_sqrt_hz", *_BIASES}
    ),
    "rms": frozenset({"acceleration_mg", "angular_velocity_deg_per_s", "bandwidth_hz", *_BIASES}),
    "paper": frozenset({"f_a", "f_g", "convention", *_BIASES}),
}
"""kinds that are white noise and constant bias, and the keys that each reads"""


def noise_keys(kind: str) -> frozenset[str]:
    """Keys of [imu.noise] that a kind of noise reads, besides the kind itself."""
    if kind == "none":
        return frozenset()
    errors = ("off", "accelerometer", "gyroscope", "temperature_course", "calibration", "rest_s")
    return WHITE.get(kind, frozenset(errors))


class NoiseConfig(ConfigSection):
    """Errors of the sensors, drawn from the run's seed.

    Each kind reads its own numbers; defaults are the BMI160's.
    """

    kind: str = Field(default="none", min_length=1)
    """none; density, rms or paper: white noise and constant bias; custom: the errors below alone;
    else a sensor of the catalogue ("bmi160") or the path of a sensor's TOML file
    """
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
    """standard deviation between sensors; applies to density, rms and paper"""
    angular_velocity_bias_deg_per_s: float = Field(default=0.0, ge=0)
    accelerometer: AccelerometerConfig = AccelerometerConfig()
    """custom and sensors: changes to the errors"""
    gyroscope: GyroscopeConfig = GyroscopeConfig()
    off: tuple[str, ...] = ()
    """custom and sensors: names of error terms that are switched off, such as "temperature\""""
    temperature_course: tuple[tuple[float, float], ...] = ()
    """custom and sensors: [seconds from the first sample, kelvin off the factory's calibration]"""
    calibration: Literal["none", "rest", "six-positions"] = "none"
    """custom and sensors: what is recorded before the scan and corrected by"""
    rest_s: float = Field(default=10.0, gt=0)
    """duration of each rest of the calibration"""


class ImuConfig(ConfigSection):
    """The sensors; defaults are the paper's."""

    rate_hz: float = Field(default=120.0, gt=0)
    clock_offset_s: float = 0.0
    """the sensors' clock minus the C-arm's: what happens at t is stamped t plus this

    No method knows it.
    """
    clock_drift_ppm: float = Field(default=0.0, gt=-1e5, lt=1e5)
    """by which the sensors' clock is fast; samples are even on that clock"""
    lost_share: float = Field(default=0.0, ge=0, lt=1)
    """probability that a sample does not reach the file"""
    lost: Literal["marked", "held"] = "marked"
    """what the file holds instead: nan, which methods leave out, or the sample before"""
    soft_tissue: SkinMountConfig = SkinMountConfig()
    """how the sensors swing on the skin; the truth is that of sensors fixed to the bone"""
    vibration: VibrationConfig = VibrationConfig()
    """of muscle and skin under the sensors"""
    noise: NoiseConfig = NoiseConfig()
    sensors: tuple[SensorConfig, ...] = Field(
        default=(
            SensorConfig(name="shank_l", segment="tibia_l", distance_mm=140),
            SensorConfig(name="thigh_l", segment="femur_l", distance_mm=250),
        ),
        min_length=1,
    )
