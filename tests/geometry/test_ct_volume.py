"""A CT series becomes the volume that it was, whatever its order, names and directions."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import ct_series, ct_volume
from legsim.geometry.volume import Volume, VolumeGrid

pydicom = pytest.importorskip("pydicom")

WATER = 20.6


def some_volume(rng, top=60.0):
    grid = VolumeGrid((5, 7, 6), (0.7e-3, 0.9e-3, 1.1e-3), (0.1, 0.45, -0.083))
    return Volume(grid, rng.uniform(-1, top, grid.shape_zyx).astype(np.float32))


def saved(folder, rng, top=60.0):
    volume = some_volume(rng, top)
    return volume, ct_series.save(folder, volume, water=WATER)


def changed(path, **elements):
    data = pydicom.dcmread(path)
    for name, value in elements.items():
        if value is None:
            delattr(data, name)
        else:
            setattr(data, name, value)
    data.save_as(path)


def replaced(path, old, new):
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))


@pytest.mark.parametrize("top", [60.0, 900.0])
def test_a_written_series_is_read_back_within_half_a_step(tmp_path, rng, top):
    volume, paths = saved(tmp_path / "ct", rng, top)
    found = ct_volume.load(tmp_path / "ct", water=WATER)
    assert found.notes == ()
    assert found.volume.grid.alike(volume.grid)
    step = float(pydicom.dcmread(paths[0]).RescaleSlope)
    off = np.abs(found.volume.attenuation - volume.attenuation).max()
    assert off <= 0.5005 * step * WATER / 1000


def test_names_and_numbers_do_not_matter(tmp_path, rng):
    volume, paths = saved(tmp_path / "ct", rng)
    expected = ct_volume.load(tmp_path / "ct", water=WATER).volume
    for k, path in enumerate(paths):
        changed(path, InstanceNumber=(5 * k) % 7)
        path.rename(tmp_path / "ct" / f"IM{(3 * k) % 7}")
    (tmp_path / "ct" / "notes.txt").write_text("not a slice")
    found = ct_volume.load(tmp_path / "ct", water=WATER).volume
    np.testing.assert_array_equal(found.attenuation, expected.attenuation)
    assert found.grid == expected.grid
    assert volume.grid.alike(found.grid)


def test_slices_of_other_directions_are_put_along_world(tmp_path, rng):
    """Rows counted from posterior to anterior and columns to the right: the same voxels."""
    _, paths = saved(tmp_path / "ct", rng)
    expected = ct_volume.load(tmp_path / "ct", water=WATER).volume
    for path in paths:
        data = pydicom.dcmread(path)
        pixels = data.pixel_array[::-1, ::-1]
        rows, columns = pixels.shape
        dv, du = (float(s) for s in data.PixelSpacing)
        x, y, z = (float(p) for p in data.ImagePositionPatient)
        data.ImagePositionPatient = [x + (columns - 1) * du, y + (rows - 1) * dv, z]
        data.ImageOrientationPatient = [-1, 0, 0, 0, -1, 0]
        data.PixelData = np.ascontiguousarray(pixels).tobytes()
        data.save_as(path)
    found = ct_volume.load(tmp_path / "ct", water=WATER).volume
    assert found.grid.alike(expected.grid)
    np.testing.assert_array_equal(found.attenuation, expected.attenuation)


def test_each_slice_has_its_own_scale(tmp_path, rng):
    volume, paths = saved(tmp_path / "ct", rng)
    data = pydicom.dcmread(paths[2])
    data.PixelData = (2 * data.pixel_array + 48).astype("<i2").tobytes()
    data.RescaleSlope, data.RescaleIntercept = "0.5", "-24"
    data.save_as(paths[2])
    found = ct_volume.load(tmp_path / "ct", water=WATER).volume
    assert np.abs(found.attenuation - volume.attenuation).max() < 0.51 * WATER / 1000


def test_padding_is_air(tmp_path, rng):
    _, paths = saved(tmp_path / "ct", rng)
    data = pydicom.dcmread(paths[0])
    pixels = data.pixel_array.copy()
    pixels[0, :2] = -3024
    data.PixelData = pixels.tobytes()
    data.add_new("PixelPaddingValue", "SS", -3024)
    data.save_as(paths[0])
    found = ct_volume.load(tmp_path / "ct", water=WATER)
    assert found.notes == ("2 pixels of padding are air",)
    assert (found.volume.attenuation[:, 0] == 0).sum() == 2


def test_missing_and_uneven_slices_are_refused(tmp_path, rng):
    _, paths = saved(tmp_path / "ct", rng)
    paths[3].unlink()
    with pytest.raises(LegsimError, match=r"0.9 mm apart, but slice_0002.dcm and slice_0004.dcm"):
        ct_volume.load(tmp_path / "ct", water=WATER)
    for path in paths[1:3] + paths[4:]:
        path.unlink()
    with pytest.raises(LegsimError, match="holds 1 DICOM slices"):
        ct_volume.load(tmp_path / "ct", water=WATER)
    paths[0].unlink()
    with pytest.raises(LegsimError, match="holds 0 DICOM slices"):
        ct_volume.load(tmp_path / "ct", water=WATER)


def shifted(paths):
    for k, path in enumerate(paths):
        x, y, z = (float(p) for p in pydicom.dcmread(path).ImagePositionPatient)
        changed(path, ImagePositionPatient=[x, y + 0.1 * k, z])


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda p: changed(p[1], SeriesInstanceUID="1.2.3"), "holds 2 series"),
        (lambda p: changed(p[1], Modality="MR"), r"slice_0001.dcm: is no CT .*modality MR"),
        (lambda p: changed(p[1], RescaleType="US"), "unit US"),
        (lambda p: changed(p[1], PixelSpacing=[1, 1]), "differs from slice_0000.dcm"),
        (lambda p: changed(p[1], ImagePositionPatient=None), "does not say where its slice is"),
        (shifted, "the gantry was tilted"),
        (
            lambda p: [changed(q, ImageOrientationPatient=[0.8, 0.6, 0, -0.6, 0.8, 0]) for q in p],
            "its axes are oblique",
        ),
        (
            lambda p: changed(
                p[1], ImagePositionPatient=pydicom.dcmread(p[0]).ImagePositionPatient
            ),
            "are at the same place",
        ),
        (lambda p: p[1].write_bytes(p[1].read_bytes()[:900]), r"slice_0001.dcm: "),
        (
            lambda p: replaced(p[1], b"\x08\0\x60\0CS", b"\x08\0\x60\0C\x13"),
            "slice_0001.dcm: does not say where its slice is",
        ),
        (lambda p: changed(p[1], RescaleSlope="1e31"), "are not finite"),
        (lambda p: changed(p[1], RescaleSlope="1e29"), "beyond any Hounsfield unit"),
        (lambda p: changed(p[1], RescaleSlope=0), "is no CT in Hounsfield units"),
        (lambda p: changed(p[1], PixelSpacing=[0, 1]), "its pixels have no size"),
    ],
)
def test_what_makes_no_volume_is_refused(tmp_path, rng, spoil, said):
    _, paths = saved(tmp_path / "ct", rng)
    spoil(paths)
    with pytest.raises(LegsimError, match=said):
        ct_volume.load(tmp_path / "ct", water=WATER)


def test_water_must_be_positive(tmp_path):
    with pytest.raises(LegsimError, match="must be positive"):
        ct_volume.load(tmp_path, water=0.0)


def test_slices_may_be_uneven_by_less_than_a_hundredth_of_their_distance(tmp_path, rng):
    _, paths = saved(tmp_path / "ct", rng)
    for k, path in enumerate(paths):
        x, y, _ = pydicom.dcmread(path).ImagePositionPatient
        changed(path, ImagePositionPatient=[x, y, 4.0 * k + (0.02 if k == 2 else 0.0)])
    found = ct_volume.load(tmp_path / "ct", water=WATER).volume
    assert found.grid.spacing_xyz[1] == pytest.approx(4e-3, rel=3e-3)
