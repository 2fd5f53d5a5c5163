"""The vertical: a file's word stays, a format without one is guessed for, contradictions are asked
about.
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.mocap import vertical
from legsim.mocap.vertical import WORLD_FROM_LAB, Vertical, guessed, stated

STANDING = {
    "SACR": (-0.09, 1.0, 0.0),
    "RASI": (0.09, 0.98, 0.13),
    "LASI": (0.09, 0.98, -0.13),
    "RKNE": (0.04, 0.5, 0.17),
    "LKNE": (0.04, 0.5, -0.17),
    "RANK": (-0.02, 0.08, 0.16),
    "LANK": (-0.02, 0.08, -0.16),
}
SITTING = STANDING | {
    "SACR": (-0.5, 0.5, 0.0),
    "RASI": (-0.32, 0.55, 0.13),
    "LASI": (-0.32, 0.55, -0.13),
}
LABELS = tuple(STANDING)
POSTURES = {
    "supine": ((0, 0, 1), 90.0),
    "prone": ((0, 0, 1), -90.0),
    "left side": ((1, 0, 0), -90.0),
}
FLOOR = np.array([2.0, 0.0, -1.5])
"""where in the lab somebody is"""


def turned(places: dict, axis=(0, 1, 0), degrees: float = 0.0, heading: float = 0.0) -> np.ndarray:
    """Markers (5, m, 3) in world, turned about an axis, then about the vertical, and put down."""
    rotation = transforms.axis_rotation([0, 1, 0], np.radians(heading)) @ transforms.axis_rotation(
        axis, np.radians(degrees)
    )
    world = np.array(list(places.values())) @ rotation.T
    world -= [*world.mean(0)[[0]], world[:, 1].min() - 0.06, world.mean(0)[2]]
    return world + FLOOR + np.linspace(0, 0.01, 5)[:, None, None]


def in_lab(world: np.ndarray, axis: str) -> np.ndarray:
    return world @ WORLD_FROM_LAB[axis]


def lying(posture: str, heading: float = 0.0) -> np.ndarray:
    return turned(STANDING, *POSTURES[posture], heading)


@pytest.mark.parametrize("heading", [0.0, 90.0, 180.0, 270.0, 30.0])
@pytest.mark.parametrize("axis", ["y", "z"])
@pytest.mark.parametrize("usual", ["y", "z"])
def test_who_stands_shows_the_vertical_of_a_format_without_one(axis, usual, heading):
    found = guessed(in_lab(turned(STANDING, heading=heading), axis), LABELS, usual)
    assert found == Vertical(axis, "the body is upright along it")


@pytest.mark.parametrize("spelling", ["Ann:{}", "Ann_{}", "S 01.{}", "{}.pos"])
def test_a_subject_in_all_names_does_not_hide_the_body(spelling):
    names = [*(spelling.format(name) for name in LABELS), "*17"]
    points = np.concatenate([turned(STANDING), turned(STANDING)[:, :1]], 1)
    found = guessed(in_lab(points, "z"), names, "y")
    assert found == Vertical("z", "the body is upright along it")


@pytest.mark.parametrize("heading", [0.0, 180.0, 270.0, 30.0])
@pytest.mark.parametrize("axis", ["y", "z"])
def test_who_sits_keeps_the_usual_vertical_and_shows_another(axis, heading):
    world = turned(SITTING, heading=heading)
    assert guessed(in_lab(world, axis), LABELS, axis).axis == axis
    assert guessed(in_lab(turned(SITTING), axis), LABELS, "y").axis == axis


@pytest.mark.parametrize("heading", [0.0, 180.0])
@pytest.mark.parametrize("posture", ["supine", "prone"])
@pytest.mark.parametrize("axis", ["y", "z"])
def test_who_lies_on_back_or_face_keeps_the_usual_vertical(axis, posture, heading):
    found = guessed(in_lab(lying(posture, heading), axis), LABELS, axis)
    assert found.axis == axis
    assert "the body lies along" in found.reason


@pytest.mark.parametrize("posture", ["supine", "prone"])
def test_who_lies_in_a_way_that_fits_two_verticals_is_asked_about(posture):
    """On the back in a lab with z up, or on the side in one with y up."""
    with pytest.raises(LegsimError, match=r"on its side if y is up, on its back.*motion\.up=z"):
        guessed(in_lab(lying(posture), "z"), LABELS, "y")


@pytest.mark.parametrize("heading", [0.0, 90.0, 180.0, 30.0])
@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("axis", ["y", "z"])
def test_who_lies_keeps_the_files_word(axis, posture, heading):
    found = stated(in_lab(lying(posture, heading), axis), LABELS, axis)
    assert found.axis == axis
    assert found.reason.startswith("as the file says")


@pytest.mark.parametrize("axis", ["y", "z", "-y"])
def test_a_word_of_the_wrong_sign_gives_way_to_feet_on_the_floor(axis):
    """Along the stated axis the person would hang below the floor."""
    said = axis[1:] if axis.startswith("-") else f"-{axis}"
    found = stated(in_lab(turned(STANDING), axis), LABELS, said)
    assert found.axis == axis
    assert f"along {said}, which the file calls up" in found.reason


@pytest.mark.parametrize("said", ["y", "z"])
def test_who_hangs_head_down_above_the_floor_is_asked_about(said):
    hanging = turned(STANDING) * [1, -1, -1] + [0, 2.0, 0]
    with pytest.raises(LegsimError, match=rf"feet are above the pelvis.*motion\.up=-{said}"):
        stated(in_lab(hanging, said), LABELS, said)


@pytest.mark.parametrize(("axis", "said"), [("z", "y"), ("y", "z")])
def test_a_word_that_the_feet_speak_against_is_asked_about(axis, said):
    with pytest.raises(LegsimError, match=rf"the file says {said} is up, but .*motion\.up={axis}"):
        stated(in_lab(turned(STANDING), axis), LABELS, said)


def test_a_body_head_down_along_the_usual_vertical_is_asked_about():
    with pytest.raises(LegsimError, match=r"feet are above the pelvis along y.*motion\.up=-y"):
        guessed(in_lab(turned(STANDING), "-y"), LABELS, "y")


@pytest.mark.parametrize(("height", "asks"), [(0.8, False), (1.7, True)])
def test_unnamed_markers_question_a_word_only_if_somebody_stands_elsewhere(rng, height, asks):
    cloud = rng.uniform([-1.5, 0, -1.8], [-0.5, height, -0.9], (5, 40, 3))
    cloud[:, 0, 1], cloud[:, 1, 1] = 0.03, height
    labels = [f"P{k}" for k in range(40)]
    if asks:
        with pytest.raises(LegsimError, match=r"somebody stands along y.*motion\.up=y"):
            stated(cloud, labels, "z")
    else:
        assert stated(cloud, labels, "z").axis == "z"


@pytest.mark.parametrize(("label", "level"), [
    ("Subject:LANK", 0), ("R.Toe.Tip", 0), ("r_5meta", 0), ("RCAL", 0), ("RKNE", 1), ("R.Knee.Lat", 1), ("RLFC", 1), ("l_asis", 2),
    ("V.Sacral", 2), ("RPSI", 2), ("C7", 3), ("RSHO", 3), ("LFHD", 4), ("Top.Head", 4), ("RELB", None), ("*17", None),
    ("T8#2", 3), ("", None),
])  # fmt: skip
def test_names_tell_their_height_on_the_body(label, level):
    assert vertical.level(label) == level


@pytest.mark.parametrize(("label", "side"), [
    ("RASI", ("r", "asi")), ("Ann:LKNE", ("l", "kne")), ("ASIS_R", ("r", "asis")), ("SACR", None), ("Left Knee", ("l", "knee")),
    ("C7", None), ("RLMA", ("r", "lma")), ("LLEPI", ("l", "lepi")),
])  # fmt: skip
def test_names_tell_their_side(label, side):
    assert vertical.side(label) == side
