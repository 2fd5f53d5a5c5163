"""What the columns of a table of sensors are, as somebody says it."""

from dataclasses import dataclass

from legsim.core.errors import LegsimError
from legsim.imu.table_rows import Column
from legsim.imu.units import AccelerationUnit, AngularVelocityUnit, TimeUnit


@dataclass(frozen=True, slots=True)
class SensorColumns:
    """Columns of one sensor."""

    name: str
    acceleration: tuple[Column, Column, Column]
    """columns of x, y, z; "-ax", or -2, is a column with the other sign"""
    angular_velocity: tuple[Column, Column, Column]
    acceleration_rows: str = ""
    """what the layout's ``rows_by`` holds in rows of its accelerations"""
    angular_velocity_rows: str = ""


ONE_CLOCK = (
    "a table of sensors has times by a column (time) or by a rate (rate_hz); give one of them"
)


@dataclass(frozen=True, slots=True)
class TableLayout:
    """What the columns of a table are."""

    sensors: tuple[SensorColumns, ...]
    acceleration_unit: AccelerationUnit | None = None
    """None takes the one that the table states, else m/s2"""
    angular_velocity_unit: AngularVelocityUnit | None = None
    """None takes the one that the table states, else rad/s"""
    time: Column | None = None
    """column of times; None where rate_hz gives them, or the channels of a C3D have their own"""
    angular_velocity_time: Column | None = None
    """column of times of the angular velocities, where these have their own"""
    time_unit: TimeUnit | None = None
    """None takes the one that the table states, or dates where there are any, else s"""
    rate_hz: float | None = None
    counter: Column | None = None
    """column of the packets' numbers; with rate_hz it gives times, and shows lost packets"""
    counter_period: int | None = None
    """count after which the counter starts at 0 again; None finds it"""
    counts_per_g: float | None = None
    """of accelerations in counts, as the sensor's data sheet has it"""
    counts_per_deg_per_s: float | None = None
    """of angular velocities in counts"""
    rows_by: Column | None = None
    """column that says whose each row is, where sensors or instruments take turns"""

    def __post_init__(self) -> None:
        if self.time is not None and self.rate_hz is not None:
            raise LegsimError(ONE_CLOCK)
        if self.angular_velocity_time is not None and (self.time is None or self.rows_by):
            raise LegsimError(
                "angular_velocity_time is beside time, the column of the accelerations' times, and "
                "without rows_by; give time, or leave it out"
            )
        whose = [t for s in self.sensors for t in (s.acceleration_rows, s.angular_velocity_rows)]
        if any(whose) != (self.rows_by is not None) or any(whose) != all(whose):
            rows = "acceleration_rows and angular_velocity_rows of every sensor"
            raise LegsimError(f"rows_by needs {rows}, and these need rows_by; give all or none")
        if self.counter is not None and self.rate_hz is None:
            raise LegsimError("a packet counter needs rate_hz to become times; give it")
        for unit, counts, name in (
            (self.acceleration_unit, self.counts_per_g, "counts_per_g"),
            (self.angular_velocity_unit, self.counts_per_deg_per_s, "counts_per_deg_per_s"),
        ):
            if unit is not None and counts is not None:
                raise LegsimError(f"{name} is given beside the unit {unit}; give one of them")
