"""Shadows of points give back the points."""

import numpy as np

from legsim.correction.triangulation import triangulated
from tests.correction.test_fused import GEOMETRY, PLACES


def test_exact_shadows_give_the_places_whatever_their_weights(rng: np.random.Generator):
    pixels = np.array(GEOMETRY.project(np.broadcast_to(PLACES, (len(GEOMETRY), 2, 3)))[0])
    np.testing.assert_allclose(triangulated(GEOMETRY, pixels), PLACES, atol=1e-12)
    weights = rng.uniform(0.1, 1.0, pixels.shape[:2])
    np.testing.assert_allclose(triangulated(GEOMETRY, pixels, weights), PLACES, atol=1e-12)


def test_what_is_not_seen_or_has_no_weight_has_no_say():
    pixels = np.array(GEOMETRY.project(np.broadcast_to(PLACES, (len(GEOMETRY), 2, 3)))[0])
    pixels[::2, 0] = np.nan
    pixels[1::2, 1] += 50.0
    weights = np.isfinite(pixels).all(-1) * np.array([1.0, 1.0])
    weights[1::2, 1] = 0.0
    np.testing.assert_allclose(triangulated(GEOMETRY, pixels, weights), PLACES, atol=1e-12)


def test_places_are_where_the_squared_distances_to_the_rays_are_least(rng: np.random.Generator):
    pixels = np.array(GEOMETRY.project(np.broadcast_to(PLACES, (len(GEOMETRY), 2, 3)))[0])
    pixels += rng.standard_normal(pixels.shape)
    found = triangulated(GEOMETRY, pixels)

    def cost(places: np.ndarray) -> float:
        ends = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], -1)
        rays = np.linalg.solve(GEOMETRY.matrices[:, None, :, :3], ends[..., None])[..., 0]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        off = np.cross(places - GEOMETRY.sources()[:, None], rays)
        return float((off**2).sum())

    for step in 1e-5 * np.concatenate([np.eye(3), -np.eye(3)]):
        assert cost(found + step) > cost(found)
