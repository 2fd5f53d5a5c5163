"""The ramp filter's kernels have the frequencies of their names."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.reconstruction import ramp_filter
from legsim.reconstruction.ramp_filter import FilterOptions


def test_the_ramp_has_the_slope_of_the_frequency() -> None:
    length, response = ramp_filter.filter_response(2000, "ram-lak")
    frequency = np.fft.rfftfreq(length)
    np.testing.assert_allclose(response, frequency, atol=2e-4)


def test_shepp_logan_is_the_ramp_times_a_sinc() -> None:
    length, response = ramp_filter.filter_response(2000, "shepp-logan")
    frequency = np.fft.rfftfreq(length)
    np.testing.assert_allclose(response, frequency * np.sinc(frequency), atol=2e-4)


def test_options_that_make_no_sense_are_refused() -> None:
    with pytest.raises(LegsimError, match="ram-lak, shepp-logan, hann"):
        FilterOptions(window="gauss")  # type: ignore[arg-type]
    with pytest.raises(LegsimError, match="water_attenuation"):
        FilterOptions(water_attenuation=-1.0)
