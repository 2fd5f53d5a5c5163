"""A run as raw files of three makers, with a SCAN.toml written by hand.

    legsim run --preset demo --set phantom.legs=scanned --out run
    python docs/examples/own_counts.py run own
    legsim correct own/scan.toml --method rigid --method standing --out corrected

Projections become a TIFF of counts whose tube varies from view to view, the geometry ASTRA's
vectors, and each sensor a text export of Xsens' MT Manager. The grid is left out: it is the field
of view.
"""

import sys
from pathlib import Path

import numpy as np
import tifffile

import legsim as ls
from legsim.core.transforms import vector_from_rotation
from legsim.geometry.files import save_geometry

SCAN = """projections = "counts.tif"
geometry = "vectors.txt"
format = "astra"
pixel_mm = {pixel!r}          # ASTRA's vectors have no unit
view_times = "views.csv"      # or view_rate_hz = 31

[counts]                      # how counts become line integrals
air = "{air}"         # columns and rows that see no object in any view
"""

SENSOR = """
[[imu]]
file = "{name}.txt"
clock_offset_s = {clock!r}

[[imu.sensors]]
name = "{name}"
segment = "{segment}"

[imu.sensors.start]           # about where it was: a centimeter, and a few degrees of its heading
known = "roughly"
position_mm = {position}
rotation_deg = {rotation}
position_sd_mm = 10
heading_sd_deg = 3
"""

UNATTENUATED = 60000
FIRST_PACKET = 65000
"""near the counter's end, where it starts at 0 again"""


def air_region(images: np.ndarray) -> str:
    """Columns at the left edge, in the middle half of the rows, that see no object in any view."""
    rows = images.shape[1] // 4, 3 * images.shape[1] // 4
    shaded = np.flatnonzero(images[:, slice(*rows)].max((0, 1)) > 0)
    if len(shaded) == 0 or shaded[0] == 0:
        sys.exit("the object reaches the edge of the detector: scan one leg alone")
    return f"0:{shaded[0]},{rows[0]}:{rows[1]}"


def counts(images: np.ndarray) -> np.ndarray:
    """What a detector of 16 bits reads, the tube varying by a few percent."""
    tube = 1 + 0.05 * np.sin(np.arange(len(images)))
    return np.round(UNATTENUATED * tube[:, None, None] * np.exp(-images)).astype(np.uint16)


def write_xsens(path: Path, signals: ls.ImuSignals, k: int) -> float:
    """Writes sensor ``k``; returns what its clock, which starts at 0, reads more than ours."""
    rate = 1 / float(np.median(np.diff(signals.times)))
    packets = np.round((signals.times - signals.times[0]) * rate).astype(int)
    names = ["PacketCounter", *(f"{kind}_{axis}" for kind in ("Acc", "Gyr") for axis in "XYZ")]
    lines = ["// Start Time: Unknown", f"// Update Rate: {rate:.1f}Hz", "\t".join(names)]
    readings = np.concatenate([signals.specific_force[:, k], signals.angular_velocity[:, k]], -1)
    for packet, row in zip(packets, readings, strict=True):
        counter = (FIRST_PACKET + packet) % 65536
        lines.append("\t".join([str(counter), *(f"{x:.7f}" for x in row)]))
    path.write_text("\r\n".join(lines) + "\r\n", "utf-8", newline="")
    return 0.0 - float(signals.times[0])


def write(scan: ls.MeasuredScan, own: Path) -> None:
    """Writes the files of a scan, and a SCAN.toml about them."""
    own.mkdir(parents=True, exist_ok=True)
    projections, signals = scan.seen.projections, scan.seen.signals
    images, geometry = projections.line_integrals.astype(float), projections.geometry
    tifffile.imwrite(own / "counts.tif", counts(images))
    save_geometry(own / "vectors.txt", geometry, format="astra")
    np.savetxt(own / "views.csv", scan.seen.times, "%.6f", header="time_s", comments="")
    text = SCAN.format(pixel=round(1e3 * geometry.pixel_pitch, 6), air=air_region(images))
    for k, (name, start) in enumerate(zip(signals.sensor_names, scan.seen.starts, strict=True)):
        clock = write_xsens(own / f"{name}.txt", signals, k)
        pose = start.world_from_sensor
        text += SENSOR.format(
            name=name,
            clock=clock,
            segment=scan.segments[name],
            position=(10 * np.round(100 * pose[:3, 3])).tolist(),
            rotation=(np.round(np.degrees(vector_from_rotation(pose[:3, :3]))) + 0.0).tolist(),
        )
    (own / "scan.toml").write_text(text, "utf-8")


if __name__ == "__main__":
    write(ls.load_measured_scan(Path(sys.argv[1]) / "scan.toml"), Path(sys.argv[2]))
