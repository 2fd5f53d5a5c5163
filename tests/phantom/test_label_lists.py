"""Lists of names as segmentation programs write them, and the structures that they become."""

import json

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.phantom import label_lists, label_maps

NNUNET = {"channel_names": {"0": "CT"}, "labels": {"background": 0, "Femur": 1, "tibia": 2}}

LABELED = [{"name": "femur", "value": 1}, {"name": "tibia", "value": 2, "opacity": 0.6}]

LISTS = {
    "total.json": json.dumps({"1": "femur", "2": "tibia"}),
    "dataset.json": json.dumps(NNUNET),
    "old.json": json.dumps({"labels": {"0": "background", "1": "femur", "2": "tibia"}}),
    "colors.ctbl": "# Color table\n0 background 0 0 0 0\n1 femur 255 0 0 255\n2 tibia 0 9 0 255\n",
    "blanks.CTBL": '0 "no bone" 0 0 0 0\n1 the femur 255 0 0 255\n2 "tibia bone" 0 9 0 255\n',
    "slicer.csv": "LabelValue,Name,Color_R,Color_G,Color_B,Color_A\n1,femur,1,1,1,255\n2,Tibia,1,1,1,9\n",
    "a_dseg.tsv": "index\tname\tcolor\n0\tbackground\t\n1\tfemur\t#fff\n2\ttibia\t#000\n",
    "rows.csv": "\ufeffname;value\nfemur;1\ntibia;2\n",
    "mitk.mitklabel.json": json.dumps(
        {"groups": [{"labels": LABELED[:1]}, {"labels": LABELED[1:]}]}
    ),
    "list.json": json.dumps({"labels": LABELED}),
    "dcmqi.json": json.dumps(
        {
            "segmentAttributes": [
                [{"labelID": 1, "SegmentLabel": "femur"}, {"labelID": 2, "SegmentLabel": "tibia"}]
            ]
        }
    ),
    "snap.txt": "# ITK-SnAP\n"
    '    0     0    0    0        0  0  0    "Clear Label"\n'
    '    1   255    0    0        1  1  1    "Femur"\n'
    '    2     0  255    0      0.5  1  1    "Tibia bone"\n',
}


@pytest.mark.parametrize("name", LISTS)
def test_numbers_and_names_are_read_of_any_program(tmp_path, name):
    (tmp_path / name).write_text(LISTS[name], "utf-8")
    found = label_maps.load_label_map(tmp_path / name)
    assert [(e.number, e.name, e.tissue, e.segment) for e in found.entries] == [
        (1, "femur", "bone", "femur"),
        (2, "tibia", "bone", "tibia"),
    ]


def test_a_table_may_say_the_side_apart(tmp_path):
    (tmp_path / "lut.tsv").write_text("label\tname\themi\n1\tfemur\tL\n2\tfemur\tR\n3\ttibia\t\n")
    found = label_maps.load_label_map(tmp_path / "lut.tsv").entries
    assert [(e.name, e.side) for e in found] == [("femur", "l"), ("femur", "r"), ("tibia", None)]


def test_the_header_of_a_segmentation_of_slicer_is_a_list(tmp_path):
    image = sitk.GetImageFromArray(np.ones((3, 3, 3), np.uint8))
    for key, value in (("Name", "left femur"), ("LabelValue", "4"), ("Layer", "0")):
        image.SetMetaData(f"Segment0_{key}", value)
    sitk.WriteImage(image, str(tmp_path / "a.seg.nrrd"))
    assert label_lists.read(tmp_path / "a.seg.nrrd") == {4: "left femur"}


@pytest.mark.parametrize("none", ["n/a", "N/A", "both", "B", ""])
def test_a_side_that_is_none_is_no_part_of_a_name(tmp_path, none):
    """BIDS has n/a where there is none."""
    rows = f"index\tname\themisphere\n1\thip_left\tLeft\n2\thip\tr\n3\tsacrum\t{none}\n"
    (tmp_path / "a_dseg.tsv").write_text(rows)
    found = label_maps.load_label_map(tmp_path / "a_dseg.tsv")
    assert [e.name for e in found.entries] == ["hip_left", "hip_right", "sacrum"]
    assert not found.foreign


