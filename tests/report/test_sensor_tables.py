"""Tables of the catalogue: every number is one of the budget, and what is missing is marked."""

import numpy as np
import pytest

from legsim.imu.budget import BudgetConditions, NominalMotion, PoseError, sensor_budget
from legsim.imu.calibration import Calibration
from legsim.imu.catalogue import CataloguedSensor, DataSheetValue, load_sensor
from legsim.report import sensor_tables
from legsim.report.sensor_tables import SensorBudget

MOTION = NominalMotion.swaying(2.0, 50.0, angle=0.01)


def budget(name: str) -> SensorBudget:
    sensor = load_sensor(name)
    return SensorBudget(name, sensor, sensor_budget(sensor.errors, MOTION))


def test_the_sum_is_that_of_the_squares_of_the_terms():
    found = budget("bmi160")
    terms = {line.term for line in found.lines}
    assert found.total.translation == pytest.approx(
        np.sqrt(sum(found.of(term).translation ** 2 for term in terms))
    )
    assert PoseError.together([]).translation == 0


def test_a_row_per_sensor_marks_what_its_file_lacks():
    budgets = [budget("bmi160"), budget("adis16505")]
    table = sensor_tables.catalogue_table(budgets, "translation")
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert rows["bmi160"]["instability"] == "?"
    assert rows["adis16505"]["misalignment"].endswith(" ?")
    assert rows["adis16505"]["g sensitivity"] == "?"
    assert rows["bmi160"]["g sensitivity"].endswith(" *")
    assert rows["bmi160"]["of a page"] == "2 of 19"
    noise = 1e3 * budgets[0].of("white-noise").translation
    assert float(rows["bmi160"]["white noise"]) == pytest.approx(noise, rel=5e-3)
    assert float(rows["bmi160"]["start tilt"]) > float(rows["bmi160"]["white noise"])
    turned = sensor_tables.catalogue_table(budgets, "rotation")
    assert float(turned.rows[0][-2]) == pytest.approx(
        np.degrees(budgets[0].total.rotation), rel=5e-3
    )


def test_a_sensors_terms_come_greatest_first():
    rows = sensor_tables.budget_table(budget("bmi270")).rows
    sizes = [float(row[2]) for row in rows[:-1]]
    assert sizes == sorted(sizes, reverse=True)
    assert rows[-1][0] == "all"
    assert ("start-tilt", "start") in {row[:2] for row in rows}


def test_every_number_of_a_file_is_shown_with_its_source():
    sensor = load_sensor("mti300")
    rows = sensor_tables.values_table(sensor).rows
    assert len(rows) == len(sensor.values)
    shown = {row[0]: row[1:] for row in rows}
    assert shown["gyroscope.g_sensitivity_deg_per_s_per_g"] == (
        "0.003",
        "MTi-300 product sheet, Movella, May 2023, page 1; calibrated",
    )
    assert shown["gyroscope.bits"][0] == "?"


@pytest.mark.parametrize(
    ("changed", "cell"),
    [
        ({}, "0 *?"),
        ({"accelerometer": "sheet"}, "0 *"),
        ({"gyroscope": "secondary"}, "0 ?"),
        ({"gyroscope": "missing"}, "?"),
        ({"accelerometer": "unverified", "gyroscope": "sheet"}, "0 *"),
        ({"accelerometer": "sheet", "gyroscope": "sheet"}, "0"),
    ],
)
def test_marks_are_those_of_either_triad(changed: dict, cell: str):
    standings = {"accelerometer": "missing", "gyroscope": "unverified"} | changed
    values = tuple(
        DataSheetValue(triad, "bits", None if standing == "missing" else 16, "a sheet", standing)
        for triad, standing in standings.items()
    )
    sensor = CataloguedSensor("A", "B", "C", values)
    table = sensor_tables.catalogue_table([SensorBudget("a", sensor, ())], "translation")
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["quantisation"] == cell
    assert row["white noise"] == "0"


def test_the_standing_of_all_numbers_is_counted():
    said = sensor_tables.standing_sentence(load_sensor("bmi160"))
    assert said.startswith("Of 23 numbers: 2 on a page of the data sheet, 10 in a secondary source")
    assert (
        "7 unverified (*), from memory of the data sheet, page not checked, 4 missing (?)" in said
    )
    assert "unverified" not in sensor_tables.standing_sentence(load_sensor("lsm6dsv"))


def test_records_hold_every_line_in_si():
    found = budget("bmi160")
    records = sensor_tables.records([found])
    stated = [record for record in records if record["rests_on"] != "missing"]
    assert len(stated) == len(found.lines)
    assert stated[0]["translation_m"] == found.lines[0].error.translation
    assert stated[-1]["of"] == "start"
    assert stated[-1]["rests_on"] == "given"


@pytest.mark.parametrize(
    ("name", "term", "triad", "standing"),
    [
        ("bmi160", "white-noise", "gyroscope", "secondary"),
        ("bmi160", "g-sensitivity", "gyroscope", "unverified"),
        ("lsm6dsv", "white-noise", "accelerometer", "sheet"),
        ("adis16505", "turn-on-bias", "gyroscope", "missing"),
    ],
)
def test_a_record_says_what_its_number_rests_on(name: str, term: str, triad: str, standing: str):
    records = sensor_tables.records([budget(name)])
    (one,) = [r for r in records if (r["term"], r["of"]) == (term, triad)]
    assert one["rests_on"] == standing
    assert (one["translation_m"] is None) == (standing == "missing")


@pytest.mark.parametrize(
    ("kind", "words"),
    [("none", "off by 0.1 degrees"), ("rest", "levels the start"), ("six-positions", "six")],
)
def test_the_conditions_are_said(kind: str, words: str):
    given = BudgetConditions(calibration=Calibration(kind, 5.0))
    said = sensor_tables.conditions_sentence(given, seconds=8, rate_hz=120, sway=0.0)
    assert words in said
    assert "8 s at 120 samples" in said


@pytest.mark.parametrize(
    ("value", "text"),
    [(25521.7, "25522"), (0.0, "0"), (12.345, "12.3"), (0.01234, "0.0123"), (1.2e-5, "1e-05")],
)
def test_sizes_have_three_digits(value: float, text: str):
    assert sensor_tables.size(value) == text
