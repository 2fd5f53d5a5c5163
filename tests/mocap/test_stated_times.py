"""Times of few digits are found again as they were; what rounding does not explain stays."""

import numpy as np
import pytest

from legsim.mocap._stated_times import full_times, last_digit


def stated(times: np.ndarray, digits: int, *, cut: bool = False) -> np.ndarray:
    """The times as a file states them, rounded or cut off."""
    scale = 10.0**digits
    return (np.floor(times * scale + 1e-9) if cut else np.round(times * scale)) / scale


@pytest.mark.parametrize("rate", [30.0, 59.94, 60.0, 119.88, 120.0, 148.1, 240.0])
@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("lost", [(), (300,), (2, 3, 77, 400), tuple(range(200, 330))])
def test_rates_that_are_no_whole_milliseconds_are_found_again(rate, cut, lost):
    times = 1.5 + np.delete(np.arange(600), lost) / rate
    found = full_times(stated(times, 3, cut=cut), 1e-3)
    steps = np.diff(found) * rate
    np.testing.assert_allclose(steps, np.rint(steps), atol=2e-3 * (1 + len(lost)))
    np.testing.assert_allclose(found, times, atol=1.01e-3)
    assert len(np.unique(np.rint(steps))) == len(np.unique(np.diff(times).round(6)))


@pytest.mark.parametrize("rate", [119.88, 120.0, 150.0, 200.0, 250.0])
def test_samples_closer_than_the_digit_are_even(rate):
    times = np.arange(500) / rate
    found = full_times(stated(times, 2), 1e-2)
    np.testing.assert_allclose(np.diff(found) * rate, 1, atol=2e-3)


@pytest.mark.parametrize("change", [
    lambda k: np.delete(k, 40), lambda k: np.insert(k, 40, 40), lambda k: np.delete(k, [30, 31]),
])  # fmt: skip
@pytest.mark.parametrize("rate", [100.0, 90.0, 50.0])
def test_a_row_left_out_or_there_twice_is_not_smoothed_away(change, rate):
    times = stated(change(np.arange(100)) / rate, 2)
    steps = np.diff(full_times(times, 1e-2))
    assert steps.max() > 1.5 * np.median(steps) or steps.min() <= 0


def test_what_rounding_does_not_explain_stays():
    rng = np.random.default_rng(1)
    uneven = stated(np.cumsum(rng.uniform(0.005, 0.03, 200)), 3)
    fine = np.arange(200) / 120
    for times, digit in ((uneven, 1e-3), (fine, 1e-9), (np.arange(5) / 119, 1e-3)):
        assert full_times(times, digit) is times


def test_exact_times_stay_to_the_bit():
    for times in (np.arange(200) / 250, np.delete(np.arange(200), [7, 90]) / 100):
        assert full_times(times, 1e-3) is times


def test_the_longest_text_has_the_last_digit():
    assert last_digit(["0.1", "0.125", "2"]) == pytest.approx(1e-3)
    assert last_digit(["8", "16"]) == 1.0
