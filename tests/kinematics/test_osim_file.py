"""Models of all file versions: each joint against its formula, what is damaged refused by name."""

import re

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import osim_file
from legsim.kinematics._osim_chain import Chain
from legsim.kinematics.osim_leg import OsimLeg
from tests.examples import osim
from tests.examples.osim import FREE, LINEAR, J

X, Y, Z = np.eye(3)
KNEE_X = "<SimmSpline><x>-2 -1 0 1</x><y>0.02 0.01 0 0</y></SimmSpline>"
TWICE = "<LinearFunction><coefficients>2 0.1</coefficients></LinearFunction>"


def turn(axis, angle):
    return transforms.axis_rotation(axis, angle)


FORMULAS = {
    "WeldJoint": (0, lambda q: transforms.rigid(np.eye(3), np.zeros(3))),
    "PinJoint": (1, lambda q: transforms.rigid(turn(Z, q[0]), np.zeros(3))),
    "SliderJoint": (1, lambda q: transforms.translation(q[0] * X)),
    "UniversalJoint": (2, lambda q: transforms.rigid(turn(X, q[0]) @ turn(Y, q[1]), np.zeros(3))),
    "BallJoint": (3, lambda q: transforms.rigid(
        turn(X, q[0]) @ turn(Y, q[1]) @ turn(Z, q[2]), np.zeros(3))),
    "GimbalJoint": (3, lambda q: transforms.rigid(
        turn(X, q[0]) @ turn(Y, q[1]) @ turn(Z, q[2]), np.zeros(3))),
    "PlanarJoint": (3, lambda q: transforms.rigid(turn(Z, q[0]), [q[1], q[2], 0])),
    "FreeJoint": (6, lambda q: transforms.rigid(
        turn(X, q[0]) @ turn(Y, q[1]) @ turn(Z, q[2]), q[3:])),
}  # fmt: skip


def frame(at, angles):
    """Translation and body-fixed x-y-z angles."""
    return transforms.rigid(
        turn(X, angles[0]) @ turn(Y, angles[1]) @ turn(Z, angles[2]), np.array(at)
    )


@pytest.mark.parametrize("write", [osim.version_4, osim.version_3])
@pytest.mark.parametrize("kind", FORMULAS)
def test_a_joint_is_its_formula_between_its_two_frames(tmp_path, write, kind):
    count, formula = FORMULAS[kind]
    joint = J(
        "j", kind, "ground", "b", "0.1 0.2 0.3", "0.4 -0.5 0.6", "-0.2 0.1 0", "0.2 0.3 -0.1",
        coordinates={f"q{k}": FREE for k in range(count)},
    )  # fmt: skip
    chain = Chain(osim_file.read(osim.saved(tmp_path, write([joint]))).joints)
    q = np.linspace(-0.7, 0.9, count)
    rotations, origins = chain.poses(np.tile(q, (2, 1)) if count else np.zeros((2, 0)))
    expected = (
        frame((0.1, 0.2, 0.3), (0.4, -0.5, 0.6))
        @ formula(q)
        @ transforms.inverse(frame((-0.2, 0.1, 0), (0.2, 0.3, -0.1)))
    )
    np.testing.assert_allclose(rotations[1, 0], expected[:3, :3], atol=1e-14)
    np.testing.assert_allclose(origins[1, 0], expected[:3, 3], atol=1e-14)


def custom(tmp_path, axes, coordinates, write=osim.version_4):
    joint = J("j", "CustomJoint", "ground", "b", coordinates=coordinates, axes=axes)
    return Chain(osim_file.read(osim.saved(tmp_path, write([joint]))).joints)


@pytest.mark.parametrize("write", [osim.version_4, osim.version_3])
def test_a_custom_joint_turns_about_its_axes_in_turn_and_shifts_along_the_parents(tmp_path, write):
    axes = (
        ("rotation2", "b", "1 1 0", LINEAR),
        ("rotation1", "a", "0 0 2", TWICE),
        ("translation1", "a", "0 3 0", KNEE_X),
        ("translation3", "", "1 0 0", "<Constant><value>0.5</value></Constant>"),
    )
    chain = custom(tmp_path, axes, {"a": FREE, "b": FREE}, write)
    rotations, origins = chain.poses(np.array([[-1.0, 0.3]]))
    expected = turn(Z, -1.9) @ turn(X + Y, 0.3)
    np.testing.assert_allclose(rotations[0, 0], expected, atol=1e-14)
    np.testing.assert_allclose(origins[0, 0], [0.5, 0.01, 0], atol=1e-14)


