"""Settings of a file of real sensors: its columns and units, and how each sensor is worn."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from legsim.config.tree import ConfigSection

Vector = tuple[float, float, float]

Column = str | Annotated[int, Field(ge=1, le=10_000)]
"""name of a table's column, or its number from 1 on"""


def _from_1_on(column: str | int) -> str | int:
    if column == 0:
        raise ValueError("columns are counted from 1")
    return column


Axis = Annotated[str | Annotated[int, Field(ge=-10_000, le=10_000)], AfterValidator(_from_1_on)]
"""the same; "-ax", or -2, is a column with the other sign"""

Positive = Annotated[float, Field(gt=0, le=1e12)]


class StartConfig(ConfigSection):
    """Pose and velocity of a sensor at the first view: stated, or by its fiducials in the images.

    A pose is position_mm with rotation or rotation_deg, world from sensor.
    """

    position_mm: Vector | None = None
    """of the sensor's origin in the geometry's world"""
    rotation: tuple[Vector, Vector, Vector] | None = None
    """rows of the matrix whose columns are the sensor's axes in world"""
    rotation_deg: Vector | None = None
    """the same as a rotation vector"""
    velocity_mm_s: Vector = (0.0, 0.0, 0.0)
    known: Literal["exactly", "roughly"] = "exactly"
    """"roughly": tilt and velocity are found such that the person stays where he stands

    Position and turn about the vertical stay as given.
    """
    position_sd_mm: float = Field(default=0.0, ge=0)
    """standard deviation per axis; above 0 it also says that an exact start is none"""
    heading_sd_deg: float = Field(default=0.0, ge=0)
    """standard deviation of the turn about the vertical"""
    fiducials: str = ""
    """CSV of view,point,u,v: pixels of four metal points (origin, x, y, z) in the first views"""
    axis_length_mm: float = Field(default=10.0, gt=0)
    """fiducials: from the origin to each tip"""
    detector: Literal["bounded", "unbounded"] = "bounded"
    """fiducials: "unbounded" allows points off the detector"""

    @model_validator(mode="after")
    def _one_way(self) -> "StartConfig":
        posed = self.position_mm is not None
        turned = (self.rotation is not None) + (self.rotation_deg is not None)
        if bool(self.fiducials) == posed or turned != posed:
            raise ValueError(
                "a start is a file of fiducials, or position_mm with one of rotation and "
                "rotation_deg"
            )
        return self

    @property
    def is_given(self) -> bool:
        """Whether its pose is taken as it stands: neither leveled anew nor found in the images."""
        return self.known == "exactly" and not self.fiducials

    @property
    def is_exact(self) -> bool:
        """Whether that pose has no stated error either."""
        return self.is_given and not (self.position_sd_mm or self.heading_sd_deg)


class WornSensorConfig(ConfigSection):
    """One sensor of a file, and where it is worn."""

    name: str
    recorded_as: str = ""
    """its name in the file; empty: the same, or the file's only sensor"""
    segment: str = ""
    """that carries it, as tibia_l"""
    acceleration: tuple[Axis, Axis, Axis] | None = None
    """columns of x, y, z; only for tables that do not say themselves what they hold"""
    angular_velocity: tuple[Axis, Axis, Axis] | None = None
    acceleration_rows: str = ""
    """what the file's rows_by holds in rows of its accelerations"""
    angular_velocity_rows: str = ""
    """the same of its angular velocities; empty: those of the accelerations"""
    angular_velocity_bias_deg_per_s: Vector = (0.0, 0.0, 0.0)
    """what its gyroscope reads at rest, in its own axes; taken off"""
    acceleration_bias_mg: Vector = (0.0, 0.0, 0.0)
    """what its accelerometer reads too much; taken off"""
    rotation_deg: Vector | None = None
    """rotation vector of the sensor's axes against the segment's, where it is known

    For the comparison with markers (`legsim replay --imu`); corrections need the start instead.
    """
    start: StartConfig | None = None
    """None where unknown: no method can then follow the sensor"""


class ImuFileConfig(ConfigSection):
    """One file of sensors of one clock."""

    file: str
    """beside this TOML, or an absolute path"""
    clock_offset_s: float | None = None
    """the sensors' clock minus the views' (or the markers'); None: about 0, and not sure"""
    rate_hz: float | None = Field(default=None, ge=1e-3, le=1e9)
    time: Column | None = None
    """column of times"""
    angular_velocity_time: Column | None = None
    """column of times of the angular velocities, where ``time`` is that of the accelerations"""
    time_unit: Literal["s", "ms", "us", "ns", "date-time"] | None = None
    """None takes the one that the table states, date-time where its times are such, else s"""
    counter: Column | None = None
    """column of the packets' numbers"""
    counter_period: int | None = Field(default=None, gt=1)
    acceleration_unit: Literal["m/s2", "g", "mg"] | None = None
    """None takes the one that the table states, else m/s2"""
    angular_velocity_unit: Literal["rad/s", "deg/s", "mdeg/s"] | None = None
    """None takes the one that the table states, else rad/s"""
    counts_per_g: Positive | None = None
    """of accelerations in an instrument's counts, instead of a unit"""
    counts_per_deg_per_s: Positive | None = None
    """of angular velocities in counts"""
    rows_by: Column | None = None
    """column that says whose each row is, where sensors or instruments take turns in a table"""
    angular_velocity_file: str = ""
    """table of the angular velocities, where ``file`` has the accelerations alone"""
    sensors: tuple[WornSensorConfig, ...] = ()

    @model_validator(mode="after")
    def _all_columns_or_none(self) -> "ImuFileConfig":
        given = [(s.acceleration is not None, s.angular_velocity is not None) for s in self.sensors]
        if len(set(given) | {(False, False)}) > 1 and set(given) != {(True, True)}:
            raise ValueError(
                "name the columns acceleration and angular_velocity of every sensor, or of none"
            )
        turns = [bool(s.acceleration_rows) for s in self.sensors]
        some = any(s.acceleration_rows or s.angular_velocity_rows for s in self.sensors)
        if (self.rows_by is not None) != some or (some and not all(turns)):
            raise ValueError(
                "rows_by needs acceleration_rows (and angular_velocity_rows, where they are other "
                "rows) of every sensor, and these need rows_by"
            )
        if self.rows_by is not None and self.angular_velocity_file:
            raise ValueError("give rows_by or angular_velocity_file, not both")
        return self

    @property
    def has_columns(self) -> bool:
        """Whether the columns are named here, not by the file."""
        return any(s.acceleration is not None for s in self.sensors)
