"""`legsim convert`, `project`, `reconstruct` and `evaluate` hand their options on and print the
result.
"""

import json

import numpy as np
import pytest
import SimpleITK as sitk
import tifffile

from legsim.cli import main as cli_main
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command prints that succeeds."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(argument) for argument in arguments])
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_convert_prints_a_path_with_brackets_whole(tmp_path, capsys):
    times = np.arange(3.0)
    first, second = tmp_path / "a.mot", tmp_path / "trial [2].sto"
    opensim.save(first, JointTrajectories(times, ("knee_angle_r",), np.zeros((3, 1))))
    assert "trial [2].sto" in printed(capsys, "convert", first, "--out", second, "--degrees")
    assert "inDegrees=yes" in second.read_text()


def test_evaluate_prints_a_row_for_each_region(tmp_path, capsys):
    grid = VolumeGrid.cubic(12, 0.002, (0.0, 0.0, 0.0))
    values = np.random.default_rng(0).random(grid.shape_zyx, np.float32)
    image_files.save_volume(tmp_path / "v.mha", Volume(grid, values))
    files = (tmp_path / "v.mha", tmp_path / "v.mha")
    shown = printed(capsys, "evaluate", *files, "--no-register", "--out", tmp_path / "m.json")
    assert "cylinder" in shown
    assert "1.0000" in shown
    assert (tmp_path / "m.json").is_file()


def test_the_same_volume_in_another_format_is_on_the_same_grid(tmp_path, capsys):
    """NIfTI holds positions in single precision; older files have no directions."""
    grid = VolumeGrid((20, 21, 22), (1.1e-3, 1.3e-3, 0.9e-3), (0.0731, 1.0472, -0.0913))
    values = np.random.default_rng(0).random(grid.shape_zyx, np.float32)
    for ending in ("mha", "nii.gz"):
        image_files.save_volume(tmp_path / f"v.{ending}", Volume(grid, values))
    old = sitk.GetImageFromArray(values * np.float32(1e-3))
    old.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    old.SetOrigin((1e3 * grid.origin).tolist())
    sitk.WriteImage(old, str(tmp_path / "old.mha"))
    for first, second in (("v.nii.gz", "v.mha"), ("old.mha", "v.mha")):
        shown = printed(
            capsys, "evaluate", tmp_path / first, tmp_path / second, "--no-register",
            "--out", tmp_path / "m.json",
        )  # fmt: skip
        assert "1.0000" in shown


def test_another_grid_is_refused_until_resampling_is_asked_for(tmp_path, capsys):
    """A smooth volume on two grids is alike once one is brought onto the other."""

    def smooth(count, spacing, shift):
        grid = VolumeGrid.cubic(count, spacing, (shift, 0.0, 0.0))
        x, y, z = grid.axes()
        wave = np.sin(120 * x) * np.cos(90 * y)[:, None] * np.cos(100 * z)[:, None, None]
        return Volume(grid, (20 + 10 * wave).astype(np.float32))

    image_files.save_volume(tmp_path / "a.mha", smooth(30, 0.002, 0.0))
    image_files.save_volume(tmp_path / "b.mha", smooth(40, 0.0015, 0.0002))
    command = ("evaluate", tmp_path / "b.mha", tmp_path / "a.mha", "--no-register")
    with pytest.raises(SystemExit) as caught:
        cli_main.main([*map(str, command), "--out", str(tmp_path / "m.json")])
    assert caught.value.code == 1
    assert "resample the volume (--resample)" in " ".join(capsys.readouterr().err.split())
    printed(capsys, *command, "--resample", "--out", tmp_path / "m.json")
    numbers = json.loads((tmp_path / "m.json").read_text())
    assert numbers["resampled"]
    assert numbers["regions"][0]["ssim"] > 0.99


def test_a_scan_in_counts_is_reconstructed_from_a_folder_of_images(tmp_path, capsys):
    """Counts of a cylinder of 0.02/mm, one TIFF for each view, geometry as ASTRA's vectors."""
    angles = np.radians(np.arange(0, 360, 6.0))
    geometry = ConeBeamGeometry.circular(
        times=np.arange(60) / 30, angles=angles, source_isocenter=0.78, source_detector=1.198,
        shape_vu=(24, 80), pixel_pitch=2e-3,
    )  # fmt: skip
    geometry_files.save_geometry(tmp_path / "g.txt", geometry, format="astra")
    rays = geometry.ray_directions(np.arange(80.0), np.arange(24.0)[:, None])
    closest = np.abs(np.cross(geometry.sources()[:, None, None], rays)[..., 1])
    half = np.hypot(rays[..., 0], rays[..., 2])
    chord = 2 * np.sqrt(np.clip(0.03**2 - (closest / half) ** 2, 0, None))
    integrals = 20 * chord * np.linalg.norm(rays, axis=-1) / half
    (tmp_path / "views").mkdir()
    for k, view in enumerate(np.rint(6e4 * np.exp(-integrals)).astype(np.uint16)):
        tifffile.imwrite(tmp_path / "views" / f"view_{k}.tif", view)
    command = (
        "reconstruct", tmp_path / "views", "--geometry", tmp_path / "g.txt",
        *("--shape-zyx", 20, 8, 20, "--spacing-mm", 2, 2, 2, "--out", tmp_path / "v.mha"),
    )  # fmt: skip
    with pytest.raises(SystemExit):
        cli_main.main([str(word) for word in command])
    assert "holds whole numbers, counts of a detector" in " ".join(capsys.readouterr().err.split())
    shown = " ".join(printed(capsys, *command, "--air", "0:8,0:24").split())
    assert "read as ASTRA's cone_vec" in shown
    middle = image_files.load_volume(tmp_path / "v.mha").attenuation[5:15, 3:5, 5:15]
    np.testing.assert_allclose(middle, 20.0, atol=0.5)
