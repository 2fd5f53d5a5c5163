"""Sensors that one can buy: TOML files with the numbers of their data sheets, and where they stand.

A file names its data sheets in ``[sheets]``, what quotes them in ``[secondary]``, and holds one
table per triad. Every key of :data:`KEYS` is there, with a value and its source, or marked as
missing, so that no term is off unseen::

    noise_density_ug_per_sqrt_hz = { value = 180, sheet = "main", page = "8" }
    turn_on_bias_mg = { value = 40, sheet = "main", page = "not checked" }
    bias_instability_ug = { missing = "the data sheet does not state it" }
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from legsim.core import files, resources
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import LARGEST
from legsim.imu.errors import SensorErrors, TriadErrors

Triad = Literal["accelerometer", "gyroscope"]

Standing = Literal["sheet", "secondary", "unverified", "missing"]
"""what a number rests on: a page of the data sheet, a source that quotes it, a page that nobody
compared, nothing"""

UNCHECKED = "not checked"
"""the page of a number that has not been compared with its data sheet"""

_FOLDER = "sensors"

_G = STANDARD_GRAVITY
_DEG = float(np.pi / 180)

KEYS: dict[Triad, dict[str, tuple[str, float]]] = {
    "accelerometer": {
        "noise_density_ug_per_sqrt_hz": ("noise_density", 1e-6 * _G),
        "turn_on_bias_mg": ("turn_on_bias", 1e-3 * _G),
        "bias_instability_ug": ("instability", 1e-6 * _G),
        "random_walk_ug_per_sqrt_s": ("random_walk", 1e-6 * _G),
        "scale_error_percent": ("scale_error", 1e-2),
        "misalignment_percent": ("misalignment", 1e-2),
        "bias_mg_per_k": ("bias_per_kelvin", 1e-3 * _G),
        "scale_percent_per_k": ("scale_per_kelvin", 1e-2),
        "range_g": ("full_scale", _G),
        "bits": ("bits", 1),
        "bandwidth_hz": ("bandwidth_hz", 1.0),
    },
    "gyroscope": {
        "noise_density_deg_per_s_per_sqrt_hz": ("noise_density", _DEG),
        "turn_on_bias_deg_per_s": ("turn_on_bias", _DEG),
        "bias_instability_deg_per_h": ("instability", _DEG / 3600),
        "random_walk_deg_per_h_per_sqrt_h": ("random_walk", _DEG / 3600 / 60),
        "scale_error_percent": ("scale_error", 1e-2),
        "misalignment_percent": ("misalignment", 1e-2),
        "g_sensitivity_deg_per_s_per_g": ("g_sensitivity", _DEG / _G),
        "bias_deg_per_s_per_k": ("bias_per_kelvin", _DEG),
        "scale_percent_per_k": ("scale_per_kelvin", 1e-2),
        "range_deg_per_s": ("full_scale", _DEG),
        "bits": ("bits", 1),
        "bandwidth_hz": ("bandwidth_hz", 1.0),
    },
}
"""keys of a file, the field that each sets, and its unit in SI"""

OPTIONAL: dict[str, tuple[str, float]] = {
    "filter_order": ("filter_order", 1),
    "instability_time_s": ("instability_time", 1.0),
}
"""keys of either triad that may be left out"""


@dataclass(frozen=True, slots=True)
class DataSheetValue:
    """One number of a file, in the unit of its key."""

    triad: Triad
    key: str
    value: float | None
    """None: the data sheet does not state it"""
    source: str
    """data sheet and page, or why there is no value"""
    standing: Standing = "sheet"


@dataclass(frozen=True, slots=True)
class CataloguedSensor:
    """A sensor of the catalogue."""

    name: str
    """as it is sold"""
    maker: str
    about: str
    values: tuple[DataSheetValue, ...]

    @property
    def errors(self) -> SensorErrors:
        """Its errors in SI; terms without a value are off."""
        return SensorErrors(self._of("accelerometer"), self._of("gyroscope"))

    def _of(self, triad: Triad) -> TriadErrors:
        stated = [v for v in self.values if v.triad == triad]
        return in_si(triad, {v.key: v.value for v in stated if v.value is not None})

    @property
    def missing(self) -> tuple[str, ...]:
        """Keys without a value, as "gyroscope.bits"."""
        return self.standing("missing")

    def standing(self, standing: Standing) -> tuple[str, ...]:
        """Keys of that standing, as "gyroscope.bits"."""
        return tuple(f"{v.triad}.{v.key}" for v in self.values if v.standing == standing)


def in_si(
    triad: Triad, values: Mapping[str, float], base: TriadErrors | None = None
) -> TriadErrors:
    """Errors of a triad from values in the units of their keys, laid over ``base``.

    Raises:
        LegsimError: an unknown key, or a size that no sensor has.
    """
    units = KEYS[triad] | OPTIONAL
    unknown = sorted(values.keys() - units.keys())
    if unknown:
        raise LegsimError(f"unknown key {unknown[0]!r}; valid here: {', '.join(units)}")
    start = base or TriadErrors()
    changed: dict[str, Any] = {name: getattr(start, name) for name in start.__slots__}
    for key, value in values.items():
        name, unit = units[key]
        changed[name] = int(value) if isinstance(unit, int) else float(value) * unit
    return TriadErrors(**changed)


def field_of(value: DataSheetValue) -> str:
    """The field of :class:`~legsim.imu.errors.TriadErrors` that a number sets."""
    return (KEYS[value.triad] | OPTIONAL)[value.key][0]


def sensor_catalogue() -> dict[str, CataloguedSensor]:
    """Sensors that ship with legsim, by the names that settings give them.

    >>> sensor_catalogue()["bmi160"].errors.gyroscope.noise_density
    """
    return {name: load_sensor(name) for name in names()}


def names() -> tuple[str, ...]:
    """Names of the shipped sensors, in alphabetical order."""
    return tuple(sorted(p.stem for p in resources.model_file(_FOLDER).glob("*.toml")))


def load_sensor(name_or_path: str | Path) -> CataloguedSensor:
    """Reads a shipped sensor by its name, or any by the path of its TOML file.

    Raises:
        LegsimError: no such sensor or file, or a file that is not a sensor's; the line names the
            key and the fix.

    >>> load_sensor("bmi160").errors.gyroscope.noise_density  # rad/s per root of Hz
    0.00012217304763960306
    """
    path = Path(name_or_path)
    if path.suffix.lower() != ".toml":
        known = str(name_or_path).lower() in names()
        if not known and files.is_file(path):
            raise file_error(
                path,
                "is no sensor's TOML",
                "readings that were recorded are read by legsim.read_imu, and set beside markers "
                "by `legsim replay --imu`",
            )
        if not known:
            raise LegsimError(
                f"unknown sensor {str(name_or_path)!r}; known: {', '.join(names())}, or give a "
                "TOML file"
            )
        path = resources.model_file(f"{_FOLDER}/{str(name_or_path).lower()}.toml")
    return _sensor(path, files.load_toml(path))


def _sensor(path: Path, tree: dict[str, Any]) -> CataloguedSensor:
    tables = ("sheets", *KEYS)
    _exactly(path, "", tree, ("name", "maker", "about", *tables), ("secondary",))
    for key in ("name", "maker", "about"):
        if not isinstance(tree[key], str) or not tree[key].strip():
            raise file_error(path, f"{key} is {tree[key]!r}", "give a text")
    for key in (*tables, *(["secondary"] if "secondary" in tree else [])):
        if not isinstance(tree[key], dict):
            raise file_error(path, f"{key} is not a table", f"write [{key}]")
    sources = _sources(path, tree["sheets"], tree.get("secondary", {}))
    values = tuple(_value(path, sources, t, k, v) for t in KEYS for k, v in _entries(path, tree, t))
    sensor = CataloguedSensor(tree["name"], tree["maker"], tree["about"], values)
    try:
        _ = sensor.errors
    except LegsimError as error:
        raise file_error(path, str(error), "fix that value") from None
    return sensor


def _sources(
    path: Path, sheets: dict[str, Any], secondary: dict[str, Any]
) -> dict[str, tuple[Standing, str]]:
    if not sheets or not all(isinstance(s, str) and s.strip() for s in sheets.values()):
        raise file_error(
            path, "[sheets] names no data sheet", 'write main = "title, revision, date"'
        )
    if not all(isinstance(s, str) and s.strip() for s in secondary.values()):
        raise file_error(
            path, "[secondary] names no source", 'write paper = "authors, year", or leave it out'
        )
    twice = next((key for key in secondary if key in sheets), None)
    if twice is not None:
        raise file_error(path, f"{twice!r} is in [sheets] and in [secondary]", "rename one of them")
    return {
        **{key: ("sheet", title) for key, title in sheets.items()},
        **{key: ("secondary", title) for key, title in secondary.items()},
    }


def _entries(path: Path, tree: dict[str, Any], triad: Triad) -> list[tuple[str, Any]]:
    _exactly(path, f"[{triad}] ", tree[triad], tuple(KEYS[triad]), tuple(OPTIONAL))
    return list(tree[triad].items())


def _exactly(
    path: Path, place: str, table: dict[str, Any], needed: tuple[str, ...], more=()
) -> None:
    unknown = next((key for key in table if key not in (*needed, *more)), None)
    if unknown is not None:
        known = ", ".join((*needed, *more))
        raise file_error(path, f"{place}unknown key {unknown!r}", f"valid here: {known}")
    lacking = next((key for key in needed if key not in table), None)
    if lacking is not None:
        raise file_error(
            path,
            f"{place}{lacking} is not there",
            'give its value and source, or { missing = "why" }' if place else "write it",
        )


def _value(
    path: Path, sources: dict[str, tuple[Standing, str]], triad: Triad, key: str, entry: Any
) -> DataSheetValue:
    place = f"[{triad}] {key}"
    form = '{ value = 1.0, sheet = "main", page = "8" } or { missing = "why" }'
    if not isinstance(entry, dict):
        raise file_error(path, f"{place} is {entry!r}", f"write {form}")
    if set(entry) == {"missing"}:
        reason = entry["missing"]
        if not isinstance(reason, str) or not reason.strip():
            raise file_error(path, f"{place} is missing without a reason", f"write {form}")
        return DataSheetValue(triad, key, None, reason, "missing")
    if not {"value", "sheet", "page"} <= set(entry) <= {"value", "sheet", "page", "note"}:
        raise file_error(path, f"{place} has the keys {', '.join(entry)}", f"write {form}")
    value, sheet = entry["value"], entry["sheet"]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (number and 0 <= value <= LARGEST):
        raise file_error(path, f"{place} has the value {value!r}", "give a number, 0 or greater")
    if key in ("bits", "filter_order") and value != int(value):
        raise file_error(path, f"{place} has the value {value!r}", "give a whole number")
    if not isinstance(sheet, str) or sheet not in sources:
        known = ", ".join(sources)
        raise file_error(path, f"{place} is from the sheet {sheet!r}", f"name one of: {known}")
    page = str(entry["page"]).strip()
    if not page:
        raise file_error(path, f"{place} has no page", f'give it, or page = "{UNCHECKED}"')
    standing, source = _sourced(*sources[sheet], page)
    note = f"; {entry['note']}" if "note" in entry else ""
    return DataSheetValue(triad, key, float(value), source + note, standing)


def _sourced(standing: Standing, title: str, page: str) -> tuple[Standing, str]:
    """Standing of a number and the words for its source."""
    if page.lower() == UNCHECKED:
        return "unverified", f"unverified: {title}, page {UNCHECKED}"
    where = f"page {page}" if page[:1].isdigit() else page
    return standing, f"{'secondary: ' if standing == 'secondary' else ''}{title}, {where}"
