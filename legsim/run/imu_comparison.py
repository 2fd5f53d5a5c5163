"""`legsim replay --imu`: measured sensors beside those that the markers predict."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.files import is_file
from legsim.core.values import FloatArray
from legsim.imu import comparison
from legsim.imu.comparison import SensorComparison
from legsim.imu.lag import REACH
from legsim.imu.recording import ImuRecording
from legsim.imu.sensors import Sensor, default_sensors
from legsim.imu.shared_time import SHORTEST
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import simulate_imu
from legsim.imu.worn_segment import better_segment
from legsim.kinematics.moving_leg import MovingLeg
from legsim.run import imu_files
from legsim.run.imu_files import WornSensor

FILE = "imu_comparison.csv"

_MISFIT = 0.15
"""of the correlation of the rates, that the mounting may cost: of sensors that fit it costs 0.03"""

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
    place_given: bool = True
    """whether it is in imu.sensors"""
    elsewhere: tuple[str, float, float] | None = None
    """a segment that it follows clearly better, the correlation there and the further lag (s)"""

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
        turn = f"by the rates about it to {np.degrees(found.turn_spread):.0f} deg"
        known = "given" if self.mounting_given else f"by gravity, and {turn}"
        clock = f"its clock reads {1e3 * found.lag:.0f} ms more than the markers'"
        if found.lag_source == "stated":
            clock = "its clock is taken as stated"
        lines = [
            f"Sensor {found.measured.name} on {self.sensor.segment}: {clock} (correlation of the "
            f"rates {found.correlation:.2f}); mounting rotation ({at}) deg, {known}. "
            f"Its gyroscope reads ({bias}) deg/s too much on average, in its own axes."
        ]
        if found.lag_source == "stated":
            lines.append(
                f"Sensor {found.measured.name}: it shares {found.shared_s:.2g} s with the markers, "
                f"less than {SHORTEST:g} s: neither a lag nor another place or segment is searched."
            )
        if not self.place_given:
            lines.append(
                f"Sensor {found.measured.name}: no sensor of imu.sensors is on "
                f"{self.sensor.segment}; it is predicted "
                f"{1e3 * self.sensor.distance:.0f} mm below the segment's upper joint."
            )
        if found.lag_source == "anywhere":
            lines.append(
                f"Sensor {found.measured.name}: no lag below {REACH:g} s agrees; this one was "
                "searched over both recordings, which were started at different times or have "
                "unrelated clocks. Give it as clock_offset_s in a TOML about the file to keep it."
            )
        if not found.trusted:
            cure = (
                "check its clock, segment and columns"
                if found.lag_source == "stated"
                else "record a clear movement first, or give clock_offset_s"
            )
            lines.append(
                f"Sensor {found.measured.name}: the rates hardly agree, so that lag and turn about "
                f"the vertical are not known; {cure}."
            )
        return (*found.measured.notes, *lines, *self._doubts())

    def _doubts(self) -> Iterator[str]:
        name, place = f"In doubt: sensor {self.found.measured.name}", self.found.place
        if self.found.trusted and self.found.misfit > _MISFIT:
            mounted = f"in the mounting {'given' if self.mounting_given else 'that gravity wants'}"
            yield (
                f"{name}: its rates agree by {self.found.correlation:.2f} in the mounting that "
                f"fits them best, and by {self.found.correlation - self.found.misfit:.2f} "
                f"{mounted}: check the order and the signs of the columns of accelerometer and "
                "gyroscope, or record longer."
            )
        if self.found.lag_source == "stated":
            return
        if self.elsewhere is not None:
            segment, correlation, more = self.elsewhere
            lag = self.found.lag + more
            yield (
                f"{name} turns as {segment} does (correlation of the rates {correlation:.2f} at a "
                f"lag of {1e3 * lag:.0f} ms), not as {self.sensor.segment} "
                f"({self.found.correlation:.2f}): give {segment}=FILE if it was worn there."
            )
        elif place.is_elsewhere and self.found.trusted:
            shift, spread = (
                1e3 * v
                for v in (self.sensor.segment_from_sensor_rotation @ place.shift, place.spread)
            )
            forward, right = 1e3 * self.sensor.offset[[0, 2]] + shift[[0, 2]]
            yield (
                f"{name}: its accelerometer fits a place {np.linalg.norm(shift):.0f} mm away on "
                f"{self.sensor.segment} better (one standard deviation {spread.max():.0f} mm; what "
                f"is left of the specific force in 0.2 to 6 Hz falls from {_mg(place.left):.0f} to "
                f"{_mg(place.left_there):.0f} mg). If it was worn there, set its distance_mm to "
                f"{1e3 * self.sensor.distance - shift[1]:.0f} and its offset_mm to "
                f"[{forward:.0f}, {1e3 * self.sensor.offset[1]:.0f}, {right:.0f}] in imu.sensors."
            )


def _mg(acceleration: float) -> float:
    return 1e3 * acceleration / STANDARD_GRAVITY


def of_argument(text: str) -> tuple[WornSensor, ...]:
    """Reads a file of sensors, or SEGMENT=FILE.

    Raises:
        LegsimError: a file that cannot be used; a segment beside a file of several sensors.
    """
    segment, separator, name = text.partition("=")
    if not separator or is_file(text):
        return imu_files.load(Path(text))
    found = imu_files.load(Path(name))
    if len(found) > 1:
        raise LegsimError(
            f"{name}: holds {len(found)} sensors, and {segment}= names one segment; give a TOML "
            "that names the segment of each"
        )
    return tuple(one.on(segment) for one in found)


_BY_SEGMENT = {
    sensor.segment: sensor for side in ("right", "left") for sensor in default_sensors(side)
}
"""the published places on thighs and shanks"""


def compare(
    measured: Sequence[WornSensor],
    predicted: ImuSignals,
    clock_offset: float,
    person: MovingLeg | None = None,
) -> tuple[ComparedSensor, ...]:
    """Compares each measured sensor with the predicted one of its place.

    Args:
        measured: sensors by their own clocks, known offsets taken off.
        predicted: signals of the configured sensors, with their places.
        clock_offset: s by which the predicted signals' times are shifted (imu.clock_offset_s).
        person: who wears them. A thigh or shank without a configured sensor is then predicted at
            the published place, and a sensor that moves as another segment does is in doubt.

    Raises:
        LegsimError: a sensor that no configured or published place fits.
    """
    if not measured:
        return ()
    times = predicted.times - clock_offset
    placed, segments = predicted.sensors, ()
    ours = [_there(s.name, times, *predicted.sensor(s.name)) for s in placed]
    if person is not None:
        worn = simulate_imu(person, tuple(_BY_SEGMENT.values()), rate_hz=_rate_hz(times))
        on_each = [ImuRecording(n, worn.times, *worn.sensor(n)) for n in worn.sensor_names]
        segments = tuple(
            replace(one, name=segment) for one, segment in zip(on_each, _BY_SEGMENT, strict=True)
        )
        lacking = [k for k, segment in enumerate(_BY_SEGMENT) if segment not in _on(placed)]
        ours += [on_each[k] for k in lacking]
        placed = (*placed, *(worn.sensors[k] for k in lacking))
    found = []
    for one in measured:
        k = _place(one, placed)
        compared = _compared(one, placed[k], ours[k], segments)
        found.append(replace(compared, place_given=k < len(predicted.sensors)))
    return tuple(found)


def _there(name: str, times: FloatArray, rate: FloatArray, force: FloatArray) -> ImuRecording:
    """The samples that are there; a run may mark lost ones."""
    there = np.isfinite(rate).all(-1) & np.isfinite(force).all(-1)
    return ImuRecording(name, times[there], rate[there], force[there])


def _rate_hz(times: FloatArray) -> float:
    return (len(times) - 1) / float(times[-1] - times[0])


def _on(sensors: Sequence[Sensor]) -> set[str]:
    return {sensor.segment for sensor in sensors}


def _compared(
    measured: WornSensor, sensor: Sensor, ours: ImuRecording, segments: Sequence[ImuRecording]
) -> ComparedSensor:
    given, rotation = measured.worn.rotation_deg, None
    if given is not None:
        mounted = transforms.rotation_from_vector(np.radians(given))
        rotation = sensor.segment_from_sensor_rotation.T @ mounted
    found = comparison.compare(
        ours, measured.recording, rotation=rotation, clock_stated=measured.clock_stated
    )
    elsewhere = None
    if found.lag_source != "stated" and sensor.segment in [one.name for one in segments]:
        on_time = measured.recording.shifted(-found.lag)
        elsewhere = better_segment(on_time, sensor.segment, found.correlation, segments)
    return ComparedSensor(sensor, found, given is not None, elsewhere=elsewhere)


def _place(measured: WornSensor, sensors: Sequence[Sensor]) -> int:
    """Number of the sensor of the same segment, of the same name, or of a name within it."""
    name, segment = measured.recording.name, measured.worn.segment
    if segment:
        fitting = [k for k, s in enumerate(sensors) if s.segment == segment]
    else:
        fitting = [k for k, s in enumerate(sensors) if s.name == name]
        fitting = fitting or [k for k, s in enumerate(sensors) if s.name in name]
    if len(fitting) == 1:
        return fitting[0]
    places = ", ".join(f"{s.name} on {s.segment}" for s in sensors)
    where = f"segment {segment!r}" if segment else f"the name {name!r}"
    raise LegsimError(
        f"sensor {name}: {where} is that of {len(fitting)} sensors ({places}); give "
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
