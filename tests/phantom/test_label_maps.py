"""LABELS.toml: the shipped maps load, and each fault names its place."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.label_images import LabelImage
from legsim.phantom import label_maps
from legsim.phantom.label_maps import LabelEntry, known, load_label_map, own_map

GOOD = '[[label]]\nnumber = 1\nname = "femur"\ntissue = "bone"\nsegment = "femur_l"\n'


@pytest.mark.parametrize("name", label_maps.names())
def test_every_shipped_map_loads_and_states_its_source(name):
    read = load_label_map(name)
    assert read.entries
    assert read.path.read_text().startswith("# Numbers")


def test_published_numbers_are_whom_they_name():
    total = {e.number: e for e in load_label_map("totalsegmentator_total").entries}
    assert (total[75].name, total[75].segment, total[75].side) == ("femur", "femur", "l")
    assert (total[78].name, total[78].segment, total[78].side) == ("hip_right", "pelvis", None)
    assert load_label_map("totalsegmentator_total").left_out[5] == "liver"
    bones = {
        e.number: e.name for e in load_label_map("totalsegmentator_appendicular_bones").entries
    }
    assert (bones[1], bones[2], bones[3]) == ("patella", "tibia", "fibula")
    slicer = {e.number: e.tissue for e in load_label_map("slicer_generic_anatomy").entries}
    assert (slicer[3], slicer[8], slicer[21]) == ("skin", "muscle", "cartilage")


def test_a_byte_order_mark_is_no_fault(tmp_path):
    (tmp_path / "m.toml").write_text(GOOD, "utf-8-sig")
    assert load_label_map(tmp_path / "m.toml").entries[0].number == 1


def test_sides_come_from_the_segment(tmp_path):
    (tmp_path / "m.toml").write_text(GOOD.replace('"femur"', '"femur_left"'))
    entry = load_label_map(tmp_path / "m.toml").entries[0]
    assert (entry.name, entry.segment, entry.side, entry.paired) == ("femur", "femur", "l", True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"no \[\[label\]\]"),
        ("x = 1\n" + GOOD, "unknown key 'x'"),
        (GOOD + "color = 3\n", r"label 1\): unknown key 'color'"),
        (GOOD.replace("1", "0"), "number 0"),
        (GOOD.replace("1", "true"), "wrong type"),
        (GOOD.replace('"bone"', '"stone"'), "unknown tissue 'stone'"),
        (GOOD.replace("femur_l", "wing"), "unknown segment 'wing'"),
        (GOOD.replace('"femur"', '"../femur"'), "names a file"),
        (GOOD.replace("number = 1\n", ""), "lacks number"),
        (GOOD + GOOD, "1 occurs twice"),
        (GOOD + GOOD.replace("1", "2"), "femur l occurs twice"),
        (GOOD + "[left_out]\nliver = 1\n", "1 occurs twice"),
        ("[[label]", "is not TOML"),
    ],
)
def test_faults_are_refused_with_file_and_place(tmp_path, text, words):
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(LegsimError, match=words) as caught:
        load_label_map(tmp_path / "m.toml")
    assert "m.toml" in str(caught.value)


def test_an_unknown_map_lists_those_that_ship():
    with pytest.raises(LegsimError, match="totalsegmentator_total"):
        load_label_map("total")
    with pytest.raises(LegsimError, match="no such file"):
        load_label_map("total.toml")


def image(name="a.nii.gz", numbers=(0, 5), **names: str) -> LabelImage:
    labels = np.resize(np.array(numbers, np.int32), (3, 3, 3))
    named = {int(number[1:]): tuple(called.split("|")) for number, called in names.items()}
    return LabelImage(Path(name), labels, np.eye(4), names=named)


def test_a_segmentation_is_its_own_map_by_the_names_in_it():
    named = {"n0": "background", "n5": "femur_left", "n6": "liver", "n7": "screw"}
    read = own_map(image(numbers=(0, 5, 6), **named))
    assert [(e.number, e.name, e.side) for e in read.entries] == [(5, "femur", "l")]
    assert (read.left_out, read.foreign) == ({6: "liver"}, {7: "screw"})
    assert read.remarks == ("a.nii.gz: numbers by the names in it: 5 femur_left",)


def test_a_mask_is_named_by_its_file():
    read = own_map(image("there/tibia_right.nii.gz"))
    assert [(e.number, e.name, e.side) for e in read.entries] == [(5, "tibia", "r")]
    assert "by the names of the file: 5 tibia_right" in read.remarks[0]


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("tibia.cartilage.nii.gz", ("tibia_cartilage", None, "cartilage")),
        ("femur.left.nii.gz", ("femur", "l", "bone")),
        ("femur.R.nrrd", ("femur", "r", "bone")),
        ("Patella.seg.nrrd", ("patella", None, "bone")),
        ("patella.NII.GZ", ("patella", None, "bone")),
    ],
)
def test_points_divide_the_words_of_a_files_name(name, entry):
    (found,) = own_map(image(name)).entries
    assert (found.name, found.side, found.tissue) == entry


@pytest.mark.parametrize("other", ["muscle", "artery", "implant", "v2"])
def test_a_word_behind_a_point_counts(other):
    with pytest.raises(LegsimError, match="does not name its numbers"):
        own_map(image(f"femur.{other}.nii.gz"))


def test_a_number_with_two_names_needs_a_map_where_it_is_there():
    assert own_map(image(n5="femur_left", n6="tibia|fibula")).entries[0].name == "femur"
    with pytest.raises(LegsimError, match=r"5 has two names, femur and tibia; say .* by --map"):
        own_map(image(n5="femur|tibia"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (image("mask.nii.gz"), r"does not name its numbers; say what they are by --map \(leg, "),
        (image("femur.nii.gz", (0, 1, 2)), "does not name its numbers"),
        (image("femur.nii.gz", n5="screw"), r"names no structure that legsim knows \(screw\)"),
    ],
)
def test_a_segmentation_without_known_names_needs_a_map(given, said):
    with pytest.raises(LegsimError, match=said):
        own_map(given)


def mapped(name: str, tissue="bone", segment: str | None = None, side: str | None = None):
    return LabelEntry(5, name, tissue, segment, side, envelope=False)


FEMUR = mapped("femur", segment="femur", side="l")


@pytest.mark.parametrize(
    ("own", "entry"),
    [
        ("left femur", FEMUR),
        ("femur", FEMUR),
        ("bone", FEMUR),
        ("Segment_1", FEMUR),
        ("my tibia", FEMUR),
        ("cartilage", mapped("femur_cartilage", "cartilage", "femur")),
        ("tissue", mapped("muscle", "muscle", "soft")),
        ("tissue", mapped("fat", "fat", "soft")),
        ("skin", mapped("body", "soft_tissue", "soft")),
        ("skin", mapped("tissue", "soft_tissue", "soft")),
        ("subcutaneous_fat", mapped("fat", "fat", "soft")),
        ("skeletal_muscle", mapped("muscle", "muscle", "soft")),
        ("muscle", mapped("sartorius", "muscle", "soft", "r")),
        ("tarsal", mapped("talus", segment="talus")),
        ("calcaneus", mapped("tarsal", segment="talus")),
        ("tarsal", mapped("calcaneus", segment="calcn")),
        ("tarsal", mapped("midfoot", segment="calcn")),
        ("hip_left", mapped("pelvis", segment="pelvis")),
        ("phalanges_feet", mapped("phalanges_feet", segment="calcn")),
        ("femur", mapped("femur", "titanium", "femur")),
        ("liver", mapped("liver", "soft_tissue", "soft")),
        ("torso_fat", mapped("fat", "fat", "soft")),
        ("artery", mapped("muscle", "muscle", "soft")),
        ("tendon", mapped("fat", "fat", "soft")),
        ("meniscus", mapped("cartilage", "cartilage", "tibia")),
        ("blood", mapped("body", "soft_tissue", "soft")),
        ("fibula", mapped("tibia_and_fibula", segment="tibia")),
        ("aorta", mapped("blood", "blood", "soft")),
        ("autochthon_left", mapped("muscle", "muscle", "soft")),
        ("ulna", mapped("forearm", "bone")),
        ("vertebrae_S1", mapped("vertebrae_S1", "bone", "pelvis")),
    ],
)
def test_a_right_map_is_not_doubted(own, entry):
    assert not known().differ(own, entry.name, entry)


@pytest.mark.parametrize(
    ("own", "entry"),
    [
        ("femur_right", FEMUR),
        ("tibia", FEMUR),
        ("fibula", FEMUR),
        ("fibula_left", mapped("tibia", segment="tibia")),
        ("muscle", FEMUR),
        ("femur", mapped("muscle", "muscle", "soft")),
        ("bone", mapped("tissue", "soft_tissue", "soft")),
        ("femur_cartilage", FEMUR),
        ("femur_cartilage", mapped("tibia_cartilage", "cartilage", "tibia")),
        ("calcaneus", mapped("talus", segment="talus")),
        ("tarsal", mapped("tibia", segment="tibia")),
        ("hip_left", mapped("hip_right", segment="pelvis")),
        ("sartorius_left", mapped("sartorius", "muscle", "soft", "r")),
        ("fat", mapped("muscle", "muscle", "soft")),
        ("muscle", mapped("skin", "skin", "soft")),
        ("artery", mapped("skin", "skin", "soft")),
        ("meniscus", mapped("skin", "skin", "soft")),
        ("cartilage", mapped("muscle", "muscle", "soft")),
        ("liver", FEMUR),
        ("humerus_left", FEMUR),
    ],
)
def test_a_map_is_doubted_that_makes_something_else_of_a_name(own, entry):
    assert known().differ(own, entry.name, entry)


@pytest.mark.parametrize(
    ("own", "left_out", "differ"),
    [
        ("femur", "liver", True),
        ("femur", "femur left", False),
        ("femur", "tibia", True),
        ("femur", "screw", False),
        ("liver", "spleen", False),
        ("muscle", "deltoid", False),
        ("bone", "skull", False),
    ],
)
def test_what_a_map_leaves_out_is_doubted_where_it_is_a_bone_that_moves(own, left_out, differ):
    assert known().differ(own, left_out, None) is differ
