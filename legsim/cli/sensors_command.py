"""`legsim sensors`: the catalogue of sensors, and what each error costs over a scan."""

from enum import StrEnum
from typing import Annotated

import typer

from legsim.cli import console
from legsim.core.errors import LegsimError


class Calibration(StrEnum):
    """What is recorded before the scan."""

    none = "none"
    rest = "rest"
    six_positions = "six-positions"


def sensors(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SENSOR]...",
            help="Sensors by name, or TOML files of sensors. Default: the whole catalogue.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Duration of the scan.")] = 8.0,
    rate_hz: Annotated[float, typer.Option(help="Samples per second.")] = 120.0,
    calibration: Annotated[
        Calibration, typer.Option(help="What is recorded before the scan.")
    ] = Calibration.none,
    rest_s: Annotated[float, typer.Option(help="Duration of each rest of a calibration.")] = 10.0,
    start_tilt_deg: Annotated[
        float, typer.Option(help="Tilt error of the start, about each horizontal axis.")
    ] = 0.1,
    temperature_k: Annotated[
        float, typer.Option(help="Temperature of the scan against that of the calibration.")
    ] = 1.0,
    sway_deg: Annotated[float, typer.Option(help="Sway of the sensor; 0 stands still.")] = 1.0,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV in SI units instead.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print JSON in SI units instead.")
    ] = False,
) -> None:
    """List sensors that one can buy, and what each of their errors costs in dead reckoning.

    With one SENSOR: its numbers, their sources, and its budget.
    """
    import json
    import math

    from legsim.imu import calibration as imu_calibration
    from legsim.imu.budget import BudgetConditions, NominalMotion, sensor_budgets
    from legsim.imu.catalogue import load_sensor
    from legsim.imu.catalogue import names as shipped
    from legsim.report import formats, sensor_tables

    if as_csv and as_json:
        raise LegsimError("--csv and --json: give one of the two")
    chosen = {name: load_sensor(name) for name in (names or shipped())}
    sway = math.radians(sway_deg)
    motion = NominalMotion.swaying(seconds, rate_hz, angle=sway)
    given = BudgetConditions(
        math.radians(start_tilt_deg),
        temperature_k,
        imu_calibration.Calibration(calibration.value, rest_s),
    )
    lines = sensor_budgets([sensor.errors for sensor in chosen.values()], motion, given)
    budgets = [
        sensor_tables.SensorBudget(name, sensor, found)
        for (name, sensor), found in zip(chosen.items(), lines, strict=True)
    ]
    records = sensor_tables.records(budgets)
    if as_json:
        console.out.print(json.dumps(records, indent=1))
        return
    if as_csv:
        rows = [list(record.values()) for record in records]
        console.out.print(formats.csv_text(list(records[0]) if records else [], rows), end="")
        return
    tables = (
        [sensor_tables.values_table(s) for s in chosen.values()]
        + [sensor_tables.budget_table(b) for b in budgets]
        if len(budgets) == 1
        else [sensor_tables.catalogue_table(budgets, w) for w in ("translation", "rotation")]
    )
    for table in tables:
        console.print_table(table.caption, table.columns, list(table.rows))
    sentence = sensor_tables.conditions_sentence(given, seconds=seconds, rate_hz=rate_hz, sway=sway)
    note = (
        sensor_tables.standing_sentence(budgets[0].sensor)
        if len(budgets) == 1
        else sensor_tables.NOTE
    )
    console.print_lines([sentence, note])
