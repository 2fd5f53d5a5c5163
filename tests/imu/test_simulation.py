import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import simulation, strapdown
from legsim.imu.sensors import Sensor, default_sensors
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel
from legsim.mocap.trajectories import JointTrajectories

TIMES = np.arange(0, 9.0, 1 / 120)
VIEWS = 0.3 + np.arange(248) / 31
GRAVITY = np.array([0.0, -9.80665, 0.0])


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


def swaying(leg: LegModel, seed: int = 0, size: float = 0.01) -> JointTrajectories:
    """Coordinates around a 30 degree squat, three slow sines each."""
    rng = np.random.default_rng(seed)
    names = leg.coordinate_names
    base = leg.default_coordinates.copy()
    for side in "lr":
        for name, degrees in (("hip_flexion", 25), ("knee_angle", -30), ("ankle_angle", 15)):
            base[names.index(f"{name}_{side}")] = np.radians(degrees)
    rate = 2 * np.pi * rng.uniform(0.15, 1.5, (3, len(names)))
    waves = (
        np.sin(TIMES[:, None, None] * rate + rng.uniform(0, 6, rate.shape))
        * size
        * 0.3
        / (rate / rate.min())
    )
    return JointTrajectories(TIMES, names, base + waves.sum(1))


def test_sensor_at_rest_reads_gravity_only(leg: LegModel):
    still = JointTrajectories(
        TIMES, leg.coordinate_names, np.tile(leg.default_coordinates, (len(TIMES), 1))
    )
    signals = simulation.simulate(leg, JointSplines(still), default_sensors(), TIMES[:50])
    rate, force = signals.sensor("shank_l")
    np.testing.assert_allclose(rate, 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(force, axis=-1), 9.80665, atol=1e-6)
    np.testing.assert_allclose(force[:, 1], 9.80665, atol=1e-3)


def test_signals_are_the_derivatives_of_the_poses(leg: LegModel):
    """Against differences of the sensors' own poses, which come by another way."""
    splines, at, h = JointSplines(swaying(leg, size=0.05)), np.linspace(1, 7, 40), 1e-3
    sensors = (
        *default_sensors(),
        Sensor(
            "odd",
            "calcn_r",
            0.02,
            np.array([0.05, 0.01, 0.03]),
            transforms.rotation_from_vector([1, 2, -0.5]),
        ),
    )
    signals = simulation.simulate(leg, splines, sensors, at)
    before, now, after = (
        simulation.sensor_poses(leg, splines, sensors, at + d).world_from_segment
        for d in (-h, 0, h)
    )
    second = (after[..., :3, 3] - 2 * now[..., :3, 3] + before[..., :3, 3]) / h**2 - GRAVITY
    expected = np.einsum("nkji,nkj->nki", now[..., :3, :3], second)
    np.testing.assert_allclose(signals.specific_force, expected, atol=2e-4)
    turn = transforms.vector_from_rotation(
        np.swapaxes(before[..., :3, :3], -1, -2) @ after[..., :3, :3]
    )
    np.testing.assert_allclose(signals.angular_velocity, turn / (2 * h), atol=2e-5)


def test_splines_pass_through_every_sample(leg: LegModel):
    given = swaying(leg)
    values, _, _ = JointSplines(given).at(TIMES, leg.coordinate_names)
    np.testing.assert_allclose(values, given.values, atol=1e-12)


def test_splines_rates_and_accelerations_match_the_sines():
    wave = np.sin(4 * TIMES)
    splines = JointSplines(JointTrajectories(TIMES, ("a", "b"), np.stack([wave, wave**2], -1)))
    at = np.linspace(0, TIMES[-1], 777)
    _, rates, accelerations = splines.at(at, ("b", "a"))
    np.testing.assert_allclose(
        rates, np.stack([4 * np.sin(8 * at), 4 * np.cos(4 * at)], -1), atol=1e-6
    )
    np.testing.assert_allclose(
        accelerations, np.stack([32 * np.cos(8 * at), -16 * np.sin(4 * at)], -1), atol=5e-4
    )


