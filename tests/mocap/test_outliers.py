"""Spikes, ghosts and exchanged labels are found; fast but smooth motion is left alone."""

import numpy as np
import pytest

from legsim.mocap import outliers


def squat(
    rate: float, *, noise: float = 0.0002, seconds: float = 10.0, seed: int = 1
) -> np.ndarray:
    """A marker (n, 3) in meters that stands, squats 0.35 m deep within a second each way, and
    stands.
    """
    t = np.arange(int(seconds * rate)) / rate
    depth = 0.175 * (1 - np.cos(2 * np.pi * np.clip((t - 3) / 2, 0, 2)))
    path = np.stack([0.3 * depth, 0.9 - depth, 0.15 + 0.002 * np.sin(t)], axis=1)
    return path + np.random.default_rng(seed).normal(0, noise, path.shape)


@pytest.mark.parametrize("rate", [30, 60, 120, 240, 500])
@pytest.mark.parametrize("noise", [0, 0.0002, 0.002])
def test_a_squat_has_no_jumps(rate, noise):
    assert not outliers.find_jumps(squat(rate, noise=noise), 1 / rate).any()


@pytest.mark.parametrize("rate", [60, 120, 240])
def test_a_step_with_heel_strike_has_no_jumps(rate):
    t = np.arange(4 * rate) / rate
    swing = np.clip((t - 1.0) / 0.4, 0, 1)
    # swings 0.6 m forward within 0.4 s and is stopped by the floor from 2 m/s
    path = np.stack(
        [0.6 * swing**2 * (3 - 2 * swing), 0.05 + 0.08 * np.abs(np.sin(np.pi * swing)), 0 * t],
        axis=1,
    )
    assert not outliers.find_jumps(path, 1 / rate).any()


@pytest.mark.parametrize("rate", [60, 120, 240, 1000])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (9999.0, 9999.0, 9999.0)])
def test_flicker_between_a_marker_and_where_it_is_not_seen_is_found(rate, place):
    """A third of the recording; its steps say nothing of how smoothly the marker moves."""
    path = squat(rate)
    false = np.zeros(len(path), bool)
    false[len(path) // 3 : 2 * len(path) // 3 : 2] = True
    path[false] = place
    np.testing.assert_array_equal(outliers.find_jumps(path, 1 / rate), false)


@pytest.mark.parametrize("rate", [60, 120, 240])
@pytest.mark.parametrize("size", [0.02, 0.25])
@pytest.mark.parametrize("length", [1, 2, 20, 60])
@pytest.mark.parametrize("start", [0, 200, 430])
def test_a_spike_and_an_exchange_of_labels_are_found_to_the_sample(rate, size, length, start):
    clean = squat(rate)
    length = min(length, int(0.25 * rate)) if size < outliers.SLIP else length
    true = np.zeros(len(clean), bool)
    true[start : start + length] = True
    np.testing.assert_array_equal(
        outliers.find_jumps(
            np.where(true[:, None], clean + np.array([size, 0, 0]), clean), 1 / rate
        ),
        true,
    )


def test_an_exchange_that_borders_on_a_gap_is_found():
    positions = squat(120)
    positions[300:320] = np.nan
    positions[320:350, 2] -= 0.25
    true = np.zeros(len(positions), bool)
    true[320:350] = True
    np.testing.assert_array_equal(outliers.find_jumps(positions, 1 / 120), true)


def test_a_gap_in_fast_motion_is_no_jump():
    positions = squat(120)
    positions[400:430] = np.nan
    assert not outliers.find_jumps(positions, 1 / 120).any()


def test_a_marker_that_slipped_is_kept():
    positions = squat(120)
    positions[600:, 1] -= 0.012
    assert not outliers.find_jumps(positions, 1 / 120).any()


def test_of_two_markers_under_one_label_the_longer_seen_stays():
    positions = squat(120)
    positions[800:, 2] += 0.3
    found = outliers.find_jumps(positions, 1 / 120)
    assert not found[:800].any()
    assert found[800:].all()


def test_many_spikes_in_a_row_do_not_pull_the_scale_up():
    positions = squat(120)
    spikes = np.zeros(len(positions), bool)
    spikes[100:1100:40] = True
    positions[spikes] += 0.05
    np.testing.assert_array_equal(outliers.find_jumps(positions, 1 / 120), spikes)


@pytest.mark.parametrize("seen", [0, 1, 2, 3])
def test_hardly_any_samples_have_no_jumps(seen):
    positions = np.full((10, 3), np.nan)
    positions[3 : 3 + seen] = 1.0
    assert not outliers.find_jumps(positions, 0.01).any()


def test_noise_without_any_order_ends_in_time(rng):
    assert outliers.find_jumps(rng.normal(size=(3000, 3)), 0.01).shape == (3000,)
