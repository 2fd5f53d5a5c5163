"""Small valid files of sensors, to be damaged."""

from pathlib import Path

import numpy as np

from legsim.imu import files as imu_files
from legsim.imu.signals import ImuSignals
from tools.fuzz.samples import Maker, content


def imu(path: Path) -> None:
    """Two sensors in legsim's own table."""
    from tests.examples.sensors import still

    one = still(30)
    rate = np.stack([one.angular_velocity] * 2, 1)
    force = np.stack([one.specific_force] * 2, 1)
    imu_files.save_imu(path, ImuSignals(one.times, ("a", "b"), rate, force))


def imu_rows(scale: float = 1.0) -> list[list[float]]:
    """(t, three of acceleration, three of angular velocity) of a sensor at rest."""
    from tests.examples.sensors import still

    one = still(30)
    return np.column_stack([one.times, scale * one.specific_force, one.angular_velocity]).tolist()


def xsens(path: Path) -> None:
    """A text export of Xsens."""
    head = "// Start Time: Unknown\n// Update Rate: 100.0Hz\nPacketCounter,SampleTimeFine,"
    head += "Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z\n"
    rows = (
        f"{(65520 + k) % 65536},,{','.join(map(repr, row[1:]))}" for k, row in enumerate(imu_rows())
    )
    path.write_text(head + "\n".join(rows) + "\n")


def imu_storage(path: Path) -> None:
    """OpenSim's vectors, both quantities in one table."""
    head = "DataRate=100.0\nDataType=Vec3\nversion=3\nendheader\n"
    head += "time\ttibia|linear_acceleration\ttibia|angular_velocity\n"
    rows = (
        f"{t!r}\t{','.join(map(repr, f))}\t{','.join(map(repr, w))}"
        for t, f, w in ((row[0], row[1:4], row[4:]) for row in imu_rows())
    )
    path.write_text(head + "\n".join(rows) + "\n")


def imu_table(path: Path) -> None:
    """A logger's table with a counter."""
    lines = ["some logger 1.0", "", "n;ax;ay;az;gx;gy;gz"]
    lines += [";".join(map(str, [250 + k, *row[1:]])) for k, row in enumerate(imu_rows())]
    path.write_text("\n".join(lines) + "\n")


IMU_TOML = """file = "table.csv"
rate_hz = 100.0
counter = "n"
clock_offset_s = 0.5
[[sensors]]
name = "shank"
segment = "tibia_l"
acceleration = ["ax", "ay", "az"]
angular_velocity = ["gx", "gy", "gz"]
acceleration_bias_mg = [1.0, 2.0, 3.0]
[sensors.start]
position_mm = [0.0, 1.0, 2.0]
rotation_deg = [0.0, 90.0, 0.0]
"""


CHANNELS = ("ACC X", "ACC Y", "ACC Z", "GYR X", "GYR Y", "GYR Z")

CHANNELS_TOML = """file = "file.c3d"
[[sensors]]
name = "shank"
acceleration = ["ACC X", "ACC Y", 3]
angular_velocity = ["GYR X", "GYR Y", "GYR Z"]
"""


def channels(*, processor: int = 84, scale: float = -0.1, unsigned: bool = False) -> Maker:
    """A C3D with a sensor at rest in six analog channels, in m/s^2 and deg/s."""
    from tests.references.c3d import Channels, c3d_bytes

    zero = 32768 if unsigned else 0
    steps = np.repeat([1e-3, 1e-5], 3)
    rows = np.array(imu_rows())[:28, 1:]
    made = Channels(
        np.rint(rows / steps).astype(int) + zero,
        CHANNELS,
        ["m/s2"] * 3 + ["deg/s"] * 3,
        (steps * np.repeat([1.0, 180 / np.pi], 3)).tolist(),
        [zero] * 6,
        unsigned=unsigned,
    )
    points = np.ones((7, 2, 3))
    return content(c3d_bytes(points, ["A", "B"], processor=processor, scale=scale, channels=made))
