"""DICOM by pydicom: views with their angles, and what is refused."""

import builtins

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import dicom, projection_images
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.counts import Counts

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


@pytest.mark.parametrize(("stated", "read"), [(1198.0, 1198.0), (None, None), (0.0, None)])
def test_the_distance_to_the_detector_is_read(tmp_path, values, stated, read):
    path = written(tmp_path / "x.dcm", values, DistanceSourceToDetector=stated)
    assert dicom.read_projections(path).detector_mm == read


def test_distances_that_differ_by_frame_are_none(tmp_path, values):
    def of_frame(distance):
        inner, group = pydicom.Dataset(), pydicom.Dataset()
        inner.DistanceSourceToDetector = distance
        group.XRayGeometrySequence = [inner]
        return group

    for distances, read in (([1100.0] * 6, 1100.0), ([1100.0, 1150.0] * 3, None)):
        groups = [of_frame(distance) for distance in distances]
        path = written(tmp_path / "x.dcm", values, PerFrameFunctionalGroupsSequence=groups)
        assert dicom.read_projections(path).detector_mm == read


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


def test_a_file_without_an_image_is_said_to_be_a_report(tmp_path, values):
    path = written(tmp_path / "x.dcm", values)
    data = pydicom.dcmread(path)
    del data.PixelData
    data.save_as(path)
    with pytest.raises(LegsimError, match="give the files of the images: this one is a report"):
        projection_images.read_images(path)


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


def rt_image(path, values, **elements):
    """A view of a treatment machine's imager, as of its image plane."""
    plane = {"RadiationMachineSAD": 1000.0, "RTImageSID": 1500.0, "GantryAngle": 358.0}
    stated = plane | {"ImagePlanePixelSpacing": [0.3, 0.4], "Modality": "RTIMAGE"} | elements
    return written(path, values[:1], **{k: v for k, v in stated.items() if v is not None})


def test_an_rt_images_pixels_are_the_detectors_unless_its_plane_is_the_isocenters(tmp_path, values):
    found = dicom.read_projections(rt_image(tmp_path / "a.dcm", values))
    assert found.pixel_mm == (0.4, 0.3)
    assert "1500 mm from the source" in found.notes[0]
    for name, elements, said in (
        ("b", {"RTImageSID": 1000.0}, "in the plane of the isocenter, not on the detector"),
        ("c", {"RTImageSID": None}, "in a plane whose distance is not stated"),
    ):
        found = dicom.read_projections(rt_image(tmp_path / f"{name}.dcm", values, **elements))
        assert found.pixel_mm is None
        assert said in found.notes[0]


def test_an_empty_angle_of_the_positioner_does_not_hide_the_gantrys(tmp_path, values):
    path = rt_image(tmp_path / "a.dcm", values, PositionerPrimaryAngle="")
    angles = dicom.read_projections(path).angles_deg
    assert angles is not None
    np.testing.assert_allclose(angles, [358.0])


def test_gantry_angles_are_the_views_and_go_on_beyond_a_turn(tmp_path, values):
    for k, angle in enumerate((358.0, 359.5, 1.0)):
        path = tmp_path / f"{k}.dcm"
        rt_image(path, values, GantryAngle=angle, InstanceNumber=k, SeriesInstanceUID="1.2")
    found = projection_images.read_images(tmp_path)
    assert found.angles_deg is not None
    np.testing.assert_allclose(found.angles_deg, [358.0, 359.5, 361.0])


@pytest.mark.parametrize(
    ("element", "value"),
    [
        (b"0.0001", b"0.00x1"),
        (b"0.0001", b"1e400\0"),
        (b"0.3\\0.4", b"0.3\\x.4"),
        (b"0.3\\0.4", b"0.3\\0.0"),
        (b"DS\x08\x000.3", b"D\x13\x08\x000.3"),  # a kind of element that does not exist
        (b"(\0\x02\x01US", b"(\0\x02\x01U\x13"),  # the same, of the highest bit
    ],
)
def test_elements_that_are_no_numbers_are_refused(tmp_path, values, element, value):
    path = written(tmp_path / "x.dcm", values, RescaleSlope="0.0001", ImagerPixelSpacing=[0.3, 0.4])
    path.write_bytes(path.read_bytes().replace(element, value))
    with pytest.raises(LegsimError, match=r"x\.dcm: (its rescaling|holds no image)"):
        dicom.read_projections(path)


