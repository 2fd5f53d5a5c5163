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


def test_rows_that_run_the_other_way_are_turned_where_a_format_has_no_mirror(matrices, capsys):
    given = geometry_files.load_geometry(matrices, columns=62, rows=48, pixel_mm=6.16)
    geometry_files.save_geometry(matrices, given.rows_turned())
    for name, to in (("scan.xml", ()), ("scan.json", ("--to", "tigre"))):
        out = matrices.with_name(name)
        shown = printed(capsys, "geometry", "convert", matrices, *DETECTOR, *to, "--out", out)
        assert "turn those of the projections too" in " ".join(shown.split())
        converted = geometry_files.load_geometry(out)
        np.testing.assert_allclose(converted.matrices, given.matrices, rtol=1e-7, atol=1e-7)


def test_rows_are_turned_when_asked_and_back_again(matrices, capsys):
    given = geometry_files.load_geometry(matrices, columns=62, rows=48, pixel_mm=6.16)
    once, twice = matrices.with_suffix(".json"), matrices.with_name("twice.json")
    printed(capsys, "geometry", "convert", matrices, *DETECTOR, "--turn-rows", "--out", once)
    turned = geometry_files.load_geometry(once)
    np.testing.assert_allclose(turned.matrices, given.rows_turned().matrices, rtol=1e-12)
    printed(capsys, "geometry", "convert", once, "--turn-rows", "--out", twice)
    back = geometry_files.load_geometry(twice)
    np.testing.assert_allclose(back.matrices, given.matrices, rtol=1e-12, atol=1e-12)
    # turned, the rows run as RTK has them: they are not turned a second time
    out = matrices.with_suffix(".xml")
    printed(capsys, "geometry", "convert", once, "--turn-rows", "--out", out)
    back = geometry_files.load_geometry(out)
    np.testing.assert_allclose(back.matrices, given.matrices, rtol=1e-7, atol=1e-7)


def test_turned_rows_that_a_format_cannot_say_are_refused(matrices, capsys):
    out = matrices.with_suffix(".xml")
    with pytest.raises(SystemExit):
        cli_main.main(
            [
                *("geometry", "convert", str(matrices), *DETECTOR),
                *("--turn-rows", "--out", str(out)),
            ]
        )
    assert "which rtk cannot say" in " ".join(capsys.readouterr().err.split())
    assert not out.exists()


def test_show_names_the_format_and_what_it_cannot_know(matrices, capsys):
    shown = " ".join(
        printed(capsys, "geometry", "show", matrices, "--columns", "62", "--rows", "48").split()
    )
    assert "format matrices" in shown
    assert "the pixel size is not known and taken as 1 mm" in shown
    shown = printed(capsys, "geometry", "show", matrices, *DETECTOR, "--up", "z")
    assert "axis               (0.000, 0.000, 1.000)" in shown


def test_a_pixel_size_that_is_none_is_refused(matrices, capsys):
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["geometry", "show", str(matrices), *DETECTOR[:-1], "0.4x"])
    assert caught.value.code == 2
    assert "give one as in 0.4 or 0.4x0.3" in " ".join(capsys.readouterr().err.split())