def test_whole_chain_reaches_the_noise_free_bound(leg: LegModel):
    """Joint splines, signals at 120 Hz, integrated for 8 s to the views: 0.05 mm and 0.001 deg are
    the bound.
    """
    splines = JointSplines(swaying(leg, seed=3, size=0.03))
    sensors = default_sensors()
    signals, truth = (
        simulation.simulate(leg, splines, sensors, TIMES),
        simulation.sensor_poses(leg, splines, sensors, VIEWS),
    )
    for sensor in sensors:
        true = truth.of(sensor.name)
        start = simulation.true_start(leg, splines, sensor, float(VIEWS[0]))
        found = strapdown.integrate(signals.times, *signals.sensor(sensor.name), start, VIEWS)
        assert np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=-1).max() < 5e-6
        assert transforms.rotation_angle(
            np.swapaxes(found[:, :3, :3], -1, -2) @ true[:, :3, :3]
        ).max() < np.radians(1e-5)


def test_true_start_is_the_pose_and_its_derivative(leg: LegModel):
    splines, h = JointSplines(swaying(leg, size=0.05)), 1e-4
    for sensor in default_sensors():
        start = simulation.true_start(leg, splines, sensor, 2.5)
        poses = simulation.sensor_poses(leg, splines, [sensor], [2.5 - h, 2.5, 2.5 + h]).of(
            sensor.name
        )
        np.testing.assert_allclose(start.world_from_sensor, poses[1], atol=1e-12)
        np.testing.assert_allclose(
            start.velocity, (poses[2] - poses[0])[:3, 3] / (2 * h), atol=1e-7
        )


def test_segment_poses_are_exact_at_any_time(leg: LegModel):
    splines = JointSplines(swaying(leg))
    at = np.array([0.1234, 3.21])
    expected = leg.segment_poses(
        JointTrajectories(at, leg.coordinate_names, splines.at(at, leg.coordinate_names)[0])
    )
    np.testing.assert_array_equal(
        joint_splines.segment_poses_at(leg, splines, at).world_from_segment,
        expected.world_from_segment,
    )


def test_refuses_times_outside_the_recording(leg: LegModel):
    with pytest.raises(LegsimError, match=r"times from 1 to 20 s .* recorded from 0 to 8\.99167 s"):
        simulation.simulate(leg, JointSplines(swaying(leg)), default_sensors(), [1.0, 20.0])


def test_refuses_motions_too_short_or_with_gaps(leg: LegModel):
    given = swaying(leg)
    with pytest.raises(LegsimError, match=r"has 5 samples; .* at least 6"):
        JointSplines(JointTrajectories(TIMES[:5], given.coordinate_names, given.values[:5]))
    broken = given.values.copy()
    broken[7, 3] = np.nan
    with pytest.raises(
        LegsimError, match=rf"coordinate {given.coordinate_names[3]} is not a number at 0\.0583"
    ):
        JointSplines(JointTrajectories(TIMES, given.coordinate_names, broken))


def test_refuses_unknown_segments_and_coordinates(leg: LegModel):
    splines = JointSplines(swaying(leg))
    with pytest.raises(LegsimError, match="tibia_x"):
        simulation.simulate(leg, splines, [Sensor.placed("s", "tibia_x", 0.1)], VIEWS)
    with pytest.raises(LegsimError, match="lacks the coordinates pelvis_ty"):
        JointSplines(JointTrajectories(TIMES, ("a",), np.zeros((len(TIMES), 1)))).at(
            VIEWS, ("a", "pelvis_ty")
        )
    with pytest.raises(LegsimError, match="names must differ"):
        simulation.simulate(leg, splines, [Sensor.placed("s", "tibia_l", 0.1)] * 2, VIEWS)
