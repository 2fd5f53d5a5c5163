"""Two recordings on shared times: splines, their derivative, and a band without delay."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.recording import ImuRecording
from legsim.imu.shared_time import (
    MOVEMENT_HZ,
    at,
    band_passed,
    in_band,
    overlap,
    shared_s,
    short,
)
from tests.examples.sensors import still

TIMES = np.arange(1000) / 100


def waves(*frequencies_hz: float) -> np.ndarray:
    turns = np.outer(TIMES, frequencies_hz) + np.arange(len(frequencies_hz)) / (2 * np.pi)
    return np.sin(2 * np.pi * turns).sum(-1)[:, None] * [1.0, 2.0, 3.0]


def test_shared_times_are_even_and_within_both():
    a, b = still(count=1000), still(count=1000).shifted(2.345)
    times = overlap(a, b, 0.02)
    assert times[0] == pytest.approx(2.345)
    assert times[-1] <= a.times[-1]
    np.testing.assert_allclose(np.diff(times), 0.02)
    with pytest.raises(LegsimError, match=r"share less than 0\.5 s"):
        overlap(a, still(count=1000).shifted(9.6), 0.02)


def test_the_derivative_of_a_wave_is_that_of_the_wave():
    one = ImuRecording("a", TIMES, waves(0.5), np.ones((1000, 3)))
    inner = TIMES[50:-50] + 0.003
    expected = np.pi * np.cos(np.pi * inner)[:, None] * [1.0, 2.0, 3.0]
    np.testing.assert_allclose(at(one, inner, "rate", derivative=1), expected, atol=1e-4)
    np.testing.assert_array_equal(at(one, np.array([99.0]), "force"), [[1.0, 1.0, 1.0]])


def test_a_band_keeps_what_is_in_it_without_delay():
    kept = in_band(
        ImuRecording("a", TIMES, waves(1.0, 15.0) + 7.0, np.ones((1000, 3))),
        TIMES, MOVEMENT_HZ, "rate",
    )  # fmt: skip
    np.testing.assert_allclose(kept[300:-300], waves(1.0)[300:-300], atol=0.12)


def test_columns_of_any_shape_are_filtered_alike():
    values = waves(1.0, 15.0)
    stacked = np.stack([values, 2 * values], -1)
    found = band_passed(stacked, TIMES, MOVEMENT_HZ)
    np.testing.assert_allclose(found[..., 1], 2 * found[..., 0], atol=1e-12)
    np.testing.assert_allclose(found[..., 0], band_passed(values, TIMES, MOVEMENT_HZ), atol=1e-12)


def test_shared_time_is_counted_and_negative_between_recordings_apart():
    one = still(count=1000)
    assert shared_s(one, one.shifted(6.9)) == pytest.approx(9.99 - 6.9)
    assert shared_s(one.shifted(12.0), one) == pytest.approx(9.99 - 12.0)


def test_the_advice_helps_the_recordings_at_hand():
    """An offset cures long recordings that were started apart, a longer trial those that are short."""
    long, brief = still(count=1000), still(count=200)
    assert str(short(long, long.shifted(8.0), 3.0)).endswith(
        "share less than 3 s; give clock_offset_s (the sensor's clock minus the markers') in a "
        "TOML about its file"
    )
    assert "record a longer trial, or state clock_offset_s" in str(short(long, brief, 3.0))
    assert str(short(brief, still(count=40), 0.5)).endswith("record a longer trial")
