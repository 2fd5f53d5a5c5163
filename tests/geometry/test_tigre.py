"""TIGRE's parameters: pixels stand where its kernels put them, step by step, and round trips."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import files, tigre
from tests.geometry.test_files import assert_same_rays, circular, corrected


def turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def parameters(views=4):
    rng = np.random.default_rng(5)
    return {
        "mode": "cone",
        "DSD": 1536.0,
        "DSO": rng.uniform(900, 1100, views),
        "nDetector": np.array([40, 60]),
        "dDetector": np.array([0.8, 0.6]),
        "offDetector": rng.uniform(-20, 20, (views, 2)),
        "rotDetector": rng.uniform(-0.2, 0.2, (views, 3)),
        "COR": 4.0,
        "angles": rng.uniform(-3, 3, (views, 3)),
    }


def pixel_position(geo, view, row, column):
    """World position (mm) of a pixel, and of the source, by the steps of TIGRE's kernels."""
    (rows, columns), (high, wide) = geo["nDetector"], geo["dDetector"]
    pixel = np.array([0, wide * (column - columns / 2 + 0.5), high * (row - rows / 2 + 0.5)])
    x, y, z = geo["rotDetector"][view]
    pixel = turn("z", z) @ turn("y", y) @ turn("x", x) @ pixel
    off_v, off_u = geo["offDetector"][view]
    pixel += (geo["DSO"][view] - geo["DSD"], off_u, off_v)
    source = np.array([geo["DSO"][view], 0, 0])
    a, t, p = geo["angles"][view]
    turned = turn("z", a) @ turn("y", t) @ turn("z", p)
    shift = geo["COR"] * np.array([-np.sin(a), np.cos(a), 0])
    return turned @ pixel + shift, turned @ source + shift


def test_pixels_stand_where_tigre_puts_them():
    geo = parameters()
    geometry = tigre.from_object(SimpleNamespace(**geo))
    assert geometry.shape_vu == (40, 60)
    assert (geometry.pixel_pitch, geometry.row_pitch()) == pytest.approx((0.6e-3, 0.8e-3))
    for view in range(4):
        for row, column in ((0, 0), (39, 59), (7, 31)):
            pixel, source = pixel_position(geo, view, row, column)
            np.testing.assert_allclose(1e3 * geometry.sources()[view], source, atol=1e-9)
            halfway = 0.5e-3 * (pixel + source)
            seen = geometry.project(halfway[None])[0][view, 0]
            np.testing.assert_allclose(seen, (column, row), atol=1e-7)


def test_json_of_the_objects_attributes_is_read(tmp_path):
    content = {k: np.asarray(v).tolist() for k, v in parameters().items()}
    (tmp_path / "geo.json").write_text(json.dumps(content))
    found = files.read_geometry(tmp_path / "geo.json")
    assert found.format == "tigre"
    expected = tigre.from_object(SimpleNamespace(**parameters()))
    np.testing.assert_allclose(found.geometry.matrices, expected.matrices, rtol=1e-12)


def matlab(geo):
    """As MATLAB's jsonencode writes the struct: columns first, a column for each view."""
    written = {k: np.asarray(v).T.tolist() for k, v in geo.items()}
    for name in ("nDetector", "dDetector", "offDetector"):
        written[name] = written[name][::-1]
    return written


def test_matlabs_struct_is_read_by_its_columns_for_each_view(tmp_path):
    (tmp_path / "geo.json").write_text(json.dumps(matlab(parameters(views=5))))
    found = files.read_geometry(tmp_path / "geo.json")
    expected = tigre.from_object(SimpleNamespace(**parameters(views=5)))
    np.testing.assert_allclose(found.geometry.matrices, expected.matrices, rtol=1e-12)
    assert found.geometry.shape_vu == (40, 60)
    assert "MATLAB struct, whose detector is (columns, rows)" in found.notes[0]


PLAIN = {
    "mode": "cone",
    "DSD": 1536,
    "DSO": 1000,
    "COR": 0,
    "angles": [0, 0.1, 0.2, 0.3],
    "nDetector": [60, 40],
    "dDetector": [0.6, 0.8],
    "offDetector": [12, 3],
}


def test_the_images_tell_the_order_of_rows_and_columns(tmp_path):
    (tmp_path / "geo.json").write_text(json.dumps(PLAIN))
    found = files.read_geometry(tmp_path / "geo.json", columns=60, rows=40, up="z")
    assert found.geometry.shape_vu == (40, 60)
    assert found.geometry.pixel_pitch == pytest.approx(0.6e-3)
    ordered = PLAIN | {k: PLAIN[k][::-1] for k in ("nDetector", "dDetector", "offDetector")}
    (tmp_path / "python.json").write_text(json.dumps(ordered))
    again = files.read_geometry(tmp_path / "python.json", columns=60, rows=40, up="z")
    np.testing.assert_array_equal(found.geometry.matrices, again.geometry.matrices)
    assert ("MATLAB" in found.notes[0], again.notes) == (True, ())
    with pytest.raises(LegsimError, match="says 60 columns and 41 rows"):
        (tmp_path / "geo.json").write_text(json.dumps(PLAIN | {"nDetector": [41, 60]}))
        files.read_geometry(tmp_path / "geo.json", columns=60, rows=40)