def test_a_set_of_axes_of_opensim_1_is_the_same_joint(tmp_path):
    """There the axes' own flags say which of them turn."""
    new = osim.version_3(osim.two_legs())
    old = new
    for k, (name, axis) in enumerate(zip(
        ("tilt", "list", "rotation", "tx", "ty", "tz"),
        ("0 0 1", "1 0 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1"), strict=True,
    )):  # fmt: skip
        slot = f"rotation{k + 1}" if k < 3 else f"translation{k - 2}"
        old = old.replace(
            f"<TransformAxis name='{slot}'><coordinates>pelvis_{name}</coordinates>"
            f"<axis>{axis}</axis>{LINEAR}</TransformAxis>",
            f"<TransformAxis name='pelvis_{name}'><function>{LINEAR}</function><coordinate>"
            f"pelvis_{name}</coordinate><axis>{axis}</axis><is_rotation>"
            f"{'true' if k < 3 else 'false'}</is_rotation></TransformAxis>",
        )
    old = old.replace("<SpatialTransform>", "<TransformAxisSet><objects>")
    old = old.replace("</SpatialTransform>", "</objects></TransformAxisSet>")
    assert "TransformAxisSet" in old
    legs = [
        OsimLeg(osim_file.read(osim.saved(tmp_path, t, f"{k}.osim")))
        for k, t in enumerate((new, old))
    ]
    values = np.random.default_rng(3).normal(size=(4, len(legs[0].coordinate_names)))
    ours, theirs = (leg.kinematics(values) for leg in legs)
    np.testing.assert_array_equal(ours.origins, theirs.origins)


def test_frames_hang_on_one_another_and_sockets_have_had_several_spellings(tmp_path):
    """A chain of offset frames in a joint; the connectors of a preview of OpenSim 4."""
    joint = J("j", "PinJoint", "ground", "b", "1 2 3", "0 0 0.5", coordinates={"q": FREE})
    plain = osim.version_4([joint])
    chained = plain.replace(
        "<socket_parent>/ground</socket_parent><translation>1 2 3</translation>"
        "<orientation>0 0 0.5</orientation></PhysicalOffsetFrame>",
        "<socket_parent>../base</socket_parent><translation>1 0 0</translation>"
        "<orientation>0 0 0.5</orientation></PhysicalOffsetFrame><PhysicalOffsetFrame name='base'>"
        "<socket_parent>/ground</socket_parent><translation>0 2 3</translation>"
        "<orientation>0 0 0</orientation></PhysicalOffsetFrame>",
    )
    connected = plain.replace(
        "<socket_parent_frame>p_offset</socket_parent_frame>",
        "<connectors><Connector_PhysicalFrame_ name='parent_frame'><connectee_name>p_offset"
        "</connectee_name></Connector_PhysicalFrame_></connectors>",
    )
    frames = []
    for k, text in enumerate((plain, chained, connected)):
        read = osim_file.read(osim.saved(tmp_path, text, f"{k}.osim"))
        frames.append(read.joints[0].parent_from_p)
        assert (read.joints[0].parent, read.joints[0].problem) == ("ground", "")
    np.testing.assert_allclose(frames[1], frames[0], atol=1e-15)
    np.testing.assert_array_equal(frames[2], frames[0])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("OpenSimDocument", "Document", "begins with <Document>"),
        ("</BodySet>", "", r"line 1, column \d+\): is not whole XML"),
        ("<?xml", "<!DOCTYPE a><?xml", "declares a document type"),
        ("<Model name='small'>", "<Model name='small'><BodySet file='b.xml'/>", "in another file"),
        ("Model", "Tool", "holds Tool, not a Model"),
        ("Version='40000'", "Version='4x'", "its Version is '4x'"),
        ("<translation>1 2 3<", "<translation>1 2<", "hold 2 and 3 numbers"),
    ],
)
def test_damaged_files_are_refused_with_the_place(tmp_path, old, new, said):
    joint = J("j", "PinJoint", "ground", "b", "1 2 3", coordinates={"q": FREE})
    text = osim.version_4([joint])
    assert old in text
    with pytest.raises(LegsimError, match=said):
        osim_file.read(osim.saved(tmp_path, text.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("PinJoint", "EllipsoidJoint", "joint type EllipsoidJoint is not supported; supported are"),
        ("<prescribed>false", "<prescribed>true", "coordinate q is prescribed over time"),
        ("/bodyset/b<", "/bodyset/c<", "no body or frame is named '/bodyset/c'|'c_offset'"),
        ("PinJoint", "BallJoint", "a BallJoint has 3 coordinates; this one 1"),
    ],
)
def test_a_joint_that_cannot_be_moved_says_why(tmp_path, old, new, said):
    joint = J("j", "PinJoint", "ground", "b", coordinates={"q": FREE})
    text = osim.version_4([joint]).replace(old, new)
    problem = osim_file.read(osim.saved(tmp_path, text)).joints[0].problem
    assert re.search(said, problem)


