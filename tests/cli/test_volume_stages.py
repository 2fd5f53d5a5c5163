"""`legsim convert` of volumes: formats, DICOM series, and what is refused."""

import json

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.cli import main as cli_main
from legsim.cli import volume_stages
from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.phantom import materials


@pytest.fixture
def volume(tmp_path, rng):
    grid = VolumeGrid((5, 7, 6), (0.7e-3, 0.9e-3, 1.1e-3), (0.1, 0.45, -0.083))
    made = Volume(grid, rng.uniform(0, 60, grid.shape_zyx).astype(np.float32))
    image_files.save_volume(tmp_path / "v.mha", made)
    return made


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return caught.value.code, " ".join((output.out + output.err).split())


def test_a_volume_without_directions_gets_them(tmp_path, volume, capsys):
    """A patient's image along ITK's axes, which looks like one without directions."""
    image = sitk.DICOMOrient(sitk.ReadImage(str(tmp_path / "v.mha")), "LPS")
    sitk.WriteImage(image, str(tmp_path / "lps.nrrd"))
    code, shown = run(
        capsys, "convert", tmp_path / "lps.nrrd", "--axes", "lps", "--out", tmp_path / "w.nii.gz"
    )
    assert code == 0
    assert "6x7x5 voxels (x, y, z)" in shown
    again = image_files.load_volume(tmp_path / "w.nii.gz")
    assert again.grid.alike(volume.grid)
    np.testing.assert_allclose(again.attenuation, volume.attenuation, rtol=1e-6)
    for axes, doubted in (("lps", False), ("world", False), (None, True)):
        lines = volume_stages.convert_volume(tmp_path / "lps.nrrd", tmp_path / "x.mha", axes=axes)
        assert any("In doubt" in line and "--axes lps" in line for line in lines) == doubted
    lines = volume_stages.convert_volume(tmp_path / "v.mha", tmp_path / "x.nii")
    assert not any("In doubt" in line for line in lines), "its directions are stated"


def test_a_folder_gets_a_series_in_hounsfield_units(tmp_path, volume, capsys):
    pytest.importorskip("pydicom")
    code, shown = run(capsys, "convert", tmp_path / "v.mha", "--out", tmp_path / "ct")
    assert code == 0
    assert "(at 60 keV)" in shown
    assert "7 axial slices" in shown
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(tmp_path / "ct")))
    found = sitk.GetArrayFromImage(reader.Execute())
    expected = 1000 * (volume.attenuation / materials.attenuation("water", 60.0) - 1)
    np.testing.assert_allclose(found, expected[::-1, :, ::-1].transpose(1, 2, 0), atol=0.51)
    code, shown = run(
        capsys, "convert", tmp_path / "v.mha", "--water-per-mm", "0.02", "--out", tmp_path / "ct2"
    )
    assert (code, "water at 0.02/mm (as given)" in shown) == (0, True)


@pytest.mark.parametrize(
    ("options", "out", "message"),
    [
        ({"energy_kev": 50.0}, "w.nii", "of DICOM series only"),
        ({}, "w.png", "not written in this format"),
        ({"energy_kev": 50.0, "water_per_mm": 0.02}, "ct", "give one"),
    ],
)
def test_options_and_formats_that_cannot_be_are_refused(tmp_path, volume, options, out, message):
    with pytest.raises(LegsimError, match=message):
        volume_stages.convert_volume(tmp_path / "v.mha", tmp_path / out, **options)


def test_options_of_recordings_do_not_apply(tmp_path, volume, capsys):
    code, shown = run(capsys, "convert", tmp_path / "v.mha", "--unit", "mm", "--out", "w.nii")
    assert (code, "a volume, to which --unit cannot apply" in shown) == (1, True)
    (tmp_path / "a.csv").write_text("time_s,knee_angle_r_rad\n0,0.1\n0.1,0.2\n")
    code, shown = run(capsys, "convert", tmp_path / "a.csv", "--axes", "lps", "--out", "b.mot")
    assert (code, "a recording, to which --axes cannot apply" in shown) == (1, True)


