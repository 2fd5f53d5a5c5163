"""Noise processes against the Allan deviation of another toolkit, and a low-pass against its
closed form.
"""

import allantools
import numpy as np
import pytest
from scipy.signal import butter, freqs

from legsim.imu import processes
from legsim.imu.errors import TriadErrors

RATE_HZ, HOUR = 100.0, 360_000


def allan(series: np.ndarray, seconds: list[float]) -> np.ndarray:
    """Mean over axes of the overlapping Allan deviation at these averaging times."""
    found = [
        allantools.oadev(axis, rate=RATE_HZ, data_type="freq", taus=seconds)[1] for axis in series.T
    ]
    return np.sqrt(np.mean(np.square(found), 0))


def test_an_hour_of_white_noise_has_its_density(rng: np.random.Generator):
    errors = TriadErrors(noise_density=2e-3)
    noise = errors.sample_rms(RATE_HZ) * rng.standard_normal((HOUR, 3))
    # one-sided density d: Allan deviation d / sqrt(2 t)
    times = [0.1, 1.0]
    assert allan(noise, times) == pytest.approx(2e-3 / np.sqrt(2 * np.array(times)), rel=0.05)


def test_an_hour_of_flicker_noise_has_its_instability_at_every_time(rng: np.random.Generator):
    errors = TriadErrors(instability=3e-4)
    response = processes.instability_response(errors, HOUR, RATE_HZ)
    noise = processes.coloured(rng.standard_normal((HOUR, 8)), response)
    assert allan(noise, [0.2, 1.0, 5.0, 20.0]) == pytest.approx(3e-4, rel=0.05)


def test_hours_of_gauss_markov_noise_have_their_instability_as_top(rng: np.random.Generator):
    errors = TriadErrors(instability=3e-4, instability_time=5.0)
    response = processes.instability_response(errors, HOUR, RATE_HZ)
    noise = processes.coloured(rng.standard_normal((HOUR, 8)), response)
    tops = allan(noise, [5.0, 9.45, 20.0])
    assert tops.max() == pytest.approx(3e-4, rel=0.05)
    assert tops.argmax() == 1


def test_an_hour_of_random_walk_has_its_coefficient(rng: np.random.Generator):
    errors = TriadErrors(random_walk=1e-4)
    response = processes.walk_response(errors, HOUR, RATE_HZ)
    noise = processes.coloured(rng.standard_normal((HOUR, 8)), response)
    # IEEE Std 952: K sqrt(t / 3)
    times = [1.0, 10.0]
    assert allan(noise, times) == pytest.approx(1e-4 * np.sqrt(np.array(times) / 3), rel=0.05)


def test_a_random_walk_has_the_variance_of_its_time(rng: np.random.Generator):
    errors = TriadErrors(random_walk=0.1)
    response = processes.walk_response(errors, 401, RATE_HZ)
    ends = processes.coloured(rng.standard_normal((401, 4000)), response)[-1]
    # 401 steps; 1.1 % of chance for 4000 walks
    assert ends.std() == pytest.approx(0.1 * np.sqrt(4.01), rel=0.04)


def test_coloured_noise_is_causal_and_starts_with_the_recording():
    white = np.zeros((50, 3))
    white[20] = 1.0
    response = processes.flicker_response(50)
    out = processes.coloured(white, response)
    np.testing.assert_allclose(out[:20], 0, atol=1e-12)
    np.testing.assert_allclose(out[20:, 0], response[:30], atol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize("frequency_hz", [1.0, 8.0])
def test_a_low_pass_has_butterworths_gain_and_delay(order: int, frequency_hz: float):
    rate_hz, bandwidth = 2000.0, 20.0
    times = np.arange(8000) / rate_hz
    out = processes.low_pass(np.cos(2 * np.pi * frequency_hz * times), bandwidth, order, rate_hz)
    top, bottom = butter(order, 2 * np.pi * bandwidth, analog=True)
    _, gain = freqs(top, bottom, [2 * np.pi * frequency_hz])
    settled = times > 2
    expected = np.real(gain[0] * np.exp(2j * np.pi * frequency_hz * times[settled]))
    # straight between samples: (2 pi 8 / 2000)^2 / 12 = 5e-5 per section
    np.testing.assert_allclose(out[settled], expected, atol=3e-4)


def test_a_low_pass_delays_a_ramp_by_its_group_delay():
    times = np.arange(4000) / 1000
    out = processes.low_pass(times, 10.0, 2, 1000.0)
    # second-order Butterworth: sqrt(2) / (2 pi f)
    assert (times - out)[-1] == pytest.approx(np.sqrt(2) / (2 * np.pi * 10), rel=1e-6)


def test_a_low_pass_above_the_rate_passes_everything_and_keeps_constants():
    values = np.random.default_rng(0).normal(size=(100, 3))
    np.testing.assert_allclose(processes.low_pass(np.ones(50), 5.0, 3, 100.0), 1, rtol=1e-12)
    np.testing.assert_allclose(processes.low_pass(values, 1e6, 2, 100.0), values, atol=1e-3)
