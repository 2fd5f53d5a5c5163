import numpy as np
import pytest
import trimesh

from legsim.phantom import skinning
from legsim.phantom.skinning import FAR, NEAR, TissueMobility

BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
SHARE = TissueMobility([(np.asarray(BALL.vertices), np.asarray(BALL.faces))])


def test_a_bones_surface_takes_nothing_of_the_swing_and_what_is_far_from_it_all():
    """Also between the vertices of its long triangles."""
    places, _ = trimesh.sample.sample_surface(BALL, 3000, seed=1)
    np.testing.assert_array_equal(SHARE.at(places), 0)
    away = places * (1 + 0.001 / 0.03)
    np.testing.assert_array_equal(SHARE.at(away), 0)
    np.testing.assert_array_equal(SHARE.at(places * (1 + (FAR + 1e-3) / 0.03)), 1)


def test_between_them_it_rises_and_never_faster_than_the_farthest_swing_allows():
    heights = np.linspace(0, 0.04, 400)
    shares = SHARE.at(
        np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8]) * (0.03 + heights)[:, None]
    )
    slopes = np.diff(shares) / np.diff(heights)
    assert (slopes >= 0).all()
    assert shares[0] == 0
    assert shares[-1] == 1
    assert slopes.max() * skinning.FARTHEST_SWING == pytest.approx(0.5, rel=0.02)
    assert NEAR < heights[np.argmax(slopes)] < FAR
