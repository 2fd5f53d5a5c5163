"""DICOM by pydicom: views with their angles, and what is refused."""

import builtins

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import dicom, projection_images

pydicom = pytest.importorskip("pydicom")


def written(path, values, **elements):
    """A multi-frame X-ray angiographic image."""
    data = pydicom.Dataset()
    data.file_meta = pydicom.dataset.FileMetaDataset()
    data.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = pydicom.uid.XRayAngiographicImageStorage
    data.file_meta.MediaStorageSOPInstanceUID = pydicom.uid.generate_uid()
    data.SOPClassUID = pydicom.uid.XRayAngiographicImageStorage
    data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID
    data.NumberOfFrames, data.Rows, data.Columns = values.shape
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated = data.BitsStored = 16
    data.HighBit, data.PixelRepresentation = 15, 0
    data.PixelData = values.tobytes()
    for name, value in elements.items():
        setattr(data, name, value)
    data.save_as(path, enforce_file_format=True)
    return path


@pytest.fixture
def values(rng):
    return rng.integers(0, 60000, (6, 5, 7)).astype(np.uint16)


def test_frames_pixels_and_angles_are_read(tmp_path, values):
    path = written(
        tmp_path / "x.dcm",
        values,
        ImagerPixelSpacing=[0.3, 0.4],
        PositionerPrimaryAngle=-100.0,
        PositionerPrimaryAngleIncrement=[0.0, 1.5, 3.0, 4.5, 6.0, 7.5],
    )
    found = dicom.read_projections(path)
    np.testing.assert_array_equal(found.values, values)
    assert found.values.dtype.kind == "u", "whole numbers stay counts"
    assert found.pixel_mm == (0.4, 0.3)
    assert found.angles_deg is not None
    np.testing.assert_allclose(found.angles_deg, -100 + 1.5 * np.arange(6))


def test_equal_increments_are_steps_from_frame_to_frame(tmp_path, values):
    path = written(
        tmp_path / "x.dcm",
        values,
        PositionerPrimaryAngle=10.0,
        PositionerPrimaryAngleIncrement=[0.0] + [1.5] * 5,
    )
    angles = dicom.read_projections(path).angles_deg
    assert angles is not None
    np.testing.assert_allclose(angles, 10 + 1.5 * np.arange(6))


def test_nearly_even_increments_of_three_frames_are_angles_from_the_first(tmp_path, values):
    path = written(
        tmp_path / "x.dcm",
        values[:3],
        PositionerPrimaryAngle=10.0,
        PositionerPrimaryAngleIncrement=[0.0, 1.0, 1.9],
    )
    angles = dicom.read_projections(path).angles_deg
    assert angles is not None
    np.testing.assert_allclose(angles, [10, 11, 11.9])


def test_values_are_rescaled_as_the_file_says(tmp_path, values):
    path = written(tmp_path / "x.dcm", values, RescaleSlope="0.0001", RescaleIntercept="-1")
    found = dicom.read_projections(path)
    np.testing.assert_allclose(found.values, 1e-4 * values - 1.0)
    assert "times 0.0001 plus -1" in found.notes[0]


def test_a_file_without_an_ending_is_known_by_its_mark(tmp_path, values):
    path = written(tmp_path / "IM0001", values)
    np.testing.assert_array_equal(projection_images.read_images(path).values, values)


def test_a_broken_file_and_a_missing_package_are_reported(tmp_path, values, monkeypatch):
    path = written(tmp_path / "x.dcm", values)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(LegsimError, match="holds no image that can be read"):
        dicom.read_projections(path)
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name == "pydicom":
            raise ModuleNotFoundError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(LegsimError, match=r"pip install 'legsim\[dicom\]'"):
        dicom.read_projections(path)


def test_files_of_a_series_are_taken_by_their_instance_numbers(tmp_path, values):
    """Names say nothing; the angles come along."""
    for name, k in (("c", 0), ("a", 1), ("b", 2)):
        written(
            tmp_path / f"{name}.dcm", values[k : k + 1], InstanceNumber=k + 9,
            SeriesInstanceUID="1.2.3", PositionerPrimaryAngle=10.0 + k,
        )  # fmt: skip
    found = projection_images.read_images(tmp_path)
    np.testing.assert_array_equal(found.values, values[:3])
    assert found.angles_deg is not None
    np.testing.assert_allclose(found.angles_deg, [10, 11, 12])
    written(tmp_path / "d.dcm", values[:1], InstanceNumber=9, SeriesInstanceUID="1.2.3")
    with pytest.raises(LegsimError, match="has the same instance number, 9, as"):
        projection_images.read_images(tmp_path)
    written(tmp_path / "d.dcm", values[:1], InstanceNumber=1, SeriesInstanceUID="1.2.4")
    with pytest.raises(LegsimError, match="holds 2 series"):
        projection_images.read_images(tmp_path)
    written(tmp_path / "d.dcm", values[:1])
    with pytest.raises(LegsimError, match="has no instance number"):
        projection_images.read_images(tmp_path)


@pytest.mark.parametrize(
    ("element", "value"),
    [
        (b"0.0001", b"0.00x1"),
        (b"0.0001", b"1e400\0"),
        (b"0.3\\0.4", b"0.3\\x.4"),
        (b"0.3\\0.4", b"0.3\\0.0"),
        (b"DS\x08\x000.3", b"D\x13\x08\x000.3"),  # a kind of element that does not exist
    ],
)
def test_elements_that_are_no_numbers_are_refused(tmp_path, values, element, value):
    path = written(tmp_path / "x.dcm", values, RescaleSlope="0.0001", ImagerPixelSpacing=[0.3, 0.4])
    path.write_bytes(path.read_bytes().replace(element, value))
    with pytest.raises(LegsimError, match=r"x\.dcm: (its rescaling|holds no image)"):
        dicom.read_projections(path)
