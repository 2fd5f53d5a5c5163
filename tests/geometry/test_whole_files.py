"""Image files that break off are refused, whatever their format; whole ones are read."""

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
