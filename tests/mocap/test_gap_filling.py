"""A hidden marker is rebuilt where its neighbors would carry it, and left alone where they cannot
tell.
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.mocap import gap_filling

SHAPE = np.array(
    [[0.1, 0.02, 0.12], [0.1, 0, -0.12], [-0.1, 0.03, 0.05], [-0.1, 0.01, -0.06], [0, 0.05, 0.15]]
)
GAP = (80, 199)


@pytest.fixture
def body() -> np.ndarray:
    """Five markers (300, 5, 3) on a body that turns by a radian and moves by half a meter."""
    t = np.linspace(0, 1, 300)
    pose = transforms.rigid(
        transforms.axis_rotation([1, 2, -1], np.sin(2 * t)),
        np.stack([0.5 * t, np.cos(3 * t), t**2], -1),
    )
    return transforms.apply(pose, SHAPE)


def hidden(body, first=GAP[0], last=GAP[1]):
    positions = body[:, 0].copy()
    positions[first : last + 1] = np.nan
    return positions


@pytest.mark.parametrize("gap", [GAP, (0, 100), (150, 299)])
def test_on_a_rigid_body_the_marker_is_rebuilt_exactly(body, gap):
    found = gap_filling.fill_from_segment(hidden(body, *gap), body[:, 1:], [gap])
    np.testing.assert_allclose(found, body[:, 0], atol=1e-12)


@pytest.mark.parametrize("three", [[1, 2, 3], [1, 2, 4], [2, 3, 4]])
def test_three_others_suffice_and_never_mirror_the_marker(body, three):
    np.testing.assert_allclose(
        gap_filling.fill_from_segment(hidden(body), body[:, three], [GAP]), body[:, 0], atol=1e-12
    )


def test_noise_is_not_enlarged(body, rng):
    noisy = body + rng.normal(0, 0.0002, body.shape)
    found = gap_filling.fill_from_segment(hidden(noisy), noisy[:, 1:], [GAP])
    assert np.sqrt(((found - body[:, 0]) ** 2).sum(-1).mean()) < 0.0005


def test_skin_that_shifted_meanwhile_does_not_become_a_step(body):
    shifted = body.copy()
    shifted[:, 0] += np.linspace(0, 0.01, 300)[:, None] * [1, 0, 0]
    found = gap_filling.fill_from_segment(hidden(shifted), shifted[:, 1:], [GAP])
    np.testing.assert_allclose(found, shifted[:, 0], atol=0.003)
    assert np.linalg.norm(np.diff(found - body[:, 0], axis=0), axis=1).max() < 0.0003


def test_two_others_cannot_tell(body):
    assert np.isnan(gap_filling.fill_from_segment(hidden(body), body[:, 1:3], [GAP])[100]).all()


def test_others_that_are_hidden_in_the_same_gap_cannot_tell(body):
    others = body[:, 1:].copy()
    others[100, :2] = np.nan
    assert np.isnan(gap_filling.fill_from_segment(hidden(body), others, [GAP])[100]).all()


def test_others_in_one_line_cannot_tell(body):
    line = body[:, 1:2] + np.linspace(0, 0.2, 4)[:, None] * (body[:, 2:3] - body[:, 1:2])
    assert np.isnan(gap_filling.fill_from_segment(hidden(body), line, [GAP])[100]).all()


def test_others_that_move_against_each_other_cannot_tell(body):
    others = body[:, 1:].copy()
    others[150:, 0] += 0.2
    assert np.isnan(gap_filling.fill_from_segment(hidden(body), others, [GAP])[100]).all()


def test_a_marker_that_is_never_seen_stays_unseen(body):
    assert np.isnan(
        gap_filling.fill_from_segment(hidden(body, 0, 299), body[:, 1:], [(0, 299)])
    ).all()
