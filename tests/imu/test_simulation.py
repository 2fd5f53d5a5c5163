import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import simulation, strapdown
from legsim.imu.sensors import Sensor, default_sensors
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap.trajectories import JointTrajectories
from tests.examples.sway_of_joints import TIMES, swaying

VIEWS = 0.3 + np.arange(248) / 31
GRAVITY = np.array([0.0, -9.80665, 0.0])


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


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


def test_refuses_times_outside_the_recording(leg: LegModel):
    with pytest.raises(LegsimError, match=r"times from 1 to 20 s .* recorded from 0 to 8\.99167 s"):
        simulation.simulate(leg, JointSplines(swaying(leg)), default_sensors(), [1.0, 20.0])


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


@pytest.fixture(scope="module")
def swayer(leg: LegModel) -> MovingLeg:
    return MovingLeg("sway", leg, swaying(leg, size=0.05), None)


def test_each_sensor_has_its_own_mount_and_vibration(swayer: MovingLeg):
    rigid = simulation.simulate_imu(swayer)
    mount = SkinMount(8.0, 0.2)
    all_swing = simulation.simulate_imu(swayer, skin_mount=mount)
    one_swings = simulation.simulate_imu(swayer, skin_mount=[None, mount])
    np.testing.assert_array_equal(one_swings.specific_force[:, 0], rigid.specific_force[:, 0])
    np.testing.assert_array_equal(one_swings.specific_force[:, 1], all_swing.specific_force[:, 1])
    shake = Vibration(acceleration=0.05, rate=0.01)
    both, one = (
        simulation.simulate_imu(swayer, vibration=given, rng=np.random.default_rng(2))
        for given in (shake, [None, shake])
    )
    np.testing.assert_array_equal(one.specific_force[:, 0], rigid.specific_force[:, 0])
    np.testing.assert_array_equal(one.specific_force[:, 1], both.specific_force[:, 1])
    apart = both.specific_force - rigid.specific_force
    assert abs(np.corrcoef(apart[:, 0, 0], apart[:, 1, 0])[0, 1]) < 0.2


def test_nothing_that_moves_leaves_the_signals_as_they_are(swayer: MovingLeg):
    rigid = simulation.simulate_imu(swayer)
    same = simulation.simulate_imu(
        swayer, skin_mount=SkinMount(8.0, 0.2, 0.0), vibration=Vibration()
    )
    np.testing.assert_array_equal(same.specific_force, rigid.specific_force)
    np.testing.assert_array_equal(same.angular_velocity, rigid.angular_velocity)


def test_mounts_of_other_sensors_and_draws_without_a_generator_are_refused(swayer: MovingLeg):
    with pytest.raises(LegsimError, match="1 skin mounts are given for 2 sensors"):
        simulation.simulate_imu(swayer, skin_mount=[SkinMount(8.0, 0.2)])
    with pytest.raises(LegsimError, match=r"give a numpy\.random\.Generator"):
        simulation.simulate_imu(swayer, vibration=Vibration(acceleration=0.1))
