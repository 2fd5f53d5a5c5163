"""Sensor files: the shipped ones say where each number is from, and wrong ones are refused."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.imu import catalogue
from legsim.imu.catalogue import KEYS, in_si, load_sensor, names, sensor_catalogue
from legsim.imu.errors import TriadErrors

GRAVITY = 9.80665


def written(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    """A copy of the BMI160's file with changed text."""
    text = resources.model_file("sensors/bmi160.toml").read_text("utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "my sensor [1].toml"
    path.write_text(text, "utf-8")
    return path


def test_the_bmi160_is_the_one_of_the_settings():
    errors = load_sensor("bmi160").errors
    assert errors.accelerometer.noise_density == pytest.approx(180e-6 * GRAVITY)
    assert errors.gyroscope.noise_density == pytest.approx(np.radians(0.007))
    assert errors.gyroscope.turn_on_bias == pytest.approx(np.radians(3))
    assert errors.gyroscope.g_sensitivity == pytest.approx(np.radians(0.1) / GRAVITY)
    assert errors.accelerometer.step == pytest.approx(4 * GRAVITY / 65536)


@pytest.mark.parametrize("name", names())
def test_every_shipped_number_has_a_source_or_a_reason(name: str):
    sensor = load_sensor(name)
    assert {(v.triad, v.key) for v in sensor.values} == {(t, k) for t in KEYS for k in KEYS[t]}
    assert all(v.source.strip() for v in sensor.values)
    stated = [v.source for v in sensor.values if v.value is not None]
    assert all("page " in source or ", " in source for source in stated)
    noise = {v.key: v.value for v in sensor.values if "noise_density" in v.key}
    # sizes of this kind of sensor, between the best and the cheapest
    assert all(
        value is None or (1e-5 < value < 0.1 if "deg" in key else 1 < value < 1000)
        for key, value in noise.items()
    )


def test_the_catalogue_has_the_sensors_that_the_documentation_names():
    assert {"bmi160", "bmi270", "bmi323", "lsm6dsv", "icm42688p", "adxl355_adxrs453"} < set(names())
    assert {"adis16470", "adis16505", "sch16t", "mti300"} < set(names())
    assert sensor_catalogue().keys() == set(names())
    assert load_sensor("BMI160") == load_sensor("bmi160")


def test_units_are_those_of_the_keys():
    gyroscope = in_si("gyroscope", {"bias_instability_deg_per_h": 3600.0})
    assert gyroscope.instability == pytest.approx(np.radians(1))
    walk = in_si("gyroscope", {"random_walk_deg_per_h_per_sqrt_h": 3600.0 * 60})
    assert walk.random_walk == pytest.approx(np.radians(1))
    base = TriadErrors(turn_on_bias=1.0, noise_density=2.0)
    changed = in_si("accelerometer", {"turn_on_bias_mg": 1000.0, "filter_order": 4.0}, base)
    assert changed.turn_on_bias == pytest.approx(GRAVITY)
    assert (changed.noise_density, changed.filter_order) == (2.0, 4)
    with pytest.raises(LegsimError, match=r"unknown key 'noise'.*turn_on_bias_mg"):
        in_si("accelerometer", {"noise": 1.0})


def test_a_file_of_ones_own_is_read_by_its_path(tmp_path: Path):
    path = written(
        tmp_path,
        ("value = 180,", "value = 90,"),
        ("[gyroscope]", '[gyroscope]\nfilter_order = { value = 3, sheet = "main", page = "4" }'),
    )
    sensor = load_sensor(path)
    assert sensor.errors.accelerometer.noise_density == pytest.approx(90e-6 * GRAVITY)
    assert sensor.errors.gyroscope.filter_order == 3
    assert "gyroscope.bias_instability_deg_per_h" in sensor.missing


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('maker = "', 'builder = "', "unknown key 'builder'"),
        ("bits = ", "bit = ", r"\[accelerometer\] unknown key 'bit'; valid here: .*bits"),
        ("[gyroscope]", "[gyro]", "unknown key 'gyro'"),
        ("value = 180,", "value = -180,", "noise_density_ug_per_sqrt_hz has the value -180"),
        ("value = 180,", 'value = "180",', "has the value '180'; give a number"),
        ("value = 180,", "value = nan,", "has the value nan"),
        ("value = 16,", "value = 16.5,", "whole number"),
        ("value = 16,", "value = 60,", "at most 32 bits"),
        ('value = 180, sheet = "main"', 'value = 180, sheet = "b"', "name one of: main"),
        ('value = 180, sheet = "main"', "value = 180, sheet = [1]", r"from the sheet \[1\]"),
        ("value = 180,", "value = 1e300,", "has the value 1e"),
        ("value = 180, ", "", "has the keys sheet, page, note"),
        ('"BMI160"', '""', "name is ''"),
        ("[sheets]\nmain", "[sheets]\n# main", "names no data sheet"),
        ("{ missing =", "{ missing = 3 } #", "missing without a reason"),
        ("[sheets]", "[sheets", "is not TOML"),
    ],
)
def test_wrong_files_are_refused_with_their_place(tmp_path: Path, old: str, new: str, problem: str):
    path = written(tmp_path, (old, new))
    with pytest.raises(LegsimError, match=problem) as error:
        load_sensor(path)
    assert "my sensor [1].toml" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_key_that_is_not_there_is_asked_for(tmp_path: Path):
    text = written(tmp_path).read_text("utf-8").splitlines()
    path = tmp_path / "short.toml"
    path.write_text("\n".join(x for x in text if not x.startswith("bias_mg_per_k")), "utf-8")
    with pytest.raises(LegsimError, match=r"\[accelerometer\] bias_mg_per_k is not there; give"):
        load_sensor(path)


def test_unknown_sensors_list_the_known_ones(tmp_path: Path):
    with pytest.raises(LegsimError, match=r"unknown sensor 'bmi161'; known: .*bmi160"):
        load_sensor("bmi161")
    with pytest.raises(LegsimError, match="cannot be read"):
        load_sensor(tmp_path / "none.toml")
    assert catalogue.names() == tuple(sorted(catalogue.names()))
