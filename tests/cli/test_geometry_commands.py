"""`legsim geometry` describes and converts a geometry of another toolkit, given its detector."""

import numpy as np
import pytest

from legsim.cli import main as cli_main
from legsim.geometry import files as geometry_files
from legsim.geometry.cone_beam import ConeBeamGeometry

DETECTOR = ("--columns", "62", "--rows", "48", "--pixel-mm", "6.16")


@pytest.fixture
def matrices(tmp_path):
    """A text file of bare 3x4 matrices."""
    path = tmp_path / "scan.txt"
    geometry = ConeBeamGeometry.circular(
        times=np.arange(60) / 31,
        angles=np.radians(6.0 * np.arange(60)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(48, 62),
        pixel_pitch=6.16e-3,
    )
    geometry_files.save_geometry(path, geometry)
    return path


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command prints that succeeds."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(argument) for argument in arguments])
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_show_describes_the_scan(matrices, capsys):
    shown = printed(capsys, "geometry", "show", matrices, *DETECTOR)
    assert "60 in 1.903 s" in shown
    assert "62 columns x 48 rows, pixels of 6.16 mm" in shown


def test_convert_writes_the_format_of_the_ending(matrices, capsys):
    out = matrices.with_suffix(".json")
    assert str(out) in printed(capsys, "geometry", "convert", matrices, *DETECTOR, "--out", out)
    converted = geometry_files.load_geometry(out)
    given = geometry_files.load_geometry(matrices, columns=62, rows=48, pixel_mm=6.16)
    np.testing.assert_allclose(converted.matrices, given.matrices, rtol=1e-12)
