"""The sensors' settings become noise of the stated size."""

import numpy as np
import pytest

from legsim.config import ImuConfig, NoiseConfig
from legsim.imu import noise
from legsim.imu.signals import ImuSignals
from legsim.run import sensors
from tests.references.sway import Sway


def signals(count: int = 60) -> ImuSignals:
    rate, force = Sway.standing(0).signals(np.arange(count) / 120)
    return ImuSignals(np.arange(count) / 120, ("shank_l",), rate[:, None], force[:, None])


@pytest.mark.parametrize(
    ("settings", "force_rms", "turn_rms_deg"),
    [
        (NoiseConfig(kind="density"), 180e-6 * 9.80665 * np.sqrt(60), 0.007 * np.sqrt(60)),
        (NoiseConfig(kind="rms"), 1.8e-3 * 9.80665 * np.sqrt(0.6), 0.07 * np.sqrt(0.6)),
        (NoiseConfig(kind="paper", f_a=1, f_g=2), 1.8e-4 * 9.80665, 0.07e-2),
        (NoiseConfig(kind="paper", f_a="none", f_g=0), 0.0, 0.07),
        (
            NoiseConfig(kind="paper", f_a=0, f_g=0, convention="per-sample"),
            1.8e-3 * 9.80665 * 31**2,
            0.07 * 120,
        ),
    ],
)
def test_noise_is_as_large_as_it_says(settings: NoiseConfig, force_rms: float, turn_rms_deg: float):
    clean = signals(40000)
    noisy = sensors.noisy(
        clean, ImuConfig(noise=settings), view_rate_hz=31.0, rng=np.random.default_rng(0)
    )
    assert (noisy.specific_force - clean.specific_force).std() == pytest.approx(force_rms, rel=0.02)
    assert np.degrees((noisy.angular_velocity - clean.angular_velocity).std()) == pytest.approx(
        turn_rms_deg, rel=0.02
    )


def test_clean_sensors_are_left_and_one_seed_gives_one_noise():
    given = signals()
    assert (
        sensors.noisy(given, ImuConfig(), view_rate_hz=31.0, rng=np.random.default_rng(0)) is given
    )
    settings = ImuConfig(noise=NoiseConfig(kind="rms", acceleration_bias_mg=3))
    first, again = (
        sensors.noisy(signals(), settings, view_rate_hz=31.0, rng=np.random.default_rng(5))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.specific_force, again.specific_force)


def test_the_sentence_names_size_and_convention():
    assert (
        sensors.noise_sentence(ImuConfig(), view_rate_hz=31.0) == "IMU signals are free of noise."
    )
    sentence = sensors.noise_sentence(
        ImuConfig(noise=NoiseConfig(kind="paper", f_a=2, f_g=3, convention="per-sample")),
        view_rate_hz=31.0,
    )
    assert "per-sample convention" in sentence
    assert "f_a = 2.0, f_g = 3.0" in sentence
    rms = noise.ImuNoise.paper(
        acceleration_exponent=2, angular_velocity_exponent=3, convention="per-sample"
    ).sample_rms(120)[0]
    assert f"{rms:.3g} m/s^2" in sentence
