"""The low-pass: its gain, its phase, stretches apart, and cut-offs that do not fit."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap.low_pass import low_pass, runs

TIMES = np.arange(2400) / 120


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("frequency_hz", [1.0, 6.0, 12.0])
def test_two_passes_have_the_squared_gain_of_one_and_no_phase(order, frequency_hz):
    wave = np.sin(2 * np.pi * frequency_hz * TIMES)[:, None]
    # the bilinear transform warps frequencies: tan(pi f / rate)
    ratio = np.tan(np.pi * frequency_hz / 120) / np.tan(np.pi * 6 / 120)
    expected = wave / (1 + ratio ** (2 * order))
    found = low_pass(wave, 120.0, 6.0, order=order)
    np.testing.assert_allclose(found[600:-600], expected[600:-600], atol=1e-6)


def test_stretches_are_filtered_by_themselves(rng):
    values = rng.normal(size=(300, 3))
    values[120:140] = np.nan
    found = low_pass(values, 120.0, 6.0)
    np.testing.assert_array_equal(found[:120], low_pass(values[:120], 120.0, 6.0))
    np.testing.assert_array_equal(found[140:], low_pass(values[140:], 120.0, 6.0))
    assert np.isnan(found[120:140]).all()


@pytest.mark.parametrize("cutoff_hz", [0.0, 60.0, 100.0, np.nan])
def test_a_cutoff_that_does_not_fit_is_refused(cutoff_hz):
    with pytest.raises(LegsimError, match="choose one below 60 Hz"):
        low_pass(np.zeros((1200, 1)), 120.0, cutoff_hz)


def test_runs_are_given_by_their_first_and_last_index():
    assert runs([True, False, True, True]) == [(0, 0), (2, 3)]
    assert runs([False]) == []
