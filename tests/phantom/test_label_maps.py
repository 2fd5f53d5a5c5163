"""LABELS.toml: the shipped maps load, and each fault names its place."""

import pytest

from legsim.core.errors import LegsimError
from legsim.phantom import label_maps
from legsim.phantom.label_maps import load_label_map

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
