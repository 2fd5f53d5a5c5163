"""From a file's unit and axes to meters in world, and what is up."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import raw as mocap_raw
from legsim.mocap.raw import RawMarkers, not_seen_as_nan
from legsim.mocap.vertical import WORLD_FROM_LAB


def raw(positions, labels, *, unit="m", up="", usual_up="y"):
    positions = np.asarray(positions, float)
    return RawMarkers(
        "trial", np.arange(len(positions)) / 100, tuple(labels), positions, unit, up, usual_up
    )


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


@pytest.mark.parametrize("axis", ["y", "z"])
@pytest.mark.parametrize("usual", ["y", "z"])
def test_unknown_names_on_the_floor_tell_it_too(axis, usual, rng):
    cloud = rng.uniform([-1.5, 0, -1.8], [-0.5, 1.7, -0.9], (5, 12, 3))
    cloud[:, 0, 1] = 0.03
    found = raw(cloud @ WORLD_FROM_LAB[axis], [f"P{k}" for k in range(12)], usual_up=usual)
    assert found.resolved_up() == axis


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


def test_a_marker_that_is_there_twice_and_tells_nothing_is_left_out(rng):
    """Never seen beside one that is, or an exact copy; two that differ are kept apart."""
    one, other, lone = rng.uniform(0.1, 1, (3, 6, 3))
    one[2] = np.nan
    unseen = np.zeros((6, 3))
    labels = ["a", "b", "a", "c", "b", "a", "d", "d", "c"]
    columns = [one, one, one, one, other, unseen, unseen, unseen, lone]
    found = raw(np.stack(columns, 1), labels)
    assert found.labels == ("a", "b#1", "c#1", "b#2", "d#1", "d#2", "c#2")
    np.testing.assert_array_equal(found.positions[:, 0], one)
    assert found.notes == ("there twice under one name, never seen or an exact copy, left out: a",)
    assert raw(np.stack([one, other], 1), ["a", "a"]).notes == ()


def test_millimeters_are_divided_not_multiplied():
    assert (
        raw([[[49.0, 1, 1]]], ["a"], unit="mm").to_motion(up="y").positions_world[0, 0, 0] == 0.049
    )


def test_no_zero_becomes_negative():
    assert not np.signbit(raw([[[0.0, 0.0, 1.0]]], ["a"]).to_motion(up="y").positions_world).any()


@pytest.mark.parametrize(("options", "message"), [
    ({"unit": "furlong"}, "unit 'furlong' is not one of m, dm, cm, mm, in, ft; give the unit"),
    ({"up": "w"}, "up = 'w' is no axis; give one of y, -y, z"),
])  # fmt: skip
def test_an_unknown_override_is_refused(options, message):
    with pytest.raises(LegsimError, match=message):
        raw([[[1, 1, 1]]], ["a"]).to_motion(**options)


def test_a_file_in_which_nothing_is_seen_is_refused():
    with pytest.raises(LegsimError, match="none of its 1 markers is seen at any time"):
        raw([[[0, 0, 0]]], ["a"]).to_motion()
