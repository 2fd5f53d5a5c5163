"""Legs of OpenSim models: joints against their formulas, derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import osim_file
from legsim.kinematics.joint_splines import JointSplines, segment_poses_at
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap.trajectories import JointTrajectories
from tests.examples import osim
from tests.examples.osim import FREE, LINEAR, J

X, Y, Z = np.eye(3)


def turn(axis, angle):
    return transforms.axis_rotation(axis, angle)


def frame(at, angles):
    """Translation and body-fixed x-y-z angles."""
    return transforms.rigid(
        turn(X, angles[0]) @ turn(Y, angles[1]) @ turn(Z, angles[2]), np.array(at)
    )


@pytest.fixture
def coupled(tmp_path) -> OsimLeg:
    """A knee with a coordinate of its own for the glide and the twist, both coupled."""
    joints = osim.two_legs()
    axes = (
        ("rotation1", "knee_angle_r", "0 0 1", LINEAR),
        ("rotation2", "knee_twist_r", "0 1 0", LINEAR),
        ("translation1", "knee_glide_r", "1 0 0", LINEAR),
    )
    coordinates = {"knee_angle_r": FREE, "knee_twist_r": FREE, "knee_glide_r": FREE}
    joints[2] = replace(joints[2], kind="CustomJoint", axes=axes, coordinates=coordinates)
    couplers = "".join(
        f"<CoordinateCouplerConstraint name='{name}'><isEnforced>true</isEnforced>"
        f"<coupled_coordinates_function>{function}</coupled_coordinates_function>"
        f"<independent_coordinate_names>{independent}</independent_coordinate_names>"
        f"<dependent_coordinate_name>{name}</dependent_coordinate_name>"
        f"<scale_factor>{scale}</scale_factor></CoordinateCouplerConstraint>"
        for name, independent, function, scale in (
            ("knee_glide_r", "knee_twist_r", "<LinearFunction><coefficients>0.1 0.01"
             "</coefficients></LinearFunction>", 1),
            ("knee_twist_r", "knee_angle_r", "<PolynomialFunction><coefficients>0.3 0.2 0"
             "</coefficients></PolynomialFunction>", 2),
        )
    )  # fmt: skip
    markers = "".join(
        f"<Marker name='{name}'><socket_parent_frame>/bodyset/{body}</socket_parent_frame>"
        "<location>0.05 -0.1 0.03</location></Marker>"
        for name, body in (("shin", "tibia_r"), ("hip", "pelvis"), ("foot", "talus_l"))
    )
    text = osim.version_4(joints, constraints=couplers, markers=markers)
    return OsimLeg(osim_file.read(osim.saved(tmp_path, text)))


def test_a_coupled_coordinate_is_the_function_of_its_independent_one(coupled):
    assert "knee_twist_r" not in coupled.coordinate_names
    values = np.tile(coupled.default_coordinates, (3, 1))
    angle = np.array([0.0, -0.5, -1.2])
    values[:, coupled.coordinate_names.index("knee_angle_r")] = angle
    whole = coupled.complete(JointTrajectories(np.arange(3.0), coupled.coordinate_names, values))
    twist = 2 * (0.3 * angle**2 + 0.2 * angle)
    np.testing.assert_allclose(whole.coordinate("knee_twist_r"), twist, atol=1e-14)
    np.testing.assert_allclose(whole.coordinate("knee_glide_r"), 0.1 * twist + 0.01, atol=1e-14)


def test_marker_jacobians_are_the_slopes_of_the_marker_positions(coupled, rng):
    sites, _ = coupled.marker_sites()
    values, h = rng.normal(size=(6, len(coupled.coordinate_names))), 1e-5
    slopes = coupled.marker_jacobians(values, sites)
    for c, step in enumerate(h * np.eye(values.shape[1])):
        ahead = coupled.marker_positions(values + step, sites)
        behind = coupled.marker_positions(values - step, sites)
        np.testing.assert_allclose(slopes[..., c], (ahead - behind) / (2 * h), atol=1e-9)


def test_sensors_feel_the_differences_of_their_poses(coupled, rng):
    values, rates, bends = rng.normal(size=(3, 5, len(coupled.coordinate_names)))
    place, h = frame((0.1, -0.2, 0.05), (0.3, 0.2, 0.1)), 1e-4
    sensor = {"segment": "tibia_r", "segment_from_sensor": place}
    motion = coupled.attached_motion(values, rates, bends, **sensor)
    before, now, after = (
        coupled.attached_motion(
            values + t * rates + t**2 / 2 * bends, rates, bends, **sensor
        ).world_from_sensor
        for t in (-h, 0.0, h)
    )
    acceleration = (after + before - 2 * now)[:, :3, 3] / h**2 + [0, 9.80665, 0]
    felt = np.einsum("nji,nj->ni", now[:, :3, :3], acceleration)
    np.testing.assert_allclose(motion.specific_force, felt, atol=2e-6)
    step = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
    spin = transforms.vector_from_rotation(step) / (2 * h)
    np.testing.assert_allclose(motion.angular_velocity, spin, atol=1e-6)


@pytest.mark.parametrize("kind", ["CustomJoint", "FreeJoint"])
def test_the_pelvis_is_found_whichever_way_it_faces(tmp_path, kind, rng):
    joints = [osim.pelvis(kind), *osim.two_legs()[1:]]
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(joints))))
    values = np.tile(leg.default_coordinates, (30, 1))
    values[:, :3] = rng.normal(0, 0.4, (30, 3))
    values[:, leg.heading] = rng.uniform(-3, 3, 30)
    values[:, 3:6] = rng.normal(size=(30, 3))
    pose = leg.kinematics(values)
    world = transforms.rigid(pose.rotations[:, 0], pose.origins[:, 0])
    found = np.tile(leg.default_coordinates, (30, 1))
    found[:, :6] = leg.pelvis_values(world)
    again = leg.kinematics(found)
    np.testing.assert_allclose(again.rotations[:, 0], pose.rotations[:, 0], atol=1e-10)
    np.testing.assert_allclose(again.origins[:, 0], pose.origins[:, 0], atol=1e-10)


def test_segment_frames_have_the_next_joint_where_the_generic_leg_has_it(tmp_path):
    """A tibia whose ankle lies off its axis, and a knee off the femur's."""
    joints = osim.two_legs()
    for k, z in ((2, 0.004), (5, -0.004)):
        joints[k] = replace(joints[k], at=f"0.01 -0.41 {z}", child_at=f"-0.008 -0.004 {z / 2}")
        joints[k + 1] = replace(joints[k + 1], at="-0.012 -0.39 0")
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(joints))))
    names, generic = leg.coordinate_names, LegModel.load()
    poses = leg.segment_poses(JointTrajectories(np.zeros(1), names, np.zeros((1, len(names)))))
    for side in "rl":
        femur, tibia = (poses.of(f"{part}_{side}")[0] for part in ("femur", "tibia"))
        scale = leg.thigh_length(side) / generic.thigh_length(side)
        assert leg.scales.of(f"femur_{side}")[0] == pytest.approx(scale)
        knee = scale * np.array([-0.004499856517536013, -0.39582069644835033, 0.0])
        np.testing.assert_allclose(femur[:3, :3] @ knee + femur[:3, 3], tibia[:3, 3], atol=1e-12)
        ankle = transforms.apply(tibia, np.array([[0, -leg.shank_length(side), 0]]))[0]
        np.testing.assert_allclose(ankle, poses.of(f"talus_{side}")[0, :3, 3], atol=1e-12)


