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
