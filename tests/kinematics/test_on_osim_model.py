"""Recordings on a user's own OpenSim model and by OpenSim's scale factors: what is taken, what is
said, what is refused.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording, on_osim_model, osim_file
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim, trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.examples import osim

TIMES = np.arange(40) / 40.0


@pytest.fixture
def model(tmp_path) -> Path:
    return osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=osim.MARKERS))


@pytest.fixture
def leg(model) -> OsimLeg:
    return OsimLeg(osim_file.read(model))


def squat(leg: OsimLeg) -> JointTrajectories:
    """A squat with some of every coordinate."""
    share = np.sin(np.pi * TIMES)[:, None] ** 2
    bent = leg.posture(*np.radians((50, -70, 15))) - leg.default_coordinates
    waves = 0.03 * np.sin(5 * TIMES[:, None] + np.arange(len(leg.coordinate_names)))
    return JointTrajectories(
        TIMES, leg.coordinate_names, leg.default_coordinates + share * bent + waves - 0.04
    )


def recorded(leg: OsimLeg, path: Path, *, name=str.lower, factor=1.0) -> Path:
    """The model's markers during that squat."""
    sites, _ = leg.marker_sites()
    places = factor * leg.marker_positions(squat(leg).values, sites)
    trc.save(path, MarkerTrajectories(TIMES, tuple(map(name, sites.names)), places))
    return path


def test_coordinates_on_their_model_are_replayed_to_the_bit(tmp_path, model, leg):
    motion = squat(leg)
    opensim.save(tmp_path / "c.mot", motion)
    person = from_recording.solve_kinematics(tmp_path / "c.mot", model=model)
    np.testing.assert_array_equal(person.trajectories.values, motion.values)
    assert person.leg.coordinate_names == leg.coordinate_names
    assert any("thighs 41.0 and 41.0 cm" in line for line in person.lines())


def test_what_a_file_lacks_is_the_models_default_and_what_it_adds_is_left_out(tmp_path, model, leg):
    motion = squat(leg)
    kept = [k for k, name in enumerate(motion.coordinate_names) if name != "pelvis_ty"]
    names = (*(motion.coordinate_names[k] for k in kept), "elbow_r")
    values = np.column_stack([motion.values[:, kept], np.ones(len(TIMES))])
    opensim.save(tmp_path / "c.mot", JointTrajectories(TIMES, names, values))
    person = from_recording.solve_kinematics(tmp_path / "c.mot", model=model)
    assert any("default (rad, m): pelvis_ty = 0.95" in note for note in person.notes)
    assert any(note.endswith("are left out: elbow_r") for note in person.notes)
    poses = person.leg.segment_poses(person.trajectories)
    np.testing.assert_allclose(poses.of("pelvis")[:, 1, 3], 0.95, atol=1e-12)
    assert "pelvis_ty" in person.leg.complete(person.trajectories).coordinate_names


@pytest.mark.parametrize("identity", ["<LinearFunction/>", "spline"])
def test_degrees_are_those_of_the_model_and_of_columns_that_it_lacks(
    tmp_path, model, leg, identity
):
    """A file of a model with more joints: an angle of 8 degrees is none of 8 rad."""
    text = model.read_text()
    if identity == "spline":  # as old models write a hip
        line = "<SimmSpline><x>-6.28318531 6.28318531</x><y>-6.28318531 6.28318531</y></SimmSpline>"
        assert osim.LINEAR in text
        model = osim.saved(tmp_path, text.replace(osim.LINEAR, line), "old.osim")
    motion = squat(leg)
    names = (*motion.coordinate_names, "lumbar_bending", "hip_adduction_r")
    more = np.radians(8 * np.sin(4 * TIMES)[:, None] + [0, -4])
    values = np.column_stack([motion.values, more])
    opensim.save(tmp_path / "c.mot", JointTrajectories(TIMES, names, values), in_degrees=True)
    person = from_recording.solve_kinematics(tmp_path / "c.mot", model=model)
    np.testing.assert_allclose(person.trajectories.values, motion.values, atol=1e-12)
    assert any(note.endswith("left out: lumbar_bending, hip_adduction_r") for note in person.notes)


