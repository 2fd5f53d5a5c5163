"""Projections of other programs: the same views from every format, and what is refused."""

import gzip

import numpy as np
import pytest
import SimpleITK as sitk
import tifffile

from legsim.core.errors import LegsimError
from legsim.geometry import counts as geometry_counts
from legsim.geometry import image_files, projection_images
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.projection_images import RawLayout, read_images, read_projections
from tests.geometry.test_files import circular

SHAPE = (5, 48, 62)


def counted(rng) -> np.ndarray:
    return rng.integers(100, 60000, SHAPE).astype(np.uint16)


def as_mha(path, values):
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.4, 0.3, 1.0))
    image.SetOrigin((-3.0, -2.0, 0.0))
    sitk.WriteImage(image, str(path / "p.mha"))
    return path / "p.mha"


def as_folder(path, values):
    for k, view in enumerate(values):
        tifffile.imwrite(path / f"view_{8 + k}.tif", view)
    return path


def as_pattern(path, values):
    (path / "readme.tif").write_text("no view")
    return as_folder(path, values) / "view_*.tif"


def as_stack(path, values):
    tifffile.imwrite(path / "p.tiff", values)
    return path / "p.tiff"


def as_npy(path, values):
    np.save(path / "p.npy", values)
    return path / "p.npy"


def as_png(path, values):
    for k, view in enumerate(values):
        sitk.WriteImage(sitk.GetImageFromArray(view), str(path / f"view_{k}.png"))
    return path


@pytest.mark.parametrize("write", [as_mha, as_folder, as_pattern, as_stack, as_npy, as_png])
def test_every_format_gives_the_same_views(tmp_path, rng, write):
    values = counted(rng)
    found = read_images(write(tmp_path, values))
    np.testing.assert_array_equal(found.values, values)
    assert found.values.dtype == np.uint16
    stated = write is as_mha
    assert found.pixel_mm == (pytest.approx((0.4, 0.3)) if stated else None)
    assert found.origin_mm == (pytest.approx((-3.0, -2.0)) if stated else None)


@pytest.mark.parametrize(
    "layout", ["U16:62x48x5", "u16be:62x48x5:12", "F32:62x48x5:7", "I32LE:62x48x5"]
)
def test_raw_numbers_by_their_layout(tmp_path, rng, layout):
    raw = RawLayout.parsed(layout)
    values = counted(rng) // 2
    content = b"x" * raw.offset + values.astype(raw.dtype).tobytes()
    (tmp_path / "p.raw").write_bytes(content)
    np.testing.assert_array_equal(read_images(tmp_path / "p.raw", raw=raw).values, values)
    (tmp_path / "p.raw").write_bytes(content + b"y")
    with pytest.raises(LegsimError, match="bytes, but 62x48x5 numbers"):
        read_images(tmp_path / "p.raw", raw=raw)
    with pytest.raises(LegsimError, match="say their layout"):
        read_images(tmp_path / "p.raw")


@pytest.mark.parametrize(
    "text", ["U16", "U12:1x1x1", "F8:1x1x1", "U16:0x1x1", "U16:1x1", "U16:1x1x1:-2"]
)
def test_no_layout_is_refused(text):
    with pytest.raises(LegsimError, match="is no layout; give type"):
        RawLayout.parsed(text)


def test_a_header_without_spacing_says_none(tmp_path, rng):
    path = as_mha(tmp_path, counted(rng))
    content = path.read_bytes()
    lines = [
        line for line in content.split(b"\n", 11) if not line.startswith((b"ElementSp", b"Offset"))
    ]
    path.write_bytes(b"\n".join(lines))
    found = read_images(path)
    assert (found.pixel_mm, found.origin_mm) == (None, None)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.his", "rtkprojections"),
        ("a.vff", "export the views"),
        ("a.h5", "save the views as"),
        ("a.raw", "--raw"),
    ],
)
def test_formats_of_vendors_are_refused_with_what_to_do(tmp_path, name, message):
    (tmp_path / name).write_bytes(b"0" * 200)
    with pytest.raises(LegsimError, match=message):
        read_images(tmp_path / name)


