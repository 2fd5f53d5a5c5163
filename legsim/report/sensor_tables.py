"""Tables of the sensor catalogue: what is stated of each sensor, and what its errors cost."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from legsim.imu.budget import BUDGET_TERMS, START_TILT, BudgetConditions, BudgetLine, PoseError
from legsim.imu.catalogue import KEYS, CataloguedSensor, DataSheetValue, Standing, field_of
from legsim.imu.errors import TERMS
from legsim.report.page import Table

UNKNOWN = "?"
UNVERIFIED = "*"

NOTE = (
    f"{UNKNOWN}: the sensor's file has no value, of gyroscope or accelerometer where a number "
    "stands before it; what is missing is not in the sum. "
    f"{UNVERIFIED}: a number in it is unverified, from memory of the data sheet, page not checked. "
    "Of a page: numbers read on a page of the data sheet, of all that the file has."
)


@dataclass(frozen=True, slots=True)
class SensorBudget:
    """A sensor and what its errors cost."""

    key: str
    """its name in settings"""
    sensor: CataloguedSensor
    lines: tuple[BudgetLine, ...]

    def of(self, term: str) -> PoseError:
        """Error of a term, gyroscope and accelerometer together."""
        return PoseError.together([line.error for line in self.lines if line.term == term])

    @property
    def total(self) -> PoseError:
        """Error of all terms together."""
        return PoseError.together([line.error for line in self.lines])


def catalogue_table(
    budgets: Sequence[SensorBudget], what: Literal["translation", "rotation"]
) -> Table:
    """One row per sensor, one column per term: root mean square over the scan, in mm or degrees."""
    unit, factor = ("mm", 1e3) if what == "translation" else ("degrees", float(np.degrees(1)))
    terms = (*BUDGET_TERMS, START_TILT)
    rows = []
    for budget in budgets:
        cells = [_marked(budget, term, factor * getattr(budget.of(term), what)) for term in terms]
        total = size(factor * getattr(budget.total, what))
        rows.append((budget.key, *cells, total, _of_a_page(budget.sensor)))
    columns = ("sensor", *(term.replace("-", " ") for term in terms), "all", "of a page")
    caption = f"{what.capitalize()} error of dead reckoning ({unit}, root mean square over a scan)"
    return Table(caption, columns, tuple(rows), NOTE)


def _of_a_page(sensor: CataloguedSensor) -> str:
    stated = len(sensor.values) - len(sensor.missing)
    return f"{len(sensor.standing('sheet'))} of {stated}"


def _marked(budget: SensorBudget, term: str, value: float) -> str:
    stated = [v for v in budget.sensor.values if _term_of(v) == term]
    lacking = {v.triad for v in stated if v.standing == "missing"}
    there = {t for t in KEYS if any(field in TERMS.get(term, ()) for field, _ in KEYS[t].values())}
    if lacking and lacking == there:
        return UNKNOWN
    unverified = any(v.standing == "unverified" for v in stated)
    marks = UNVERIFIED * unverified + UNKNOWN * bool(lacking)
    return f"{size(value)} {marks}".rstrip()


def _term_of(value: DataSheetValue) -> str | None:
    field = field_of(value)
    return next((term for term, fields in TERMS.items() if field in fields), None)


def budget_table(budget: SensorBudget) -> Table:
    """One row per term and triad of one sensor, the greatest first."""
    lines = sorted(budget.lines, key=lambda line: -line.error.translation)
    rows = [(line.term, line.triad or "start", *_cells(line.error)) for line in lines]
    rows.append(("all", "", *_cells(budget.total)))
    columns = ("term", "of", "mm", "degrees", "mm at the end", "degrees at the end")
    return Table(
        f"Dead reckoning with the {budget.sensor.name}, root mean square over a scan",
        columns,
        tuple(rows),
    )


def _cells(error: PoseError) -> tuple[str, ...]:
    return (
        size(1e3 * error.translation),
        size(float(np.degrees(error.rotation))),
        size(1e3 * error.translation_at_end),
        size(float(np.degrees(error.rotation_at_end))),
    )


def values_table(sensor: CataloguedSensor) -> Table:
    """Every number of a sensor's file with its source, or why there is none."""
    rows = [(f"{v.triad}.{v.key}", _number(v), v.source) for v in sensor.values]
    return Table(
        f"{sensor.maker} {sensor.name}: {sensor.about}", ("key", "value", "source"), tuple(rows)
    )


