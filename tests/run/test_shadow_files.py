"""CSV files of shadows: other programs' spellings, what is refused, and what images speak against."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction.fiducials import FIDUCIAL_NAMES
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.run import shadow_files

VIEWS = 62
GEOMETRY = ConeBeamGeometry.circular(
    times=np.arange(VIEWS) / 31,
    angles=np.radians(3.2) * np.arange(VIEWS),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(90, 110),
    pixel_pitch=2e-3,
)
BEADS = np.array([[0.03, -0.02, 0.01], [-0.01, 0.025, -0.03]])


def bead_rows(pixels: np.ndarray, separator: str = ",", decimal: str = ".") -> str:
    numbers = [
        (str(view), str(bead), *(f"{x:.3f}".replace(".", decimal) for x in pixels[view, bead]))
        for view in range(len(pixels))
        for bead in range(pixels.shape[1])
    ]
    return "\n".join(separator.join(row) for row in [("view", "bead", "u", "v"), *numbers]) + "\n"


@pytest.fixture
def pixels():
    return GEOMETRY.project(BEADS)[0]


@pytest.mark.parametrize(
    ("separator", "decimal", "encoding"),
    [(",", ".", "utf-8"), (";", ",", "utf-8-sig"), ("\t", ".", "utf-16"), (", ", ".", "utf-8")],
)
def test_tables_of_other_programs_are_read(tmp_path, pixels, separator, decimal, encoding):
    path = tmp_path / "beads.csv"
    path.write_text(bead_rows(pixels, separator, decimal), encoding)
    np.testing.assert_allclose(shadow_files.load_beads(path, GEOMETRY), pixels, atol=1e-3)


def test_what_is_not_seen_has_no_row_or_empty_pixels(tmp_path, pixels):
    rows = bead_rows(pixels).splitlines()
    rows[1:6] = ["0,0,,", "0,1,nan,NaN", "1.0,0.0,7,8", "2,0,9,9"]
    (tmp_path / "beads.csv").write_text("\n".join(rows))
    found = shadow_files.load_beads(tmp_path / "beads.csv", GEOMETRY)
    assert np.isnan(found[0]).all()
    np.testing.assert_array_equal(found[1:3, 0], [[7, 8], [9, 9]])
    assert np.isnan(found[1, 1]).all()
    np.testing.assert_allclose(found[3:], pixels[3:], atol=1e-3)


def test_one_row_is_a_table(tmp_path):
    (tmp_path / "beads.csv").write_text("view,bead,u,v\n3,0,9,8\n")
    found = shadow_files.load_beads(tmp_path / "beads.csv", GEOMETRY)
    np.testing.assert_array_equal(found[3], [[9, 8]])
    assert np.isfinite(found).sum() == 2


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("0,0,x,1\n50,0,3,3", r"line 2.: 'x' in column 'u' is not a number"),
        (
            "62,0,1,1\n50,0,3,3",
            r"line 2.: view 62, bead 0 .* count views from 0 to 61, beads from 0 to 999, and",
        ),
        ("0,x,9,9\n50,0,3,3", r"line 2.: bead 'x' is no whole number; number the beads from 0"),
        ("0,x,9,9", r"line 2.: bead 'x' is no whole number; number the beads from 0"),
        ("0,1.5,9,9\n50,0,3,3", r"line 2.: bead '1.5' is no whole number"),
        ("0,1000,1,1\n50,0,3,3", r"bead 1000 at 1, 1 is none of this scan"),
        ("0,0,nan,1\n50,0,3,3", r"none of this scan; .* leave out what is not seen"),
        ("0,0,1,1\n0,0,1,2", r"line 3.: bead 0 of view 0 is there twice; keep one"),
        ("0,1,1,1\n50,1,3,3", r"has beads \[1\]; count beads from 0"),
        ("0,0,12345,3\n5,0,3,3", r"line 2.: bead 0 of view 0 at 12345, 3 is beyond"),
        ("", "holds no samples"),
    ],
)
def test_what_is_wrong_with_a_file_of_beads_is_named_with_its_line(tmp_path, rows, said):
    path = tmp_path / "beads.csv"
    path.write_text(f"view,bead,u,v\n{rows}\n")
    with pytest.raises(LegsimError, match=said):
        shadow_files.load_beads(path, GEOMETRY)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("0,a,1,1\n50,x,3,3", r"line 2.: view 0, point a .* name the points origin, x, y, z"),
        ("62,x,1,1\n50,x,3,3", r"line 2.: view 62, point x .* count views from 0 to 61"),
        ("0,x,1,1\n0,x,2,2", r"line 3.: point x of view 0 is there twice"),
        ("0,x,1,-9\n50,x,3,3", r"line 2.: point x of view 0 at 1, -9 is beyond the \d+ columns"),
        ("0,x,one,1\n50,x,3,3", r"line 2.: 'one' in column 'u' is not a number"),
    ],
)
def test_what_is_wrong_with_a_file_of_fiducials_is_named_with_its_line(tmp_path, rows, said):
    path = tmp_path / "points.csv"
    path.write_text(f"view,point,u,v\n{rows}\n")
    with pytest.raises(LegsimError, match=said):
        shadow_files.load_fiducials(path, GEOMETRY)


def test_the_first_views_that_show_all_points_are_those_of_a_start(tmp_path):
    rows = [f"{view},{name},{view}.5,2" for view in range(5) for name in FIDUCIAL_NAMES]
    rows.remove("3,y,3.5,2")
    path = tmp_path / "p.csv"
    path.write_text("\n".join(["view,point,u,v", *rows]))
    pixels = shadow_files.load_fiducials(path, GEOMETRY)
    assert shadow_files.first_views(path, pixels).tolist() == [
        [[view + 0.5, 2.0]] * 4 for view in range(3)
    ]
    with pytest.raises(LegsimError, match="lacks point 'y' of view 0"):
        shadow_files.first_views(path, pixels[3:])


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("99999999999999999999,origin,1,2", "none of this scan"),
        ("0,x,nan,2", "none of this scan"),
        ("0,x,1e300,2", "is not a number"),
        ("-1,x,1,2", "none of this scan"),
        ("0.5,x,1,2", "none of this scan"),
        ("0,x,999,2", "is beyond"),
    ],
)
def test_points_that_cannot_be_are_refused_at_once(tmp_path, row, said):
    rows = ["view,point,u,v", *(f"0,{name},1,2" for name in FIDUCIAL_NAMES if name != "x")]
    (tmp_path / "p.csv").write_text("\n".join([*rows, row, ""]))
    with pytest.raises(LegsimError, match=said):
        shadow_files.load_fiducials(tmp_path / "p.csv", GEOMETRY)


def test_points_beyond_the_detector_are_read_where_it_has_no_bounds(tmp_path):
    rows = [f"{view},{name},-700,2" for view in range(2) for name in FIDUCIAL_NAMES]
    (tmp_path / "p.csv").write_text("\n".join(["view,point,u,v", *rows]))
    found = shadow_files.load_fiducials(tmp_path / "p.csv", GEOMETRY, bounded=False)
    assert (found[:2, :, 0] == -700).all()


def with_shadows(pixels: np.ndarray) -> Projections:
    """Noise, with a square of 3 x 3 pixels about each shadow."""
    images = np.random.default_rng(5).normal(2, 0.01, (VIEWS, *GEOMETRY.shape_vu))
    for image, shadows in zip(images, pixels.round().astype(int), strict=True):
        for u, v in shadows:
            image[v - 1 : v + 2, u - 1 : u + 2] += 0.5
    return Projections(GEOMETRY, images.astype(np.float32))


@pytest.mark.parametrize(
    ("mistaken", "said"),
    [
        (lambda p: p, ""),
        (lambda p: p + 1, ""),
        (lambda p: p[..., ::-1], "(column, row) are exchanged"),
        (lambda p: p * [1, -1] + [0, 89], "rows are counted from the other edge"),
        (lambda p: p * [-1, 1] + [109, 0], "columns are counted from the other edge"),
        (
            lambda p: np.where(np.arange(VIEWS)[:, None, None] < 30, p, p[:, ::-1]),
            "miss each other",
        ),
    ],
)
def test_images_and_rays_speak_against_mistaken_pixels(tmp_path, pixels, mistaken, said):
    found = shadow_files.doubts(tmp_path, "bead", mistaken(pixels), with_shadows(pixels))
    assert len(found) == bool(said)
    assert all(said in line for line in found)


def test_images_without_shadows_say_nothing(tmp_path, pixels):
    """Beads may have been removed from the images."""
    plain = with_shadows(pixels[:, :0])
    assert not shadow_files.doubts(tmp_path, "bead", pixels, plain)
    assert not shadow_files.doubts(tmp_path, "bead", pixels * [1, -1] + [0, 89], plain)
