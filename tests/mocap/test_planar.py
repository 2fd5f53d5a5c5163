"""Markers of a video from one side are told from markers of three dimensions."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap.planar import objections


@pytest.fixture
def walk(rng) -> np.ndarray:
    """(n, m, 3) m: six markers that go forward and sway, one not seen for a while."""
    places = rng.uniform(0.1, 1.0, (6, 3))
    sway = 0.03 * np.sin(np.linspace(0, 6, 50))[:, None, None] * rng.normal(size=(1, 6, 3))
    positions = places + np.linspace(0, 1, 50)[:, None, None] * np.array([1.0, 0, 0]) + sway
    positions[10:20, 2] = np.nan
    return positions


def test_a_recording_of_three_dimensions_is_not_doubted(walk):
    assert objections(walk) == ()
    assert objections(walk[:1]) == ()
    assert objections(np.repeat(walk[:1], 40, 0)) == (), "who stands still"


@pytest.mark.parametrize("axis", [0, 2])
def test_markers_that_never_move_across_a_plane_are_reported(walk, axis):
    walk[..., axis] = walk[0, :, axis]
    walk[10:20, 2] = np.nan
    walk[..., 1 if axis == 0 else 0] += np.linspace(0, 1, 50)[:, None]
    (line,) = objections(walk)
    assert f"never do along {'xyz'[axis]} " in line


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_markers_in_one_plane_are_refused(walk, axis):
    walk[..., axis] = np.where(np.isnan(walk[..., axis]), np.nan, 0.2)
    with pytest.raises(LegsimError, match=f"lie in one plane .the same {'xyz'[axis]} in m"):
        objections(walk)


@pytest.mark.parametrize("normal", [[1, 0, -1], [0.2, 0.3, 1.0]])
def test_markers_in_a_plane_along_no_axis_are_refused(walk, normal):
    across = np.array(normal) / np.linalg.norm(normal)
    flat = walk - (walk @ across - 0.1)[..., None] * across
    with pytest.raises(LegsimError, match=r"lie in one plane .across \["):
        objections(flat)
    assert objections(flat[:, :4]) == (), "four markers of a pelvis may lie in one"
    assert objections(flat + 4e-3 * np.sin(np.arange(6))[:, None] * across) == ()


def test_two_markers_alone_say_nothing(walk):
    walk[..., 1] = 0.2
    assert objections(walk[:, :2]) == ()