def rescaled_group(slope, intercept):
    """A functional group that rescales frames."""
    inner, group = pydicom.Dataset(), pydicom.Dataset()
    inner.RescaleSlope, inner.RescaleIntercept, inner.RescaleType = slope, intercept, "US"
    group.PixelValueTransformationSequence = pydicom.Sequence([inner])
    return group


def test_frames_are_rescaled_by_groups_of_all_or_of_each(tmp_path, values):
    shared = pydicom.Sequence([rescaled_group(2, -1)])
    found = dicom.read_projections(
        written(tmp_path / "x.dcm", values, SharedFunctionalGroupsSequence=shared)
    )
    np.testing.assert_array_equal(found.values, 2.0 * values - 1)
    each = pydicom.Sequence([rescaled_group(k + 1, -k) for k in range(len(values))])
    path = written(
        tmp_path / "x.dcm", values,
        SharedFunctionalGroupsSequence=shared, PerFrameFunctionalGroupsSequence=each,
    )  # fmt: skip
    found = dicom.read_projections(path)
    k = np.arange(len(values))[:, None, None]
    np.testing.assert_array_equal(found.values, (k + 1.0) * values - k)
    assert "times 1 to 6 plus -5 to 0" in found.notes[0]
    few = pydicom.Sequence(list(each)[:2])
    with pytest.raises(LegsimError, match="2 frames rescaled"):
        dicom.read_projections(
            written(tmp_path / "x.dcm", values, PerFrameFunctionalGroupsSequence=few)
        )


def test_files_of_a_series_have_rescalings_of_their_own(tmp_path, values):
    """The one whose slope is 1 holds whole numbers."""
    for k in range(6):
        written(
            tmp_path / f"{k}.dcm", values[k : k + 1], InstanceNumber=k, SeriesInstanceUID="1.2",
            RescaleSlope=f"{1 + k}", RescaleIntercept="0",
        )  # fmt: skip
    found = projection_images.read_images(tmp_path)
    np.testing.assert_array_equal(found.values, np.arange(1, 7)[:, None, None] * values)
    assert found.notes[-1] == "and 2 more notes"


def test_values_that_a_table_or_bits_shift_are_refused(tmp_path, values):
    table = pydicom.Dataset()
    table.LUTDescriptor, table.ModalityLUTType, table.LUTData = [2, 0, 16], "US", b"\0\0\1\0"
    path = written(tmp_path / "x.dcm", values, ModalityLUTSequence=pydicom.Sequence([table]))
    with pytest.raises(LegsimError, match=r"by a table \(Modality LUT\)"):
        dicom.read_projections(path)
    path = written(tmp_path / "x.dcm", values, BitsStored=12, HighBit=15)
    with pytest.raises(LegsimError, match="12 bits up to bit 15"):
        dicom.read_projections(path)


@pytest.mark.parametrize(
    ("elements", "said"),
    [
        ({}, ""),
        ({"PixelIntensityRelationship": "LIN", "PixelIntensityRelationshipSign": 1}, ""),
        ({"PixelIntensityRelationship": ""}, ""),
        ({"HighBit": None, "RescaleSlope": None, "RescaleIntercept": None}, ""),
        ({"PixelIntensityRelationship": "LOG"}, "not linear in intensity"),
        ({"PixelIntensityRelationshipSign": -1}, "fall where intensity rises"),
    ],
)
def test_a_file_says_whether_its_values_are_counts(tmp_path, values, elements, said):
    found = dicom.read_projections(written(tmp_path / "x.dcm", values, **elements))
    assert said in found.no_counts
    assert bool(said) == bool(found.no_counts)


def test_other_files_in_a_folder_of_a_series_are_left_out(tmp_path, values):
    for k in range(2):
        written(tmp_path / f"IM{k}", values[k : k + 1], InstanceNumber=k)
    written(tmp_path / "DICOMDIR", values)
    (tmp_path / "README").write_text("made by a scanner")
    found = projection_images.read_images(tmp_path)
    np.testing.assert_array_equal(found.values, values[:2])
    assert found.notes == ("not images, left out: DICOMDIR, README",)


def test_a_file_without_preamble_is_refused_with_the_fix(tmp_path, values):
    path = written(tmp_path / "x.dcm", values)
    path.write_bytes(path.read_bytes()[132:])
    with pytest.raises(LegsimError, match="has no preamble of DICOM files; write it as one"):
        dicom.read_projections(path)


