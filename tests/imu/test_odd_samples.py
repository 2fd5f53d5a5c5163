"""What no sensor reads by itself is in doubt, and what sensors read is not."""

import numpy as np
import pytest

from legsim.imu.odd_samples import odd_notes
from tests.examples.sensors import still, swaying


def readings(rng, lean=0.3):
    one = swaying(lean=lean)
    noise = np.r_[[0.002] * 3, [0.02] * 3] * rng.normal(size=(len(one.times), 6))
    return one.times, one.readings + noise


def test_what_sensors_read_is_not(rng):
    assert odd_notes("a", *readings(rng)) == ()
    one = still(count=3000)
    coarse = np.round(one.readings / 0.005) * 0.005
    assert odd_notes("a", one.times, one.readings) == ()
    assert odd_notes("a", one.times, coarse) == ()
    steps = one.readings.copy()
    steps[::110, 3:] += 30.0  # as heels that strike
    assert odd_notes("a", one.times, steps) == ()


@pytest.mark.parametrize(
    ("axis", "said"), [(1, "angular velocity along y"), (3, "acceleration along x")]
)
def test_an_axis_that_never_changes(rng, axis, said):
    times, read = readings(rng)
    read[:, axis] = 0.25
    (note,) = odd_notes("a", times, read)
    assert note.startswith(f"In doubt: sensor a: its {said} never changes")


@pytest.mark.parametrize(
    ("axis", "size", "said"),
    [
        (2, np.radians(900), "one angular velocity at 7.000 s is 89"),
        (5, 40.0, "one acceleration at 7.0"),
    ],
)
def test_a_lone_spike(rng, axis, size, said):
    times, read = readings(rng)
    read[700, axis] += size
    (note,) = odd_notes("a", times, read)
    assert said in note


@pytest.mark.parametrize("digits", [4, 9])
def test_a_gap_that_was_filled_by_a_line(rng, digits):
    times, read = readings(rng)
    share = (np.arange(300, 361) - 300)[:, None] / 60
    read[300:361] = (1 - share) * read[300] + share * read[360]
    (note,) = odd_notes("a", times, np.round(read, digits))
    assert "59 of 1200 samples lie on straight lines between others" in note
    assert "the longest stretch is 600 ms at 3.000 s" in note


def smooth(rng, count, kernel):
    """Noise of unit variance, averaged over some samples."""
    noise = rng.normal(size=(count + kernel, 6))
    mean = np.stack([np.convolve(v, np.hanning(kernel + 2)[1:-1], "same") for v in noise.T], -1)
    return mean[:count] / mean.std(0)


@pytest.mark.parametrize("digit", [1e-9, 1e-3, 0.02])
@pytest.mark.parametrize(("rate_hz", "kernel"), [(50, 1), (200, 1), (200, 10), (200, 40)])
def test_rest_before_and_amid_fast_motion_is_not_filled(rng, rate_hz, kernel, digit):
    """Its noise is small beside what readings in motion are bent by."""
    times = np.arange(30 * rate_hz) / rate_hz
    rest = np.r_[[0.0008] * 3, [0.008] * 3] * smooth(rng, len(times), kernel)
    motion = np.r_[[5.0] * 3, [11.0] * 3] * smooth(rng, len(times), max(2, kernel // 4))
    moves = (times > 4) & (np.abs(times - 15) > 0.3) & (np.abs(times - 20) > 2)
    read = rest + np.where(moves[:, None], motion, np.r_[0, 0, 0, 0, 0, 9.8])
    assert odd_notes("a", times, np.round(read / digit) * digit) == ()
