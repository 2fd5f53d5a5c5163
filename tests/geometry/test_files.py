"""Geometry files: round trips between all kinds, RTK's own reading and writing, and what malformed
files are told.
"""

import contextlib
import gzip
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry import files
from legsim.geometry.cone_beam import ConeBeamGeometry


def circular(views: int = 5, **options) -> ConeBeamGeometry:
    defaults = {
        "source_isocenter": 0.78,
        "source_detector": 1.198,
        "shape_vu": (48, 62),
        "pixel_pitch": 0.616e-3,
    }
    return ConeBeamGeometry.circular(
        times=0.1 + np.arange(views) / 31.0,
        angles=np.deg2rad(71.3 * np.arange(views)),
        **(defaults | options),
    )


def corrected() -> ConeBeamGeometry:
    """Views moved freely: every one of RTK's nine parameters differs from view to view."""
    rng = np.random.default_rng(3)
    moves = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(0, 0.2, (5, 3))), rng.normal(0, 0.05, (5, 3))
    )
    return circular(isocenter=(0.1, 0.4, -0.05)).moved(moves)


def assert_same_rays(
    first: ConeBeamGeometry, second: ConeBeamGeometry, tolerance: float = 1e-9
) -> None:
    """Pixels of points in the field agree to ``tolerance`` pixels, times to rounding."""
    points = first.rotation_center() + np.random.default_rng(1).uniform(-0.1, 0.1, (50, 3))
    np.testing.assert_allclose(
        first.project(points)[0], second.project(points)[0], atol=tolerance, rtol=0
    )
    np.testing.assert_allclose(first.times, second.times, atol=1e-12)
    assert first.shape_vu == second.shape_vu
    assert first.pixel_pitch == pytest.approx(second.pixel_pitch, rel=1e-14)


@pytest.mark.parametrize("suffix", ["json", "xml"])
@pytest.mark.parametrize("geometry", [circular(), corrected()], ids=["circular", "corrected"])
def test_round_trip(tmp_path, suffix, geometry):
    files.save_geometry(tmp_path / f"g.{suffix}", geometry)
    assert_same_rays(files.load_geometry(tmp_path / f"g.{suffix}"), geometry)


@pytest.mark.parametrize("suffix", ["txt", "npy"])
def test_round_trip_of_plain_matrices(tmp_path, suffix):
    geometry = corrected()
    files.save_geometry(tmp_path / f"g.{suffix}", geometry)
    loaded = files.load_geometry(tmp_path / f"g.{suffix}", columns=62, rows=48, pixel_mm=0.616)
    np.testing.assert_allclose(loaded.matrices, geometry.matrices, rtol=1e-14)
    np.testing.assert_allclose(loaded.times, np.arange(5) / 31)


def test_around_all_kinds_and_back(tmp_path):
    geometry = corrected()
    for name in ("a.json", "b.xml", "c.json", "d.xml"):
        files.save_geometry(tmp_path / name, geometry)
        geometry = files.load_geometry(tmp_path / name)
    assert_same_rays(geometry, corrected())


def test_json_is_as_documented(tmp_path):
    geometry = circular(2)
    files.save_geometry(tmp_path / "g.json", geometry)
    content = json.loads((tmp_path / "g.json").read_text())
    assert content["unit"] == "mm"
    assert (content["columns"], content["rows"]) == (62, 48)
    center_mm = np.array([content["matrices"][0]]).reshape(3, 4) @ (0, 0, 0, 1)
    np.testing.assert_allclose(center_mm / center_mm[2], (30.5, 23.5, 1))
    assert content["pixel_mm"] == pytest.approx(0.616)
    del content["pixel_mm"]
    (tmp_path / "h.json").write_text(json.dumps(content))
    np.testing.assert_array_equal(
        files.load_geometry(tmp_path / "h.json").matrices,
        files.load_geometry(tmp_path / "g.json").matrices,
    )