def test_images_that_are_no_counts_are_doubted_where_they_are_taken_for_some(tmp_path, values):
    path = written(tmp_path / "x.dcm", values + 1, PixelIntensityRelationship="LOG")
    matrices = np.tile([[1.0, 0, 3, 0], [0, 1, 2, 0], [0, 0, 1, 1]], (6, 1, 1))
    geometry = ConeBeamGeometry(np.arange(6.0), matrices, values.shape[1:])
    _, notes = projection_images.read_projections(path, geometry, counts=Counts(i0=60000.0))
    assert any(n.startswith("In doubt: the images say that their values are not") for n in notes)


def frame_group(**elements):
    """A group of an enhanced image: the detector's pixel, and the positioner's angle."""
    group = pydicom.Dataset()
    sequences = {
        "ImagerPixelSpacing": "FramePixelDataPropertiesSequence",
        "PositionerPrimaryAngle": "PositionerPositionSequence",
    }
    for name, value in elements.items():
        inner = pydicom.Dataset()
        setattr(inner, name, value)
        setattr(group, sequences[name], pydicom.Sequence([inner]))
    return group


def test_frames_of_enhanced_images_state_pixels_and_angles_in_groups(tmp_path, values):
    shared = pydicom.Sequence([frame_group(ImagerPixelSpacing=[0.3, 0.4])])
    angles = [-20.0, -12.0, 3.0, 14.5, 30.0, 41.0]
    each = pydicom.Sequence([frame_group(PositionerPrimaryAngle=angle) for angle in angles])
    groups = {
        "SharedFunctionalGroupsSequence": shared,
        "PerFrameFunctionalGroupsSequence": each,
    }
    found = dicom.read_projections(written(tmp_path / "x.dcm", values, **groups))
    assert found.pixel_mm == (0.4, 0.3)
    assert found.angles_deg is not None
    np.testing.assert_allclose(found.angles_deg, angles)
    del each[2].PositionerPositionSequence
    found = dicom.read_projections(written(tmp_path / "x.dcm", values, **groups))
    assert found.angles_deg is None
    each[1].FramePixelDataPropertiesSequence = frame_group(
        ImagerPixelSpacing=[0.3, 0.3]
    ).FramePixelDataPropertiesSequence
    with pytest.raises(LegsimError, match="pixels of several sizes"):
        dicom.read_projections(written(tmp_path / "x.dcm", values, **groups))


def test_slices_that_lie_in_a_patient_are_no_projections(tmp_path, values):
    path = written(
        tmp_path / "x.dcm",
        values,
        Modality="CT",
        ImagePositionPatient=[0, 0, 30],
        ImageOrientationPatient=[1, 0, 0, 0, 1, 0],
    )
    with pytest.raises(LegsimError, match=r"slice that lies in the patient \(CT\), no projection"):
        dicom.read_projections(path)


def test_enhanced_slices_keep_their_places_in_groups(tmp_path, values):
    def placed(*heights, **elements):
        groups = []
        for height in heights:
            inner, group = pydicom.Dataset(), pydicom.Dataset()
            inner.ImagePositionPatient = [0, 0, height]
            group.PlanePositionSequence = pydicom.Sequence([inner])
            groups.append(group)
        each = {"PerFrameFunctionalGroupsSequence": pydicom.Sequence(groups)}
        return dicom.read_projections(written(tmp_path / "x.dcm", values, **each, **elements))

    with pytest.raises(LegsimError, match=r"lies in the patient \(CT\)"):
        placed(*range(6), Modality="CT")
    with pytest.raises(LegsimError, match=r"lies in the patient \(no modality\)"):
        placed(*range(6))
    with pytest.raises(LegsimError, match=r"lies in the patient \(RF\)"):
        placed(*6 * [0], Modality="RF", SOPClassUID=pydicom.uid.EnhancedCTImageStorage)
    np.testing.assert_array_equal(placed(*6 * [0], Modality="RF").values, values)


def test_captured_views_whose_place_is_0_are_views(tmp_path, values):
    place = {"ImagePositionPatient": [0, 0, 0], "ImageOrientationPatient": [1, 0, 0, 0, 1, 0]}
    found = dicom.read_projections(written(tmp_path / "x.dcm", values, Modality="RF", **place))
    np.testing.assert_array_equal(found.values, values)
    with pytest.raises(LegsimError, match=r"lies in the patient \(MR\)"):
        dicom.read_projections(written(tmp_path / "x.dcm", values, Modality="MR", **place))
