"""Markers from a file of their own sit on the model as if it had them."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import (
    from_recording,
    osim_file,
    osim_marker_set,
    osim_scaled_file,
    osim_scaling,
)
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim
from tests.examples import osim
from tests.kinematics.test_on_osim_model import recorded, squat

BY_BODY = osim.MARKERS.replace("socket_parent_frame>/bodyset/", "body> ").replace(
    "</socket_parent_frame", "</body"
)
"""as OpenSim 3 writes them"""


def set_file(folder, markers, *, document="<OpenSimDocument Version='40000'>{}</OpenSimDocument>"):
    inside = f"<MarkerSet name='s'><objects>{markers}</objects><groups/></MarkerSet>"
    return osim.saved(folder, document.format(inside), "set.xml")


def marker(name, body, place):
    return (
        f"<Marker name='{name}'><socket_parent_frame>/bodyset/{body}</socket_parent_frame>"
        f"<location>{place}</location></Marker>"
    )


@pytest.fixture
def bare(tmp_path):
    return osim.saved(tmp_path, osim.version_4(osim.two_legs()), "bare.osim")


@pytest.mark.parametrize("version", [osim.version_4, osim.version_3])
@pytest.mark.parametrize("markers", [osim.MARKERS, BY_BODY])
@pytest.mark.parametrize(
    "document", ["<OpenSimDocument Version='20302'>{}</OpenSimDocument>", "{}"]
)
def test_a_bare_model_with_the_set_is_the_model_with_markers(tmp_path, version, markers, document):
    whole = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=osim.MARKERS))
    model = osim.saved(tmp_path, version(osim.two_legs()), "bare.osim")
    path = set_file(tmp_path, markers, document=document)
    with_set, said = osim_marker_set.with_set(osim_file.read(model), path)
    ours, theirs = (
        OsimLeg(with_set).marker_sites()[0],
        OsimLeg(osim_file.read(whole)).marker_sites()[0],
    )
    assert ours.names == theirs.names
    assert ours.segments == theirs.segments
    np.testing.assert_array_equal(ours.positions, theirs.positions)
    assert said == (f"{len(ours.names)} markers of the marker set set.xml",)


def test_markers_replace_by_exact_name_and_others_are_added(tmp_path):
    own = marker("A", "pelvis", "1 2 3") + marker("B", "femur_r", "4 5 6")
    model = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=own))
    given = marker("A", "tibia_l", "7 8 9") + marker("b", "talus_r", "1 1 1")
    with_set, said = osim_marker_set.with_set(osim_file.read(model), set_file(tmp_path, given))
    found = {m.name: (m.body, *m.location) for m in with_set.markers}
    assert found == {
        "A": ("tibia_l", 7, 8, 9),
        "B": ("femur_r", 4, 5, 6),
        "b": ("talus_r", 1, 1, 1),
    }
    assert "1 of the same names give way and 1 stay" in said[0]


def test_a_set_sits_in_a_frame_of_a_body(tmp_path):
    frame = (
        "<Body name='pelvis'><mass>1</mass><components><PhysicalOffsetFrame name='front'>"
        "<socket_parent>..</socket_parent><translation>0.1 0 0</translation>"
        "<orientation>0 0 1.5707963267948966</orientation></PhysicalOffsetFrame></components></Body>"
    )
    text = osim.version_4(osim.two_legs()).replace(
        "<Body name='pelvis'><mass>1</mass></Body>", frame
    )
    model = osim_file.read(osim.saved(tmp_path, text))
    given = marker("F", "pelvis/front", "0.2 0 0")
    with_set, _ = osim_marker_set.with_set(model, set_file(tmp_path, given))
    np.testing.assert_allclose(with_set.markers[0].location, (0.1, 0.2, 0), atol=1e-12)
    assert with_set.markers[0].body == "pelvis"


def offset(name, parent, place):
    return (
        f"<PhysicalOffsetFrame name='{name}'><socket_parent>{parent}</socket_parent>"
        f"<translation>{place}</translation></PhysicalOffsetFrame>"
    )


def test_frames_of_one_name_on_two_bodies_are_told_apart_by_their_paths(tmp_path):
    """And a frame may hang on one that comes after it."""
    text = osim.version_4(osim.two_legs())
    for body, frames in {
        "pelvis": offset("on", "../under", "0.1 0 0") + offset("under", "..", "0 0.5 0"),
        "femur_r": offset("on", "/bodyset/femur_r", "0 0 0.3"),
    }.items():
        old = f"<Body name='{body}'><mass>1</mass></Body>"
        assert old in text
        text = text.replace(
            old, f"<Body name='{body}'><mass>1</mass><components>{frames}</components></Body>"
        )
    given = marker("A", "pelvis/on", "0 0 0.01") + marker("B", "femur_r/on", "0 0 0.01")
    model = osim_file.read(osim.saved(tmp_path, text))
    with_set, _ = osim_marker_set.with_set(model, set_file(tmp_path, given))
    assert [m.body for m in with_set.markers] == ["pelvis", "femur_r"]
    np.testing.assert_allclose(with_set.markers[0].location, (0.1, 0.5, 0.01), atol=1e-12)
    np.testing.assert_allclose(with_set.markers[1].location, (0, 0, 0.31), atol=1e-12)
    ambiguous = marker("A", "pelvis/on", "0 0 0") + marker("B", "on", "0 0 0")
    _, said = osim_marker_set.with_set(model, set_file(tmp_path, ambiguous))
    assert said[1].endswith("are left out: B (on on)")


def test_markers_on_bodies_that_the_model_lacks_are_named(tmp_path, bare):
    given = osim.MARKERS + marker("Nose", "head", "0 0 0")
    _, said = osim_marker_set.with_set(osim_file.read(bare), set_file(tmp_path, given))
    assert said[1].endswith("on bodies that the model lacks are left out: Nose (on head)")
    text = osim.version_4(osim.two_legs(), markers=given)
    person = from_recording.solve_kinematics(
        recorded(
            OsimLeg(osim_file.read(osim.saved(tmp_path, text, "own.osim"))), tmp_path / "m.trc"
        ),
        model=tmp_path / "own.osim",
    )
    assert any("lacks are left out: Nose (on head)" in note for note in person.notes)


def test_a_recording_is_solved_by_the_set(tmp_path, bare):
    whole = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=osim.MARKERS))
    path = recorded(OsimLeg(osim_file.read(whole)), tmp_path / "m.trc")
    with pytest.raises(LegsimError, match=r"bare.osim.*no markers on its legs.*--marker-set"):
        from_recording.solve_kinematics(path, model=bare)
    given = set_file(tmp_path, osim.MARKERS)
    ours = from_recording.solve_kinematics(path, model=bare, marker_set=given)
    theirs = from_recording.solve_kinematics(path, model=whole)
    np.testing.assert_array_equal(ours.trajectories.values, theirs.trajectories.values)
    assert any("spells otherwise: pelvis_M0 (pelvis_m0)" in note for note in ours.notes)
    assert given in from_recording.files_read(path, model=bare, marker_set=given)


def test_the_scaled_file_holds_the_set(tmp_path, rng):
    for version in (osim.version_4, osim.version_3):
        model = osim_file.read(
            osim.saved(tmp_path, version(osim.two_legs(), markers=marker("A", "pelvis", "1 2 3")))
        )
        given = set_file(tmp_path, osim.MARKERS + marker("A", "talus_l", "0 0 0.1"))
        with_set, _ = osim_marker_set.with_set(model, given)
        factors = {body: rng.uniform(0.8, 1.2, 3) for body in model.bodies}
        scaled = osim_scaling.scaled(with_set, factors)
        again = osim_file.read(osim.saved(tmp_path, osim_scaled_file.text(scaled), "s.osim"))
        assert [m.body for m in again.markers if m.name == "A"] == ["talus_l"]
        for ours, theirs in zip(
            sorted(scaled.markers, key=lambda m: m.name),
            sorted(again.markers, key=lambda m: m.name),
            strict=True,
        ):
            assert (ours.name, ours.body) == (theirs.name, theirs.body)
            np.testing.assert_allclose(ours.location, theirs.location, atol=1e-12)


@pytest.mark.parametrize(
    ("markers", "problem"),
    [
        ("", "its MarkerSet holds no marker"),
        (
            marker("A", "head", "0 0 0"),
            r"none of its markers is on a body of the model: A \(on head\)",
        ),
        (marker("", "pelvis", "0 0 0"), "a marker has no name"),
        (marker("A", "pelvis", "0 0"), "marker A: <location> holds 2 numbers"),
        (
            marker("A", "pelvis", "0 0 0") + marker("A", "pelvis", "0 0 1"),
            "two markers are named A",
        ),
    ],
)
def test_damaged_sets_are_refused(tmp_path, bare, markers, problem):
    with pytest.raises(LegsimError, match=rf"set.xml.*{problem}"):
        osim_marker_set.with_set(osim_file.read(bare), set_file(tmp_path, markers))


def test_a_set_is_refused_where_it_cannot_apply(tmp_path, bare):
    leg = OsimLeg(osim_file.read(bare))
    opensim.save(tmp_path / "c.mot", squat(leg))
    given = set_file(tmp_path, osim.MARKERS)
    solve = from_recording.solve_kinematics
    with pytest.raises(LegsimError, match=r"marker_set puts markers on an OpenSim model.*--model"):
        solve("subject01/squat_30.trc", marker_set=given)
    with pytest.raises(LegsimError, match=r"c.mot.*marker_set cannot apply"):
        solve(tmp_path / "c.mot", model=bare, marker_set=given)
    with pytest.raises(LegsimError, match=r"c.mot.*scale_model cannot apply"):
        solve(tmp_path / "c.mot", model=bare, scale_model=True)
    with pytest.raises(LegsimError, match=r"bare.osim: holds Model, not a MarkerSet"):
        osim_marker_set.with_set(osim_file.read(bare), bare)
