"""A CT series: ITK's reader finds every voxel at its place, in Hounsfield units."""

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import ct_series
from legsim.geometry.volume import Volume, VolumeGrid

pydicom = pytest.importorskip("pydicom")

WATER = 20.6


def some_volume(rng, top=60.0):
    grid = VolumeGrid((5, 7, 6), (0.7e-3, 0.9e-3, 1.1e-3), (0.1, 0.45, -0.083))
    return Volume(grid, rng.uniform(-1, top, grid.shape_zyx).astype(np.float32))


def read(folder):
    reader = sitk.ImageSeriesReader()
    names = reader.GetGDCMSeriesFileNames(str(folder))
    reader.SetFileNames(names)
    return reader.Execute()


@pytest.mark.parametrize("top", [60.0, 900.0])
def test_itk_finds_every_voxel_in_hounsfield_units(tmp_path, rng, top):
    volume = some_volume(rng, top)
    ct_series.save(tmp_path / "ct", volume, water=WATER)
    image = read(tmp_path / "ct")
    assert image.GetSize() == (5, 6, 7), "left, posterior, superior"
    np.testing.assert_allclose(image.GetSpacing(), (1.1, 0.7, 0.9), rtol=1e-6)
    assert image.GetDirection() == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    anterior, superior, right = volume.grid.axes()
    slope = 1.0 if top < 600 else 1000 * (top / WATER) / 32767
    for k, j, i in np.ndindex(volume.grid.shape_zyx):
        place = (-1e3 * right[k], -1e3 * anterior[i], 1e3 * superior[j])
        index = image.TransformPhysicalPointToIndex(place)
        np.testing.assert_allclose(image.TransformIndexToPhysicalPoint(index), place, atol=1e-4)
        expected = 1000 * (volume.attenuation[k, j, i] / WATER - 1)
        assert image[index] == pytest.approx(expected, abs=0.51 * max(1, slope))


def test_a_series_holds_no_person_and_is_the_same_each_time(tmp_path, rng):
    volume = some_volume(rng)
    paths = ct_series.save(tmp_path / "a", volume, water=WATER)
    again = ct_series.save(tmp_path / "b", volume, water=WATER)
    assert [p.read_bytes() for p in paths] == [p.read_bytes() for p in again]
    headers = [pydicom.dcmread(path) for path in paths]
    assert len({h.SOPInstanceUID for h in headers}) == len(paths) == 7
    assert len({(h.SeriesInstanceUID, h.StudyInstanceUID) for h in headers}) == 1
    assert {str(h.PatientName) for h in headers} == {""}
    assert headers[0].PatientIdentityRemoved == "YES"
    assert headers[0].DerivationDescription == "HU with water at 0.0206/mm"


def test_refusals(tmp_path, rng):
    volume = some_volume(rng)
    ct_series.save(tmp_path / "a", volume, water=WATER)
    with pytest.raises(LegsimError, match="holds DICOM files already"):
        ct_series.save(tmp_path / "a", volume, water=WATER)
    with pytest.raises(LegsimError, match="must be positive"):
        ct_series.save(tmp_path / "b", volume, water=0.0)
    (tmp_path / "file").touch()
    with pytest.raises(LegsimError, match="cannot be made"):
        ct_series.save(tmp_path / "file" / "c", volume, water=WATER)
