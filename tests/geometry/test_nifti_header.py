"""NIfTI files whose two statements of place contradict each other are refused."""

import struct

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import _nifti_header, image_files
from legsim.geometry.label_images import load_label_image

SROW, CODES = 280, 252
"""bytes at which the header has the matrix of sform, and both codes"""


@pytest.fixture
def written(tmp_path):
    """Writes an image along directions, with both forms; optionally another sform."""

    def write(direction=(1, 0, 0, 0, 1, 0, 0, 0, 1), sform=None, codes=(1, 1)):
        image = sitk.GetImageFromArray(np.ones((4, 5, 6), np.uint8))
        image.SetSpacing((2.0, 2.0, 3.0))
        image.SetDirection([float(x) for x in direction])
        path = tmp_path / "labels.nii"
        sitk.WriteImage(image, str(path))
        raw = bytearray(path.read_bytes())
        struct.pack_into("<hh", raw, CODES, *codes)
        if sform is not None:
            struct.pack_into("<12f", raw, SROW, *np.asarray(sform, float).ravel())
        path.write_bytes(raw)
        return path

    return write


@pytest.mark.parametrize(
    "direction",
    [
        (1, 0, 0, 0, 1, 0, 0, 0, 1),
        (0, 0, -1, -1, 0, 0, 0, 1, 0),
        (-1, 0, 0, 0, -1, 0, 0, 0, 1),
        (1, 0, 0, 0, 1, 0, 0, 0, -1),  # left-handed
        (0.8, 0.6, 0, -0.6, 0.8, 0, 0, 0, 1),
    ],
)
def test_what_itk_writes_is_not_doubted(written, direction):
    assert load_label_image(written(direction)).labels.shape == (4, 5, 6)


@pytest.mark.parametrize(
    "sform",
    [
        [[-2, 0, 0, 0], [0, -2, 0, 0], [0, 0, 6, 0]],  # another spacing
        [[2, 0, 0, 0], [0, -2, 0, 0], [0, 0, 3, 0]],  # left and right exchanged
        [[0, -2, 0, 0], [-2, 0, 0, 0], [0, 0, 3, 0]],  # two axes exchanged
    ],
)
def test_forms_that_contradict_each_other_are_refused(written, sform):
    path = written(sform=sform)
    with pytest.raises(LegsimError, match=r"labels.nii: its qform and its sform"):
        load_label_image(path)
    with pytest.raises(LegsimError, match=r"qform and its sform"):
        image_files.load_volume(path)


@pytest.mark.parametrize(("shift", "refused"), [(0.4, False), (20.0, True)])
def test_forms_that_are_a_shift_apart_are_refused(written, shift, refused):
    path = written(sform=[[-2, 0, 0, shift], [0, -2, 0, 0], [0, 0, 3, 0]])
    if refused:
        with pytest.raises(LegsimError, match=r"qform and its sform place the voxels 20 mm apart"):
            load_label_image(path)
    else:
        assert load_label_image(path).labels.all()


def test_a_form_that_is_not_set_contradicts_nothing(written):
    assert load_label_image(written(sform=np.zeros((3, 4)), codes=(1, 0))).labels.all()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_sense_of_the_third_axis_is_read_of_both_versions(tmp_path, order, sense):
    """pixdim[0]: a float at byte 76 of NIfTI-1, a double at byte 104 of NIfTI-2."""
    for size, place, kind in ((348, 76, "f"), (540, 104, "d")):
        head = bytearray(size)
        struct.pack_into(f"{order}i", head, 0, size)
        struct.pack_into(f"{order}{kind}", head, place, sense)
        path = tmp_path / "a.nii"
        path.write_bytes(head)
        assert _nifti_header._sense(path) == sense


@pytest.mark.parametrize(("place", "code"), [(268, 252), (280 + 12, 254)])
@pytest.mark.parametrize("number", [np.inf, np.nan])
def test_offsets_that_are_not_finite_are_refused(written, place, code, number):
    """qoffset_x and the last of srow_x; ITK takes such an offset for 0."""
    path = written(sform=[[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 3, 0]], codes=(1, 1))
    content = bytearray(path.read_bytes())
    struct.pack_into("<f", content, place, number)
    struct.pack_into("<h", content, 252 + 254 - code, 0)
    path.write_bytes(content)
    with pytest.raises(LegsimError, match=r"labels.nii: .*(not finite|axes are not)"):
        image_files.load_volume(path)


def test_a_matrix_of_another_spacing_than_stated_is_refused(written):
    """ITK would place the voxels by the spacing, others by the matrix."""
    doubled = 2 * np.array([[-2, 0, 0, 0], [0, -2, 0, 0], [0, 0, 3, 0]])
    with pytest.raises(
        LegsimError, match="voxels of 2, 2, 3 by pixdim, and of 4, 4, 6 by its sform"
    ):
        load_label_image(written(sform=doubled, codes=(0, 1)))


@pytest.mark.parametrize(
    ("pixdim", "spacing", "read"),
    [
        ((0, 0, 0), (1, 1, 1), True),
        ((2, 2, 0), (2, 2, 1), True),
        ((0, 2, 3), (2, 2, 3), False),
        ((2, 2, -3), (2, 2, 3), False),
        ((-1, -1, -1), (1, 1, 1), False),
    ],
)
def test_spacings_of_0_or_less_are_read_where_itk_takes_the_matrix(written, pixdim, spacing, read):
    """ITK takes 0 for 1, and mirrors an axis whose spacing is negative."""
    matrix = np.diag([*spacing, 1.0])[:3] * [[-1], [-1], [1]]
    path = written(sform=matrix, codes=(0, 1))
    content = bytearray(path.read_bytes())
    struct.pack_into("<3f", content, 80, *pixdim)
    path.write_bytes(content)
    if not read:
        with pytest.raises(LegsimError, match="by pixdim, and of"):
            load_label_image(path)
        found = sitk.ReadImage(str(path))
        right = np.diag(found.GetDirection()[::4]) @ np.diag(found.GetSpacing())
        assert not np.allclose(right, np.diag(spacing)), "what ITK alone makes of it"
        return
    image = sitk.ReadImage(str(path))
    assert image.GetDirection() == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert image.GetSpacing() == spacing
    assert load_label_image(path).labels.all()
