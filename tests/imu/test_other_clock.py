"""A stated rate goes with the times that stand beside it, or is in doubt."""

import numpy as np
import pytest

from legsim.imu.other_clock import rate_doubts

NAMES = ("n", "time", "x")


def table(folder, times, name="time"):
    path = folder / "a.csv"
    rows = [f"{k},{t!r},0.5" for k, t in enumerate(np.asarray(times).tolist())]
    path.write_text("\n".join([f"n,{name},x", *rows]))
    return path


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-4, 1e-6, 1e-9])
def test_a_rate_by_times_of_any_unit_is_in_no_doubt(tmp_path, rng, unit):
    steps = 0.01 + 0.003 * rng.uniform(-1, 1, size=400)
    path = table(tmp_path, np.cumsum(steps) / unit)
    assert rate_doubts(path, NAMES, None, 100.0, 399.0) == ()
    (note,) = rate_doubts(path, NAMES, None, 60.0, 399.0)
    assert "by its column 'time' the table has 100" in note or "has 99" in note
    assert "not 60 (rate_hz): give the column of times (time), or correct the rate" in note


def test_lost_packets_count(tmp_path):
    """A counter says how many samples there were."""
    path = table(tmp_path, np.r_[np.arange(100), np.arange(150, 200)] / 100)
    assert rate_doubts(path, NAMES, None, 100.0, 199.0) == ()
    assert len(rate_doubts(path, NAMES, None, 100.0, 149.0)) == 1


@pytest.mark.parametrize("name", ["time (s)", "time_s"])
def test_a_stated_unit_leaves_no_other(tmp_path, name):
    path = table(tmp_path, np.arange(100) / 100, name)
    assert rate_doubts(path, [name], None, 100.0, 99.0) == ()
    assert "has 100 samples per second, not 100000" in rate_doubts(path, [name], None, 1e5, 99.0)[0]


@pytest.mark.parametrize(
    "times",
    [
        np.arange(100),
        np.full(100, 7.0),
        np.arange(100) % 50 / 100,
        [f"12:00:{k:02}" for k in range(60)],
    ],
)
def test_what_says_no_rate_says_nothing(tmp_path, times):
    """Numbers of samples, one moment, clocks that begin anew, times of the day."""
    assert rate_doubts(table(tmp_path, times), NAMES, None, 60.0, float(len(times) - 1)) == ()


EVEN = np.arange(400) / 100


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("epoch", 1.7e9 + np.floor(EVEN[:350])),
        ("time", np.floor(EVEN / 0.16) * 0.16),
        ("time", np.floor((EVEN + 0.1) / 0.16) * 160),
        ("time (min)", EVEN / 60),
        ("time (h)", EVEN / 3600),
        ("Time", EVEN / 60),
        ("datenum_time", 738000.5 + np.arange(400) / 8_640_000),
        ("timestamp", 2000 + np.round(32768 * EVEN)),
        ("timestamp", EVEN / 312.5e-6),
        ("time (ticks)", np.round(40e6 * EVEN)),
        ("elapsed", np.round(40e6 * EVEN)),
    ],
)
def test_right_rates_beside_times_of_other_units_or_coarse_ones_are_in_no_doubt(
    tmp_path, name, times
):
    """Whole seconds, times of delivery, days, minutes, and ticks of processors."""
    path = table(tmp_path, times, name)
    assert rate_doubts(path, [name], None, 100.0, len(times) - 1.0) == ()


@pytest.mark.parametrize("rate_hz", [50.0, 200.0, 60.0, 128.0])
def test_wrong_rates_beside_times_of_delivery_are_in_doubt(tmp_path, rate_hz):
    path = table(tmp_path, np.floor(EVEN / 0.16) * 0.16)
    assert "has 103.9 samples" in rate_doubts(path, NAMES, None, rate_hz, 399.0)[0]
