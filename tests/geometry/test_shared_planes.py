"""Planes that two views measure: their weighted sums are the same for both."""

import numpy as np
import pytest

from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.shared_planes import SharedPlanes
from tests.examples.bodies import circular

RADIUS, DENSITY = 0.03, 40.0


def same(pixels, views):
    return pixels


def ball(geometry: ConeBeamGeometry, center: tuple[float, float, float]) -> np.ndarray:
    """Exact line integrals (v, rows, columns) of a ball."""
    v, u = np.mgrid[: geometry.shape_vu[0], : geometry.shape_vu[1]]
    rays = geometry.ray_directions(u, v)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to = np.array(center) - geometry.sources()
    along = (rays * to[:, None, None]).sum(-1)
    inside = RADIUS**2 - (to**2).sum(-1)[:, None, None] + along**2
    return (2 * DENSITY * np.sqrt(np.maximum(inside, 0))).astype(np.float32)


def scan(shape_vu: tuple[int, int] = (64, 128), turn_deg: float = 90.0) -> ConeBeamGeometry:
    angles = np.radians(np.arange(0.0, turn_deg, 3.0))
    return ConeBeamGeometry.circular(
        times=np.arange(len(angles)) / 30,
        angles=angles,
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=shape_vu,
        pixel_pitch=3e-3,
        isocenter=(0.2, 1.0, -0.1),
    )


@pytest.mark.parametrize("center", [(0.2, 1.0, -0.1), (0.24, 1.01, -0.12), (0.17, 0.99, -0.06)])
def test_two_views_agree_on_planes_through_a_ball(center):
    geometry = scan()
    projections = Projections(geometry, ball(geometry, center))
    left = SharedPlanes.of(geometry).difference(projections, same)
    assert left is not None
    assert left < 0.008  # a ball of 15 pixels, rays of 2 pixels and planes of 3 rows


def test_the_finer_the_pixels_the_better_they_agree():
    lefts = []
    for factor in (1, 2):
        geometry = scan().finer(factor)
        projections = Projections(geometry, ball(geometry, (0.24, 1.01, -0.12)))
        lefts.append(SharedPlanes.of(geometry).difference(projections, same))
    assert lefts[1] < 0.7 * lefts[0]


def test_the_sum_of_a_plane_is_attenuation_over_the_distance_from_the_line_between_sources():
    geometry = scan((96, 128))
    center = np.array([0.2, 1.0, -0.1])
    images = ball(geometry, tuple(center))
    planes = SharedPlanes.of(geometry)
    pair, points, step = next(iter(planes._planes()))
    sums = planes._fan(images[pair[0]], pair[0], points, step, same, 0.01)
    sources = geometry.sources()[pair]
    line = (sources[1] - sources[0]) / np.linalg.norm(sources[1] - sources[0])
    # a disk of the ball, far from the line beside its size: its area over the middle's distance
    inwards = points[:, len(points[0]) // 2] - sources[0]
    inwards -= (inwards @ line)[:, None] * line
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    to = (center - sources[0]) - ((center - sources[0]) @ line) * line
    along = inwards @ to
    off = (to**2).sum() - along**2
    expected = DENSITY * np.pi * np.maximum(RADIUS**2 - off, 0) / along
    seen = np.isfinite(sums)
    assert seen.sum() > 20
    assert np.abs(sums - expected)[seen].max() < 0.02 * expected.max()


def test_planes_that_leave_the_detector_or_hold_an_object_that_is_cut_off_count_for_nothing():
    geometry = scan()
    images = ball(geometry, (0.2, 1.0, -0.1))
    planes = SharedPlanes.of(geometry)
    assert planes.difference(Projections(geometry, images + 1.0), same) is None
    assert planes.difference(Projections(geometry, 0 * images), same) is None


def test_views_from_nearly_one_place_share_nothing_that_tells():
    geometry = circular(5, (16, 16))
    few = geometry[:1]
    assert SharedPlanes.of(few).difference(Projections(few, np.ones((1, 16, 16))), same) is None