def test_flexions_that_too_few_markers_tell_are_warned_of(tmp_path, model, leg):
    """The pelvis and one marker on each foot: the knee may be anywhere."""
    few = recorded(
        leg, tmp_path / "few.trc", name=lambda n: n if "pelvis" in n or "talus" in n else f"x{n}"
    )
    kept = trc.load(few)
    names = [n for n in kept.marker_names if "pelvis" in n or n in ("talus_r_M0", "talus_l_M0")]
    trc.save(
        few,
        MarkerTrajectories(TIMES, tuple(names), np.stack([kept.marker(n) for n in names], 1)),
    )
    said = from_recording.solve_kinematics(few, model=model).warnings
    assert any(re.search(r"do not tell.*knee_angle_r \(\d+ deg\)", line) for line in said), said
    whole = recorded(leg, tmp_path / "whole.trc")
    said = from_recording.solve_kinematics(whole, model=model).warnings
    assert not any("do not tell" in line for line in said)


def test_a_knee_that_would_bend_forwards_is_refused(tmp_path, model, leg):
    motion = squat(leg)
    values = motion.values.copy()
    values[:, motion.coordinate_names.index("knee_angle_r")] *= -1
    opensim.save(tmp_path / "c.mot", JointTrajectories(TIMES, motion.coordinate_names, values))
    with pytest.raises(LegsimError, match=r"c.mot: on this model the right knee bends forwards by"):
        from_recording.solve_kinematics(tmp_path / "c.mot", model=model)


def test_a_file_of_another_model_is_refused(tmp_path, model):
    opensim.save(tmp_path / "c.mot", JointTrajectories(TIMES, ("elbow",), np.zeros((40, 1))))
    with pytest.raises(LegsimError, match="none of its columns elbow is a coordinate"):
        from_recording.solve_kinematics(tmp_path / "c.mot", model=model)


def test_markers_give_back_the_coordinates_they_came_from(tmp_path, model, leg):
    """Names in another case and with a subject's prefix."""
    path = recorded(leg, tmp_path / "m.trc", name=lambda n: f"Ann:{n.upper()}")
    person = from_recording.solve_kinematics(path, model=model, filter_hz=0, marker_noise=0)
    assert person.fit is not None
    # what the weak prior, 1e-7 m^2, pulls
    assert person.fit.ik.rms < 1e-5
    away = person.trajectories.values - squat(leg).values
    assert np.abs(away).max() < 5e-4
    assert any("22 of the 22 markers" in note for note in person.notes)


def test_locked_coordinates_stay_and_clamped_ones_stop(tmp_path, model, leg):
    path = recorded(leg, tmp_path / "m.trc")
    text = model.read_text().replace(
        "<Coordinate name='ankle_x_r'><default_value>0.0</default_value><range>-10.0 10.0</range>"
        "<clamped>false</clamped><locked>false",
        "<Coordinate name='ankle_x_r'><default_value>0.1</default_value><range>-10.0 10.0</range>"
        "<clamped>false</clamped><locked>true",
    )
    text = text.replace("<range>-2.0 0.2</range>", "<range>-1.0 0.2</range>")
    person = from_recording.solve_kinematics(path, model=osim.saved(tmp_path, text, "held.osim"))
    assert any("so held at its default: ankle_x_r" in note for note in person.notes)
    whole = person.leg.complete(person.trajectories)
    np.testing.assert_array_equal(whole.coordinate("ankle_x_r"), 0.1)
    assert person.trajectories.coordinate("knee_angle_r").min() >= -1.01
    assert person.fit is not None
    column = person.leg.coordinate_names.index("knee_angle_r")
    assert person.fit.ik.coordinate_at_limit[column] > 5


def test_too_few_markers_and_a_wrong_size_are_refused_or_reported(tmp_path, model, leg):
    few = tmp_path / "few.trc"
    recorded(leg, few, name=lambda n: n if n.startswith("femur") else f"x{n}")
    with pytest.raises(LegsimError, match=r"6 of the 22 markers .* three on the pelvis"):
        from_recording.solve_kinematics(few, model=model)
    tall = recorded(leg, tmp_path / "tall.trc", factor=1.2)
    notes = from_recording.solve_kinematics(tall, model=model).notes
    assert any(
        "not of this person's size; by its markers the person's are: thighs +20 %" in note
        for note in notes
    )
    small = recorded(leg, tmp_path / "small.trc", factor=0.1)
    with pytest.raises(LegsimError, match="unit of length is wrong"):
        from_recording.solve_kinematics(small, model=model)


