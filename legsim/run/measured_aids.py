"""What aids the sensors of a measured scan: what is known of them, how worn, metal points."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.config.imu_file import StartConfig
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import file_error
from legsim.core.files import key_of, sha256
from legsim.core.values import FloatArray
from legsim.correction.bead_scan import BeadScan
from legsim.correction.fiducials import FIDUCIAL_NAMES, Fiducials
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Scan
from legsim.correction.rough_start import StartErrors
from legsim.correction.smoother import BeadShadows, FiducialShadows, triangulated
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu import table_rows
from legsim.imu.catalogue import CataloguedSensor, field_of, load_sensor
from legsim.imu.errors import TERMS
from legsim.imu.signals import SensorStart
from legsim.run import measured, methods
from legsim.run.measured import MeasuredScan
from legsim.run.sensors import unconfirmed_sentence

_MOST_BEADS = 4

_FEWEST_BY_HAND = 2
"""views that give a bead its place in space"""


def followed(scan: MeasuredScan) -> str:
    """Sensor that methods of one sensor follow; empty where none has a start."""
    names = scan.seen.signals.sensor_names
    return scan.settings.methods.sensor or (names[0] if names else "")


def _sensor_model(scan: MeasuredScan) -> CataloguedSensor:
    """The sensor whose errors are expected: a file beside SCAN.toml, or one of the catalogue."""
    beside = scan.folder / scan.settings.methods.sensor_model
    return load_sensor(str(beside) if beside.is_file() else scan.settings.methods.sensor_model)


def priors(scan: MeasuredScan) -> SensorPriors:
    """What is known of the followed sensor: its model's data sheet, and how it was worn.

    Raises:
        LegsimError: an unknown model.
    """
    wanted = scan.settings.methods
    errors = _sensor_model(scan).errors
    start = _start_errors(scan.worn.get(followed(scan)))
    # a start that was leveled at rest is tilted by the accelerometer's bias
    leveled = errors.accelerometer.turn_on_bias / STANDARD_GRAVITY
    start = replace(start, tilt=max(start.tilt, leveled))
    return SensorPriors(errors, start, 1e-3 * wanted.spread_mm, 1e-3 * wanted.clock_ms)


def _start_errors(given: StartConfig | None) -> StartErrors:
    """As stated for a rough start; a stated pose is trusted no more than a hand."""
    usual = StartErrors()
    if given is None or given.known == "exactly":
        return usual
    return replace(
        usual,
        heading=float(np.radians(given.heading_sd_deg)) or usual.heading,
        place=1e-3 * given.position_sd_mm or usual.place,
    )


def as_worn(scan: MeasuredScan) -> Scan:
    """The same scan whose rough starts are as they were given, without speed.

    Dead reckoning needs a tilt and a velocity that keep the person in place, which a biased sensor
    turns into a start far from the truth; methods that find the bias start from what was given.
    """
    starts = []
    for name, start in zip(scan.seen.signals.sensor_names, scan.seen.starts, strict=True):
        given = scan.worn.get(name)
        rough = given is not None and given.known == "roughly" and not given.fiducials
        starts.append(
            SensorStart(measured.stated_pose(given), np.zeros(3)) if given and rough else start
        )
    return replace(scan.seen, starts=tuple(starts))


def doubts(scan: MeasuredScan, names: Sequence[str]) -> tuple[str, ...]:
    """Sentences on methods whose sensors drift by more than a person who stands moves."""
    said = methods.undetermined(names, scan.seen, followed(scan), priors(scan))
    model = scan.settings.methods.sensor_model
    return tuple(f"In doubt: {line}; its errors are taken for those of {model}." for line in said)


_DECISIVE = ("turn-on-bias", "white-noise")
"""terms without which a covariance says nothing"""


def reliance(scan: MeasuredScan, names: Sequence[str]) -> tuple[str, ...]:
    """Sentences on what the expected errors of the sensors rest on, where a method uses them."""
    follow = {*methods.FIND_START, *methods.DEAD_RECKONING}
    if not (scan.seen.signals.sensor_names and follow.intersection(names)):
        return ()
    model, sensor = scan.settings.methods.sensor_model, _sensor_model(scan)
    unconfirmed = unconfirmed_sentence(model, sensor.values)
    said = [f"The sensors' errors are taken for those of {model}.{unconfirmed}"]
    for term in _DECISIVE:
        lacking = [v for v in sensor.values if v.value is None and field_of(v) in TERMS[term]]
        if lacking:
            triads = " and ".join(dict.fromkeys(value.triad for value in lacking))
            said.append(
                f"In doubt: {model} states no {term} of its {triads}, which "
                "methods take for zero: they may follow it as motion. Measure it at rest, and give "
                "a file with it as methods.sensor_model."
            )
    return tuple(said)


def fingerprint(scan: MeasuredScan) -> str:
    """Part of the keys that changes with how sensors were worn and with the beads."""
    settings, model = scan.settings, scan.folder / scan.settings.methods.sensor_model
    pixels = [one for one in (settings.beads, settings.fiducials) if one is not None]
    return key_of(
        {name: start.model_dump() for name, start in scan.worn.items()},
        [(one.model_dump(), sha256(scan.folder / one.file)) for one in pixels],
        sha256(model) if model.is_file() else None,
    )


def beads(scan: MeasuredScan) -> Callable[[], BeadShadows | BeadScan] | None:
    """Shadows of the scan's beads, or where to track them; None where it has none.

    Raises:
        LegsimError: a file that cannot be used.
    """
    given, geometry = scan.settings.beads, scan.seen.projections.geometry
    if given is None:
        return None
    path = scan.folder / given.file
    pixels = load_beads(path, geometry)
    if not given.track:
        return lambda: BeadShadows(pixels, given.error_px).enough()
    counts = np.isfinite(pixels).all(-1).sum(0)
    if counts.min() < _FEWEST_BY_HAND:
        raise file_error(
            path,
            f"bead {int(np.argmin(counts))} is there in {counts.min()} view",
            f"give each bead in {_FEWEST_BY_HAND} views or more, far apart; the others are tracked",
        )
    guesses = triangulated(geometry, pixels)
    return lambda: BeadScan(scan.seen.projections, guesses, 0.5e-3 * given.diameter_mm)


def fiducials(scan: MeasuredScan) -> Callable[[], FiducialShadows] | None:
    """Shadows of the points in the followed sensor; None where the scan has none.

    Raises:
        LegsimError: a file that cannot be used.
    """
    given = scan.settings.fiducials
    if given is None:
        return None
    pixels = load_fiducials(scan.folder / given.file, scan.seen.projections.geometry)
    places = Fiducials(1e-3 * given.axis_length_mm).points_sensor
    return lambda: FiducialShadows(pixels, places, given.error_px).enough()


def load_beads(path: Path, geometry: ConeBeamGeometry) -> FloatArray:
    """Reads pixels (v, b, 2) of a CSV ``view,bead,u,v``; NaN where a bead is not named.

    Views and beads count from 0.

    Raises:
        LegsimError: missing columns, what is no number, a view or bead that is not there or there
            twice, or a pixel beyond the detector.
    """
    known = {str(number): number for number in range(_MOST_BEADS)}
    fix = f"beads from 0 to {_MOST_BEADS - 1}"
    seen = _shadows(path, "bead", known, fix, geometry)
    named = sorted({bead for _, bead in seen})
    if named != list(range(len(named))):
        raise file_error(path, f"has beads {named}", "count beads from 0 without gaps")
    return _table(seen, len(geometry), len(named))


def load_fiducials(path: Path, geometry: ConeBeamGeometry) -> FloatArray:
    """Reads pixels (v, 4, 2) of a CSV ``view,point,u,v``, as :func:`load_beads`; the points are
    origin, x, y and z.
    """
    known = {name: number for number, name in enumerate(FIDUCIAL_NAMES)}
    fix = f"name the points {', '.join(FIDUCIAL_NAMES)}"
    return _table(_shadows(path, "point", known, fix, geometry), len(geometry), len(known))


def _shadows(
    path: Path, what: str, known: Mapping[str, int], fix: str, geometry: ConeBeamGeometry
) -> dict[tuple[int, int], tuple[float, float]]:
    """Pixels by view and number of a CSV ``view,<what>,u,v``."""
    views, (rows, columns) = len(geometry), geometry.shape_vu
    seen: dict[tuple[int, int], tuple[float, float]] = {}
    for line, (view, name, u, v) in table_rows.read_rows(path, ("view", what, "u", "v")).rows:
        place = f"line {line}"
        try:
            number, pixel = int(view), (float(u), float(v))
        except ValueError:
            problem = f"{view}, {name}, {u} or {v} is not a number"
            raise file_error(path, problem, "correct it", place=place) from None
        one = known.get(name.strip().lower())
        if one is None or not 0 <= number < views or not np.isfinite(pixel).all():
            raise file_error(
                path,
                f"view {view}, {what} {name} at {u}, {v} is none of this scan",
                f"count views from 0 to {views - 1}, {fix}, and leave out what is not seen",
                place=place,
            )
        if not (-0.5 <= pixel[0] <= columns - 0.5 and -0.5 <= pixel[1] <= rows - 0.5):
            raise file_error(
                path,
                f"{what} {name} of view {view} at {u}, {v} is beyond the {columns} columns and "
                f"{rows} rows",
                "give pixels of these images, (column, row) counted from 0, in the order of the "
                "geometry's rows, and leave out what is not seen",
                place=place,
            )
        if (number, one) in seen:
            problem = f"{what} {name} of view {view} is there twice"
            raise file_error(path, problem, "keep one of the lines", place=place)
        seen[number, one] = pixel
    return seen


def _table(
    seen: Mapping[tuple[int, int], tuple[float, float]], views: int, count: int
) -> FloatArray:
    """(views, count, 2) pixels; NaN where nothing was seen."""
    pixels = np.full((views, count, 2), np.nan)
    for (view, one), pixel in seen.items():
        pixels[view, one] = pixel
    return pixels
