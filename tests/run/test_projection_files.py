"""Projections with another file's geometry and times."""

import re
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from legsim.config.measured_scan import MeasuredScanConfig
from legsim.core.errors import LegsimError
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.run import projection_files
from tests.examples import measured


def settings(**more) -> MeasuredScanConfig:
    return MeasuredScanConfig(
        **{"projections": "projections.mha", "geometry": "geometry.xml", **more}
    )


def test_a_geometry_in_mm_takes_pixels_from_the_projections(tmp_path):
    measured.write(tmp_path)
    read = projection_files.read(settings(), tmp_path).geometry
    assert read.shape_vu == (16, 20)
    points = 0.02 * np.eye(3)
    np.testing.assert_allclose(
        read.project(points)[0], measured.geometry().project(points)[0], atol=1e-6
    )


def test_an_image_without_pixels_needs_their_size(tmp_path):
    measured.write(tmp_path)
    image = image_files.load_projections(tmp_path / "projections.mha", measured.geometry())
    tifffile.imwrite(tmp_path / "projections.tif", image.line_integrals)
    # RTK itself leaves out the comment with legsim's detector
    text = (tmp_path / "geometry.xml").read_text("utf-8")
    (tmp_path / "geometry.xml").write_text(re.sub("<!--.*?-->", "", text, flags=re.S), "utf-8")
    given = settings(projections="projections.tif")
    with pytest.raises(LegsimError, match="pixel"):
        projection_files.read(given, tmp_path)
    given = settings(projections="projections.tif", pixel_mm=8.0)
    assert projection_files.read(given, tmp_path).geometry.shape_vu == (16, 20)


def test_counts_in_a_folder_upside_down_are_the_same_line_integrals(tmp_path):
    measured.write(tmp_path)
    expected = projection_files.read(settings(), tmp_path).projections.line_integrals.copy()
    expected[:, :, :3] = 0
    counts = np.round(60000 * np.exp(-expected.astype(float))).astype(np.uint16)
    (tmp_path / "views").mkdir()
    for k, view in enumerate(counts):
        tifffile.imwrite(tmp_path / "views" / f"view_{k}.tif", view[::-1])
    given = settings(projections="views", pixel_mm=8.0, turn_rows=True, counts={"air": "0:3,0:16"})
    found = projection_files.read(given, tmp_path)
    # counts are whole
    np.testing.assert_allclose(found.projections.line_integrals, expected, atol=1e-4)
    read = projection_files.files_of(given, tmp_path)
    assert [path.name for path in read[:3]] == ["view_0.tif", "view_1.tif", "view_10.tif"]
    assert read[-1].name == "geometry.xml"
    assert len(read) == 25


def test_a_detector_of_another_size_is_refused(tmp_path):
    measured.write(tmp_path)
    assert projection_files.read(settings(columns=20, rows=16), tmp_path)
    with pytest.raises(LegsimError, match="has 20 columns and 16 rows, not those"):
        projection_files.read(settings(columns=21, rows=16), tmp_path)


def test_times_are_the_geometrys_or_given(tmp_path):
    views = measured.geometry()
    assert projection_files.with_times(views, True, None, None) is views
    assert projection_files.with_times(views, False, None, None) is None
    by_rate = projection_files.with_times(views, True, 2.0, None)
    assert by_rate is not None
    np.testing.assert_allclose(by_rate.times, np.arange(24) / 2)
    (tmp_path / "t.csv").write_text("t\n" + "\n".join(str(k * k) for k in range(24)))
    by_file = projection_files.with_times(views, True, None, tmp_path / "t.csv")
    assert by_file is not None
    np.testing.assert_array_equal(by_file.times, np.arange(24.0) ** 2)
    np.testing.assert_array_equal(replace(by_file, times=views.times).times, views.times)


@pytest.mark.parametrize(("name", "timed"), [("g.json", True), ("tigre.json", False)])
def test_only_legsims_json_says_when_views_were_taken(tmp_path, name, timed):
    measured.write(tmp_path)
    kind = "legsim" if timed else "tigre"
    geometry_files.save_geometry(tmp_path / name, measured.geometry(), format=kind)
    assert projection_files.read(settings(geometry=name), tmp_path).timed == timed


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1\n2\n", "holds 2 times, the geometry 24 views"),
        ("t [min]\n" + "1\n" * 24, r"t.csv \(line 1\): the times are stated to be in 'min'"),
        ("times\n" + "1\n" * 24, r"t.csv: .*increase strictly"),
        ("1\nx\n", "line 2.: 'x' is not a time"),
        ("\n".join(["1"] * 24), r"t.csv: .*increase strictly"),
    ],
)
def test_times_of_another_scan_are_refused(tmp_path, text, said):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(LegsimError, match=said):
        projection_files.with_times(measured.geometry(), True, None, tmp_path / "t.csv")


def test_two_clocks_are_refused(tmp_path):
    with pytest.raises(LegsimError, match="give one of them"):
        projection_files.with_times(measured.geometry(), True, 1.0, tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        *(("time (ms)", 1e-3), ("time_ms", 1e-3), ("t_us", 1e-6), ("ms", 1e-3)),
        *(("time_ms,", 1e-3), ("Time(ms);", 1e-3), ('"Time (ms)",', 1e-3)),
        *(("view_g", 1.0), ("trigger (counts)", 1.0), ("view", 1.0)),
    ],
)
def test_a_unit_above_the_times_of_views_is_theirs(tmp_path, header, factor):
    (tmp_path / "t.csv").write_text("\n".join([header, *map(str, range(24))]))
    timed = projection_files.with_times(measured.geometry(), False, None, tmp_path / "t.csv")
    assert timed is not None
    np.testing.assert_allclose(timed.times, factor * np.arange(24), rtol=1e-15)
    (tmp_path / "t.csv").write_text("\n".join(["time (min)", *map(str, range(24))]))
    with pytest.raises(LegsimError, match=r"line 1\): the times are stated to be in 'min'; give s"):
        projection_files.with_times(measured.geometry(), False, None, tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (8000.0, "ms they would be 8 s"),
        (8e6, "us they would be 8 s"),
        (2e3, "ms .* 2 s"),
        (8e-3, ""),
    ],
)
def test_views_in_another_unit_are_in_doubt(times, said):
    (note,) = projection_files.time_doubts(np.linspace(0, times, 20))
    assert "views are said to take" in note
    assert re.search(said, note)
    for scan in (0.6, 8.0, 200.0):
        assert projection_files.time_doubts(np.linspace(0, scan, 20)) == ()
