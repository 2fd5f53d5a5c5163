"""`legsim phantom from-labels` makes a phantom that `legsim project` projects."""

import numpy as np
import pytest

from legsim.cli import main as cli_main
from legsim.geometry import files as geometry_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.image_files import load_projections
from legsim.geometry.volume import VolumeGrid
from tests.examples import segmentations

GRID = VolumeGrid((30, 30, 30), (0.002,) * 3, (0.0, 0.0, 0.0))
MAP = """
[[label]]
number = 1
name = "rod"
tissue = "cortical_bone"
"""


def run(capsys, *arguments: object, code=0) -> str:
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(a) for a in arguments])
    shown = capsys.readouterr()
    assert caught.value.code == code, shown
    return " ".join((shown.out + shown.err).split())


@pytest.fixture
def ball(tmp_path):
    """A ball of 20 mm, and one stray voxel of another number."""
    x, y, z = GRID.axes()
    far = z[:, None, None] ** 2 + y[None, :, None] ** 2 + x**2
    labels = (far < 0.02**2).astype(np.uint8)
    labels[0, 0, 0] = 9
    (tmp_path / "map.toml").write_text(MAP)
    return segmentations.write(tmp_path / "ball.nii.gz", labels, GRID)


def test_a_ball_is_projected_with_its_diameter_and_attenuation(ball, tmp_path, capsys):
    common = ("phantom", "from-labels", ball, "--map", tmp_path / "map.toml")
    refused = run(capsys, *common, "--out", tmp_path / "made", code=1)
    assert "9 (1 voxels)" in refused
    shown = run(capsys, *common, "--out", tmp_path / "made", "--ignore", "9")
    assert "PHANTOM.toml" in shown
    assert "unnamed (9)" in shown
    geometry = ConeBeamGeometry.circular(
        times=np.arange(2.0),
        angles=np.array([0.0, 1.0]),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(31, 31),
        pixel_pitch=3e-3,
    )
    geometry_files.save_geometry(tmp_path / "g.json", geometry)
    out = tmp_path / "p.mha"
    run(
        capsys,
        *("project", tmp_path / "made" / "PHANTOM.toml"),
        *("--geometry", tmp_path / "g.json", "--out", out),
    )
    values = load_projections(out, geometry).line_integrals
    # cortical bone at 60 keV: 0.604 / cm (ICRU 44's 0.3148 cm2/g times 1.92 g/cm3)
    np.testing.assert_allclose(values[:, 15, 15], 4 * 0.604, rtol=0.02)


def test_what_is_not_a_list_of_numbers_is_refused(ball, tmp_path, capsys):
    shown = run(
        capsys,
        *("phantom", "from-labels", ball, "--map", tmp_path / "map.toml"),
        *("--out", tmp_path / "made", "--ignore", "liver"),
        code=1,
    )
    assert "--ignore liver: expected whole numbers" in shown


def test_a_mask_that_its_file_names_needs_no_map(ball, tmp_path, capsys):
    refused = run(capsys, "phantom", "from-labels", ball, "--out", tmp_path / "made", code=1)
    assert "does not name its numbers; say what they are by --map" in refused
    x, y, z = GRID.axes()
    labels = (z[:, None, None] ** 2 + y[None, :, None] ** 2 + x**2 < 0.02**2).astype(np.uint8)
    mask = segmentations.write(tmp_path / "femur_left.nii.gz", labels, GRID)
    shown = run(capsys, "phantom", "from-labels", mask, "--out", tmp_path / "made")
    assert "numbers by the names of the file: 1 femur_left" in shown
    assert list((tmp_path / "made").glob("femur_*l.ply"))
