"""White noise and bias of inertial sensors, in SI or as the paper's equations count it.

Data sheets give a density (per square root of a hertz) and sometimes an RMS in a stated band: the
same white noise, stated twice. Maier et al. 2022 (section 2.2) take the BMI160's RMS, 1.8 mg and
0.07 deg/s, and divide it by powers of ten, f_a and f_g. Their results are only reproduced if those
numbers enter the recursion without the time step: degrees per sample of the IMU, and m per squared
projection interval. Both readings are here. ``convention`` says which one a value follows, and
belongs next to every number made with it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.signals import ImuSignals

BMI160_RMS_MG = 1.8
"""accelerometer of Bosch Sensortec's BMI160, in 100 Hz bandwidth (data sheet: 180 ug/sqrt(Hz))"""

BMI160_RMS_DEG_PER_S = 0.07
"""its gyroscope, in 100 Hz bandwidth (data sheet: 0.007 deg/s/sqrt(Hz))"""

Convention = Literal["SI", "per-sample"]


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """White Gaussian noise of a sensor, and constant biases.

    Densities are one-sided. Biases are drawn once per recording and axis.
    """

    acceleration_density: float
    """m/s^2 per sqrt(Hz)"""
    angular_velocity_density: float
    """rad/s per sqrt(Hz)"""
    acceleration_bias: float = 0.0
    """m/s^2, standard deviation between sensors"""
    angular_velocity_bias: float = 0.0
    """rad/s, standard deviation between sensors"""
    convention: Convention = "SI"
    """"per-sample": densities inflated by the units that the paper's equations leave out

    See :meth:`paper`.
    """

    def __post_init__(self) -> None:
        sizes = (
            self.acceleration_density,
            self.angular_velocity_density,
            self.acceleration_bias,
            self.angular_velocity_bias,
        )
        if not all(np.isfinite(size) and size >= 0 for size in sizes):
            raise LegsimError(
                "noise and bias must be finite and not negative; got "
                f"{', '.join(f'{size:g}' for size in sizes)}"
            )

    @classmethod
    def from_density(
        cls, *, acceleration_ug_per_sqrt_hz: float, angular_velocity_deg_per_s_per_sqrt_hz: float
    ) -> "ImuNoise":
        """Noise of the data sheet's densities, in micro-g and deg/s per square root of a hertz."""
        return cls(
            acceleration_ug_per_sqrt_hz * 1e-6 * STANDARD_GRAVITY,
            float(np.radians(angular_velocity_deg_per_s_per_sqrt_hz)),
        )

    @classmethod
    def from_rms(
        cls, *, acceleration_mg: float, angular_velocity_deg_per_s: float, bandwidth_hz: float
    ) -> "ImuNoise":
        """Noise of an RMS measured in a band: density = RMS / sqrt(bandwidth).

        Raises:
            LegsimError: the bandwidth is not positive.
        """
        if not bandwidth_hz > 0:
            raise LegsimError(
                f"an RMS noise needs the bandwidth it was measured in, in Hz; got {bandwidth_hz:g}"
            )
        root = np.sqrt(bandwidth_hz)
        return cls(
            acceleration_mg * 1e-3 * STANDARD_GRAVITY / root,
            float(np.radians(angular_velocity_deg_per_s)) / root,
        )

    @classmethod
    def paper(
        cls,
        *,
        acceleration_exponent: float | None,
        angular_velocity_exponent: float | None,
        imu_rate_hz: float = 120.0,
        projection_rate_hz: float = 31.0,
        convention: Convention = "SI",
    ) -> "ImuNoise":
        """Noise of one cell of the paper's ladder.

        It is the BMI160's RMS over 10^f_a and 10^f_g on every sample; None is no noise.

        Args:
            acceleration_exponent: f_a.
            angular_velocity_exponent: f_g.
            imu_rate_hz: rate of the signals the noise will be added to.
            projection_rate_hz: rate of the views.
            convention: "SI" adds m/s^2 and rad/s. "per-sample" adds degrees per IMU sample (x
                imu_rate) and meters per squared projection interval (x projection_rate^2): the
                reading that reproduces the paper's Table 2.
        """
        turn_unit, shift_unit = (
            (imu_rate_hz, projection_rate_hz**2) if convention == "per-sample" else (1.0, 1.0)
        )
        rms_mg = (
            0.0
            if acceleration_exponent is None
            else shift_unit * BMI160_RMS_MG / 10**acceleration_exponent
        )
        rms_deg_per_s = (
            0.0
            if angular_velocity_exponent is None
            else turn_unit * BMI160_RMS_DEG_PER_S / 10**angular_velocity_exponent
        )
        # the RMS is that of each sample: the whole band up to half the sampling rate
        plain = cls.from_rms(
            acceleration_mg=rms_mg,
            angular_velocity_deg_per_s=rms_deg_per_s,
            bandwidth_hz=imu_rate_hz / 2,
        )
        return cls(
            plain.acceleration_density, plain.angular_velocity_density, convention=convention
        )

    def with_bias(
        self, *, acceleration_mg: float = 0.0, angular_velocity_deg_per_s: float = 0.0
    ) -> "ImuNoise":
        """The same noise with constant biases of these standard deviations.

        Biases are the same in either convention.
        """
        bias = (
            acceleration_mg * 1e-3 * STANDARD_GRAVITY,
            float(np.radians(angular_velocity_deg_per_s)),
        )
        return ImuNoise(
            self.acceleration_density,
            self.angular_velocity_density,
            *bias,
            convention=self.convention,
        )

    def sample_rms(self, rate_hz: float) -> tuple[float, float]:
        """Standard deviation (m/s^2, rad/s) of single samples taken at ``rate_hz``.

        It is density x sqrt(rate / 2).
        """
        root = float(np.sqrt(rate_hz / 2))
        return self.acceleration_density * root, self.angular_velocity_density * root


def add_noise(signals: ImuSignals, noise: ImuNoise, rng: np.random.Generator) -> ImuSignals:
    """Adds noise and bias to the signals; every axis and sensor is independent.

    Raises:
        LegsimError: fewer than two samples, which leave the bandwidth of the noise open.
    """
    if len(signals.times) < 2:
        raise LegsimError("noise needs signals of at least 2 samples: their rate decides its size")
    rate_hz = (len(signals.times) - 1) / float(signals.times[-1] - signals.times[0])
    force_rms, turn_rms = noise.sample_rms(rate_hz)
    force = signals.specific_force + _disturbance(
        signals.specific_force, force_rms, noise.acceleration_bias, rng
    )
    turn = signals.angular_velocity + _disturbance(
        signals.angular_velocity, turn_rms, noise.angular_velocity_bias, rng
    )
    return replace(signals, angular_velocity=turn, specific_force=force)


def _disturbance(
    clean: FloatArray, rms: float, bias: float, rng: np.random.Generator
) -> FloatArray:
    """White noise (n, k, 3) of ``rms`` plus a constant ``bias`` (k, 3) drawn per axis.

    The draws do not depend on the sizes: one seed gives one noise at every level.
    """
    return rms * rng.standard_normal(clean.shape) + bias * rng.standard_normal(clean.shape[1:])