def test_a_coarse_model_gets_the_feet_it_lacks_and_says_so(tmp_path):
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(osim.two_legs(foot="foot")))))
    assert any(note.startswith("toes_r is taken to be fixed in") for note in leg.notes)
    assert leg.moves[leg.coordinate_names.index("ankle_x_r")].sum() == 3


def test_held_coordinates_stay_at_the_models_default(tmp_path):
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(osim.two_legs()))))
    held = leg.with_held(["pelvis_ty"])
    assert "pelvis_ty" not in held.coordinate_names
    assert held.kinematics(np.zeros((1, len(held.coordinate_names)))).origins[0, 0, 1] == 0.95


def test_a_splined_motion_poses_the_segments(coupled):
    times = np.linspace(0, 1, 20)
    values = np.sin(times[:, None] + np.arange(len(coupled.coordinate_names)))
    motion = JointTrajectories(times, coupled.coordinate_names, values)
    poses = segment_poses_at(coupled, JointSplines(motion), times)
    ours = coupled.kinematics(values)
    np.testing.assert_allclose(poses.world_from_segment[..., :3, 3], ours.origins, atol=1e-12)


def refused(tmp_path, text, said):
    with pytest.raises(LegsimError, match=said):
        OsimLeg(osim_file.read(osim.saved(tmp_path, text)))


