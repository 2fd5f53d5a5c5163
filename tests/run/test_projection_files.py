"""Projections with another file's geometry and times."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import files as geometry_files
from legsim.run import projection_files
from tests.examples import measured


def test_a_geometry_in_mm_takes_pixels_from_the_projections(tmp_path):
    measured.write(tmp_path)
    read = projection_files.load_geometry(tmp_path / "projections.mha", tmp_path / "geometry.xml")
    assert read.shape_vu == (16, 20)
    points = 0.02 * np.eye(3)
    np.testing.assert_allclose(
        read.project(points)[0], measured.geometry().project(points)[0], atol=1e-6
    )


def test_an_image_without_pixels_needs_their_size(tmp_path):
    measured.write(tmp_path)
    import SimpleITK as sitk

    image = sitk.ReadImage(str(tmp_path / "projections.mha"))
    sitk.WriteImage(image, str(tmp_path / "projections.tif"))
    files = tmp_path / "projections.tif", tmp_path / "geometry.xml"
    with pytest.raises(LegsimError, match=r"projections.tif: .*give pixel_mm"):
        projection_files.load_geometry(*files)
    assert projection_files.load_geometry(*files, pixel_mm=8.0).shape_vu == (16, 20)


def test_times_are_the_geometrys_or_given(tmp_path):
    views = measured.geometry()
    path = tmp_path / "geometry.json"
    geometry_files.save_geometry(path, views)
    assert projection_files.with_times(views, path, None, None) is views
    assert projection_files.with_times(views, tmp_path / "g.xml", None, None) is None
    by_rate = projection_files.with_times(views, path, 2.0, None)
    assert by_rate is not None
    np.testing.assert_allclose(by_rate.times, np.arange(24) / 2)
    (tmp_path / "t.csv").write_text("t\n" + "\n".join(str(k * k) for k in range(24)))
    by_file = projection_files.with_times(views, path, None, tmp_path / "t.csv")
    assert by_file is not None
    np.testing.assert_array_equal(by_file.times, np.arange(24.0) ** 2)
    np.testing.assert_array_equal(replace(by_file, times=views.times).times, views.times)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1\n2\n", "holds 2 times, the geometry 24 views"),
        ("1\nx\n", "line 2.: 'x' is not a time"),
        ("\n".join(["1"] * 24), r"t.csv: .*increase strictly"),
    ],
)
def test_times_of_another_scan_are_refused(tmp_path, text, said):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(LegsimError, match=said):
        projection_files.with_times(
            measured.geometry(), tmp_path / "g.json", None, tmp_path / "t.csv"
        )


def test_two_clocks_are_refused(tmp_path):
    with pytest.raises(LegsimError, match="give one of them"):
        projection_files.with_times(
            measured.geometry(), tmp_path / "g.json", 1.0, tmp_path / "t.csv"
        )