def test_files_of_other_sizes_are_named(tmp_path, rng):
    as_folder(tmp_path, counted(rng))
    tifffile.imwrite(tmp_path / "view_10.tif", np.zeros((4, 4), np.uint16))
    with pytest.raises(LegsimError, match=r"view_10\.tif: has \(4, 4\) columns and rows"):
        read_images(tmp_path)


def test_counts_become_line_integrals_by_what_is_given(tmp_path):
    geometry = circular()
    expected = np.zeros(SHAPE, np.float32)
    expected[:, 10:30, 20:40] = 1.5
    as_folder(tmp_path, np.rint(5e4 * np.exp(-expected)).astype(np.uint16))
    pattern = tmp_path / "view_*.tif"
    with pytest.raises(LegsimError, match=r"view_\*\.tif: holds whole numbers"):
        read_projections(pattern, geometry)
    tifffile.imwrite(
        tmp_path / "flat.tif", np.full((3, 48, 62), 5e4, np.float32), photometric="minisblack"
    )
    np.save(tmp_path / "bad.npy", np.eye(48, 62, dtype=bool))
    for given in (
        {"i0": 5e4},
        {"air": "0:10,0:48"},
        {"flat": tmp_path / "flat.tif", "bad": tmp_path / "bad.npy"},
    ):
        counts = projection_images.read_counts(**given)
        projections, notes = read_projections(pattern, geometry, counts=counts)
        away = np.abs(projections.line_integrals - expected)
        assert np.sort(away, axis=None)[:-200].max() < 1e-4
        assert ("bad" in given) == bool(notes)
    turned, _ = read_projections(pattern, geometry, counts=counts, turn_rows=True)
    np.testing.assert_array_equal(turned.line_integrals, projections.line_integrals[:, ::-1])
    assert projection_images.read_counts() is None


def test_whole_numbers_are_line_integrals_only_on_request(tmp_path):
    path = as_npy(tmp_path, np.full(SHAPE, 25, np.int16))
    with pytest.raises(LegsimError, match="holds whole numbers"):
        read_projections(path, circular())
    projections, _ = read_projections(path, circular(), line_integrals=True)
    assert (projections.line_integrals == 25).all()
    with pytest.raises(LegsimError, match="say one of the two"):
        counts = projection_images.read_counts(i0=30.0)
        read_projections(path, circular(), counts=counts, line_integrals=True)
    sitk.WriteImage(sitk.GetImageFromArray(np.ones(SHAPE, np.int16)), str(tmp_path / "p.mha"))
    with pytest.raises(LegsimError, match="holds whole numbers"):
        image_files.load_projections(tmp_path / "p.mha", circular())


def test_other_sizes_than_the_geometrys_and_odd_numbers_are_refused(tmp_path):
    path = as_npy(tmp_path, np.zeros((5, 48, 61), np.float32))
    with pytest.raises(LegsimError, match=r"holds \(61, 48, 5\) columns, rows and views"):
        read_projections(path, circular())
    values = np.zeros(SHAPE, np.float32)
    values[3, 2, 1] = np.nan
    with pytest.raises(LegsimError, match=r"\(view 3\): holds values that are not finite"):
        read_projections(as_npy(tmp_path, values), circular())


def test_files_of_unequal_numbers_of_views_are_refused(tmp_path, rng):
    values = rng.random((7, 3, 4)).astype(np.float32)
    for k, views in enumerate((values[:3], values[3:6], values[6:])):
        np.save(tmp_path / f"p{k}.npy", views)
    np.testing.assert_array_equal(projection_images.read_images(tmp_path).values, values)
    np.save(tmp_path / "p1.npy", values[3:5])
    with pytest.raises(LegsimError, match=r"p1\.npy: holds 2 views, p0\.npy 3"):
        projection_images.read_images(tmp_path)


