"""The sensors' settings become noise of the stated size."""

import numpy as np
import pytest

from legsim.config import ImuConfig, NoiseConfig, SkinMountConfig, VibrationConfig
from legsim.imu import noise, simulation
from legsim.imu.signals import ImuSignals
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.run import sensors
from tests.examples.sway_of_joints import swaying
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


@pytest.fixture(scope="module")
def swayer() -> MovingLeg:
    leg = LegModel.load()
    return MovingLeg("sway", leg, swaying(leg, size=0.05), None)


def test_settings_of_one_sensor_take_the_place_of_those_of_all(swayer: MovingLeg):
    """Mount and vibration, in SI: the shank's own are off, the thigh has what all have."""
    shank, thigh = ImuConfig().sensors
    calm = shank.model_copy(
        update={"soft_tissue": SkinMountConfig(), "vibration": VibrationConfig()}
    )
    for_all = ImuConfig(
        soft_tissue=SkinMountConfig(amplitude=0.8, turn_amplitude=0.5, axes=(1, 0, 1)),
        vibration=VibrationConfig(acceleration_mg=3, angular_velocity_deg_per_s=0.5),
        sensors=(calm, thigh),
    )
    rigid = sensors.sense(swayer, ImuConfig())
    felt = sensors.sense(swayer, for_all, np.random.default_rng(1))
    mount = SkinMount(10.0, 0.25, 0.8, (1, 0, 1), 0.5)
    shake = Vibration(3e-3 * 9.80665, rate=float(np.radians(0.5)))
    expected = simulation.simulate_imu(
        swayer,
        skin_mount=[None, mount],
        vibration=[None, shake],
        rng=np.random.default_rng(1),
    )
    for name in ("specific_force", "angular_velocity"):
        read = getattr(felt, name)
        np.testing.assert_array_equal(read[:, 0], getattr(rigid, name)[:, 0])
        np.testing.assert_array_equal(read, getattr(expected, name))
    assert sensors.vibrate(for_all)
    assert not sensors.vibrate(ImuConfig())


def test_the_report_names_the_sensors_that_skin_moves():
    assert sensors.skin_sentences(ImuConfig()) == ()
    shank, thigh = ImuConfig().sensors
    own = thigh.model_copy(update={"vibration": VibrationConfig(acceleration_mg=3)})
    swings, shakes = sensors.skin_sentences(
        ImuConfig(soft_tissue=SkinMountConfig(turn_amplitude=1), sensors=(shank, own))
    )
    assert swings == "Sensors swing on soft tissue: shank_l, thigh_l."
    assert "thigh_l by 3 mg and 0 deg/s RMS" in shakes
    assert "shank" not in shakes