@pytest.mark.parametrize("name", ["femoral", "femoral_left", "Tibial R", "fibular", "the patellar"])
def test_an_adjective_alone_is_no_bone(tmp_path, name):
    """An artery's beside the aorta, say."""
    (tmp_path / "a.json").write_text(json.dumps({"1": "aorta", "2": name, "3": "sacrum"}))
    found = label_maps.load_label_map(tmp_path / "a.json")
    assert [e.name for e in found.entries] == ["sacrum"]
    assert found.foreign == {2: name}


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("tibial bone left", ("tibia", "l", "bone")),
        ("Femur_L", ("femur", "l", "bone")),
        ("TibiaRight", ("tibia", "r", "bone")),
        ("femoral cartilage", ("femur_cartilage", None, "cartilage")),
        ("patella bone", ("patella", None, "bone")),
        ("distal_femur_left", ("femur", "l", "bone")),
        ("Bones", ("bone", None, "bone")),
        ("Muscles", ("muscle", None, "muscle")),
        ("gluteus_maximus_left", ("gluteus_maximus", "l", "muscle")),
    ],
)
def test_names_are_compared_by_their_words(tmp_path, name, entry):
    (tmp_path / "a.json").write_text(json.dumps({"3": name}))
    (found,) = label_maps.load_label_map(tmp_path / "a.json").entries
    assert (found.name, found.side, found.tissue) == entry


def test_names_without_a_known_tissue_stay_unknown(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"1": "femur", "9": "screw"}))
    found = label_maps.load_label_map(tmp_path / "a.json")
    assert [e.number for e in found.entries] == [1]
    assert found.foreign == {9: "screw"}


@pytest.mark.parametrize("name", ["脂肪", "Кожа", "???", "of the", "left", "Fémur", "Fe\u0301mur"])
def test_a_name_without_known_words_is_nothing(tmp_path, name):
    (tmp_path / "a.json").write_text(json.dumps({"1": "tibia", "2": name}), "utf-8")
    found = label_maps.load_label_map(tmp_path / "a.json")
    assert [e.number for e in found.entries] == [1]
    assert found.foreign == {2: name}


@pytest.mark.parametrize("name", ["bone", "Bone", "the bone"])
def test_bone_by_itself_is_a_name(tmp_path, name):
    (tmp_path / "a.json").write_text(json.dumps({"2": name}))
    (found,) = label_maps.load_label_map(tmp_path / "a.json").entries
    assert (found.name, found.tissue) == ("bone", "bone")


def test_names_that_shipped_maps_leave_out_are_left_out(tmp_path):
    names = {"1": "femur_left", "5": "liver", "27": "vertebrae_L5", "9": "deltoid_right"}
    (tmp_path / "a.json").write_text(json.dumps(names))
    found = label_maps.load_label_map(tmp_path / "a.json")
    assert [e.number for e in found.entries] == [1]
    assert found.left_out == {5: "liver", 27: "vertebrae_L5", 9: "deltoid_right"}
    assert not found.foreign


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", "[1, 2]", "no numbers with names"),
        ("a.json", "{", "is not JSON"),
        ("a.txt", "1 2 3\n", "no numbers with names"),
        ("a.json", '{"1": "screw"}', r"knows \(screw\); it says no tissues"),
        (
            "a.json",
            '{"1": "femur", "2": "Femur bone"}',
            "twice, 1 femur and 2 Femur bone; give them one",
        ),
        ("a.json", '{"femur": 1, "tibia": 1}', "number 1 has two names, femur and tibia"),
        ("a.json", '{"1": "femur", "1": "tibia"}', "the key '1' occurs twice"),
        ("a.ctbl", "1 femur 0 0 0 0\n1 tibia 0 0 0 0\n", "number 1 has two names"),
        ("a.csv", "a,b\n1,femur\n", "no numbers with names"),
        ("a.csv", "", "no numbers with names"),
    ],
)
def test_what_is_no_list_is_refused(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(LegsimError, match=said):
        label_maps.load_label_map(tmp_path / name)
