"""Sensor files: the shipped ones say where each number is from, and wrong ones are refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from legsim.core import files, resources
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
    standings = {v: v.standing for v in sensor.values}
    assert all((v.value is None) == (s == "missing") for v, s in standings.items())
    # what is not of a page of the data sheet says so in its source
    assert all(("unverified: " in v.source) == (s == "unverified") for v, s in standings.items())
    assert all(("not checked" in v.source) == (s == "unverified") for v, s in standings.items())
    assert all(("secondary: " in v.source) == (s == "secondary") for v, s in standings.items())
    assert all(re.search(r", page \d", v.source) for v, s in standings.items() if s == "sheet")


@pytest.mark.parametrize("name", names())
def test_every_source_of_a_shipped_file_is_used(name: str):
    tree = files.load_toml(resources.model_file(f"sensors/{name}.toml"))
    used = {entry["sheet"] for t in KEYS for entry in tree[t].values() if "sheet" in entry}
    assert used == tree["sheets"].keys() | tree.get("secondary", {}).keys()


# SI; from the best of this kind of sensor to the cheapest
BOUNDS = {
    ("accelerometer", "noise_density"): (1e-5, 1e-2),
    ("accelerometer", "turn_on_bias"): (1e-3, 1.0),
    ("accelerometer", "instability"): (1e-6, 1e-2),
    ("accelerometer", "bias_per_kelvin"): (1e-5, 0.05),
    ("accelerometer", "full_scale"): (2 * GRAVITY, 64 * GRAVITY),
    ("gyroscope", "noise_density"): (5e-6, 1e-3),
    ("gyroscope", "turn_on_bias"): (1e-4, 0.2),
    ("gyroscope", "instability"): (1e-7, 1e-3),
    ("gyroscope", "bias_per_kelvin"): (1e-5, 5e-3),
    ("gyroscope", "g_sensitivity"): (1e-6, 1e-3),
    ("gyroscope", "full_scale"): (np.radians(100), np.radians(4000)),
    ("both", "scale_error"): (1e-4, 0.05),
    ("both", "misalignment"): (5e-4, 0.05),
    ("both", "scale_per_kelvin"): (1e-5, 1e-3),
    ("both", "bandwidth_hz"): (10, 1000),
    ("both", "bits"): (16, 32),
}


@pytest.mark.parametrize("name", names())
def test_sizes_are_those_of_such_sensors(name: str):
    sensor = load_sensor(name)
    for value in sensor.values:
        field = KEYS[value.triad][value.key][0]
        bounds = BOUNDS.get((value.triad, field)) or BOUNDS.get(("both", field))
        if value.value is None:
            continue
        assert bounds is not None, value.key
        found = getattr(getattr(sensor.errors, value.triad), field)
        assert bounds[0] <= found <= bounds[1], (value.key, found)


@pytest.mark.parametrize("name", names())
def test_the_errors_of_a_sensor_are_in_their_order(name: str):
    errors = load_sensor(name).errors
    for triad in (errors.accelerometer, errors.gyroscope):
        # what wanders within a run is less than what differs between runs
        assert not triad.turn_on_bias or triad.instability < triad.turn_on_bias
        # a warming by 20 K moves no more than a few standard deviations of the bias
        assert 20 * triad.bias_per_kelvin <= 3 * (triad.turn_on_bias or np.inf)
        # bits are dithered by noise in half of 100 samples per second
        assert not triad.bits or triad.step < 6 * triad.noise_density * np.sqrt(50)


def test_factory_calibrated_sensors_are_better_than_bare_ones():
    bare = [load_sensor(name).errors for name in ("bmi160", "bmi270", "bmi323", "icm42688p")]
    for name in ("adis16470", "mti300", "sch16t"):
        calibrated = load_sensor(name).errors
        for other in bare:
            assert calibrated.gyroscope.turn_on_bias <= 0.5 * other.gyroscope.turn_on_bias
            assert calibrated.accelerometer.turn_on_bias <= 0.5 * other.accelerometer.turn_on_bias


def test_derived_numbers_follow_from_what_their_notes_state():
    def stated(name: str, key: str) -> float:
        value = next(v for v in load_sensor(name).values if f"{v.triad}.{v.key}" == key)
        return value.value or 0.0

    # the sheet of the ADIS16470 states both: the convention of its maker
    both = np.sqrt(2) * 0.34 / 60, stated("adis16470", _RATE_NOISE)
    assert both[0] == pytest.approx(both[1], rel=0.01)
    assert stated("adis16505", _RATE_NOISE) == pytest.approx(np.sqrt(2) * 0.13 / 60, rel=2e-3)
    instability = stated("adis16505", "accelerometer.bias_instability_ug")
    assert instability == pytest.approx(26.5 / GRAVITY, rel=2e-3)
    for name, degrees in (("adis16470", 0.1), ("adis16505", 0.25), ("mti300", 0.05)):
        tilted = stated(name, "gyroscope.misalignment_percent")
        assert tilted == pytest.approx(100 * np.tan(np.radians(degrees)), rel=5e-3)
    assert stated("mti300", "accelerometer.turn_on_bias_mg") == pytest.approx(
        50 / GRAVITY, rel=0.01
    )


_RATE_NOISE = "gyroscope.noise_density_deg_per_s_per_sqrt_hz"


def test_the_catalogue_has_the_sensors_that_the_documentation_names():
    assert {"bmi160", "bmi270", "bmi323", "lsm6dsv", "icm42688p", "adxl355_adxrs453"} < set(names())
    assert {"adis16470", "adis16505", "sch16t", "mti300"} < set(names())
    assert sensor_catalogue().keys() == set(names())
    assert load_sensor("BMI160") == load_sensor("bmi160")


_SHOWN = (
    "accelerometer.noise_density_ug_per_sqrt_hz",
    "accelerometer.turn_on_bias_mg",
    "accelerometer.bias_instability_ug",
    "gyroscope.noise_density_deg_per_s_per_sqrt_hz",
    "gyroscope.turn_on_bias_deg_per_s",
    "gyroscope.bias_instability_deg_per_h",
    "gyroscope.g_sensitivity_deg_per_s_per_g",
)


@pytest.mark.parametrize("name", names())
def test_the_documentation_shows_the_numbers_of_the_files(name: str):
    sensor = load_sensor(name)
    marks = {"sheet": "", "secondary": "′", "unverified": "\\*", "missing": ""}
    values = {f"{v.triad}.{v.key}": v for v in sensor.values}
    cells = [
        "?" if v.value is None else f"{v.value:g}{marks[v.standing]}"
        for v in (values[key] for key in _SHOWN)
    ]
    counts = [str(len(sensor.standing(standing))) for standing in marks]
    row = " | ".join((f"| `{name}`", f"{sensor.maker} {sensor.name}", *cells, *counts)) + " |"
    page = Path(__file__).parents[2] / "docs" / "sensors.md"
    assert row in page.read_text("utf-8").splitlines()


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
    assert "gyroscope.g_sensitivity_deg_per_s_per_g" in sensor.standing("unverified")
    assert "accelerometer.noise_density_ug_per_sqrt_hz" in sensor.standing("secondary")


@pytest.mark.parametrize("page", ["not checked", "Not Checked", " not checked "])
def test_a_page_that_is_not_checked_leaves_a_number_unverified(tmp_path: Path, page: str):
    sensor = load_sensor(written(tmp_path, ('page = "section 2.2"', f'page = "{page}"')))
    assert "accelerometer.noise_density_ug_per_sqrt_hz" in sensor.standing("unverified")
    assert sensor.errors == load_sensor("bmi160").errors


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
        ('value = 180, sheet = "maier"', 'value = 180, sheet = "b"', "name one of: main, maier"),
        ('value = 180, sheet = "maier"', "value = 180, sheet = [1]", r"from the sheet \[1\]"),
        ('page = "section 2.2"', 'page = " "', "noise_density_ug_per_sqrt_hz has no page; give it"),
        ('maier = "', 'main = "', "'main' is in \\[sheets\\] and in \\[secondary\\]"),
        ('maier = "Maier et al. 2022"', "maier = 2022", r"\[secondary\] names no source"),
        ("[secondary]", "[primary]", "unknown key 'primary'; valid here: .*secondary"),
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
    with pytest.raises(LegsimError, match="no such file"):
        load_sensor(tmp_path / "none.toml")
    assert catalogue.names() == tuple(sorted(catalogue.names()))


def test_a_file_of_readings_is_no_sensor(tmp_path):
    (tmp_path / "shank.csv").write_text("time,ax\n0,1\n")
    with pytest.raises(LegsimError, match=r"shank.csv: is no .* read by legsim.read_imu, and set"):
        load_sensor(tmp_path / "shank.csv")