def test_what_the_legs_cannot_do_is_refused_by_name(tmp_path):
    joints = osim.two_legs()
    text = osim.version_4(joints)
    odd = [*joints[:2], replace(joints[2], kind="EllipsoidJoint"), *joints[3:]]
    refused(tmp_path, osim.version_4(odd), r"joint knee_r \(EllipsoidJoint\): the joint type")
    refused(tmp_path, text.replace(LINEAR, "<Sine/>"), "ground_pelvis .*type Sine is not")
    refused(tmp_path, text.replace("femur_l", "fomur_l"), "named like femur_l; there are: pelvis")
    refused(tmp_path, text.replace("-0.07 -0.07 0.08", "-0.07 -0.07 -0.3"), "right hip does not")
    refused(tmp_path, text[: len(text) // 2], "not whole XML")
    refused(tmp_path, text.replace("OpenSimDocument", "Document"), "begins with <Document>")
    tied = "<WeldConstraint name='w'><isEnforced>true</isEnforced><frame1>tibia_r</frame1></WeldConstraint>"
    refused(
        tmp_path, osim.version_4(joints, constraints=tied), r"w \(WeldConstraint\) holds tibia_r"
    )
    untied = tied.replace("tibia_r", "hand_r")
    OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(joints, constraints=untied))))
    arm = J("arm", "EllipsoidJoint", "pelvis", "hand_r")
    OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4([*joints, arm]))))


def test_a_talus_along_the_ankles_axis_is_level_with_the_calcaneus(tmp_path):
    """Some models turn the talus' frame so that the ankle turns about one of its axes."""
    legs = []
    for k, turned in enumerate(("0 0 0", "0 0.8 0")):
        joints = [
            replace(j, child_turned=turned) if j.child.startswith("talus") else j
            for j in osim.two_legs()
        ]
        joints += [
            J(f"heel_{s}", "WeldJoint", f"talus_{s}", f"calcn_{s}", turned=turned) for s in "rl"
        ]
        legs.append(
            OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(joints), f"{k}.osim")))
        )
    straight = np.zeros((1, len(legs[0].coordinate_names)))
    ours, theirs = (leg.kinematics(straight) for leg in legs)
    np.testing.assert_allclose(ours.rotations, theirs.rotations, atol=1e-12)
    np.testing.assert_allclose(ours.origins, theirs.origins, atol=1e-12)


@pytest.mark.parametrize(("joint", "part"), [("0 -0.41 0", "femur"), ("0 -0.4 0", "tibia")])
def test_a_leg_whose_joints_lie_at_one_point_is_refused(tmp_path, joint, part):
    text = osim.version_4(osim.two_legs())
    assert joint in text
    with pytest.raises(LegsimError, match=f"both ends of the {part}_. lie at one point"):
        OsimLeg(osim_file.read(osim.saved(tmp_path, text.replace(joint, "0 0 0"))))
