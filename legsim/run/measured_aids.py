"""What aids the sensors of a measured scan: what is known of them, how worn, metal points."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from legsim.config.imu_file import StartConfig
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.files import is_file, key_of, sha256
from legsim.correction.fiducials import Fiducials
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Scan
from legsim.correction.path_measurements import FiducialShadows
from legsim.correction.rough_start import EXACT, StartErrors
from legsim.imu.catalogue import KEYS, CataloguedSensor, Triad, field_of, load_sensor
from legsim.imu.errors import TERMS, SensorErrors
from legsim.imu.signals import SensorStart
from legsim.run import measured, measured_beads, methods, sensors, shadow_files
from legsim.run.measured import MeasuredScan, followed


def _sensor_model(scan: MeasuredScan) -> CataloguedSensor | None:
    """The sensor whose errors are expected: a file beside SCAN.toml, or one of the catalogue; None
    where all are given there.
    """
    if scan.settings.methods.sensor_model == "custom":
        return None
    beside = scan.folder / scan.settings.methods.sensor_model
    return load_sensor(str(beside) if is_file(beside) else scan.settings.methods.sensor_model)


def priors(scan: MeasuredScan) -> SensorPriors:
    """What is known of the followed sensor: its model's data sheet, and how it was worn.

    Raises:
        LegsimError: an unknown model.
    """
    wanted, model = scan.settings.methods, _sensor_model(scan)
    given = wanted.sensor_errors
    try:
        errors = sensors.changed(model.errors if model else SensorErrors(), given)
    except LegsimError as error:
        raise LegsimError(f"methods.sensor_errors: {error}") from error
    errors = sensors.calibrated(errors, given, warms=given.warms)
    start = _start_errors(scan.worn.get(followed(scan)))
    # a start that was leveled at rest is tilted by the accelerometer's bias
    leveled = errors.accelerometer.turn_on_bias / STANDARD_GRAVITY
    start = replace(start, tilt=max(start.tilt, leveled))
    return SensorPriors(errors, start, 1e-3 * wanted.spread_mm, 1e-3 * wanted.clock_ms)


def _start_errors(given: StartConfig | None) -> StartErrors:
    """As stated; a pose without errors is trusted no more than a hand."""
    usual = StartErrors()
    if given is None:
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
    """Sentences on methods whose sensors drift by more than a person who stands moves, and on
    pixels of beads or points that images or geometry speak against.
    """
    # dead reckoning trusts a pose that is stated exactly, as methods that find it do not
    exact = {name: EXACT for name, start in scan.worn.items() if start.is_exact}
    said = methods.undetermined(names, scan.seen, followed(scan), priors(scan), exact)
    model = scan.settings.methods.sensor_model
    whose = "methods.sensor_errors" if model == "custom" else model
    lines = [f"{line}; its errors are taken for those of {whose}" for line in said]
    projections, given = scan.seen.projections, scan.settings
    lines += measured_beads.doubts(scan)
    if given.fiducials is not None:
        path = scan.folder / given.fiducials.file
        pixels = shadow_files.load_fiducials(path, projections.geometry)
        lines += shadow_files.doubts(path, "point", pixels, projections)
    return tuple(f"In doubt: {line}." for line in lines)


_DECISIVE = ("turn-on-bias", "white-noise")
"""terms without which a covariance says nothing"""


def reliance(scan: MeasuredScan, names: Sequence[str]) -> tuple[str, ...]:
    """Sentences on what the expected errors of the sensors rest on, where a method uses them."""
    follow = {*methods.FIND_START, *methods.DEAD_RECKONING}
    if not (scan.seen.signals.sensor_names and follow.intersection(names)):
        return ()
    model, sensor = scan.settings.methods.sensor_model, _sensor_model(scan)
    if sensor is None:
        said = ["The sensors' errors are taken for those of methods.sensor_errors."]
    else:
        unconfirmed = sensors.unconfirmed_sentence(model, sensor.values)
        said = [f"The sensors' errors are taken for those of {model}.{unconfirmed}"]
    who = model if sensor else "methods.sensor_errors"
    for term in _DECISIVE:
        lacking = [triad for triad in KEYS if not _is_stated(scan, sensor, triad, term)]
        if lacking:
            said.append(
                f"In doubt: {who} states no {term} of its {' and '.join(lacking)}, which methods "
                "take for zero: they may follow it as motion. Measure it at rest, and give it as "
                "methods.sensor_errors, or in a file as methods.sensor_model."
            )
    return tuple(said)


def _is_stated(
    scan: MeasuredScan, sensor: CataloguedSensor | None, triad: Triad, term: str
) -> bool:
    """Whether the size of an error term is known, be it 0."""
    given = scan.settings.methods.sensor_errors
    calibrated = ("six-positions",) if triad == "accelerometer" else ("rest", "six-positions")
    if term in given.off or (term == "turn-on-bias" and given.calibration in calibrated):
        return True
    own, sets = getattr(given, triad), KEYS[triad]
    if any(
        getattr(own, key) is not None for key, (field, _) in sets.items() if field in TERMS[term]
    ):
        return True
    return sensor is not None and any(
        v.value is not None
        for v in sensor.values
        if v.triad == triad and field_of(v) in TERMS[term]
    )


def fingerprint(scan: MeasuredScan) -> str:
    """Part of the keys that changes with how sensors were worn and with the beads."""
    settings, model = scan.settings, scan.folder / scan.settings.methods.sensor_model
    pixels = (*settings.beads, *([settings.fiducials] if settings.fiducials else []))
    return key_of(
        {name: start.model_dump() for name, start in scan.worn.items()},
        [(one.model_dump(), sha256(scan.folder / one.file)) for one in pixels],
        sha256(model) if is_file(model) else None,
    )


def fiducials(scan: MeasuredScan) -> Callable[[], FiducialShadows] | None:
    """Shadows of the points in the followed sensor; None where the scan has none.

    Raises:
        LegsimError: a file that cannot be used.
    """
    given = scan.settings.fiducials
    if given is None:
        return None
    pixels = shadow_files.load_fiducials(scan.folder / given.file, scan.seen.projections.geometry)
    places = Fiducials(1e-3 * given.axis_length_mm).points_sensor
    return lambda: FiducialShadows(pixels, places, given.error_px).enough()