def test_matrices_in_brackets_over_several_lines(tmp_path):
    (tmp_path / "g.txt").write_text(
        "# CONRAD\n[[-1944.8, 0.0, 30.5, -23790]; [0, -1944.8, 23.5, -18330];\n [0.0, 0.0, 1.0, "
        "-780.0]]\n"
    )
    loaded = files.load_geometry(tmp_path / "g.txt", columns=62, rows=48)
    np.testing.assert_allclose(loaded.sources()[0], (0, 0, 0.78), atol=1e-9)
    assert loaded.matrices[0, 2, 3] > 0, "depth is positive in front of the source"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", r"g\.json \(line 1, column 2\): is not JSON"),
        ("[]", "holds no object"),
        ('{"unit": "mm"}', "lacks columns, rows, times_s, matrices"),
        (
            '{"unit": "m", "columns": 2, "rows": 2, "times_s": [0], "matrices": [[1]]}',
            r"\(unit\): the unit is 'm'",
        ),
        (
            '{"unit": "mm", "columns": 2.5, "rows": 2, "times_s": [0], "matrices": [[1]]}',
            r"\(columns\): 2.5 is not a count",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0], "matrices": [[1]]}',
            r"\(matrices\[0\]\): has 1 numbers",
        ),
        (
            '{"unit": "mm", "columns": 2000000, "rows": 2, "times_s": [0], "matrices": [[1]]}',
            r"\(columns\): 2000000 is not a count",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0], "matrices": [[NaN]]}',
            r"\(matrices\[0\]\): is not a list of finite",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [1'
            + 400 * "0"
            + '], "matrices": [[1]]}',
            r"\(times_s\): is not a list of finite",
        ),
        ("[" * 100_000, "nests lists too deeply"),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0], "matrices": []}',
            r"\(matrices\): is not a list",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0, "x"], "matrices": [[1]]}',
            r"\(times_s\): is not a list of finite",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0, 1], "matrices": '
            "[[1,0,0,0,0,1,0,0,0,0,1,5]]}",
            "1 matrices but 2 times",
        ),
        (
            '{"unit": "mm", "columns": 2, "rows": 2, "times_s": [0], "matrices": '
            "[[1,0,0,0,0,1,0,0,0,1,0,5]]}",
            "is singular",
        ),
    ],
)
def test_malformed_json_is_refused_with_its_place(tmp_path, content, message):
    (tmp_path / "g.json").write_text(content)
    with pytest.raises(LegsimError, match=message) as caught:
        files.load_geometry(tmp_path / "g.json")
    assert "\n" not in str(caught.value)
    assert "g.json" in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((2, 12), 1 + 2j), "not an .npy file of real numbers"),
        (np.array(["a"] * 12), "not an .npy file of real numbers"),
        (np.zeros((12, 1)), r"holds an array of shape \(12, 1\)"),
        (
            np.ones((3, 4, 4)),
            r"\(row 0\): 16 numbers are a 4x4 matrix, but its last row is 1",
        ),
        (
            np.stack([np.eye(3, 4), np.full((3, 4), np.nan)]),
            r"\(matrix 1\): holds numbers that are not finite",
        ),
    ],
)
def test_odd_arrays_are_refused(tmp_path, values, message):
    np.save(tmp_path / "g.npy", values)
    with pytest.raises(LegsimError, match=message):
        files.load_geometry(tmp_path / "g.npy", columns=2, rows=2)


def test_a_byte_order_mark_is_passed_over(tmp_path):
    for name in ("g.json", "g.txt"):
        files.save_geometry(tmp_path / name, circular())
        (tmp_path / name).write_text("\ufeff" + (tmp_path / name).read_text("utf-8"), "utf-8")
        np.testing.assert_allclose(
            files.load_geometry(tmp_path / name, columns=62, rows=48).matrices, circular().matrices
        )


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(1e-3, 1e3), min_size=5, max_size=5),
    st.lists(st.booleans(), min_size=5, max_size=5),
)
def test_the_scale_and_sign_of_a_matrix_mean_nothing(tmp_path_factory, scales, flips):
    factors = np.where(flips, -1.0, 1.0) * scales
    path = tmp_path_factory.mktemp("scaled") / "g.npy"
    np.save(path, factors[:, None, None] * corrected().matrices * np.array([1, 1, 1, 1e3]))
    loaded = files.load_geometry(path, columns=62, rows=48)
    np.testing.assert_allclose(loaded.matrices, corrected().matrices, rtol=1e-9, atol=1e-9)


