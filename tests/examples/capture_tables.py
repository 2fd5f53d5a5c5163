"""Tables of markers as Motive, Nexus and Qualisys Track Manager export them."""

import numpy as np

NAMES = ("LASI", "RASI", "LKNE")
RATE = 120.0


def row(numbers: np.ndarray) -> list[str]:
    return ["" if np.isnan(x) else f"{x:.3f}" for x in numbers.ravel()]


def motive(positions: np.ndarray, *, kind: str = "Marker", space: str = "Global") -> str:
    """With a bone, the time code, and where the skeleton expects a marker, as Motive 3 may write."""
    kinds = ["", "Type", "", "Bone", "Bone", "Bone", *[kind] * 9, *["Bone Marker"] * 3]
    names = ["", "Name", "", *["Joe:Hip"] * 3, *(f"Joe:{n}" for n in NAMES for _ in range(3))]
    units = ["", "", "", *["Position"] * 15]
    axes = ["Frame", "Time (Seconds)", "TimeCode", *"XYZ" * 5]
    head = (
        f"Format Version,1.25,Take Name,a,Export Frame Rate,{RATE:f},Length Units,Millimeters,"
        f"Coordinate Space,{space}\r\n\r\n"
    )
    ids = ["", "ID", "", *["A"] * 15]
    lines = [kinds, [*names, *["Joe:LASI"] * 3], ids, units, axes]
    for k, frame in enumerate(positions):
        cells = [str(k), f"{k / RATE:.6f}", "15:26:46:12.02", "1", "2", "3", *row(frame)]
        lines.append([*cells, "7", "8", "9"])
    return "\ufeff" + head + "\r\n".join(",".join(line) for line in lines) + "\r\n"


def nexus(positions: np.ndarray) -> str:
    """With devices before the trajectories, and blank lines."""
    lines = [
        "Devices", "1200", ",,Force", "Frame,Sub Frame,Fx", ",,N", "1,0,3", "", "Trajectories",
        f"{RATE:g}", ",," + ",,,".join(f"Joe:{n}" for n in NAMES) + ",,",
        "Frame,Sub Frame" + ",X,Y,Z" * 3, "," + ",mm" * 9,
    ]  # fmt: skip
    lines += [",".join([str(k + 1), "0", *row(frame)]) for k, frame in enumerate(positions)]
    return "\n".join([*lines, "", ""])


def qualisys(positions: np.ndarray, *, timed: bool = True, included: str = "3D") -> str:
    head = [
        f"NO_OF_FRAMES\t{len(positions)}", "NO_OF_MARKERS\t3", f"FREQUENCY\t{RATE:g}",
        "TIME_STAMP\t2022-06-03, 10:47:36.627\t94247.45", f"DATA_INCLUDED\t{included}",
        "MARKER_NAMES\t" + "\t".join(NAMES) + "\t", "TRAJECTORY_TYPES\tMeasured\tMeasured\tMixed",
    ]  # fmt: skip
    head += ["Frame\tTime\t" + "\t".join(f"{n} {x}" for n in NAMES for x in "XYZ")] * timed
    for k, frame in enumerate(np.nan_to_num(positions)):
        before = [str(k + 1), f"{k / RATE:.5f}"] * timed
        head.append("\t".join([*before, *row(frame)]))
    return "\n".join(head) + "\n"
