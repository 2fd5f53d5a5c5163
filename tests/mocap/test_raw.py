"""From a file's unit and axes to meters in world, and what is up."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import raw as mocap_raw
from legsim.mocap.raw import WORLD_FROM_LAB, RawMarkers, not_seen_as_nan

BODY = {
    "RANK": (0.2, 0.1, 0.1),
    "LANK": (0.2, 0.1, -0.1),
    "RKNE": (0.25, 0.5, 0.15),
    "RASI": (0.3, 0.95, 0.1),
    "LASI": (0.3, 0.95, -0.1),
    "C7": (0.1, 1.4, 0),
}


def raw(positions, labels, *, unit="m", up="", usual_up="y"):
    positions = np.asarray(positions, float)
    return RawMarkers(
        "trial", np.arange(len(positions)) / 100, tuple(labels), positions, unit, up, usual_up
    )


def body(axis: str, **options) -> RawMarkers:
    """Somebody standing in a lab whose ``axis`` points up."""
    world = np.array(list(BODY.values())) + np.linspace(0, 0.01, 5)[:, None, None]
    return raw(world @ WORLD_FROM_LAB[axis], BODY, **options)


@pytest.mark.parametrize("axis", WORLD_FROM_LAB)
def test_every_axis_is_a_rotation_that_brings_it_up(axis):
    rotation = WORLD_FROM_LAB[axis]
    lab_axis = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
    np.testing.assert_array_equal(rotation @ lab_axis, [0, 1, 0])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_z_up_becomes_y_up_by_x_z_minus_y():
    np.testing.assert_array_equal(
        raw([[[1, 2, 3]]], ["a"]).to_motion(up="z").positions_world, [[[1, 3, -2]]]
    )


@pytest.mark.parametrize("axis", WORLD_FROM_LAB)
@pytest.mark.parametrize("said", ["", "y", "-z"])
def test_named_markers_on_a_body_tell_what_is_up_whatever_the_file_says(axis, said):
    found = body(axis, up=said).to_motion()
    np.testing.assert_allclose(found.positions_world[0], list(BODY.values()), atol=1e-12)


@pytest.mark.parametrize("axis", ["y", "z"])
@pytest.mark.parametrize("usual", ["y", "z"])
def test_unknown_names_on_the_floor_tell_it_too(axis, usual, rng):
    cloud = rng.uniform([-1.5, 0, -1.8], [-0.5, 1.7, -0.9], (5, 12, 3))
    cloud[:, 0, 1] = 0.03
    found = raw(cloud @ WORLD_FROM_LAB[axis], [f"P{k}" for k in range(12)], usual_up=usual)
    assert found.resolved_up() == axis


@pytest.mark.parametrize(("height", "up"), [(0.8, "z"), (1.7, "y")])
def test_a_word_of_the_file_goes_before_the_floor_unless_somebody_stands_elsewhere(rng, height, up):
    cloud = rng.uniform([-1.5, 0, -1.8], [-0.5, height, -0.9], (5, 40, 3))
    cloud[:, 0, 1], cloud[:, 1, 1] = 0.03, height
    assert raw(cloud, [f"P{k}" for k in range(40)], up="z").resolved_up() == up


@pytest.mark.parametrize(("label", "level"), [
    ("Subject:LANK", 0), ("R.Toe.Tip", 0), ("r_5meta", 0), ("RCAL", 0), ("RKNE", 1), ("R.Knee.Lat", 1), ("RLFC", 1), ("l_asis", 2),
    ("V.Sacral", 2), ("RPSI", 2), ("C7", 3), ("RSHO", 3), ("LFHD", 4), ("Top.Head", 4), ("RELB", None), ("*17", None),
    ("T8#2", 3), ("", None),
])  # fmt: skip
def test_names_tell_their_height_on_the_body(label, level):
    assert mocap_raw.level(label) == level


def test_partly_known_zero_and_infinite_positions_are_not_seen():
    positions = np.array([[[0, 0, 0], [np.inf, 1, 1], [np.nan, 1, 1], [0, 0, 1]]], float)
    seen = np.isfinite(not_seen_as_nan(positions)).all(-1)
    assert seen.tolist() == [[False, False, False, True]]


@pytest.mark.parametrize(("labels", "expected"), [
    (["a", "b"], ("a", "b")),
    (["a", "a", "b"], ("a#1", "a#2", "b")),
    (["a", "a", "a#1"], ("a#1#1", "a#2", "a#1#2")),
])  # fmt: skip
def test_equal_labels_become_different(labels, expected):
    assert mocap_raw.distinct(labels) == expected


def test_millimeters_are_divided_not_multiplied():
    assert (
        raw([[[49.0, 1, 1]]], ["a"], unit="mm").to_motion(up="y").positions_world[0, 0, 0] == 0.049
    )


def test_no_zero_becomes_negative():
    assert not np.signbit(raw([[[0.0, 0.0, 1.0]]], ["a"]).to_motion(up="y").positions_world).any()


@pytest.mark.parametrize(("options", "message"), [
    ({"unit": "furlong"}, "unit 'furlong' is not one of m, cm, mm; give the unit"),
    ({"up": "w"}, "up = 'w' is no axis; give one of y, -y, z"),
])  # fmt: skip
def test_an_unknown_override_is_refused(options, message):
    with pytest.raises(LegsimError, match=message):
        raw([[[1, 1, 1]]], ["a"]).to_motion(**options)


def test_a_file_in_which_nothing_is_seen_is_refused():
    with pytest.raises(LegsimError, match="none of its 1 markers is seen at any time"):
        raw([[[0, 0, 0]]], ["a"]).to_motion()
