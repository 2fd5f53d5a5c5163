"""Segmentations stand where the patient does: whatever the file's axes, world has its own."""

import gzip

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.label_images import load_label_image

STRAIGHT = np.eye(3)


def image(labels=None, *, spacing=(1.0, 2.0, 3.0), origin=(0, 0, 0), direction=STRAIGHT):
    if labels is None:
        labels = np.zeros((4, 5, 6), np.uint8)
        labels[3, 1, 2] = 7
    made = sitk.GetImageFromArray(labels)
    made.SetSpacing(spacing)
    made.SetOrigin([float(x) for x in origin])
    made.SetDirection(np.asarray(direction, float).ravel().tolist())
    return made


def place(loaded) -> np.ndarray:
    """World (3,) mm of the voxel that is 7."""
    k, j, i = np.argwhere(loaded.labels == 7)[0]
    return 1e3 * transforms.apply(loaded.world_from_index, np.array([[i, j, k]], float))[0]


@pytest.mark.parametrize("ending", ["nii.gz", "nrrd", "mha"])
def test_left_posterior_superior_become_front_up_and_right(tmp_path, ending):
    sitk.WriteImage(image(origin=(10, 20, 30)), str(tmp_path / f"a.{ending}"))
    # ITK has it at (10 + 2, 20 + 2, 30 + 9): mm to the left, behind, above
    found = place(load_label_image(tmp_path / f"a.{ending}"))
    np.testing.assert_allclose(found, (-22, 39, -12), atol=1e-4)


def test_the_axes_of_the_file_do_not_matter(tmp_path):
    plain = image(origin=(10, 20, 30))
    turned = sitk.DICOMOrient(plain, "ASR")
    for name, one in (("plain", plain), ("turned", turned)):
        sitk.WriteImage(one, str(tmp_path / f"{name}.nrrd"))
    first, second = (load_label_image(tmp_path / f"{n}.nrrd") for n in ("plain", "turned"))
    assert first.labels.shape != second.labels.shape
    np.testing.assert_allclose(place(first), place(second), atol=1e-4)


def test_an_oblique_image_keeps_its_direction(tmp_path):
    tilt = transforms.rotation_from_vector(np.array([0.3, -0.2, 0.5]))
    sitk.WriteImage(image(direction=tilt), str(tmp_path / "a.nrrd"))
    loaded = load_label_image(tmp_path / "a.nrrd")
    x, y, z = tilt @ (2 * 1.0, 1 * 2.0, 3 * 3.0)
    np.testing.assert_allclose(place(loaded), (-y, z, -x), atol=1e-4)
    np.testing.assert_allclose(1e3 * loaded.spacing, (1, 2, 3), atol=1e-6)


def test_files_in_world_are_not_turned(tmp_path):
    sitk.WriteImage(image(origin=(10, 20, 30)), str(tmp_path / "a.mha"))
    found = place(load_label_image(tmp_path / "a.mha", axes="world"))
    np.testing.assert_allclose(found, (12, 22, 39), atol=1e-4)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (image(np.full((3, 3, 3), 0.5, np.float32)), "no whole numbers"),
        (image(np.full((3, 3, 3), -1, np.int16)), "from -1 to -1"),
        (image(np.zeros((3, 3, 3), np.uint8)), "from 0 to 0"),
        (image(spacing=(0.001, 0.001, 0.001)), "fix the unit"),
    ],
)
def test_what_is_no_segmentation_is_refused(tmp_path, made, words):
    sitk.WriteImage(made, str(tmp_path / "a.nrrd"))
    with pytest.raises(LegsimError, match=words) as caught:
        load_label_image(tmp_path / "a.nrrd")
    assert "a.nrrd" in str(caught.value)


def test_grids_are_the_same_to_a_hundredth_of_a_voxel(tmp_path):
    for name, x in (("a", 0.0), ("b", 0.005), ("c", 0.05)):
        sitk.WriteImage(image(origin=(x, 0, 0)), str(tmp_path / f"{name}.nrrd"))
    a, b, c = (load_label_image(tmp_path / f"{name}.nrrd") for name in "abc")
    assert a.on_grid_of(b)
    assert not a.on_grid_of(c)


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (2**31 - 1, np.int32, "holds the number 2147483647"),
        (np.nan, np.float32, "no whole numbers"),
    ],
)
def test_numbers_that_no_structure_has_are_refused(tmp_path, number, kind, said):
    labels = np.zeros((4, 5, 6), kind)
    labels[1, 2, 3], labels[0, 0, 0] = number, 1
    sitk.WriteImage(image(labels), str(tmp_path / "a.mha"))
    with pytest.raises(LegsimError, match=said):
        load_label_image(tmp_path / "a.mha")


@pytest.mark.parametrize(
    ("said", "wrong", "words"),
    [
        ("DimSize = 6 5 4", "DimSize = 0 5 4", r"a\.mha: has a size of \(0, 5, 4\): no pixels"),
        ("1 0 0 0 1 0", "1 0 0 0.1 1 0", r"a\.mha: its axes are not at right angles"),
        ("1 0 0 0 1 0", "1 0 nan 0 1 0", r"a\.mha: its axes are not at right angles"),
        ("1 0 0 0 1 0", "1e300 0 0 0 1 0", r"a\.mha: its first voxel .* its axes along \(1e\+300"),
    ],
)
def test_what_has_no_voxels_or_no_directions_is_refused(tmp_path, said, wrong, words):
    sitk.WriteImage(image(), str(tmp_path / "a.mha"))
    text = (tmp_path / "a.mha").read_bytes()
    assert said.encode() in text
    (tmp_path / "a.mha").write_bytes(text.replace(said.encode(), wrong.encode()))
    with pytest.raises(LegsimError, match=words):
        load_label_image(tmp_path / "a.mha")


