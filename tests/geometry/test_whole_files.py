"""Image files that break off are refused, whatever their format; whole ones are read."""

import gzip
import locale
import struct
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import image_files


@pytest.fixture
def values(rng):
    return rng.integers(1, 60000, (24, 26, 28)).astype(np.float32)


def written(path: Path, values: np.ndarray) -> Path:
    sitk.WriteImage(sitk.GetImageFromArray(values), str(path), path.suffix == ".gz")
    return path


@pytest.mark.parametrize("share", [0.6, 0.9999])
@pytest.mark.parametrize(
    "name",
    ["v.nii", "v.nii.gz", "v.mha", "v.nrrd", "v.hdr", "v.gipl", "v.gipl.gz", "v.mrc"],
)
def test_what_breaks_off_is_refused(tmp_path, values, name, share):
    path = written(tmp_path / name, values)
    np.testing.assert_array_equal(image_files.read_stored(path)[0], values)
    data = path.with_suffix(".img") if path.suffix == ".hdr" else path
    content = data.read_bytes()
    data.write_bytes(content[: int(share * len(content))])
    for read in (image_files.read_stored, image_files.load_volume, image_files.read_samples):
        with pytest.raises(LegsimError, match="write or copy it again"):
            read(path)


def test_compressed_content_that_is_damaged_is_refused(tmp_path, values):
    """The last bytes are the checksum and the length."""
    path = written(tmp_path / "v.nii.gz", values)
    content = bytearray(path.read_bytes())
    content[-6] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(LegsimError, match=r"cannot be read to its end|not an image"):
        image_files.read_stored(path)


def test_plain_content_under_a_compressed_name_is_read(tmp_path, values):
    path = written(tmp_path / "v.nii", values).rename(tmp_path / "v.nii.gz")
    np.testing.assert_array_equal(image_files.read_stored(path)[0], values)


@pytest.mark.parametrize("name", ["v.gipl", "v.mrc", "v.vtk", "v.hdr"])
def test_whole_files_are_read_whatever_their_kind(tmp_path, values, name):
    path = written(tmp_path / name, values)
    before = locale.setlocale(locale.LC_ALL)
    np.testing.assert_array_equal(image_files.read_samples(path)[0], values)
    # ITK's reader of .vtk leaves the locale "C", in which Python reads text as ASCII
    assert locale.setlocale(locale.LC_ALL) == before


def test_a_header_in_capitals_has_its_values_beside_it(tmp_path, values):
    path = written(tmp_path / "v.hdr", values).rename(tmp_path / "v.HDR")
    (tmp_path / "v.img").rename(tmp_path / "v.IMG")
    np.testing.assert_array_equal(image_files.read_stored(path)[0], values)


def test_values_written_as_text_may_be_shorter(tmp_path):
    path = tmp_path / "v.vtk"
    path.write_text(
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 4 5 6\n"
        "SPACING 1 1 1\nORIGIN 0 0 0\nPOINT_DATA 120\nSCALARS s int 1\nLOOKUP_TABLE default\n"
        + "\n".join(["1 2 3 4"] * 30)
        + "\n"
    )
    assert image_files.read_samples(path)[0].sum() == 300


@pytest.mark.parametrize("offset", [np.nan, np.inf])
def test_an_offset_that_is_no_number_is_refused(tmp_path, values, offset):
    path = written(tmp_path / "v.nii", values)
    content = bytearray(path.read_bytes())
    content[108:112] = np.float32(offset).tobytes()
    path.write_bytes(content)
    with pytest.raises(LegsimError) as error:
        image_files.read_stored(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_nifti_2_is_refused_as_such(tmp_path, name):
    content = struct.pack("<i8s", 540, b"n+2\0\r\n\x1a\n") + bytes(600)
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    with pytest.raises(
        LegsimError, match="is NIfTI-2, which ITK does not read; write it as NIfTI-1"
    ):
        image_files.load_volume(tmp_path / name)


def test_freesurfers_volumes_are_refused_as_such(tmp_path):
    (tmp_path / "aseg.mgz").write_bytes(gzip.compress(bytes(300)))
    with pytest.raises(LegsimError, match=r"is FreeSurfer's; write it as \.nii\.gz"):
        image_files.load_volume(tmp_path / "aseg.mgz")