@pytest.mark.parametrize(
    ("pairs", "asked"),
    [
        ({"nDetector": [50, 50]}, True),
        ({"nDetector": [50, 50], "dDetector": [0.5, 0.5]}, True),
        ({"nDetector": [50, 50], "dDetector": [0.5, 0.5], "offDetector": [0, 0]}, False),
        ({"nDetector": [50, 50], "offDetector": [[1, 2]] * 4}, False),
    ],
)
def test_an_order_that_nothing_tells_is_said_where_it_matters(tmp_path, pairs, asked):
    (tmp_path / "geo.json").write_text(json.dumps(PLAIN | pairs))
    notes = files.read_geometry(tmp_path / "geo.json", columns=50, rows=50, up="z").notes
    assert [("exchange the two numbers" in note) for note in notes] == [True] * asked


def test_a_struct_without_angles_says_how_to_add_them(tmp_path):
    (tmp_path / "geo.json").write_text(json.dumps({k: PLAIN[k] for k in PLAIN if k != "angles"}))
    with pytest.raises(LegsimError, match=r"lacks angles; .*geo.angles = angles"):
        files.read_geometry(tmp_path / "geo.json")


@pytest.mark.parametrize("geometry", [circular(), corrected()], ids=["circular", "corrected"])
def test_round_trip(geometry):
    content = tigre.parameters_of("g.json", geometry)
    again = tigre.geometry("g.json", content, files.Given())
    assert_same_rays(
        again, type(geometry)(again.times, geometry.matrices, (48, 62), 0.616e-3), 1e-7
    )


def test_a_plain_circle_has_plain_angles():
    """About z, one angle turns: theta, psi and the detector's own turns are 0."""
    geo = {"DSD": 1000, "DSO": 700, "nDetector": [8, 9], "dDetector": [1, 1], "angles": [0.1, 1, 2]}
    written = tigre.parameters_of("g.json", tigre.geometry("g.json", geo, files.Given()))
    np.testing.assert_allclose(written["angles"], [[0.1, 0, 0], [1, 0, 0], [2, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(written["rotDetector"], np.zeros((3, 3)), atol=1e-9)
    np.testing.assert_allclose(written["DSD"], [1000] * 3)
    np.testing.assert_allclose(written["offDetector"], np.zeros((3, 2)), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": "parallel"}, r"\(mode\): the beam is 'parallel'"),
        ({"angles": np.zeros((4, 2))}, r"\(angles\): angles have the shape \(4, 2\)"),
        ({"angles": np.arange(0, 360, 90.0)}, r"\(angles\): an angle is 270 rad"),
        ({"DSD": [1.0, 2.0, 3.0]}, r"\(DSD\): has the shape \(3,\)"),
        ({"DSD": "far"}, r"\(DSD\): is not of numbers"),
        ({"COR": np.nan}, r"\(COR\): holds numbers that are not finite"),
        ({"dDetector": [0.8, -0.6]}, "not positive"),
    ],
)
def test_impossible_parameters_are_refused(change, message):
    with pytest.raises(LegsimError, match=message):
        tigre.from_object(SimpleNamespace(**(parameters() | change)))


def test_what_is_missing_is_named():
    geo = parameters()
    del geo["angles"]
    with pytest.raises(LegsimError, match="lacks angles"):
        tigre.from_object(SimpleNamespace(**geo))
    assert len(tigre.from_object(SimpleNamespace(**geo), parameters()["angles"])) == 4


def test_a_detector_through_its_source_and_numbers_beyond_all_are_refused(tmp_path):
    for change, said in (
        (
            {"DSD": 1e-320, "offDetector": [0, 0], "rotDetector": [0, 0, 0]},
            "the detector's plane holds the source",
        ),
        ({"DSO": [1e200] * 4}, "too large for a geometry"),
        ({"DSD": 10**400}, "is not of numbers"),
    ):
        content = {k: np.asarray(v).tolist() for k, v in parameters().items()} | change
        (tmp_path / "t.json").write_text(json.dumps(content))
        with pytest.raises(LegsimError, match=said):
            files.read_geometry(tmp_path / "t.json")


def test_the_detectors_size_is_its_pixels_in_rows_and_columns(tmp_path):
    files.save_geometry(tmp_path / "g.json", circular(), format="tigre")
    written = json.loads((tmp_path / "g.json").read_text())
    assert written["nDetector"] == [48, 62]
    np.testing.assert_allclose(written["sDetector"], 0.616 * np.array([48, 62]))