@pytest.mark.parametrize(
    ("header", "text", "names"),
    [
        ("p.mhd", "NDims = 3\nElementDataFile = p.raw\n", ["p.raw"]),
        ("p.mhd", "NDims = 3\nElementDataFile = s%02d.raw 1 2 1\n", ["s01.raw", "s02.raw"]),
        ("p.mhd", "NDims = 3\nElementDataFile = LIST\ns02.raw\ns01.raw\n", ["s01.raw", "s02.raw"]),
        ("p.mhd", "NDims = 3\nElementDataFile = LOCAL\n", []),
        ("p.nhdr", "NRRD0004\ndimension: 3\ndata file: ./p.raw\n\n", ["p.raw"]),
        ("p.nhdr", "NRRD0004\ndata file: LIST\ns01.raw\ns02.raw\n", ["s01.raw", "s02.raw"]),
        ("p.nhdr", "NRRD0004\ndatafile: s%02d.raw 1 2 1\n", ["s01.raw", "s02.raw"]),
    ],
)
def test_files_with_the_values_of_a_header_count_as_read(tmp_path, header, text, names):
    for name in ("p.raw", "s01.raw", "s02.raw", "other.raw"):
        (tmp_path / name).touch()
    (tmp_path / header).write_text(text)
    found = projection_images.members(tmp_path / header)
    assert found[0].name == header
    assert sorted(path.name for path in found[1:]) == names


def test_a_flat_field_that_is_infinite_in_a_pixel_has_a_bad_one_there(tmp_path, rng):
    flat = np.full((2, 30, 40), 5e4)
    flat[0, 3, 4], flat[:, 20, 9], flat[1, 11, 12] = np.inf, 1e308, np.nan
    np.save(tmp_path / "flat.npy", flat)
    counts = projection_images.read_counts(flat=tmp_path / "flat.npy")
    assert counts is not None
    thick = rng.uniform(1, 1.001, (3, 30, 40))
    made = geometry_counts.line_integrals(5e4 * np.exp(-thick), counts)
    np.testing.assert_allclose(made.values, thick, atol=2e-3)
    assert "3 dead" in made.notes[0]


def test_images_without_a_pixel_are_refused(tmp_path):
    np.save(tmp_path / "none.npy", np.zeros((0, 6, 7)))
    with pytest.raises(LegsimError, match=r"none\.npy: holds no pixel"):
        read_images(tmp_path / "none.npy")


def twenty_views(rows: int) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(20.0),
        angles=np.linspace(0, 6, 20),
        source_isocenter=0.7,
        source_detector=1.1,
        shape_vu=(rows, 9),
        pixel_pitch=4e-3,
    )


def test_views_along_the_second_axis_are_refused_with_the_way_out(tmp_path):
    """ASTRA's arrays are (rows, views, columns)."""
    np.save(tmp_path / "astra.npy", np.zeros((6, 20, 9), np.float32))
    geometry = twenty_views(6)
    with pytest.raises(LegsimError, match="views seem to be the second axis, as ASTRA stores"):
        projection_images.read_projections(tmp_path / "astra.npy", geometry)


def test_views_that_are_missing_are_not_taken_for_another_order(tmp_path):
    """As many rows as views: the second axis has their count without being theirs."""
    np.save(tmp_path / "few.npy", np.zeros((18, 20, 9), np.float32))
    geometry = twenty_views(20)
    with pytest.raises(LegsimError, match="give the geometry file that belongs to these"):
        projection_images.read_projections(tmp_path / "few.npy", geometry)


def test_packed_views_are_to_be_unpacked_and_those_of_nifti_are_read(tmp_path):
    values = np.ones((2, 3, 4), np.float32)
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "a.nii.gz"))
    np.testing.assert_array_equal(read_images(tmp_path / "a.nii.gz").values, values)
    layout = RawLayout.parsed("F32:4x3x2")
    for name, raw in (("a.tif.gz", None), ("a.mha.gz", None), ("a.raw.gz", layout)):
        (tmp_path / name).write_bytes(gzip.compress(values.tobytes()))
        with pytest.raises(LegsimError, match=r"is packed \(gzip\); unpack it"):
            read_images(tmp_path / name, raw=raw)
    # two bytes of a reading are no mark
    (tmp_path / "a.raw").write_bytes(b"\x1f\x8b\x08\0" + values.tobytes()[4:])
    assert read_images(tmp_path / "a.raw", raw=layout).values.shape == values.shape


@pytest.mark.parametrize("ending", [".tif", ".dcm", ".npy", ".mha", ".nrrd", ".nii.gz"])
def test_a_pointer_of_git_lfs_is_refused_as_one(tmp_path, ending):
    path = tmp_path / f"p{ending}"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2\nsize 12345\n")
    with pytest.raises(LegsimError, match=r"is a pointer of Git LFS, .* git lfs pull"):
        projection_images.read_images(path)
