"""The leg model: laws of kinematics, OpenSim's numbers, exact sensors."""

# mujoco is compiled and ships no type stubs
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from legsim.core import resources, transforms
from legsim.core.constants import GRAVITY_WORLD
from legsim.core.errors import LegsimError
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales, segment_index
from legsim.mocap.trajectories import JointTrajectories

LEG = LegModel.load()
SITES = MarkerSites(
    ("foot", "shank", "hip", "toe", "thigh"),
    ("calcn_r", "tibia_l", "pelvis", "toes_l", "femur_r"),
    [[0.1, 0.02, 0.03], [0.01, -0.2, 0.05], [0.1, 0.1, 0.1], [0.02, 0, 0], [0, -0.3, 0.1]],
    np.ones(5),
)


def random_values(rng, n):
    low, high = LEG.coordinate_ranges.T
    return low + (high - low) * rng.random((n, len(COORDINATES)))


def motion(values):
    return JointTrajectories(np.arange(len(values)), COORDINATES, values)


def random_scales(rng):
    return SegmentScales(rng.uniform(0.8, 1.2, (len(SEGMENTS), 3)))


def test_standing_joint_centers_are_gait2392s():
    centers = LEG.joint_centers(LEG.segment_poses(motion(LEG.default_coordinates[None])))
    for side, z in (("r", 0.0835), ("l", -0.0835)):
        np.testing.assert_allclose(
            centers.of(f"hip_{side}")[0], (-0.0707, 0.95 - 0.0661, z), atol=1e-9
        )
        np.testing.assert_allclose(
            centers.of(f"knee_{side}")[0], (-0.0707 - 0.00449986, 0.8839 - 0.39582070, z), atol=1e-8
        )
        np.testing.assert_allclose(
            centers.of(f"ankle_{side}")[0],
            (-0.0707 - 0.00449986, 0.8839 - 0.82582070, z),
            atol=1e-8,
        )


def test_knee_flexion_is_negative_and_bends_the_shank_backward():
    bent = LEG.default_coordinates.copy()
    bent[COORDINATES.index("knee_angle_r")] = -1.0
    centers = LEG.joint_centers(LEG.segment_poses(motion(bent[None])))
    assert centers.of("ankle_r")[0, 0] < centers.of("ankle_l")[0, 0] - 0.3


def test_left_mirrors_right(rng):
    values = random_values(rng, 20)
    values[:, COORDINATES.index("pelvis_list")] = values[
        :, COORDINATES.index("pelvis_rotation")
    ] = 0
    values[:, COORDINATES.index("pelvis_tz")] = 0
    values[:, 13:] = values[:, 6:13]
    poses = LEG.segment_poses(motion(values))
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    for name in (s[:-2] for s in SEGMENTS if s.endswith("_r")):
        np.testing.assert_allclose(
            poses.of(f"{name}_l"), mirror @ poses.of(f"{name}_r") @ mirror, atol=1e-12
        )


def test_jacobians_match_finite_differences(rng):
    leg, values, h = LegModel.load(random_scales(rng)), random_values(rng, 20), 1e-6
    jacobians = leg.marker_jacobians(values, SITES)
    for c in range(len(COORDINATES)):
        step = h * np.eye(len(COORDINATES))[c]
        slope = (
            leg.marker_positions(values + step, SITES) - leg.marker_positions(values - step, SITES)
        ) / (2 * h)
        np.testing.assert_allclose(jacobians[..., c], slope, atol=1e-8)


