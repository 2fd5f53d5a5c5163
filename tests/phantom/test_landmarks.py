"""Landmarks turn with the bones, and are where the leg model has its joints."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.phantom import landmarks, leg_phantom
from legsim.phantom.landmarks import BoneSurface

LEGS = leg_phantom.load_leg_phantom()
STILL = np.eye(4)


def bones(side="l", motion=STILL, *names: str) -> dict[str, BoneSurface]:
    found = {}
    for name in names or ("femur", "tibia"):
        part = LEGS.phantom.parts[LEGS.part_index(f"{name}_cortex_{side}")]
        found[name] = BoneSurface(transforms.apply(motion, part.vertices), part.triangles)
    return found


@pytest.mark.parametrize("side", ["l", "r"])
def test_they_are_near_the_joint_centers_of_the_leg_model(side):
    found = landmarks.find(bones(side), side)
    names = ("femur", "tibia", "talus")
    hip, knee, ankle = (LEGS._reference(f"{name}_{side}")[:3, 3] for name in names)
    assert np.linalg.norm(found["hip"] - hip) < 0.002
    # the model's knee axis and the condyles' middle are two definitions of one place
    assert np.linalg.norm(landmarks.middle_of_knee(found) - knee) < 0.010
    assert np.linalg.norm(found["ankle"] - ankle) < 0.040


def test_sides_are_mirror_images():
    left, right = (landmarks.find(bones(side), side) for side in "lr")
    for name, point in left.items():
        np.testing.assert_allclose(point * [1, 1, -1], right[name], atol=1e-6)


def test_a_leg_that_lies_otherwise_has_them_at_the_same_places_of_its_bones():
    turn = transforms.rotation_from_vector(np.array([0.08, 0.2, -0.1]))
    motion = transforms.rigid(turn, (0.1, -0.3, 0.5))
    before, after = (landmarks.find(bones("l", m), "l") for m in (np.eye(4), motion))
    assert before.keys() == after.keys()
    for name, point in before.items():
        # ends of slices and boxes are where other triangles end, small as they are
        carried = transforms.apply(motion, point[None])[0]
        assert np.linalg.norm(after[name] - carried) < 0.0005, name


def test_finer_triangles_of_the_same_surface_have_the_same_landmarks():
    whole = bones()
    fine = {}
    for name, bone in whole.items():
        a, b, c = np.moveaxis(bone.corners(), 1, 0)
        middle = (a + b + c) / 3
        corners = np.concatenate(
            [np.stack(t, 1) for t in ((a, b, middle), (b, c, middle), (c, a, middle))]
        )
        fine[name] = BoneSurface(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    before, after = landmarks.find(whole, "l"), landmarks.find(fine, "l")
    for name, point in before.items():
        assert np.linalg.norm(after[name] - point) < 0.0003, name


def test_cutting_large_triangles_keeps_the_surface():
    bone = bones()["femur"]
    fine = bone.divided()
    edges = np.linalg.norm(np.diff(fine.corners(), axis=1), axis=-1)
    assert edges.max() <= landmarks._LARGE
    volumes = [np.linalg.det(b.corners()).sum() / 6 for b in (bone, fine)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)


def cut(bone: BoneSurface, low: float, high: float) -> BoneSurface:
    fine = bone.divided()
    middle = fine.corners().mean(1)[:, 1]
    return BoneSurface(fine.vertices, fine.triangles[(middle > low) & (middle < high)])


def test_bones_that_are_cut_have_the_middles_of_their_shafts():
    whole = bones()
    knee = landmarks.middle_of_knee(landmarks.find(whole, "l"))[1]
    short = {name: cut(bone, knee - 0.15, knee + 0.15) for name, bone in whole.items()}
    found = landmarks.find(short, "l")
    assert found.keys() == {"condyle_medial", "condyle_lateral", "thigh", "shank"}
    assert found["thigh"][1] == pytest.approx(knee + 0.135, abs=0.005)
    middle = landmarks.middle_of_knee(found)
    reach = [float(np.linalg.norm(found[name] - middle)) for name in ("thigh", "shank")]
    same = landmarks.find(whole, "l", thigh_reach=reach[0], shank_reach=reach[1])
    for name, point in found.items():
        assert np.linalg.norm(same[name] - point) < 0.002, name


def test_without_a_femur_or_its_condyles_there_are_none():
    with pytest.raises(LegsimError, match="no femur of side l"):
        landmarks.find(bones("l", np.eye(4), "tibia"), "l")
    shaft = cut(bones()["femur"], -0.3, -0.1)
    with pytest.raises(LegsimError, match=r"femur_l: no condyles .* is \d+ mm wide"):
        landmarks.find({"femur": shaft}, "l")


def turned(motion, *names: str) -> dict[str, BoneSurface]:
    """Bones of which the named ones have moved."""
    whole = bones()
    return {
        name: BoneSurface(transforms.apply(motion, bone.vertices), bone.triangles)
        if name in names
        else bone
        for name, bone in whole.items()
    }


@pytest.mark.parametrize(
    ("motion", "names"),
    [
        (transforms.rigid(np.diag([1.0, -1, -1]), (0, -0.8, -0.17)), ("femur", "tibia")),
        (transforms.rigid(np.diag([-1.0, -1, 1]), (0, -1.2, 0)), ("femur", "tibia")),
        (transforms.translation((0, -0.06, 0)), ("tibia",)),
        (transforms.translation((0, 0.2, 0)), ("tibia",)),
    ],
    ids=["upside down", "upside down and back to front", "torn apart", "shifted into the thigh"],
)
def test_bones_that_form_no_knee_have_no_landmarks(motion, names):
    with pytest.raises(LegsimError, match=r"(tibia_l: its upper end|femur_l: no condyle)"):
        landmarks.find(turned(motion, *names), "l")


@pytest.mark.parametrize("lean", [-0.25, 0.25])
def test_a_head_is_found_on_a_femur_that_leans_to_either_side(lean):
    turn = transforms.rigid(transforms.axis_rotation((1, 0, 0), lean), (0, 0, 0))
    upright, leaning = (landmarks.find(bones("l", m), "l") for m in (STILL, turn))
    carried = transforms.apply(turn, upright["hip"][None])[0]
    assert np.linalg.norm(leaning["hip"] - carried) < 0.0005


def test_a_femur_whose_head_is_cut_off_has_none():
    head = landmarks.find(bones(), "l")["hip"]
    bone = bones()["femur"].divided()
    far = np.linalg.norm(bone.corners().mean(1) - head, axis=1) > 0.026
    found = landmarks.find({"femur": BoneSurface(bone.vertices, bone.triangles[far])}, "l")
    assert "hip" not in found
    assert "thigh" in found


@pytest.mark.parametrize("above", [0.07, 0.2])
def test_a_knee_that_is_called_by_the_other_side_is_noticed(above):
    femur = bones()["femur"]
    knee = landmarks.middle_of_knee(landmarks.find({"femur": femur}, "l"))[1]
    short = cut(femur, knee - 0.1, knee + above)
    for side, expected in (("l", False), ("r", True)):
        found = landmarks.find({"femur": short}, side)
        assert landmarks.of_other_side({"femur": short}, found, side) is expected


def test_a_short_stump_and_a_head_raise_no_doubt_about_the_side():
    femur = bones()["femur"]
    whole = landmarks.find({"femur": femur}, "l")
    assert not landmarks.of_other_side({"femur": femur}, whole, "l")
    stump = cut(femur, -1.0, landmarks.middle_of_knee(whole)[1] + 0.045)
    found = landmarks.find({"femur": stump}, "r")
    assert not landmarks.of_other_side({"femur": stump}, found, "r")


def test_those_of_a_file_are_read_in_mm():
    read = landmarks.read(Path("p.toml"), {"l": {"hip": [1, 2.5, -3]}})
    np.testing.assert_allclose(read["l"]["hip"], (0.001, 0.0025, -0.003))


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        (3, "no table"),
        ({"left": {}}, "landmarks.left"),
        ({"l": {"nose": [1, 2, 3]}}, "unknown landmark 'nose'"),
        ({"l": {"hip": [1, 2]}}, "give x, y, z in mm"),
        ({"l": {"hip": [1, 2, float("nan")]}}, "give x, y, z in mm"),
        ({"l": {"hip": [1, 2, True]}}, "give x, y, z in mm"),
    ],
)
def test_faults_of_a_file_name_it(tables, words):
    with pytest.raises(LegsimError, match=words) as caught:
        landmarks.read(Path("p.toml"), tables)
    assert "p.toml" in str(caught.value)


@pytest.mark.parametrize("degrees", [-150, -60, 45, 60, 100, 180])
@pytest.mark.parametrize(("side", "reach"), [("l", np.inf), ("r", 0.08)])
def test_a_leg_turned_about_its_length_has_them_where_its_patella_says(degrees, side, reach):
    names = ("femur", "tibia", "patella")
    knee = landmarks.middle_of_knee(landmarks.find(bones(side), side))[1]
    whole = {
        name: cut(bone, knee - reach, knee + reach)
        for name, bone in bones(side, STILL, *names).items()
    }
    turn = transforms.rigid(transforms.axis_rotation((0, 1, 0), np.radians(degrees)), (0.1, 0, 0))
    moved = {
        name: BoneSurface(transforms.apply(turn, bone.vertices), bone.triangles)
        for name, bone in whole.items()
    }
    # the patella itself lies a few degrees beside the front
    off = np.radians(degrees) - landmarks.turned(moved)
    assert abs(np.angle(np.exp(1j * off))) < np.radians(12)
    expected, found = landmarks.find(whole, side), landmarks.find(moved, side)
    for name, point in expected.items():
        carried = transforms.apply(turn, point[None])[0]
        assert np.linalg.norm(found[name] - carried) < 0.001, name
    assert not landmarks.of_other_side(moved, found, side)


def test_without_a_patella_nothing_is_turned():
    assert landmarks.turned(bones()) == 0
