"""`legsim replay --imu`: measured sensors beside those that the markers predict."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu import comparison
from legsim.imu.comparison import SensorComparison
from legsim.imu.recording import ImuRecording
from legsim.imu.sensors import Sensor
from legsim.imu.signals import ImuSignals
from legsim.run import imu_files
from legsim.run.imu_files import WornSensor

FILE = "imu_comparison.csv"

_COLUMNS = (
    *("sensor", "quantity", "unit", "band_low_hz", "band_high_hz"),
    *("measured_rms", "predicted_rms", "difference_rms", "correlation"),
    *("lag_ms", "rotation_x_deg", "rotation_y_deg", "rotation_z_deg", "agreement"),
)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedSensor:
    """A measured sensor, the place it was compared with, and what was found."""

    sensor: Sensor
    found: SensorComparison
    mounting_given: bool

    @property
    def segment_from_sensor(self) -> FloatArray:
        """(3, 3) mounting of the measured sensor on its segment."""
        return self.sensor.segment_from_sensor_rotation @ self.found.predicted_from_measured

    def rotation_deg(self) -> tuple[float, float, float]:
        """The mounting as a rotation vector."""
        x, y, z = np.degrees(transforms.vector_from_rotation(self.segment_from_sensor)).tolist()
        return x, y, z

    def lines(self) -> tuple[str, ...]:
        """Sentences for the terminal and the report."""
        found, at = self.found, ", ".join(f"{v:.1f}" for v in self.rotation_deg())
        bias = ", ".join(f"{v:.2f}" for v in np.degrees(found.mean_rate))
        known = "given" if self.mounting_given else "by gravity, and by the rates about it"
        lines = [
            f"Sensor {found.measured.name} on {self.sensor.segment}: its clock reads "
            f"{1e3 * found.lag:.0f} ms more than the markers' (correlation of the rates "
            f"{found.correlation:.2f}); mounting rotation ({at}) deg, {known}. "
            f"Its gyroscope reads ({bias}) deg/s too much on average, in its own axes."
        ]
        if not found.trusted:
            lines.append(
                f"Sensor {found.measured.name}: the rates hardly agree, so that lag and turn about "
                "the vertical are not known; record a clear movement first."
            )
        return (*found.measured.notes, *lines)


def of_argument(text: str) -> tuple[WornSensor, ...]:
    """Reads a file of sensors, or SEGMENT=FILE.

    Raises:
        LegsimError: a file that cannot be used; a segment beside a file of several sensors.
    """
    segment, separator, name = text.partition("=")
    if not separator or Path(text).exists():
        return imu_files.load(Path(text))
    found = imu_files.load(Path(name))
    if len(found) > 1:
        raise LegsimError(
            f"{name}: holds {len(found)} sensors, and {segment}= names one segment; give a TOML "
            "that names the segment of each"
        )
    return tuple(one.on(segment) for one in found)


def compare(
    measured: Sequence[WornSensor], predicted: ImuSignals, clock_offset: float
) -> tuple[ComparedSensor, ...]:
    """Compares each measured sensor with the configured one of its place.

    Args:
        measured: sensors by their own clocks, known offsets taken off.
        predicted: signals with their sensors' places.
        clock_offset: s by which the predicted signals' times are shifted (imu.clock_offset_s).

    Raises:
        LegsimError: a sensor whose place is not among the configured ones.
    """
    found = []
    for one in measured:
        sensor = _place(one, predicted.sensors)
        rate, force = predicted.sensor(sensor.name)
        ours = ImuRecording(sensor.name, predicted.times - clock_offset, rate, force)
        given = one.worn.rotation_deg
        rotation = None
        if given is not None:
            mounted = transforms.rotation_from_vector(np.radians(given))
            rotation = sensor.segment_from_sensor_rotation.T @ mounted
        agreement = comparison.compare(ours, one.recording, rotation=rotation)
        found.append(ComparedSensor(sensor, agreement, given is not None))
    return tuple(found)


def _place(measured: WornSensor, sensors: Sequence[Sensor]) -> Sensor:
    """The configured sensor of the same segment, of the same name, or of a name within it."""
    name, segment = measured.recording.name, measured.worn.segment
    if segment:
        fitting = [s for s in sensors if s.segment == segment]
    else:
        fitting = [s for s in sensors if s.name == name] or [s for s in sensors if s.name in name]
    if len(fitting) == 1:
        return fitting[0]
    places = ", ".join(f"{s.name} on {s.segment}" for s in sensors)
    where = f"segment {segment!r}" if segment else f"the name {name!r}"
    raise LegsimError(
        f"sensor {name}: {where} is that of {len(fitting)} configured sensors ({places}); give "
        "--imu SEGMENT=FILE, and the sensor in imu.sensors"
    )


def table(compared: Sequence[ComparedSensor]) -> str:
    """CSV of one row per sensor, quantity and band; rates in deg/s, forces in mg."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for one in compared:
        whole = [1e3 * one.found.lag, *one.rotation_deg(), one.found.correlation]
        for band in one.found.bands:
            numbers = [*band.band_hz, band.measured, band.predicted, band.difference]
            numbers += [band.correlation, *whole]
            unit = "deg/s" if band.quantity == "rate" else "mg"
            head = [one.found.measured.name, band.quantity, unit]
            writer.writerow([*head, *(f"{n:.6g}" for n in numbers)])
    return stream.getvalue()
