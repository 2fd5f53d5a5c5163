"""Names that a segmentation's own file has for its numbers, as each program writes them."""

import gzip
import json
import struct

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import label_names
from legsim.geometry.label_images import load_label_image

CARET = (
    '<?xml version="1.0" encoding="UTF-8"?> <CaretExtension>  <Date><![CDATA[2013-07-14]]></Date>'
    '<VolumeInformation Index="0"> <LabelTable>\n'
    '<Label Key="0" Red="0" Green="0" Blue="0" Alpha="0"><![CDATA[???]]></Label>\n'
    '<Label Key="75" Red="1" Green="0.0" Blue="0" Alpha="1"><![CDATA[femur_left]]></Label>\n'
    '<Label Key="78" Red="1" Green="0.0" Blue="0" Alpha="1"><![CDATA[hip_right]]></Label>\n'
    "</LabelTable></VolumeInformation></CaretExtension>\n              "
)

NAMED = {75: ("femur_left",), 78: ("hip_right",)}


def ones(path):
    image = sitk.GetImageFromArray(np.full((3, 4, 5), 75, np.uint8))
    sitk.WriteImage(image, str(path))
    return path


def with_extensions(tmp_path, *contents, name="a.nii.gz"):
    """A NIfTI file of one number with extensions of (code, bytes)."""
    whole = ones(tmp_path / "plain.nii").read_bytes()
    packed = b""
    for code, content in contents:
        content += b"\0" * (-(len(content) + 8) % 16)
        packed += struct.pack("<2i", len(content) + 8, code) + content
    values = whole[352:]
    head = bytearray(whole[:348])
    struct.pack_into("<f", head, 108, 352.0 + len(packed))
    content = bytes(head) + bytes([bool(contents), 0, 0, 0]) + packed + values
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return path


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_a_table_in_an_extension_of_nifti_is_read(tmp_path, name):
    path = with_extensions(tmp_path, (0, CARET.encode()), name=name)
    assert load_label_image(path).names == NAMED
    assert (load_label_image(path).labels == 75).all()


def test_extensions_of_other_programs_are_passed_over(tmp_path):
    others = ((4, b"<?xml?><AFNI_attributes/>"), (6, b"a comment"), (30, CARET.encode()))
    assert label_names.read(with_extensions(tmp_path, *others)) == NAMED
    assert label_names.read(with_extensions(tmp_path, *others[:2])) == {}


@pytest.mark.parametrize(
    "content",
    [CARET[:200], CARET.replace("<Caret", "<!DOCTYPE x><Caret", 1), "", CARET.replace("Key", "No")],
)
def test_a_table_that_cannot_be_read_names_nothing(tmp_path, content):
    assert label_names.read(with_extensions(tmp_path, (0, content.encode()))) == {}


def test_extensions_that_claim_other_sizes_name_nothing(tmp_path):
    path = with_extensions(tmp_path, (0, CARET.encode()), name="a.nii")
    content = bytearray(path.read_bytes())
    for size in (0, -16, 1 << 30):
        struct.pack_into("<i", content, 352, size)
        path.write_bytes(content)
        assert label_names.read(path) == {}


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.mha", "a.nrrd"])
def test_files_without_names_have_none(tmp_path, name):
    assert load_label_image(ones(tmp_path / name)).names == {}


def slicer(path, *segments):
    image = sitk.GetImageFromArray(np.full((3, 4, 5), 4, np.uint8))
    for k, (name, value, layer) in enumerate(segments):
        for key, said in (("Name", name), ("LabelValue", value), ("Layer", layer)):
            image.SetMetaData(f"Segment{k}_{key}", said)
    sitk.WriteImage(image, str(path))
    return path


def test_segments_of_slicer_name_their_numbers(tmp_path):
    path = slicer(tmp_path / "a.seg.nrrd", ("left femur", "4", "0"), ("Tibia", "9", "0"))
    assert load_label_image(path).names == {4: ("left femur",), 9: ("Tibia",)}


def test_segments_that_overlap_are_refused(tmp_path):
    with pytest.raises(LegsimError, match="segments of 2 layers"):
        load_label_image(slicer(tmp_path / "a.seg.nrrd", ("femur", "4", "0"), ("tibia", "4", "1")))


def test_names_of_one_number_are_all_read(tmp_path):
    """The image can be read by them, by a map that says which number is what."""
    twice = slicer(tmp_path / "a.seg.nrrd", ("femur", "4", "0"), ("tibia", "4", "0"))
    assert load_label_image(twice).names == {4: ("femur", "tibia")}
    tables = ((0, CARET.encode()), (30, CARET.replace("hip_right", "hip_left").encode()))
    found = load_label_image(with_extensions(tmp_path, *tables)).names
    assert found == {75: ("femur_left",), 78: ("hip_right", "hip_left")}
    with pytest.raises(LegsimError, match="78 has two names, hip_right and hip_left; say it"):
        label_names.unique(tmp_path, found, "say it")


def test_groups_of_labels_of_mitk_name_their_numbers(tmp_path):
    labels = [{"name": 'the "left" femur', "value": 4, "locked": True}, {"name": "b", "value": 2}]
    image = sitk.GetImageFromArray(np.full((3, 4, 5), 4, np.uint8))
    key = "org.mitk.multilabel.segmentation.labelgroups"
    image.SetMetaData(key, json.dumps([{"labels": labels}, {"labels": None}]))
    sitk.WriteImage(image, str(tmp_path / "a.nrrd"))
    assert label_names.read(tmp_path / "a.nrrd") == {4: ('the "left" femur',), 2: ("b",)}
