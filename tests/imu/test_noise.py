import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import strapdown
from legsim.imu.noise import Convention, ImuNoise, add_noise
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway

TIMES = np.arange(961) / 120


def still(count: int = 2000, rate_hz: float = 120.0) -> ImuSignals:
    return ImuSignals(
        np.arange(count) / rate_hz, ("a", "b"), np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
    )


def test_data_sheet_density_and_rms_are_the_same_noise():
    by_density = ImuNoise.from_density(
        acceleration_ug_per_sqrt_hz=180, angular_velocity_deg_per_s_per_sqrt_hz=0.007
    )
    by_rms = ImuNoise.from_rms(
        acceleration_mg=1.8, angular_velocity_deg_per_s=0.07, bandwidth_hz=100
    )
    assert by_density.acceleration_density == pytest.approx(by_rms.acceleration_density)
    assert by_density.angular_velocity_density == pytest.approx(by_rms.angular_velocity_density)


@pytest.mark.parametrize("rate_hz", [50.0, 120.0, 1000.0])
def test_samples_have_the_noise_of_their_band(rng: np.random.Generator, rate_hz: float):
    noise = ImuNoise.from_density(
        acceleration_ug_per_sqrt_hz=180, angular_velocity_deg_per_s_per_sqrt_hz=0.007
    )
    noisy = add_noise(still(20000, rate_hz), noise, rng)
    assert noisy.specific_force.std() == pytest.approx(
        180e-6 * 9.80665 * np.sqrt(rate_hz / 2), rel=0.02
    )
    assert np.degrees(noisy.angular_velocity.std()) == pytest.approx(
        0.007 * np.sqrt(rate_hz / 2), rel=0.02
    )


def test_noise_is_white_and_axes_are_independent(rng: np.random.Generator):
    noise = ImuNoise(1.0, 1.0)
    noisy = add_noise(still(20000), noise, rng)
    channels = np.concatenate(
        [noisy.specific_force.reshape(-1, 6), noisy.angular_velocity.reshape(-1, 6)], 1
    )
    both = np.concatenate([channels[1:], channels[:-1]], 1)
    correlation = np.corrcoef(both.T) - np.eye(24)
    assert np.abs(correlation).max() < 0.04


def test_paper_ladder_in_both_conventions():
    si = ImuNoise.paper(acceleration_exponent=0, angular_velocity_exponent=0)
    assert si.sample_rms(120) == pytest.approx((1.8e-3 * 9.80665, np.radians(0.07)))
    lower = ImuNoise.paper(acceleration_exponent=4, angular_velocity_exponent=1)
    assert lower.sample_rms(120) == pytest.approx((1.8e-7 * 9.80665, np.radians(0.007)))
    literal = ImuNoise.paper(
        acceleration_exponent=0, angular_velocity_exponent=0, convention="per-sample"
    )
    assert literal.sample_rms(120) == pytest.approx(
        (1.8e-3 * 9.80665 * 31**2, np.radians(0.07) * 120)
    )
    assert (si.convention, literal.convention) == ("SI", "per-sample")
    silent = ImuNoise.paper(acceleration_exponent=None, angular_velocity_exponent=None)
    assert silent.sample_rms(120) == (0, 0)


def test_no_noise_changes_nothing(rng: np.random.Generator):
    given = still()
    noisy = add_noise(given, ImuNoise(0.0, 0.0), rng)
    np.testing.assert_array_equal(noisy.specific_force, given.specific_force)
    np.testing.assert_array_equal(noisy.angular_velocity, given.angular_velocity)


def test_one_seed_is_one_noise_scaled_by_its_level():
    strong, weak = (
        add_noise(
            still(),
            ImuNoise.paper(acceleration_exponent=f, angular_velocity_exponent=None),
            np.random.default_rng(3),
        )
        for f in (0, 2)
    )
    np.testing.assert_allclose(strong.specific_force, 100 * weak.specific_force)


def test_bias_is_constant_and_differs_between_axes(rng: np.random.Generator):
    biased = add_noise(
        still(),
        ImuNoise(0.0, 0.0).with_bias(acceleration_mg=1, angular_velocity_deg_per_s=0.1),
        rng,
    )
    assert np.ptp(biased.specific_force, axis=0).max() == 0
    assert len(np.unique(biased.specific_force[0])) == 6
    draws = [
        add_noise(still(2), ImuNoise(0.0, 0.0).with_bias(acceleration_mg=1), rng).specific_force[0]
        for _ in range(500)
    ]
    assert np.std(draws) == pytest.approx(1e-3 * 9.80665, rel=0.05)


@pytest.mark.parametrize(
    ("convention", "f_a", "f_g", "expected_mm"),
    # 8 s at 120 Hz: sigma sqrt(T^3/12/rate) RMS over the scan for acceleration alone, in closed
    # form
    [("SI", 0, None, 10.5), ("per-sample", 0, None, 10100), ("SI", 1, None, 1.05)],
)
def test_drift_by_accelerometer_noise_is_the_random_walks(
    convention: Convention, f_a: float, f_g: float | None, expected_mm: float
):
    rng, sway = np.random.default_rng(5), Sway.standing(5)
    rate, force = sway.signals(TIMES)
    start, clean = (
        SensorStart(sway.poses(TIMES[:1])[0], sway.velocities(TIMES[:1])[0]),
        ImuSignals(TIMES, ("s",), rate[:, None], force[:, None]),
    )
    noise = ImuNoise.paper(
        acceleration_exponent=f_a, angular_velocity_exponent=f_g, convention=convention
    )
    square = 0.0
    for _ in range(40):
        noisy = add_noise(clean, noise, rng)
        poses = strapdown.integrate(TIMES, *noisy.sensor("s"), start, TIMES[::8])
        square += ((poses[:, :3, 3] - sway.poses(TIMES[::8])[:, :3, 3]) ** 2).mean() / 40
    assert 1e3 * np.sqrt(square) == pytest.approx(expected_mm, rel=0.25)


def test_refuses_sizes_that_are_none(rng: np.random.Generator):
    with pytest.raises(LegsimError, match="not negative"):
        ImuNoise(-1.0, 0.0)
    with pytest.raises(LegsimError, match="bandwidth"):
        ImuNoise.from_rms(acceleration_mg=1, angular_velocity_deg_per_s=1, bandwidth_hz=0)
    with pytest.raises(LegsimError, match="at least 2 samples"):
        add_noise(still(1), ImuNoise(1.0, 1.0), rng)