@pytest.mark.parametrize("number", [np.nan, 3e38])
def test_a_first_voxel_that_is_nowhere_is_refused(tmp_path, number):
    sitk.WriteImage(image(), str(tmp_path / "a.nii"))
    data = bytearray((tmp_path / "a.nii").read_bytes())
    for place in (276, 324):  # qoffset_z, the last number of srow_z
        data[place : place + 4] = np.float32(number).tobytes()
    (tmp_path / "a.nii").write_bytes(data)
    with pytest.raises(
        LegsimError, match=r"a\.nii: .*(first voxel is at .*finite numbers|not finite)"
    ):
        load_label_image(tmp_path / "a.nii")


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.nhdr", "a.mha", "a.mhd"])
def test_files_that_state_their_directions_are_not_doubted(tmp_path, name):
    sitk.WriteImage(image(), str(tmp_path / name))
    assert load_label_image(tmp_path / name).remarks == ()


def test_files_that_state_no_directions_are_doubted(tmp_path):
    sitk.WriteImage(image(), str(tmp_path / "a.nii"))
    content = bytearray((tmp_path / "a.nii").read_bytes())
    content[252:256] = bytes(4)  # the codes of qform and sform
    (tmp_path / "a.nii").write_bytes(content)
    sitk.WriteImage(image(), str(tmp_path / "a.nhdr"))
    lines = (tmp_path / "a.nhdr").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("space", "kinds"))]
    (tmp_path / "a.nhdr").write_text("\n".join(kept) + "\n\n")
    sitk.WriteImage(image(), str(tmp_path / "a.tif"))
    for name in ("a.nii", "a.nhdr", "a.tif"):
        (remark,) = load_label_image(tmp_path / name).remarks
        assert f"{name} does not state the directions" in remark
        assert "left, posterior, superior" in remark


def test_numbers_that_scaling_left_beside_whole_ones_are_rounded(tmp_path):
    labels = np.zeros((4, 5, 6), np.float32)
    labels[3, 1, 2] = 7.002
    sitk.WriteImage(image(labels), str(tmp_path / "a.nrrd"))
    loaded = load_label_image(tmp_path / "a.nrrd")
    np.testing.assert_array_equal(loaded.labels, np.rint(labels))
    assert any("0.002 off whole numbers" in line for line in loaded.remarks)


def test_a_space_of_no_patient_is_doubted(tmp_path):
    sitk.WriteImage(image(), str(tmp_path / "a.nrrd"))
    raw = (tmp_path / "a.nrrd").read_bytes()
    (tmp_path / "a.nrrd").write_bytes(raw.replace(b"left-posterior-superior", b"scanner-xyz"))
    assert any("In doubt" in line for line in load_label_image(tmp_path / "a.nrrd").remarks)


@pytest.mark.parametrize("packed", [False, True])
def test_the_header_beside_packed_voxels_states_their_directions(tmp_path, packed):
    image = sitk.GetImageFromArray(np.ones((4, 5, 6), np.uint8))
    sitk.WriteImage(image, str(tmp_path / "a.img"))
    for name in ("a.img", "a.hdr") if packed else ():
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress((tmp_path / name).read_bytes()))
        (tmp_path / name).unlink()
    assert load_label_image(tmp_path / ("a.img.gz" if packed else "a.img")).remarks == ()


@pytest.mark.parametrize("size", [0, 10, 348])
def test_a_packed_header_that_was_left_beside_another_says_nothing(tmp_path, size):
    image = sitk.GetImageFromArray(np.ones((4, 5, 6), np.uint8))
    sitk.WriteImage(image, str(tmp_path / "a.img"))
    (tmp_path / "a.hdr.gz").write_bytes(gzip.compress(bytes(size)))
    assert load_label_image(tmp_path / "a.img").remarks == ()


def test_a_header_in_capitals_states_directions_too(tmp_path):
    image = sitk.GetImageFromArray(np.ones((4, 5, 6), np.uint8))
    sitk.WriteImage(image, str(tmp_path / "a.img"))
    for name in ("a.img", "a.hdr"):
        (tmp_path / name).rename(tmp_path / name.upper())
    assert load_label_image(tmp_path / "A.IMG").remarks == ()


def test_a_dicom_file_is_no_volume(tmp_path):
    """ITK reads the frames of a DICOM segmentation, one structure's after another's, as slices."""
    path = tmp_path / "segments.dcm"
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((3, 4, 5), np.uint8)), str(path))
    with pytest.raises(LegsimError, match=r"one DICOM file.*segmentation as NRRD or NIfTI"):
        load_label_image(path)


def test_a_folder_of_masks_is_refused_as_one(tmp_path):
    with pytest.raises(LegsimError, match="is a folder; give the segmentations in it"):
        load_label_image(tmp_path)


def test_voxels_are_counted_by_number(tmp_path):
    labels = np.zeros((4, 5, 6), np.uint8)
    labels[1:, 2, 3], labels[0, 0, :2] = 7, 3
    sitk.WriteImage(image(labels), str(tmp_path / "a.nrrd"))
    loaded = load_label_image(tmp_path / "a.nrrd")
    assert loaded.numbers == (3, 7)
    assert loaded.counts.tolist() == [115, 0, 0, 2, 0, 0, 0, 3]