def test_other_refusals(tmp_path):
    with pytest.raises(LegsimError, match=r"unknown kind of geometry '\.dat'"):
        files.load_geometry(tmp_path / "g.dat")
    with pytest.raises(LegsimError, match="cannot be read"):
        files.load_geometry(tmp_path / "none.json")
    (tmp_path / "g.txt").write_text("1 2 3 x")
    with pytest.raises(LegsimError, match=r"\(line 1\): 'x' is not a number"):
        files.load_geometry(tmp_path / "g.txt", columns=2, rows=2)
    (tmp_path / "g.txt").write_text("1 2 3")
    with pytest.raises(LegsimError, match="holds 3 numbers"):
        files.load_geometry(tmp_path / "g.txt", columns=2, rows=2)
    (tmp_path / "g.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 5")
    with pytest.raises(LegsimError, match="does not say how large the detector is"):
        files.load_geometry(tmp_path / "g.txt")
    with pytest.raises(LegsimError, match="both columns and rows"):
        files.load_geometry(tmp_path / "g.txt", columns=4)
    (tmp_path / "g.npy").write_bytes(b"nothing")
    with pytest.raises(LegsimError, match=r"is not an \.npy file"):
        files.load_geometry(tmp_path / "g.npy", columns=2, rows=2)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, of numbers that overflow
@pytest.mark.parametrize("number", [1e308, 1e-308, 1e200, 1e155])
def test_matrices_of_numbers_near_the_largest_are_read_or_refused(tmp_path, number):
    matrices = np.tile(np.hstack([np.eye(3), np.ones((3, 1))]), (3, 1, 1))
    matrices[1] *= number
    matrices[2, 0, 0] = number
    np.save(tmp_path / "m.npy", matrices)
    with contextlib.suppress(LegsimError):
        files.load_geometry(tmp_path / "m.npy", columns=7, rows=6, pixel_mm=1.0)


def test_a_damaged_header_of_npy_is_refused(tmp_path):
    np.save(tmp_path / "m.npy", np.zeros((3, 3, 4)))
    data = (tmp_path / "m.npy").read_bytes()
    for damage in ((b"{'descr'", b"['descr'"), (b"'<f8'", b"[<f8'"), (b"(3, 3, 4)", b"(3, 3, 1e")):
        assert damage[0] in data
        (tmp_path / "m.npy").write_bytes(data.replace(*damage))
        with pytest.raises(LegsimError, match=r"m\.npy: "):
            files.load_geometry(tmp_path / "m.npy", columns=7, rows=6, pixel_mm=1.0)


def other_programs(path, suffix, format, geometry):
    """What comes back of a geometry that another program's format held."""
    files.save_geometry(path / f"g{suffix}", geometry, format=format)
    rows, columns = geometry.shape_vu
    size = {} if format in ("tigre", "conrad", "rtk") else {"columns": columns, "rows": rows}
    pixel = {"pixel_mm": (0.616, 0.308)} if format in ("matrices", "projtable") else {}
    found = files.read_geometry(path / f"g{suffix}", **size, **pixel, up="y")
    assert found.format == format
    return found.geometry


@pytest.mark.parametrize(
    ("suffix", "format"),
    [(suffix, name) for name, endings in files.FORMATS.items() for suffix in endings],
)
def test_every_format_keeps_rays_and_pixels_that_are_higher_than_wide(tmp_path, suffix, format):
    scan = corrected()
    flat = np.diag([1.0, 2.0, 1.0]) @ scan.matrices  # rows of half the pitch
    geometry = ConeBeamGeometry(np.arange(5) / 31, flat, (96, 62), 0.616e-3)
    if format == "legsim":
        files.save_geometry(tmp_path / "g.json", geometry)
        found = files.load_geometry(tmp_path / "g.json")
    else:
        found = other_programs(tmp_path, suffix, format, geometry)
    assert_same_rays(found, geometry, 1e-7)
    assert found.row_pitch() == pytest.approx(0.308e-3, rel=1e-9)


@pytest.mark.parametrize("format", ["matrices", "astra", "conrad", "projtable"])
def test_a_mirrored_detector_stays_mirrored_where_a_format_has_it(tmp_path, format):
    geometry = ConeBeamGeometry(np.arange(5) / 31, np.diag([1.0, 2.0, 1.0]) @ corrected().matrices, (96, 62), 0.616e-3).rows_turned()  # fmt: skip
    assert geometry.mirrored().all()
    found = other_programs(tmp_path, files.FORMATS[format][0], format, geometry)
    assert found.mirrored().all()
    assert_same_rays(found, geometry, 1e-7)


@pytest.mark.parametrize(("format", "name"), [("rtk", "g.xml"), ("tigre", "g.json")])
def test_a_mirrored_detector_is_refused_where_a_format_has_none(tmp_path, format, name):
    with pytest.raises(LegsimError, match=r"view 0 is mirrored .* has no mirror"):
        files.save_geometry(tmp_path / name, circular().rows_turned(), format=format)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(("format", "name"), [("rtk", "g.xml"), ("tigre", "g.json")])
