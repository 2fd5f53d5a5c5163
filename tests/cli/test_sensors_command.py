"""`legsim sensors` as a user meets it."""

import csv
import io
import json

import pytest

from legsim.cli import main as cli_main
from legsim.core import resources
from legsim.imu import catalogue


def printed(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> str:
    """What the command prints."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["sensors", *map(str, arguments)])
    assert caught.value.code == code
    shown = capsys.readouterr()
    return shown.err if code else shown.out


def test_it_lists_every_sensor_of_the_catalogue(capsys):
    shown = printed(capsys, "--seconds", 2)
    assert all(f" {name} " in shown for name in catalogue.names())
    assert "A scan of 2 s" in shown
    assert "start tilt" in shown


def test_one_sensor_comes_with_its_numbers_and_their_sources(capsys):
    shown = printed(capsys, "adxl355_adxrs453", "--seconds", 2, "--calibration", "rest")
    assert "ADXRS453, Rev. B, 2011, page 1" in shown
    assert "levels the start" in shown
    assert "start-tilt" not in shown


def test_every_number_and_source_of_a_sensor_is_shown_whole(capsys):
    shown = printed(capsys, "bmi160", "--seconds", 1)
    for value in catalogue.load_sensor("bmi160").values:
        line = next(x for x in shown.splitlines() if f" {value.triad}.{value.key} " in x)
        assert value.source in line
        assert ("?" if value.value is None else f" {value.value:g} ") in line


def test_unverified_numbers_are_marked(capsys):
    alone = printed(capsys, "bmi160", "--seconds", 1)
    assert " 0.1 * " in alone  # g-sensitivity
    assert "unverified (*), from memory of the data sheet, page not checked" in alone
    beside = printed(capsys, "--seconds", 1)
    assert "*: a number in it is unverified" in beside
    marked = [x.split()[0] for x in beside.splitlines() if "*" in x and "unverified" not in x]
    assert set(marked) == {"adis16505", "bmi160", "bmi323"}


def test_a_file_of_ones_own_is_listed_beside_others(capsys, tmp_path):
    own = tmp_path / "a [b] sensor.toml"
    own.write_bytes(resources.model_file("sensors/bmi160.toml").read_bytes())
    rows = json.loads(printed(capsys, own, "BMI160", "--seconds", 1, "--json"))
    by_sensor = {
        name: [row["translation_m"] for row in rows if row["sensor"] == name]
        for name in (str(own), "BMI160")
    }
    assert by_sensor[str(own)] == by_sensor["BMI160"] != []


def test_csv_and_json_hold_the_same_numbers(capsys):
    options = ("bmi270", "--seconds", 1, "--temperature-k", 0, "--sway-deg", 0)
    table = list(csv.DictReader(io.StringIO(printed(capsys, *options, "--csv"))))
    records = json.loads(printed(capsys, *options, "--json"))
    numbers = [float(row["rotation_rad"]) if row["rotation_rad"] else None for row in table]
    assert numbers == [record["rotation_rad"] for record in records]
    assert "temperature" not in {row["term"] for row in table if row["rotation_rad"]}


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("bmi161",), "unknown sensor 'bmi161'; known: adis16470"),
        (("--seconds", 0), "give positive numbers"),
        (("--seconds", "nan"), "give positive numbers"),
        (("--rate-hz", -5), "give positive numbers"),
        (("--csv", "--json"), "give one of the two"),
        (("--start-tilt-deg", "nan"), "start tilt"),
        (("--temperature-k", "inf"), "temperature"),
        (("--calibration", "rest", "--rest-s", 0), "rests for some seconds"),
        (("--seconds", 1e6, "--rate-hz", 1e6), "samples"),
    ],
)
def test_wrong_options_are_one_line(capsys, arguments: tuple, problem: str):
    shown = printed(capsys, *arguments, code=1)
    assert problem in shown
    assert shown.count("\n") == 1
