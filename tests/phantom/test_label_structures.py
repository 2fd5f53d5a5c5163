"""Segmentations become structures of one side each; what is unknown or unclear is refused."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.label_images import LabelImage
from legsim.phantom.label_maps import LabelEntry, LabelMap
from legsim.phantom.label_structures import structure_grid

# index axis i to the right (world z), j up, k front: m per voxel
PLACED = np.array([[0.0, 0, 0.002, 0], [0, 0.002, 0, 0], [0.002, 0, 0, 0], [0, 0, 0, 1]])


def entry(number, name, tissue="bone", segment=None, side=None, envelope=False) -> LabelEntry:
    return LabelEntry(number, name, tissue, segment, side, envelope)


TIBIA, SKIN = entry(2, "tibia", segment="tibia"), entry(1, "skin", "skin", "soft", envelope=True)


def image(labels: np.ndarray, name="labels.nii.gz", **named: str) -> LabelImage:
    names = {int(number[1:]): tuple(called.split("|")) for number, called in named.items()}
    return LabelImage(Path(name), np.array(labels, np.int32), PLACED, names=names)


def read(*entries: LabelEntry, left_out: dict[int, str] | None = None) -> LabelMap:
    return LabelMap(Path("map.toml"), entries, left_out or {})


def two_legs() -> np.ndarray:
    """Two bones (2) in a body (1) that is one, 20 voxels wide."""
    labels = np.ones((6, 8, 20), int)
    labels[2:4, 1:7, 3:6] = labels[2:4, 1:7, 14:17] = 2
    return labels


def test_one_number_for_both_legs_is_split_between_them():
    grid = structure_grid([image(two_legs())], [read(SKIN, TIBIA)], side=None)
    assert [s.name for s in grid.structures] == ["skin_l", "skin_r", "tibia_l", "tibia_r"]
    assert [s.segment for s in grid.structures] == ["soft_l", "soft_r", "tibia_l", "tibia_r"]
    assert (grid.codes[2:4, 1:7, 3:6] == 3).all()
    assert (grid.codes[2:4, 1:7, 14:17] == 4).all()
    assert grid.right_of == pytest.approx(0.002 * 9.5)


def test_one_leg_needs_its_side_said():
    labels = two_legs()[:, :, :10]
    with pytest.raises(LegsimError, match=r"labels\.nii\.gz.*say --side left"):
        structure_grid([image(labels)], [read(SKIN, TIBIA)], side=None)
    grid = structure_grid([image(labels)], [read(SKIN, TIBIA)], side="r")
    assert [s.name for s in grid.structures] == ["skin_r", "tibia_r"]


def test_a_side_that_the_map_states_holds_for_all_of_one_leg():
    stated = entry(2, "tibia", segment="tibia", side="l")
    grid = structure_grid([image(two_legs()[:, :, :10])], [read(SKIN, stated)], side=None)
    assert [s.name for s in grid.structures] == ["skin_l", "tibia_l"]
    with pytest.raises(LegsimError, match="leave out --side"):
        structure_grid([image(two_legs()[:, :, :10])], [read(SKIN, stated)], side="r")


def test_envelopes_come_first_and_bones_last_whatever_the_map_says():
    grid = structure_grid([image(two_legs()[:, :, :10])], [read(TIBIA, SKIN)], side="l")
    assert [s.name for s in grid.structures] == ["skin_l", "tibia_l"]


def test_unknown_numbers_are_named_and_refused_unless_ignored():
    labels = two_legs()[:, :, :10]
    labels[0, 0, :3] = 9
    with pytest.raises(LegsimError, match=r"9 \(3 voxels\).*--ignore 9"):
        structure_grid([image(labels)], [read(SKIN, TIBIA)], side="l")
    grid = structure_grid([image(labels)], [read(SKIN, TIBIA)], side="l", ignore={9})
    assert (grid.codes[0, 0, :3] == 0).all()
    known = structure_grid([image(labels)], [read(SKIN, TIBIA, left_out={9: "liver"})], side="l")
    assert any("liver (9)" in line for line in known.remarks)


def test_what_is_left_out_is_called_as_its_list_calls_it():
    labels = np.zeros((4, 4, 4), np.uint16)
    labels[1], labels[2], labels[3] = 1, 2, 3
    bones = (entry(1, "hip", segment="pelvis"), entry(2, "sacrum", segment="pelvis"))
    known = LabelMap(Path("a.json"), bones, {}, {3: "screw"})
    grid = structure_grid([image(labels)], [known], side=None, ignore=[2, 3])
    assert "left out: sacrum (2), screw (3)" in " ".join(grid.remarks)


def test_islands_join_what_is_around_them():
    labels = np.ones((20, 20, 20), int)
    labels[5:15, 5:15, 5:15] = 2
    labels[2, 2, 2] = labels[17, 17, 17] = 2
    grid = structure_grid([image(labels)], [read(SKIN, TIBIA)], side="l")
    assert grid.codes[2, 2, 2] == grid.codes[17, 17, 17] == 1
    assert (grid.codes == 2).sum() == 1000
    assert any("tibia_l: 2 islands of together 0.016 cm3" in line for line in grid.remarks)


def test_later_segmentations_displace_earlier_ones_on_the_same_grid():
    body = np.ones((6, 8, 10), int)
    bones = np.zeros((6, 8, 10), int)
    bones[2:4, 1:7, 3:6] = 2
    grid = structure_grid([image(body), image(bones)], [read(SKIN), read(TIBIA)], side="l")
    assert (grid.codes[2:4, 1:7, 3:6] == 2).all()
    with pytest.raises(LegsimError, match="another grid"):
        structure_grid([image(body), image(bones[:5])], [read(SKIN), read(TIBIA)], side="l")
    with pytest.raises(LegsimError, match="2 segmentations and 1 maps"):
        structure_grid([image(body), image(bones)], [read(SKIN)], side="l")


def test_a_segmentation_without_any_structure_of_the_map_is_refused():
    labels = np.full((4, 4, 4), 9)
    with pytest.raises(LegsimError, match="no structure of its map"):
        structure_grid([image(labels)], [read(TIBIA, left_out={9: "liver"})], side="l")


def test_names_in_the_file_that_contradict_the_map_are_said():
    stated = entry(2, "tibia", segment="tibia")
    agrees = image(two_legs(), n1="skin", n2="Tibia bone", n3="patella")
    assert structure_grid([agrees], [read(SKIN, stated)], side=None).remarks == ()
    other = image(two_legs(), n1="skin", n2="fibula_left", n3="patella")
    grid = structure_grid([other], [read(SKIN, stated, left_out={3: "liver"})], side=None)
    (line,) = grid.remarks
    begin = "In doubt: labels.nii.gz: by the names in it numbers are others than by map.toml: 2"
    assert line.startswith(begin)
    assert "2 is fibula_left there, tibia in the map; the map is followed" in line


def test_a_map_decides_where_the_file_names_a_number_twice():
    twice = image(two_legs(), n1="skin", n2="fibula|tibia")
    assert structure_grid([twice], [read(SKIN, TIBIA)], side=None).remarks == ()
    with pytest.raises(LegsimError, match=r"2 fibula or tibia \(\d+ voxels\)"):
        structure_grid([twice], [read(SKIN)], side=None)


def test_what_the_map_leaves_out_is_doubted_where_the_file_has_a_bone():
    seen, other = (image(two_legs(), n1=name) for name in ("femur", "muscle"))
    doubted, not_doubted = (
        structure_grid([one], [read(TIBIA, left_out={1: "liver"})], side=None).remarks
        for one in (seen, other)
    )
    assert "1 is femur there, liver in the map" in doubted[0]
    assert not_doubted == ("labels.nii.gz: left out: liver (1)",)


def test_a_mask_whose_file_name_contradicts_the_map_is_said():
    mask = image(two_legs() // 2, "fibula.nii.gz")
    named = entry(1, "tibia", segment="tibia")
    (line,) = structure_grid([mask], [read(named)], side=None).remarks
    assert "by the names of the file" in line
    assert structure_grid([image(two_legs() // 2)], [read(named)], side=None).remarks == ()


def test_numbers_that_no_map_knows_are_called_as_in_the_file():
    with pytest.raises(LegsimError, match=r"2 tibia \(\d+ voxels\); name them there"):
        structure_grid([image(two_legs(), n2="tibia")], [read(SKIN)], side=None)


def test_both_sides_that_the_map_states_need_no_gap_between_them():
    """As muscles of an abdomen, of which no leg is seen."""
    labels = two_legs()
    labels[labels == 2] = 3
    labels[:, :, 10:][labels[:, :, 10:] == 3] = 4
    sided = [entry(n, "psoas", "muscle", "soft", side) for n, side in ((3, "l"), (4, "r"))]
    grid = structure_grid([image(labels)], [read(*sided, left_out={1: "body"})], side=None)
    assert [s.name for s in grid.structures] == ["psoas_l", "psoas_r"]
    assert grid.right_of is None
    with pytest.raises(
        LegsimError, match="leaves the side of skin open, and the bones show no gap"
    ):
        structure_grid([image(labels)], [read(SKIN, *sided)], side=None)
