"""Rays that two views measure: alike for a scan that is right, apart by any of the usual mistakes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.opposite_rays import OppositeRays, _mistakes, objection

COLUMNS, ROWS = 96, 32

BALLS = (((0.05, 0.0, 0.02), 0.03), ((-0.06, 0.01, 0.03), 0.02), ((0.0, 0.0, -0.07), 0.015))
"""middles and radii in m, no two alike, so that no mirror maps them onto themselves"""


def geometry(
    *,
    turn_deg: float = 215.0,
    pixel: float = 4e-3,
    offset: float = 0.0,
    sense: float = 1.0,
    start_deg: float = 20.0,
    back: bool = False,
) -> ConeBeamGeometry:
    angles = sense * np.radians(np.arange(0.0, turn_deg, 2.5) + start_deg)
    angles = np.concatenate([angles, angles[::-1]]) if back else angles
    plain = ConeBeamGeometry.circular(
        times=np.arange(len(angles)) / 30,
        angles=angles,
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=(ROWS, COLUMNS),
        pixel_pitch=pixel,
    )
    shift = np.eye(3)
    shift[0, 2] = offset
    return replace(plain, matrices=shift @ plain.matrices)


def scanned(
    views: ConeBeamGeometry, sway: float = 0.0, drift: float = 0.0, balls: tuple = BALLS
) -> np.ndarray:
    """Exact line integrals (v, rows, columns) of the balls, which sway or drift by m along x."""
    v, u = np.mgrid[: views.shape_vu[0], : views.shape_vu[1]]
    rays = views.ray_directions(u, v)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    moved = sway * np.sin(2 * np.pi * np.linspace(0, 1.3, len(views)))
    moved += np.linspace(0, drift, len(views))
    images = np.zeros(rays.shape[:3])
    for center, radius in balls:
        to = np.array(center) + moved[:, None] * np.eye(3)[0] - views.sources()
        along = (rays * to[:, None, None]).sum(-1)
        inside = radius**2 - (to**2).sum(-1)[:, None, None] + along**2
        images += 40 * 2 * np.sqrt(np.maximum(inside, 0))
    return images.astype(np.float32)


def test_the_ray_between_two_sources_is_the_same_line_in_both_views():
    views = geometry(offset=3.0)
    rays = OppositeRays.of(views)
    assert len(rays.views) > 100
    sources = views.sources()
    for k in range(2):
        view, other = rays.views[:, k], rays.views[:, 1 - k]
        u, v = rays.pixels[:, k].T
        along = np.stack(
            [views.ray_directions(u[i : i + 1], v[i : i + 1])[view[i], 0] for i in range(len(u))]
        )
        to = sources[other] - sources[view]
        assert np.abs(np.cross(along, to)).max() < 1e-9


@pytest.mark.parametrize("offset", [0.0, 6.0])
def test_a_scan_that_is_right_is_not_doubted(offset):
    views = geometry(offset=offset)
    assert objection(Projections(views, scanned(views))) is None


def test_nor_is_one_of_a_person_who_sways(rng):
    views = geometry()
    images = scanned(views, sway=5e-3) + rng.normal(0, 0.03, (len(views), ROWS, COLUMNS))
    assert objection(Projections(views, images.astype(np.float32))) is None


def test_images_cut_off_at_both_sides_are_not_doubted():
    whole = geometry()
    cut = 30
    shift = np.eye(3)
    shift[0, 2] = -cut
    part = ConeBeamGeometry(whole.times, shift @ whole.matrices, (ROWS, COLUMNS - 2 * cut), 4e-3)
    images = scanned(whole)[:, :, cut:-cut]
    assert images[:, ROWS // 2, 0].max() > 0.5  # something is cut off
    assert objection(Projections(part, images)) is None


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (lambda images: images[:, :, ::-1], "columns are mirrored"),
        (lambda images: images[::-1], "in reverse order"),
        (lambda images: np.roll(images, len(images) // 3, axis=0), "check the order of the views"),
    ],
)
def test_images_in_another_order_are_doubted(mistake, said):
    views = geometry()
    images = np.ascontiguousarray(mistake(scanned(views)))
    assert said in str(objection(Projections(views, images)))


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (geometry(sense=-1.0), "sense of rotation"),
        (geometry(pixel=2e-3), "pixels are twice as large"),
        (geometry(pixel=8e-3), "pixels are half as large"),
    ],
)
def test_a_geometry_of_another_scan_is_doubted_with_its_cure(stated, said):
    images = scanned(geometry())
    assert said in str(objection(Projections(stated, images)))


OR_MOTION = "unless somebody moved by several millimeters"


@pytest.mark.parametrize(("sway", "sure"), [(0.0, True), (2e-3, False)])
def test_another_size_of_pixels_that_leaves_much_may_be_motion(sway, sure):
    images = scanned(geometry(), sway=sway)
    line = str(objection(Projections(geometry(pixel=2e-3), images)))
    assert "pixels are twice as large" in line
    assert (OR_MOTION not in line) is sure


def test_a_difference_that_motion_can_make_is_said_to_be_perhaps_motion():
    views = geometry(turn_deg=200.0)
    line = str(objection(Projections(views, scanned(views, sway=20e-3))))
    assert "check the order of the views" in line
    assert line.endswith(OR_MOTION + " during the scan")
    images = np.roll(scanned(geometry()), 29, axis=0)
    assert OR_MOTION not in str(objection(Projections(geometry(), images)))


def test_an_offset_of_the_wrong_sign_is_doubted():
    images = scanned(geometry(offset=7.0))
    line = str(objection(Projections(geometry(offset=-7.0), images)))
    assert "the detector's offset along its columns has the other sign" in line


@pytest.mark.parametrize("turn_deg", [30.0, 150.0])
def test_a_short_arc_is_doubted_by_planes_where_its_columns_are_mirrored(turn_deg):
    views = geometry(turn_deg=turn_deg)
    images = scanned(views)
    assert objection(Projections(views, images)) is None
    assert objection(Projections(views, scanned(views, sway=5e-3))) is None
    line = str(objection(Projections(views, images[:, :, ::-1])))
    assert "planes that two views measure" in line
    assert "sense of rotation" in line


def test_a_ball_that_no_ray_between_sources_meets_is_doubted_by_planes():
    views = geometry(turn_deg=180.0)
    up = np.eye(4)
    up[1, 3] = 0.03
    images = scanned(views.moved(up))[:, :, ::-1]
    assert "planes" in str(objection(Projections(views, images)))


def test_a_short_arc_of_an_object_that_is_cut_off_says_nothing():
    views = geometry(turn_deg=90.0)
    images = scanned(views) + 1.0  # no air at the sides
    assert objection(Projections(views, images[:, :, ::-1])) is None


@pytest.mark.parametrize("offset", [4.0, -9.0])
def test_an_offset_that_is_left_out_is_doubted_where_the_views_are_all_around(offset):
    images = scanned(geometry(turn_deg=360.0, offset=offset), sway=2e-3)
    line = str(objection(Projections(geometry(turn_deg=360.0), images)))
    stated = re.search(r"stands ([\d.]+) columns \(([\d.]+) mm\) nearer to the (\w+)", line)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(abs(offset), abs=0.5)
    assert float(stated[2]) == pytest.approx(4 * abs(offset), abs=2)
    assert stated[3] == ("last" if offset > 0 else "first")


@pytest.mark.parametrize("turn_deg", [215.0, 360.0])
def test_somebody_who_drifts_is_no_offset(turn_deg):
    """Half a turn of somebody who drifts looks like a shift of the detector."""
    views = geometry(turn_deg=turn_deg)
    images = scanned(views, drift=8e-3)
    assert "offset" not in str(objection(Projections(views, images)))


def test_a_body_that_looks_alike_from_both_sides_is_doubted_by_planes():
    """Rays that two views measure read nearly the same mirrored, as of a leg in the middle."""
    views = geometry(turn_deg=360.0)
    images = scanned(views, balls=(((0.0, 0.0, 0.0), 0.05), ((0.03, 0.0, 0.02), 0.02)))
    mirrored = Projections(views, np.ascontiguousarray(images[:, :, ::-1]))
    apart = OppositeRays.of(views).difference(mirrored, _mistakes(views)[0])
    assert apart is not None
    assert apart < 0.08
    assert "columns are mirrored" in str(objection(mirrored))
    assert objection(Projections(views, images)) is None


@pytest.mark.parametrize("sway", [2e-3, 4e-3])
def test_a_turn_forth_and_back_is_not_all_around(sway):
    views = geometry(start_deg=0.0, back=True)
    assert objection(Projections(views, scanned(views, sway=sway))) is None


@pytest.mark.parametrize("sway", [8e-3, 12e-3, 15e-3])
def test_one_round_leg_that_sways_in_the_middle_is_not_mirrored(sway):
    """Mirroring explains 40 % of what its planes differ by, all of which is motion."""
    views = geometry(start_deg=0.0)
    images = scanned(views, sway=sway, balls=(((0.0, 0.0, 0.0), 0.055),))
    assert objection(Projections(views, images)) is None