@pytest.mark.parametrize("segment", ["pelvis", "femur_r", "tibia_l", "patella_r", "toes_r"])
def test_sensors_match_finite_differences(rng, segment):
    leg, values = LegModel.load(random_scales(rng)), random_values(rng, 8)
    rates, accelerations, h = rng.normal(size=values.shape), rng.normal(size=values.shape), 1e-4
    segment_from_sensor = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=3)), rng.uniform(-0.2, 0.2, 3)
    )

    def pose(t):
        return leg.attached_motion(
            values + t * rates + t * t / 2 * accelerations,
            rates,
            accelerations,
            segment=segment,
            segment_from_sensor=segment_from_sensor,
        ).world_from_sensor

    found = leg.attached_motion(
        values, rates, accelerations, segment=segment, segment_from_sensor=segment_from_sensor
    )
    before, now, after = pose(-h), pose(0), pose(h)
    acceleration = (after - 2 * now + before)[:, :3, 3] / h**2
    np.testing.assert_allclose(
        found.specific_force,
        np.einsum("nji,nj->ni", now[:, :3, :3], acceleration - GRAVITY_WORLD),
        atol=1e-5,
        rtol=0,
    )
    turn = transforms.vector_from_rotation(
        np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
    ) / (2 * h)
    np.testing.assert_allclose(found.angular_velocity, turn, atol=1e-5, rtol=0)


def test_sensor_at_rest_reads_gravity_upward(rng):
    still = np.zeros((3, len(COORDINATES)))
    sensor = LEG.attached_motion(
        random_values(rng, 3), still, still, segment="tibia_l", segment_from_sensor=np.eye(4)
    )
    world_force = np.einsum(
        "nij,nj->ni", sensor.world_from_sensor[:, :3, :3], sensor.specific_force
    )
    np.testing.assert_allclose(world_force, [[0, 9.80665, 0]] * 3, atol=1e-12)
    np.testing.assert_allclose(sensor.angular_velocity, 0, atol=1e-15)


def test_the_sensor_pose_is_the_segment_pose(rng):
    values, still = random_values(rng, 4), np.zeros((4, len(COORDINATES)))
    segment_from_sensor = transforms.rigid(
        transforms.rotation_from_vector([0.3, 0.2, 0.1]), [0.1, 0.2, 0.3]
    )
    sensor = LEG.attached_motion(
        values, still, still, segment="femur_l", segment_from_sensor=segment_from_sensor
    )
    expected = LEG.segment_poses(motion(values)).of("femur_l") @ segment_from_sensor
    np.testing.assert_allclose(sensor.world_from_sensor, expected, atol=1e-12)


def test_scaling_moves_the_joints_by_the_parent_factors():
    factors = np.ones((len(SEGMENTS), 3))
    factors[segment_index("pelvis")] = 1.1, 1.2, 1.3
    factors[segment_index("femur_r")] = 0.9, 0.8, 1.0
    leg = LegModel.load(SegmentScales(factors))
    values = leg.default_coordinates.copy()
    values[COORDINATES.index("knee_angle_r")] = np.radians(-90)
    centers = leg.joint_centers(leg.segment_poses(motion(values[None])))
    hip = np.array([-0.0707 * 1.1, 0.95 - 0.0661 * 1.2, 0.0835 * 1.3])
    np.testing.assert_allclose(centers.of("hip_r")[0], hip, atol=1e-12)
    np.testing.assert_allclose(
        centers.of("knee_r")[0],
        hip + np.array([0.0032587518503 * 0.9, -0.4139921977551 * 0.8, 0]),
        atol=1e-12,
    )


def test_lengths_are_distances_of_joint_centers(rng):
    leg = LegModel.load(random_scales(rng))
    centers = leg.joint_centers(leg.segment_poses(motion(leg.default_coordinates[None])))
    for side in "rl":
        hip, knee, ankle = (centers.of(f"{joint}_{side}")[0] for joint in ("hip", "knee", "ankle"))
        assert leg.thigh_length(side) == pytest.approx(np.linalg.norm(hip - knee))
        assert leg.shank_length(side) == pytest.approx(np.linalg.norm(ankle - knee))


def test_masses_follow_the_volume_or_a_given_total():
    assert LegModel.load(SegmentScales.uniform(1.1)).mass_of("femur_r") == pytest.approx(
        9.3014 * 1.1**3
    )
    heavy = LegModel.load(SegmentScales.uniform(1.1, mass=2 * 75.337))
    assert heavy.mass_of("tibia_l") == pytest.approx(2 * 3.7075)
    np.testing.assert_allclose(
        heavy.inertia_of("tibia_l"), 2 * 1.1**2 * np.array([0.0504, 0.0051, 0.0511])
    )
    np.testing.assert_allclose(heavy.mass_center_of("tibia_l"), [0, -0.1867 * 1.1, 0])