def test_skewed_pixels_are_refused_with_view_and_angle(tmp_path, format, name):
    matrices = circular().matrices.copy()
    matrices[3] = (np.eye(3) + 0.1 * np.eye(3, k=1)) @ matrices[3]
    odd = ConeBeamGeometry(circular().times, matrices, (48, 62), 0.616e-3)
    with pytest.raises(
        LegsimError, match=r"cannot say view 3: its pixels are skewed by -?5\.\d+ deg"
    ):
        files.save_geometry(tmp_path / name, odd, format=format)


def test_the_axis_that_is_up_becomes_worlds_vertical(tmp_path):
    """What z up means for recordings: (x, y, z) becomes (x, z, -y)."""
    upright = circular(7)
    old_from_new = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    lying = upright.moved(np.linalg.inv(old_from_new))
    np.save(tmp_path / "g.npy", lying.matrices * [1, 1, 1, 1e3])
    detector = {"columns": 62, "rows": 48, "pixel_mm": 0.616}
    found = files.read_geometry(tmp_path / "g.npy", **detector)
    assert "turns about the file's z" in found.notes[0]
    turned = files.read_geometry(tmp_path / "g.npy", **detector, up="z")
    assert not turned.notes
    np.testing.assert_allclose(turned.geometry.matrices, upright.matrices, atol=1e-9)


@pytest.mark.parametrize(("up", "axis"), [("x", 0), ("y", 1), ("z", 2)])
def test_whichever_axis_is_up_becomes_worlds_y_and_nothing_is_mirrored(tmp_path, up, axis):
    tilted = transforms.rotation_from_vector(np.array([0.3, 0.5, -0.4]))
    geometry = circular(7).moved(transforms.rigid(tilted, [0.1, 0.2, 0.3]))
    np.save(tmp_path / "g.npy", geometry.matrices * [1, 1, 1, 1e3])
    detector = {"columns": 62, "rows": 48, "pixel_mm": 0.616}
    turned = files.read_geometry(tmp_path / "g.npy", **detector, up=up).geometry
    np.testing.assert_allclose(turned.sources()[:, 1], geometry.sources()[:, axis], atol=1e-9)

    def sense(sources: np.ndarray, upwards: int) -> float:
        steps = sources[1:3] - sources[0]
        return float(np.linalg.det([*steps, np.eye(3)[upwards]]))

    assert sense(turned.sources(), 1) == pytest.approx(sense(geometry.sources(), axis), abs=1e-9)


def test_a_detector_that_contradicts_the_file_is_refused(tmp_path):
    files.save_geometry(tmp_path / "g.json", circular())
    with pytest.raises(LegsimError, match="says 62 columns and 48 rows, not 60 and 48"):
        files.load_geometry(tmp_path / "g.json", columns=60, rows=48)
    with pytest.raises(LegsimError, match=r"says pixels of 0\.616 mm, not 0\.4"):
        files.load_geometry(tmp_path / "g.json", pixel_mm=0.4)
    files.save_geometry(tmp_path / "g.txt", circular())
    with pytest.raises(LegsimError, match=r"0\.616 x 0\.3 mm were given, but by the matrices"):
        files.load_geometry(tmp_path / "g.txt", columns=62, rows=48, pixel_mm=(0.616, 0.3))
    with pytest.raises(LegsimError, match="unknown format 'rtx'"):
        files.read_geometry(tmp_path / "g.txt", format="rtx")
    with pytest.raises(LegsimError, match=r"'astra' is not written with the ending '\.xml'"):
        files.save_geometry(tmp_path / "g.xml", circular(), format="astra")


