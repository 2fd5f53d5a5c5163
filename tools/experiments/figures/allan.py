"""Draws the Allan deviation of three catalogued sensors over six hours at rest, beside the noise
and the instability that their data sheets state.

Usage: python -m tools.experiments.figures.allan [--out docs/images] (a minute)
"""

import argparse
from pathlib import Path

import allantools
import numpy as np

from legsim import figures
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.figures import AllanCurve, AllanPanel
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals

FOLDER = Path(__file__).parents[3] / "docs/images"
SENSORS = ("mti300", "adis16470", "adxl355_adxrs453")
RATE_HZ, HOURS = 20.0, 6.0
UNITS = {
    "gyroscope": ("deg/h", float(np.degrees(1)) * 3600),
    "accelerometer": ("µg", 1e6 / STANDARD_GRAVITY),
}


def at_rest(errors: SensorErrors) -> ImuSignals:
    """Readings of a level sensor at rest; a filter's rate is not needed here."""
    count = int(HOURS * 3600 * RATE_HZ)
    force = np.tile([0.0, STANDARD_GRAVITY, 0.0], (count, 1, 1))
    still = ImuSignals(np.arange(count) / RATE_HZ, ("s",), np.zeros_like(force), force)
    return read_out(still, errors.without("low-pass"), np.random.default_rng(0))


def curve(readings: FloatArray, factor: float) -> tuple[FloatArray, FloatArray]:
    """(averaging times, Allan deviation), mean of the squares of three axes."""
    wanted = np.geomspace(2 / RATE_HZ, HOURS * 3600 / 20, 40)
    found = [
        allantools.oadev(axis, rate=RATE_HZ, data_type="freq", taus=wanted)[:2]
        for axis in (factor * readings).T
    ]
    return found[0][0], np.sqrt(np.mean([deviation**2 for _, deviation in found], 0))


def panels() -> list[AllanPanel]:
    """Gyroscopes and accelerometers of all sensors."""
    drawn: dict[str, list[AllanCurve]] = {triad: [] for triad in UNITS}
    for name in SENSORS:
        sensor = load_sensor(name)
        rate, force = at_rest(sensor.errors).sensor("s")
        for triad, readings in (("gyroscope", rate), ("accelerometer", force)):
            factor = UNITS[triad][1]
            stated = getattr(sensor.errors, triad)
            drawn[triad].append(
                AllanCurve(
                    sensor.name,
                    *curve(readings, factor),
                    factor * stated.noise_density / np.sqrt(2) if stated.noise_density else None,
                    factor * stated.instability if stated.instability else None,
                )
            )
    return [AllanPanel(triad, UNITS[triad][0], tuple(drawn[triad])) for triad in UNITS]


def main() -> None:
    """Writes allan.png."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=FOLDER)
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    (out / "allan.png").write_bytes(figures.png(figures.allan_deviations(panels()), dpi=110))


if __name__ == "__main__":
    main()
