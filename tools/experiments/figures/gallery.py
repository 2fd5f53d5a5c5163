"""Draws the pictures of docs/gallery.md: the notebook's calls and the example method on one scan.

Usage: python -m tools.experiments.figures.gallery [--out docs/images] (one minute)
"""

import argparse
import runpy
import warnings
from pathlib import Path

import legsim as ls
from legsim.figures import png

ROOT = Path(__file__).parents[3]


def main() -> None:
    """Writes gallery-angles.png, gallery-imu.png and gallery-slices.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    # the published scan is 0.1 degrees short of complete
    warnings.simplefilter("ignore")
    person = ls.solve_kinematics("subject06/squat_60.trc")
    imu = ls.simulate_imu(person)
    angles = ls.plot_angles(person, ["knee_angle_l", "hip_flexion_l", "ankle_angle_l"])
    (out / "gallery-angles.png").write_bytes(png(angles, dpi=80))
    (out / "gallery-imu.png").write_bytes(png(ls.plot_imu(imu), dpi=80))
    own = runpy.run_path(str(ROOT / "docs/examples/own_method.py"))["without_drift"]
    scan = ls.simulate_scan(person, ls.CArm.half(), imu)
    methods = {
        "uncorrected": ls.Uncorrected(),
        "rigid": ls.Rigid("shank_l"),
        "without_drift": own,
        "joints": ls.NonRigid3D(),
    }
    volumes, table = ls.compare(scan, methods, scan.grid(160, 1.6e-3))
    slices = ls.plot_slices(window_per_mm=None, **volumes)
    (out / "gallery-slices.png").write_bytes(png(slices, dpi=80))
    print(table)


if __name__ == "__main__":
    main()