@pytest.mark.parametrize("format", ["matrices", "astra", "projtable", "conrad", "rtk", "tigre"])
@pytest.mark.parametrize("number", ["1e300", "-1e160", "1e-320"])
def test_numbers_with_which_nothing_can_be_computed_are_refused(tmp_path, format, number):
    """Each number of the file in turn; some may be that small, none that large."""
    path = tmp_path / f"g{files.FORMATS[format][0]}"
    files.save_geometry(path, circular(3), format=format)
    text = path.read_text()
    places = [m.span() for m in re.finditer(r"-?\d+\.\d+(e[-+]?\d+)?", text)]
    for begin, end in places[:: max(1, len(places) // 25)]:
        path.write_text(text[:begin] + number + text[end:])
        with contextlib.suppress(LegsimError):
            found = files.read_geometry(path, columns=62, rows=48, pixel_mm=0.616)
            assert np.abs(found.geometry.matrices).max() < 1e31


def test_an_encoding_that_nobody_knows_is_refused(tmp_path):
    (tmp_path / "g.xml").write_text('<?xml version="1.0" encoding="utf-9"?><java/>')
    with pytest.raises(LegsimError, match="is not XML"):
        files.read_geometry(tmp_path / "g.xml")


def test_sources_on_a_line_turn_about_no_axis(tmp_path):
    """As in tomosynthesis; their plane is any through that line."""
    still = circular(1).matrices[0]
    line = np.tile(np.eye(4), (6, 1, 1))
    line[:, 0, 3] = np.linspace(-0.1, 0.1, 6)
    detector = {"columns": 62, "rows": 48, "pixel_mm": 0.616}
    for views in (2, 6):
        np.save(tmp_path / "g.npy", (still @ line[:views]) * [1, 1, 1, 1e3])
        notes = files.read_geometry(tmp_path / "g.npy", **detector).notes
        assert "turns about" not in " ".join(notes)


@pytest.mark.parametrize("format", ["legsim", "rtk", "astra", "tigre"])
def test_one_view_looks_at_the_same_side_after_a_round_trip(tmp_path, format):
    """Also where world's origin lies behind the source."""
    center = np.array([[0.0, 0.0, -1.2]])
    geometry = ConeBeamGeometry.circular(
        times=[0.0],
        angles=[0.0],
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(6, 8),
        pixel_pitch=2e-3,
        isocenter=center[0],
    )
    path = tmp_path / f"g{files.FORMATS[format][0]}"
    if format == "tigre":
        with pytest.raises(LegsimError, match="view 0 looks away from world's origin"):
            files.save_geometry(path, geometry, format=format)
        shift = np.array([0.0, 0.0, -1.0])
        geometry, center = geometry.moved(transforms.translation(shift)), center - shift
    files.save_geometry(path, geometry, format=format)
    size = {"columns": 8, "rows": 6} if format == "astra" else {}
    read = files.load_geometry(path, **size)
    np.testing.assert_allclose(read.project(center)[1], [[0.78]], rtol=1e-9)


def test_a_tomosynthesis_of_astra_looks_from_source_to_detector(tmp_path):
    """A fixed detector: all principal rays are parallel, whatever the origin."""
    rows = [[x, 0, 500, 0, 0, 1500, 2, 0, 0, 0, 2, 0] for x in np.linspace(-200, 200, 9)]
    np.savetxt(tmp_path / "g.txt", rows)
    read = files.read_geometry(tmp_path / "g.txt", columns=64, rows=48, format="astra").geometry
    np.testing.assert_allclose(read.project([[0, 0, 1.4]])[1], 0.9)


@pytest.mark.parametrize("format", ["rtk", "astra", "matrices", "legsim"])
@pytest.mark.parametrize(
    "given", [{"pixel_mm": p} for p in (0.0, -2.0, np.nan, np.inf)] + [{"view_rate_hz": 0.0}]
)
def test_sizes_and_rates_that_are_none_are_refused(tmp_path, format, given):
    path = tmp_path / f"g{files.FORMATS[format][0]}"
    files.save_geometry(path, circular(), format=format)
    with pytest.raises(LegsimError, match="positive"):
        files.read_geometry(path, columns=62, rows=48, format=format, **given)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("scan.xtekct", "[XTekCT]\nSrcToObject=700", "is Nikon's own description"),
        ("bruker.txt", "[System]\nScanner=SkyScan", "'System' is not a number"),
        ("scan.xml", "<Scan><SAD>1000</SAD></Scan>", "begins with <Scan.*rtkvarianobigeometry"),
        ("gvxr.json", '{"Source": {}, "Detector": {}}', 'expected the keys "unit"'),
    ],
)
def test_descriptions_of_scanners_are_refused_with_the_way_out(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(LegsimError, match=f"{said}.*as TIGRE's JSON, or a matrix per view"):
        files.read_geometry(tmp_path / name, columns=9, rows=6, pixel_mm=1.0)


def test_a_packed_geometry_is_to_be_unpacked(tmp_path):
    (tmp_path / "a.xml.gz").write_bytes(gzip.compress(b"<java/>"))
    with pytest.raises(LegsimError, match=r"a\.xml\.gz: is packed \(gzip\); unpack it"):
        files.read_geometry(tmp_path / "a.xml.gz")
