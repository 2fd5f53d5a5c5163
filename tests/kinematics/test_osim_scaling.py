"""OpenSim's scale files: on legsim's own leg, on a model, and those that are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording, osim_file, osim_scaling
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim
from tests.examples import osim


def scales(path: Path, *, thigh: str = "1.1 1.2 1.0", more: str = "") -> Path:
    path.write_text(
        "<OpenSimDocument Version='40000'><ScaleSet><objects>"
        + "".join(
            f"<Scale><scales>{f}</scales><segment>{body}</segment><apply>{apply}</apply></Scale>"
            for body, f, apply in (
                ("femur_r", thigh, "true"),
                ("tibia_r", "0.9 0.8 0.7", "true"),
                ("tibia_l", "2 2 2", "false"),
                ("torso", "1 1 1", "true"),
            )
        )
        + f"{more}</objects></ScaleSet></OpenSimDocument>"
    )
    return path


def test_a_scale_file_sizes_legsims_own_leg(tmp_path):
    motion = from_recording.solve_kinematics("subject01/squat_30.trc").trajectories
    opensim.save(tmp_path / "c.mot", motion)
    path = scales(tmp_path / "s.xml")
    person = from_recording.solve_kinematics(tmp_path / "c.mot", scale_file=path)
    np.testing.assert_array_equal(person.leg.scales.of("femur_r"), (1.1, 1.2, 1.0))
    np.testing.assert_array_equal(person.leg.scales.of("patella_r"), (1.1, 1.2, 1.0))
    np.testing.assert_array_equal(person.leg.scales.of("tibia_l"), 1.0)
    assert any("leaves pelvis, talus_r" in note for note in person.notes)
    marked = from_recording.solve_kinematics("subject01/squat_30.trc", scale_file=path)
    np.testing.assert_array_equal(marked.leg.scales.factors, person.leg.scales.factors)


def test_a_scale_file_sizes_a_model(tmp_path):
    marker = (
        "<Marker name='M'><socket_parent_frame>/bodyset/tibia_r</socket_parent_frame>"
        "<location>0.03 -0.1 0.04</location></Marker>"
    )
    text = osim.version_4(osim.two_legs(), markers=marker)
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, text)))
    scaled = OsimLeg(osim_scaling.scaled(leg.model, osim_scaling.read(scales(tmp_path / "s.xml"))))
    assert scaled.thigh_length("r") == pytest.approx(1.2 * 0.41)
    assert scaled.shank_length("r") == pytest.approx(0.8 * 0.40)
    assert scaled.shank_length("l") == pytest.approx(0.40)
    ours, before = (one.marker_sites()[0] for one in (scaled, leg))
    place = before.position("M") * (0.9, 0.8, 0.7)
    np.testing.assert_allclose(ours.position("M"), place, atol=1e-12)


def test_bad_scale_files_are_refused(tmp_path):
    double = "<Scale><scales>1 1 1</scales><segment>torso</segment></Scale>"
    for path, said in (
        (scales(tmp_path / "a.xml", thigh="1 2"), "femur_r has 2 factors"),
        (scales(tmp_path / "b.xml", thigh="11 1 1"), "factors of femur_r are 11, 1, 1"),
        (scales(tmp_path / "c.xml", more=double), "torso is scaled twice"),
    ):
        with pytest.raises(LegsimError, match=said):
            osim_scaling.read(path)
    with pytest.raises(LegsimError, match="scales torso, none of which"):
        osim_scaling.segment_scales({"torso": np.ones(3)})
    empty = tmp_path / "e.xml"
    empty.write_text("<OpenSimDocument><ScaleSet/></OpenSimDocument>")
    with pytest.raises(LegsimError, match="holds no scale that applies"):
        osim_scaling.read(empty)


def test_translations_that_are_no_coordinates_grow_with_the_parent(tmp_path):
    """Along their axis, whatever the turn of the joint's frame; free ones stay what they are."""
    glide = "<SimmSpline><x>-2 -1 0 1</x><y>0.02 0.01 0 0</y></SimmSpline>"
    joints = osim.two_legs()
    axes = (
        ("rotation1", "knee_angle_r", "0 0 1", osim.LINEAR),
        ("translation1", "knee_angle_r", "0.6 0.8 0", glide),
        ("translation2", "slip_r", "0 1 0", osim.LINEAR),
    )
    bare = {"knee_angle_r": osim.FREE, "slip_r": osim.FREE}
    knee = {"kind": "CustomJoint", "axes": axes, "coordinates": bare, "turned": "0 0 1.5"}
    joints[2] = replace(joints[2], **knee)
    model = osim_file.read(osim.saved(tmp_path, osim.version_4(joints)))
    scaled = osim_scaling.scaled(model, {"femur_r": np.array([1.1, 1.2, 1.3])})
    before, after = (m.joint_of("tibia_r").translations for m in (model, scaled))
    value = [[axis.function.with_derivatives(-1.0)[0] for axis in axes] for axes in (before, after)]
    assert value[1][0] == pytest.approx(value[0][0] * (0.6 * 1.1 + 0.8 * 1.2))
    assert value[1][1] == value[0][1] == -1.0