def _number(value: DataSheetValue) -> str:
    if value.value is None:
        return UNKNOWN
    return f"{value.value:g}" + (f" {UNVERIFIED}" if value.standing == "unverified" else "")


def standing_sentence(sensor: CataloguedSensor) -> str:
    """Counts what the numbers of a sensor's file rest on."""
    found = [
        f"{len(sensor.standing(standing))} {words}"
        for standing, words in _STANDINGS.items()
        if sensor.standing(standing)
    ]
    return f"Of {len(sensor.values)} numbers: {', '.join(found)}."


_STANDINGS: dict[Standing, str] = {
    "sheet": "on a page of the data sheet",
    "secondary": "in a secondary source that quotes it",
    "unverified": f"unverified ({UNVERIFIED}), from memory of the data sheet, page not checked",
    "missing": f"missing ({UNKNOWN}), not in the sum",
}


def records(budgets: Sequence[SensorBudget]) -> list[dict[str, str | float | None]]:
    """Every line of the budgets in full precision, in SI units, and what its number rests on.

    A term whose number is missing has a line without errors.
    """
    return [record for budget in budgets for record in (*_stated(budget), *_missing(budget))]


def _stated(budget: SensorBudget) -> list[dict[str, str | float | None]]:
    return [
        _record(budget, line.term, line.triad or "start", _weakest(budget.sensor, line), line.error)
        for line in budget.lines
    ]


def _missing(budget: SensorBudget) -> list[dict[str, str | float | None]]:
    lines = {(line.term, line.triad) for line in budget.lines}
    lacking = {
        (term, v.triad): None
        for v in budget.sensor.values
        if v.standing == "missing" and (term := _term_of(v)) in BUDGET_TERMS
    }
    return [
        _record(budget, str(term), triad, "missing", None)
        for term, triad in lacking
        if (term, triad) not in lines
    ]


def _record(
    budget: SensorBudget, term: str, of: str, standing: str, error: PoseError | None
) -> dict[str, str | float | None]:
    errors = dict.fromkeys(_UNITS) if error is None else asdict(error)
    sizes = {f"{name}_{_UNITS[name]}": value for name, value in errors.items()}
    return {"sensor": budget.key, "term": term, "of": of, "rests_on": standing, **sizes}


def _weakest(sensor: CataloguedSensor, line: BudgetLine) -> str:
    """The least confirmed of the numbers behind a line, as its standing; "given" where none is."""
    of_line = [v for v in sensor.values if v.triad == line.triad and _term_of(v) == line.term]
    found = {v.standing for v in of_line}
    return next((one for one in ("unverified", "secondary", "sheet") if one in found), "given")


_UNITS = {
    "translation": "m",
    "rotation": "rad",
    "translation_at_end": "m",
    "rotation_at_end": "rad",
}


def conditions_sentence(
    given: BudgetConditions, *, seconds: float, rate_hz: float, sway: float
) -> str:
    """Describes what a budget is of; ``sway`` is in rad."""
    calibrated = {
        "none": (
            f"no calibration before it, a start that is off by {np.degrees(given.start_tilt):g} "
            "degrees about each horizontal axis"
        ),
        "rest": (
            f"a rest of {given.calibration.seconds:g} s before it, which removes the gyroscope's "
            "bias and levels the start"
        ),
        "six-positions": (
            f"six positions of {given.calibration.seconds:g} s before it, which calibrate the "
            "accelerometer, and a rest as long, which removes the gyroscope's bias and levels the "
            "start"
        ),
    }[given.calibration.kind]
    return (
        f"A scan of {seconds:g} s at {rate_hz:g} samples per second, a sway of "
        f"{np.degrees(sway):g} degrees, {given.temperature_change:g} K off the temperature of the "
        f"calibration; {calibrated}."
    )


def size(value: float) -> str:
    """Three digits of a number of any size; what rounding leaves of zero is zero."""
    if value >= 1000:
        return f"{value:.0f}"
    if value < 1e-9:
        return "0"
    return f"{value:.3g}" if value >= 1e-4 else f"{value:.0e}"
