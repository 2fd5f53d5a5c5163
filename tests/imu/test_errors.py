"""Error terms of a sensor: switched by name, checked for sizes that no sensor has."""

from dataclasses import fields

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.errors import TERMS, SensorErrors, TemperatureCourse, TriadErrors

FULL = TriadErrors(
    noise_density=1e-3,
    turn_on_bias=0.1,
    instability=1e-4,
    random_walk=1e-5,
    scale_error=0.01,
    misalignment=0.02,
    g_sensitivity=1e-3,
    bias_per_kelvin=1e-3,
    scale_per_kelvin=1e-4,
    full_scale=20.0,
    bits=16,
    bandwidth_hz=80.0,
)


def test_every_field_belongs_to_one_term_or_shapes_one():
    of_terms = [name for names in TERMS.values() for name in names]
    assert len(of_terms) == len(set(of_terms))
    shapes = {"instability_time", "filter_order"}
    assert {f.name for f in fields(TriadErrors)} == {*of_terms, *shapes}


@pytest.mark.parametrize("term", TERMS)
def test_one_term_is_switched_off_and_the_others_stay(term: str):
    left = FULL.without([term])
    gone = {name for name in TERMS[term] if getattr(left, name) == 0}
    assert gone == set(TERMS[term])
    # rounding counts bits of the full scale, so that it goes with it
    also = {"bits"} if term == "saturation" else set()
    others = {f.name for f in fields(TriadErrors)} - gone - also
    assert all(getattr(left, name) == getattr(FULL, name) for name in others)


def test_one_term_alone_leaves_the_rest_off():
    errors = SensorErrors(gyroscope=FULL).only("instability", "quantisation")
    kept = {f.name for f in fields(TriadErrors) if getattr(errors.gyroscope, f.name)}
    assert kept == {"instability", "full_scale", "bits", "filter_order"}
    assert errors.accelerometer == TriadErrors()


def test_all_terms_off_is_no_error():
    assert SensorErrors(gyroscope=FULL).without(*TERMS) == SensorErrors()


def test_a_bit_is_its_share_of_the_whole_range():
    assert FULL.step == pytest.approx(40 / 65536)
    assert TriadErrors(full_scale=5.0).step == 0


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"noise_density": -1.0}, "noise_density of a sensor must be finite and not negative"),
        ({"turn_on_bias": float("nan")}, "turn_on_bias"),
        ({"bits": 16}, "needs its full scale"),
        ({"bits": 40, "full_scale": 1.0}, "at most 32 bits"),
        ({"filter_order": 9}, "order 1 to 8"),
    ],
)
def test_sizes_that_no_sensor_has_are_refused(values: dict, problem: str):
    with pytest.raises(LegsimError, match=problem):
        TriadErrors(**values)


def test_unknown_terms_and_misplaced_ones_are_refused():
    with pytest.raises(LegsimError, match=r"unknown error term 'bias'.*turn-on-bias"):
        SensorErrors().without("bias")
    with pytest.raises(LegsimError, match="unknown error term"):
        SensorErrors().only("noise")
    with pytest.raises(LegsimError, match="g-sensitivity is of gyroscopes"):
        SensorErrors(accelerometer=FULL)


def test_a_temperature_course_is_straight_between_its_points():
    course = TemperatureCourse((0.0, 10.0), (1.0, 3.0))
    np.testing.assert_allclose(course.at(np.array([-1.0, 0.0, 5.0, 20.0])), [1, 1, 2, 3])
    with pytest.raises(LegsimError, match="must increase"):
        TemperatureCourse((1.0, 1.0), (0.0, 0.0))
    with pytest.raises(LegsimError, match="one temperature per time"):
        TemperatureCourse((0.0, 1.0), (0.0,))
    with pytest.raises(LegsimError, match="not finite"):
        TemperatureCourse((0.0,), (float("inf"),))
