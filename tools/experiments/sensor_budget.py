"""What each error of a catalogued sensor costs over a scan of 8 s: the linear budget beside draws
through the real integration.

    python -m tools.experiments.sensor_budget [--sensor bmi160] [--draws 300]

The table of docs/sensors.md. The sensor sways by a degree at 120 samples per second; it is 1 K off
the temperature of its calibration, and the start is off by 0.1 degrees about both horizontal axes
where no calibration levels it. Root mean square over the scan, in mm and degrees. Five minutes.
"""

import argparse

import numpy as np

from legsim.core import transforms
from legsim.core.constants import GRAVITY_WORLD
from legsim.imu import strapdown
from legsim.imu.budget import START_TILT, BudgetConditions, NominalMotion, sensor_budget
from legsim.imu.calibration import Calibration, CalibrationKind, leveled
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors, TemperatureCourse
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.report.formats import markdown_table
from legsim.report.page import Table
from legsim.report.sensor_tables import size

SECONDS, RATE_HZ, SWAY = 8.0, 120.0, float(np.radians(1))
KINDS: tuple[CalibrationKind, ...] = ("none", "rest", "six-positions")


def drawn(
    errors: SensorErrors, motion: NominalMotion, given: BudgetConditions, draws: int
) -> tuple[float, float]:
    """(m, rad) root of mean squares over the scan and over draws of sensors and starts."""
    rng = np.random.default_rng(0)
    first = motion.world_from_sensor[0]
    names = tuple(f"sensor {k}" for k in range(draws))
    rate, force = (
        np.repeat(a[:, None], draws, 1) for a in (motion.angular_velocity, motion.specific_force)
    )
    calibrated = given.calibration.kind != "none"
    change = given.temperature_change
    read = read_out(
        ImuSignals(motion.times, names, rate, force),
        errors.without("low-pass"),
        rng,
        # it rests at the temperature of the calibration
        temperature=TemperatureCourse((0.0, 1e-9), (0.0 if calibrated else change, change)),
        calibration=given.calibration,
        rest_force=np.tile(first.T @ -GRAVITY_WORLD, (draws, 1)),
    )
    views = motion.times[::4]
    squares = np.zeros(2)
    for k, name in enumerate(names):
        tilt = np.zeros(3)
        tilt[[0, 2]] = given.start_tilt * rng.standard_normal(2)
        turned = transforms.rotation_from_vector(tilt) @ first
        start = SensorStart(transforms.rigid(turned, np.zeros(3)), np.zeros(3))
        if read.rest_force is not None:
            start = leveled(start, read.rest_force[k])
        poses = strapdown.integrate(*read.samples(name), start, views)
        off = poses[:, :3, :3] @ np.swapaxes(motion.world_from_sensor[::4], -1, -2)
        away = ((poses[:, :3, 3] ** 2).sum(-1), transforms.rotation_angle(off) ** 2)
        squares += [np.trapezoid(a, views) / views[-1] for a in away]
    translation, rotation = np.sqrt(squares / draws)
    return float(translation), float(rotation)


def table(name: str, kind: CalibrationKind, draws: int) -> Table:
    """One row per term and triad, the greatest first."""
    errors, motion = load_sensor(name).errors, NominalMotion.swaying(SECONDS, RATE_HZ, angle=SWAY)
    given = BudgetConditions(calibration=Calibration(kind, 10.0))
    level = BudgetConditions(0.0, given.temperature_change, given.calibration)
    rows = []
    lines = sensor_budget(errors, motion, given)
    for line in sorted(lines, key=lambda line: -line.error.translation):
        if line.error.translation < 1e-6:
            continue
        if line.term == START_TILT:
            found = drawn(SensorErrors(), motion, given, draws)
        else:
            # rounding is white only where noise dithers it: what it adds to the noise is not seen
            alone = errors.only(line.term)
            found = drawn(
                SensorErrors(**{line.triad: getattr(alone, line.triad)}), motion, level, draws
            )
        expected = (line.error.translation, line.error.rotation)
        cells = [
            size(factor * value)
            for factor, pair in ((1e3, 0), (float(np.degrees(1)), 1))
            for value in (expected[pair], found[pair])
        ]
        if line.term == "quantisation":
            cells[1] = cells[3] = "–"
        rows.append((f"{line.triad} {line.term}".strip(), *cells))
    columns = ("term", "mm", "mm, drawn", "degrees", "degrees, drawn")
    return Table(f"{load_sensor(name).name}, calibration: {kind}", columns, tuple(rows))


def main() -> None:
    """Prints a table per calibration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensor", default="bmi160")
    parser.add_argument("--draws", type=int, default=300)
    options = parser.parse_args()
    for kind in KINDS:
        made = table(options.sensor, kind, options.draws)
        print(f"{made.caption}\n\n{markdown_table(made)}\n", flush=True)


if __name__ == "__main__":
    main()