def test_a_folder_of_slices_is_a_volume_once_water_is_known(tmp_path, volume, capsys):
    pytest.importorskip("pydicom")
    ct, back = tmp_path / "ct", tmp_path / "back.mha"
    water = ("--water-per-mm", "0.02")
    assert run(capsys, "convert", tmp_path / "v.mha", *water, "--out", ct)[0] == 0
    code, shown = run(capsys, "convert", ct, "--out", back)
    assert (code, "give --water-per-mm" in shown) == (1, True)
    code, shown = run(capsys, "convert", ct, *water, "--out", back)
    assert (code, "7 slices up, water at 0.02/mm" in shown) == (0, True)
    found = image_files.load_volume(back)
    assert found.grid.alike(volume.grid)
    # half a Hounsfield unit, and float32 in the file
    assert np.abs(found.attenuation - volume.attenuation).max() < 0.501 * 20e-3
    code, shown = run(capsys, "convert", ct, *water, "--axes", "lps", "--out", back)
    assert (code, "leave --axes out" in shown) == (1, True)


def test_slices_are_evaluated_as_the_volume_that_they_are(tmp_path, capsys, rng):
    pytest.importorskip("pydicom")
    grid = VolumeGrid.cubic(12, 1e-3, (0.1, 0.45, -0.083))
    made = Volume(grid, rng.uniform(0, 60, grid.shape_zyx).astype(np.float32))
    image_files.save_volume(tmp_path / "v.mha", made)
    ct, out = tmp_path / "ct", tmp_path / "m.json"
    water = ("--water-per-mm", "0.02")
    assert run(capsys, "convert", tmp_path / "v.mha", *water, "--out", ct)[0] == 0
    compared = ("evaluate", ct, tmp_path / "v.mha", "--no-register", "--out", out)
    assert run(capsys, *compared, *water)[0] == 0
    region = json.loads(out.read_text())["regions"][0]
    assert region["ssim"] > 0.999
    assert region["rmse"] < 1e-3
    code, shown = run(capsys, *compared)
    assert (code, "Hounsfield units, which do not say" in shown) == (1, True)


@pytest.mark.parametrize("values", ["hounsfield", "per_m"])
def test_values_that_are_no_attenuation_are_refused_by_convert(tmp_path, volume, capsys, values):
    """As if 1/mm, Hounsfield units would be written as attenuation a thousand times a body's."""
    wrong = (
        1e6 * (volume.attenuation / 20 - 1)
        if values == "hounsfield"
        else 1e3 * 60 + volume.attenuation
    )
    image_files.save_volume(tmp_path / "w.mha", Volume(volume.grid, wrong.astype(np.float32)))
    code, shown = run(capsys, "convert", tmp_path / "w.mha", "--out", tmp_path / "o.nii.gz")
    assert code == 1
    assert "no attenuation in 1/mm" in shown
    assert not (tmp_path / "o.nii.gz").exists()


def test_volumes_of_two_units_are_not_compared(tmp_path, volume, capsys):
    image_files.save_volume(
        tmp_path / "w.mha", Volume(volume.grid, (10 * volume.attenuation).astype(np.float32))
    )
    code, shown = run(
        capsys, "evaluate", tmp_path / "w.mha", tmp_path / "v.mha", "--out", tmp_path / "m.json"
    )
    assert code == 1
    assert "give both in one unit, 1/mm" in shown


@pytest.mark.parametrize("water", ["20.6", "0.00002"])
def test_water_in_another_unit_is_refused(tmp_path, volume, water):
    with pytest.raises(LegsimError, match=r"--water-per-mm .*: water attenuates by 0.005 to 0.6"):
        volume_stages.convert_volume(tmp_path / "v.mha", tmp_path / "ct", water_per_mm=float(water))


def test_voxels_in_another_unit_are_doubted(tmp_path, volume, capsys):
    grid = VolumeGrid(volume.grid.shape_zyx, (0.7e-6, 0.9e-6, 1.1e-6), (0.0, 0.0, 0.0))
    image_files.save_volume(tmp_path / "s.mha", Volume(grid, volume.attenuation))
    code, shown = run(capsys, "convert", tmp_path / "s.mha", "--out", tmp_path / "o.nrrd")
    assert code == 0
    assert "In doubt: voxels of 0.0007x0.0009x0.0011 mm" in shown