def test_unequal_factors_turn_inertia_into_a_cylinders():
    factors = np.ones((len(SEGMENTS), 3))
    factors[segment_index("femur_r")] = 1.1, 1.2, 1.3
    inertia = LegModel.load(SegmentScales(factors)).inertia_of("femur_r")
    np.testing.assert_allclose(
        inertia, [0.3305711, 0.08613119, 0.3305711], rtol=1e-6
    )  # OpenSim's Body.scaleInertialProperties


def test_coordinates_are_taken_by_name():
    values = LEG.default_coordinates[None] + 0.1
    shuffled = JointTrajectories(
        [0.0], (*COORDINATES[::-1], "lumbar_extension"), np.hstack([values[:, ::-1], [[9.0]]])
    )
    np.testing.assert_array_equal(
        LEG.segment_poses(shuffled).world_from_segment,
        LEG.segment_poses(motion(values)).world_from_segment,
    )


def test_the_quartic_couplings_of_the_simulation_stay_near_the_splines():
    model = mujoco.MjModel.from_xml_path(str(resources.model_file("lower_body/lower_body.xml")))
    values = np.tile(LEG.default_coordinates, (100, 1))
    angles = np.linspace(-2.09, 0.17, 100)
    values[:, COORDINATES.index("knee_angle_r")] = angles
    tibia = np.linalg.inv(LEG.segment_poses(motion(values)).of("femur_r")) @ LEG.segment_poses(
        motion(values)
    ).of("tibia_r")
    for equality, spline in ((0, tibia[:, 0, 3]), (1, tibia[:, 1, 3])):
        offset = model.qpos0[model.eq_obj1id[equality]]
        np.testing.assert_allclose(
            offset + np.polynomial.polynomial.polyval(angles, model.eq_data[equality, :5]),
            spline,
            atol=4e-4,
        )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: LEG.marker_positions(np.zeros((2, 19)), SITES),
            r"shape \(2, 19\); expected \(n, 20\)",
        ),
        (
            lambda: LEG.marker_positions(np.full((1, 20), np.nan), SITES),
            "pelvis_tilt is not a number at sample 0",
        ),
        (
            lambda: LEG.segment_poses(JointTrajectories([0.0], ("knee_angle_r",), [[0.0]])),
            "has no coordinate pelvis_tilt",
        ),
        (lambda: LEG.mass_of("torso"), "no segment named 'torso'"),
        (
            lambda: LEG.marker_jacobians(
                np.zeros((1, 20)),
                MarkerSites(("kneecap",), ("patella_r",), np.zeros((1, 3)), np.ones(1)),
            ),
            "kneecap sits on a patella",
        ),
    ],
)
def test_nonsense_is_refused(call, message):
    with pytest.raises(LegsimError, match=message):
        call()


@pytest.mark.parametrize("segment", ["femur_l", "tibia_l", "calcn_r"])
def test_sensors_are_mujocos_own(rng, segment):
    """A site with MuJoCo's accelerometer and gyroscope, through inverse dynamics; knee and patella
    set by the splines.
    """
    place, turn = rng.uniform(-0.2, 0.2, 3), transforms.rotation_from_vector(rng.normal(size=3))
    spec = mujoco.MjSpec.from_file(str(resources.model_file("lower_body/lower_body.xml")))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    spec.body(segment).add_site(name="s", pos=place, quat=quaternion)
    for kind in (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="s")
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    values, rates, accelerations = (
        random_values(rng, 5),
        rng.normal(size=(5, 20)),
        rng.normal(size=(5, 20)),
    )
    ours = LEG.attached_motion(
        values,
        rates,
        accelerations,
        segment=segment,
        segment_from_sensor=transforms.rigid(turn, place),
    )
    for i, state in enumerate(
        zip(*LEG._with_time_derivatives(values, rates, accelerations), strict=True)
    ):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(ours.specific_force[i], data.sensordata[:3], atol=1e-9)
        np.testing.assert_allclose(ours.angular_velocity[i], data.sensordata[3:], atol=1e-10)