@pytest.mark.parametrize(("span", "said"), [
    ("1", "coordinate q: <range> holds 1 numbers"),
    ("10 -10", "coordinate q: <range> runs from 10 to -10, backwards"),
    ("nan 1", "coordinate q: <range> holds 'nan 1', not finite numbers"),
])  # fmt: skip
def test_a_coordinates_range_matters_where_its_joint_does(tmp_path, span, said):
    """An arm's is passed over, a leg's refused."""
    arm = J("arm", "PinJoint", "pelvis", "humerus", "0 1 0", coordinates={"q": FREE})
    text = osim.version_4([*osim.two_legs(), arm])
    damaged = text.replace(
        "name='q'><default_value>0.0</default_value><range>-10.0 10.0",
        f"name='q'><default_value>0.0</default_value><range>{span}",
    )
    assert damaged != text
    model = osim_file.read(osim.saved(tmp_path, damaged))
    assert said in model.joints[-1].problem
    assert OsimLeg(model).coordinate_names == OsimLeg(osim_file.read(
        osim.saved(tmp_path, text, "sound.osim"))).coordinate_names  # fmt: skip
    of_leg = text.replace("<range>-2.0 0.2</range>", f"<range>{span}</range>")
    with pytest.raises(LegsimError, match="knee_r.*" + re.escape(said[12:])):
        OsimLeg(osim_file.read(osim.saved(tmp_path, of_leg)))


@pytest.mark.parametrize("span", ["-Inf inf", "-1e10 1e10", "-1.797e308 1.797e308"])
def test_a_range_without_end_and_flags_of_numbers_are_opensims(tmp_path, span):
    text = osim.version_4(osim.two_legs())
    endless = text.replace("<range>-2.0 0.2</range>", f"<range>{span}</range>", 1).replace(
        "<clamped>true</clamped>", "<clamped>1</clamped>", 1
    )
    knee = osim_file.read(osim.saved(tmp_path, endless)).joints[2].coordinates[0]
    assert (knee.name, knee.low, knee.high, knee.clamped) == ("knee_angle_r", -np.inf, np.inf, True)


def test_an_axis_without_a_function_is_its_coordinate(tmp_path):
    axes = (("rotation1", "a", "0 0 1", ""), ("translation2", "b", "0 1 0", ""))
    chain = custom(tmp_path, axes, {"a": FREE, "b": FREE})
    rotations, origins = chain.poses(np.array([[0.3, -0.2]]))
    np.testing.assert_allclose(rotations[0, 0], turn(Z, 0.3), atol=1e-14)
    np.testing.assert_allclose(origins[0, 0], [0, -0.2, 0], atol=1e-14)


def test_scale_factors_of_opensim_1s_joints_are_not_passed_over(tmp_path):
    text = osim.version_3(osim.two_legs())
    text = text.replace("<SpatialTransform>", "<TransformAxisSet><objects>", 1)
    text = text.replace("</SpatialTransform>", "</objects></TransformAxisSet>", 1)
    for factors, refused in (("1 1 1", False), ("1.1 1.1 1", True)):
        scaled = f"</TransformAxisSet><scale_factors>{factors}</scale_factors>"
        model = osim_file.read(osim.saved(tmp_path, text.replace("</TransformAxisSet>", scaled)))
        assert ("scale factors of its own" in model.joints[0].problem) == refused
