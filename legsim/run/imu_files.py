"""Files of real sensors with how they are worn, by themselves or through a small TOML."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim.config import tree
from legsim.config.imu_file import ImuFileConfig, WornSensorConfig
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import load_toml
from legsim.imu import files, joining, tables
from legsim.imu.recording import ImuRecording
from legsim.imu.signals import ImuSignals
from legsim.imu.table_layout import SensorColumns, TableLayout
from legsim.kinematics.skeleton import SEGMENTS
from legsim.mocap.c3d_analog import has_points

_OF_COLUMNS = (
    "time",
    "angular_velocity_time",
    "time_unit",
    "counter",
    "counter_period",
    "counts_per_g",
    "counts_per_deg_per_s",
    "angular_velocity_file",
    "rows_by",
)
"""settings of tables whose columns are named"""


@dataclass(frozen=True, slots=True, eq=False)
class WornSensor:
    """A sensor's recording and what is known of how it is worn."""

    recording: ImuRecording
    """times are those of the views: the clock's offset is taken off"""
    worn: WornSensorConfig
    file: Path
    folder: Path
    """to which the files of its settings are relative"""
    clock_offset: float = 0.0
    """s that its clock is taken to read more than the views'"""
    clock_stated: bool = False
    """whether that is stated, by the settings or by a C3D file that holds markers too"""

    def on(self, segment: str) -> "WornSensor":
        """The same sensor, worn on that segment."""
        return replace(self, worn=self.worn.model_copy(update={"segment": segment}))


def read_imu(path: Path | str) -> ImuSignals:
    """Reads real sensors in SI: imu.csv, text exports of Xsens, .sto, or a TOML about another file.

    Sensors of different times are put on one clock's, with NaN in longer gaps of one of them. Lost
    packets and the like are warnings.

    Raises:
        LegsimError: a file that is not understood, units that cannot be.

    >>> read_imu("shank.txt").sensor_names
    ('shank',)
    """
    joined = joining.join([sensor.recording for sensor in load(Path(path))])
    for note in joined.notes:
        warnings.warn(note, stacklevel=2)
    return joined.signals


def load(path: Path) -> tuple[WornSensor, ...]:
    """Reads the sensors of a file, or of the file that a TOML is about; errors as in read_imu."""
    if path.suffix.lower() == ".toml":
        settings = tree.validated(ImuFileConfig, load_toml(path), path)
        return load_configured(settings, path.parent)
    return load_configured(ImuFileConfig(file=str(path)), Path())


def load_configured(settings: ImuFileConfig, folder: Path) -> tuple[WornSensor, ...]:
    """Reads the sensors of a described file, which is relative to ``folder``."""
    path = folder / settings.file
    recorded = [sensor.recorded_as or sensor.name for sensor in settings.sensors]
    twice = [name for name in recorded if recorded.count(name) > 1]
    if twice:
        raise file_error(
            path,
            f"two sensors are that which is recorded as {twice[0]!r}",
            "give each its own name (recorded_as)",
        )
    found = _recordings(path, settings)
    offset = settings.clock_offset_s or 0.0
    of_markers = path.suffix.lower() == ".c3d" and has_points(path)
    stated = settings.clock_offset_s is not None or of_markers
    worn = settings.sensors or tuple(WornSensorConfig(name=one.name) for one in found)
    sensors = []
    for sensor in worn:
        if sensor.segment not in ("", *SEGMENTS):
            raise file_error(
                path,
                f"sensor {sensor.name!r} is on {sensor.segment!r}, which no leg has",
                f"give one of {', '.join(SEGMENTS)}, or leave the segment out",
            )
        name = sensor.recorded_as or sensor.name
        match = [one for one in found if one.name == name]
        if not match and len(found) == 1 and len(worn) == 1 and not sensor.recorded_as:
            match = list(found)
        if not match:
            raise file_error(
                path,
                f"holds no sensor {name!r}",
                f"name one of {', '.join(one.name for one in found)} (recorded_as)",
            )
        own = match[0].named(sensor.name).shifted(-offset)
        own = own.without_bias(
            np.radians(sensor.angular_velocity_bias_deg_per_s),
            1e-3 * STANDARD_GRAVITY * np.array(sensor.acceleration_bias_mg),
        )
        sensors.append(WornSensor(own, sensor, path, folder, offset, stated))
    return tuple(sensors)


def _recordings(path: Path, settings: ImuFileConfig) -> tuple[ImuRecording, ...]:
    if not settings.has_columns:
        foreign = [name for name in _OF_COLUMNS if getattr(settings, name)]
        if foreign:
            raise file_error(
                path,
                f"{foreign[0]} is given, but no columns",
                "name acceleration and angular_velocity of each of its [[sensors]]",
            )
        return files.load_recordings(
            path,
            rate_hz=settings.rate_hz,
            acceleration_unit=settings.acceleration_unit,
            angular_velocity_unit=settings.angular_velocity_unit,
        )
    columns = tuple(
        SensorColumns(
            s.recorded_as or s.name,
            s.acceleration,
            s.angular_velocity,
            s.acceleration_rows,
            s.angular_velocity_rows or s.acceleration_rows,
        )
        for s in settings.sensors
        if s.acceleration is not None and s.angular_velocity is not None
    )
    try:
        layout = TableLayout(
            columns,
            acceleration_unit=settings.acceleration_unit,
            angular_velocity_unit=settings.angular_velocity_unit,
            time=settings.time,
            angular_velocity_time=settings.angular_velocity_time,
            time_unit=settings.time_unit,
            rate_hz=settings.rate_hz,
            counter=settings.counter,
            counter_period=settings.counter_period,
            counts_per_g=settings.counts_per_g,
            counts_per_deg_per_s=settings.counts_per_deg_per_s,
            rows_by=settings.rows_by,
        )
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error
    other = settings.angular_velocity_file
    return tables.load(path, layout, angular_velocity_file=path.parent / other if other else None)