@pytest.mark.parametrize("factor", [100.0, 1000.0])
def test_a_model_that_is_not_in_meters_is_refused(tmp_path, model, leg, factor):
    """Its joints, whatever the file; its markers, whatever the recording's unit."""
    text = model.read_text()

    def longer(tag):
        def scaled(found):
            return f"<{tag}>{' '.join(repr(factor * float(x)) for x in found[1].split())}<"

        return osim.saved(tmp_path, re.sub(rf"<{tag}>([^<]*)<", scaled, text), f"{tag}.osim")

    path = recorded(leg, tmp_path / "m.trc")
    with pytest.raises(LegsimError, match=r"translation\.osim \(JointSet\): the right thigh is "):
        from_recording.solve_kinematics(path, model=longer("translation"))
    with pytest.raises(LegsimError, match="its markers' places are not in meters"):
        from_recording.solve_kinematics(path, model=longer("location"))


def test_roles_of_the_own_leg_say_nothing_of_a_models_markers(tmp_path, model, leg):
    path = recorded(leg, tmp_path / "m.trc")
    with pytest.raises(LegsimError, match=r"settings.*found by their names; .*--marker-set"):
        from_recording.solve_kinematics(path, model=model, marker_map="cast")


def test_a_size_given_twice_is_refused(tmp_path, model):
    with pytest.raises(LegsimError, match="size is given twice"):
        from_recording.solve_kinematics(
            "subject01/squat_30.trc", model=model, scale_from="subject01/squats.trc"
        )
    with pytest.raises(LegsimError, match="no such file; give an OpenSim model"):
        from_recording.solve_kinematics("subject01/squat_30.trc", model=tmp_path / "none.osim")


def test_without_a_model_coordinates_say_whose_leg_they_are_on(tmp_path):
    motion = from_recording.solve_kinematics("subject01/squat_30.trc").trajectories
    opensim.save(tmp_path / "c.mot", motion)
    person = from_recording.solve_kinematics(tmp_path / "c.mot")
    length = 100 * LegModel.load().thigh_length("r")
    assert f"generic leg, thigh {length:.1f} cm" in person.notes[0]


def other_side(name: str) -> str:
    """The name of the marker on the other leg, or on the pelvis' other side."""
    pairs = {"_r_": "_l_", "_l_": "_r_", "pelvis_M0": "pelvis_M1", "pelvis_M1": "pelvis_M0"}
    return next((name.replace(a, b) for a, b in pairs.items() if a in name), name)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        (other_side, "the legs lie above it: left and right are exchanged"),
        (lambda n: n if n.startswith("pelvis") else other_side(n), "right thigh lie .* left of"),
        (lambda n: other_side(n) if n.startswith(("tib", "tal")) else n, "right shank lie .* left"),
    ],
)
def test_exchanged_sides_are_refused(tmp_path, name, problem):
    """Three markers on the pelvis fit upside down as well."""
    gone = "<Marker name='pelvis_M3'>"
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS.replace(gone, "<Marker name='x'>"))
    model = osim.saved(tmp_path, text)
    path = recorded(OsimLeg(osim_file.read(model)), tmp_path / "m.trc", name=name)
    loaded = trc.load(path)
    kept = [n for n in loaded.marker_names if n != "x"]
    places = np.stack([loaded.marker(n) for n in kept], 1)
    trc.save(path, MarkerTrajectories(loaded.times, tuple(kept), places))
    for scale_model in (False, True):
        with pytest.raises(LegsimError, match=rf"m.trc: .*{problem}"):
            from_recording.solve_kinematics(path, model=model, scale_model=scale_model)


def test_a_label_that_is_a_markers_very_name_is_no_others(tmp_path):
    """Models that serve several laboratories hold names that differ in case alone."""
    also = "<Marker name='tibia_r_m0'><socket_parent_frame>/bodyset/femur_r</socket_parent_frame>"
    markers = f"{osim.MARKERS}{also}<location>0 -0.2 0</location></Marker>"
    text = osim.version_4(osim.two_legs(), markers=markers)
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, text)))
    labels = [name for name in leg.marker_sites()[0].names if name != "tibia_r_m0"]
    assert "tibia_r_M0" in labels
    chosen, sites, notes = on_osim_model.marker_map(leg, labels)
    assert set(chosen.roles) == set(sites.names) == set(labels)
    assert "not there: tibia_r_m0" in notes[0]
