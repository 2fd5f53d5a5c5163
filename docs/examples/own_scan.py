"""Files of a run as another laboratory would have them, with a SCAN.toml written by hand.

    legsim run --preset demo --out run
    python docs/examples/own_scan.py run own
    legsim correct own/scan.toml --method rigid --out corrected

Projections become a TIFF, the geometry is RTK's, and each sensor is a table of its own: in g and
deg/s, counted by packets, by a clock that reads 12.5 s more than the scanner's.
"""

import csv
import shutil
import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk

import legsim as ls
from legsim.core.transforms import vector_from_rotation

CLOCK = 12.5
"""s that the sensors' clock reads more"""

SENSOR = """file = "{name}.csv"
clock_offset_s = {clock!r}
time = "t"
acceleration_unit = "g"
angular_velocity_unit = "deg/s"

[[sensors]]
name = "{name}"
segment = "{segment}"
acceleration = ["ax", "ay", "az"]
angular_velocity = ["gx", "gy", "gz"]

[sensors.start]    # about where the sensor was: centimeters, and a few degrees of its heading
known = "roughly"
position_mm = {position}
rotation_deg = {rotation}
position_sd_mm = 10
heading_sd_deg = 3
"""

SCAN = """projections = "projections.tif"
geometry = "geometry.xml"
pixel_mm = {pixel!r}          # RTK's geometry is in mm on the detector
view_times = "views.csv"      # or view_rate_hz = 31
imu = {imu}

[grid]
like = "{grid}"               # or shape_zyx and spacing_mm
"""


def write_sensor(folder: Path, scan: ls.MeasuredScan, k: int) -> str:
    """Writes one sensor's table and the TOML about it; returns the TOML's name."""
    signals = scan.seen.signals
    name, start = signals.sensor_names[k], scan.seen.starts[k]
    with (folder / f"{name}.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["logger 7, firmware 1.2"])
        writer.writerow(["t", "ax", "ay", "az", "gx", "gy", "gz"])
        force = signals.specific_force[:, k] / 9.80665
        rate = np.degrees(signals.angular_velocity[:, k])
        for row in np.column_stack([signals.times + CLOCK, force, rate]):
            writer.writerow(f"{x:.7f}" for x in row)
    rotation = np.degrees(vector_from_rotation(start.world_from_sensor[:3, :3]))
    text = SENSOR.format(
        name=name,
        clock=CLOCK,
        segment=scan.segments[name],
        position=(10 * np.round(100 * start.world_from_sensor[:3, 3])).tolist(),
        rotation=(np.round(rotation) + 0.0).tolist(),
    )
    (folder / f"{name}.toml").write_text(text)
    return f"{name}.toml"


def main(run: Path, own: Path) -> None:
    """Writes the folder ``own`` from the run."""
    own.mkdir(parents=True, exist_ok=True)
    scan = ls.load_measured_scan(run / "scan.toml")
    image = sitk.ReadImage(str(run / "projections.mha"))
    sitk.WriteImage(image, str(own / "projections.tif"))
    shutil.copy(run / "geometry_rtk.xml", own / "geometry.xml")
    np.savetxt(own / "views.csv", scan.seen.times, "%.6f", header="time_s", comments="")
    names = [write_sensor(own, scan, k) for k in range(len(scan.seen.starts))]
    grid = (run / "volume-static.mha").resolve()
    text = SCAN.format(pixel=image.GetSpacing()[0], imu=names, grid=grid)
    (own / "scan.toml").write_text(text)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
