"""Held squats scaled from the person's active squats or from themselves: `python tools/scaling_errors.py`, for docs/biomechanics.md."""

from typing import Annotated

import numpy as np
import typer
from posture_statistics import load_truth

from legsim import recovery, resources
from legsim.arrays import FloatArray
from legsim.config import MotionConfig

JOINTS = "hip", "knee", "ankle"


def center_errors(name: str, scaling_file: str) -> FloatArray:
    """(3,) mm RMS over frames and sides: distance of hip, knee and ankle centers from the truth beside the recording."""
    truth = load_truth(str(resources.motion_file(f"{name}_truth.npz")))
    recovered = recovery.recover(MotionConfig(file=f"{name}.trc", scaling_file=scaling_file))
    found = recovered.leg.joint_centers(recovered.leg.segment_poses(recovered.trajectories))
    pairs = [[found.names.index(f"{joint}_{side}") for side in "lr"] for joint in JOINTS]
    distances = np.linalg.norm(found.positions_world - truth.joint_centers, axis=-1)
    return 1e3 * np.array([np.sqrt(np.mean(distances[:, pair] ** 2)) for pair in pairs])


def main(subjects: Annotated[int, typer.Option(help="How many of the subjects.")] = 7) -> None:
    """RMS errors of joint centers over all held squats, with both scalings."""
    names = [f"subject{k:02d}/squat_{bend}" for k in range(1, subjects + 1) for bend in (30, 60)]
    typer.echo("| held squat | scaled from squats.trc: hip, knee, ankle (mm) | scaled from itself |\n|---|---|---|")
    rows = []
    for name in names:
        rows.append([center_errors(name, scaling_file) for scaling_file in ("", f"{name}.trc")])
        typer.echo(f"| {name} | " + " | ".join(", ".join(f"{e:.1f}" for e in errors) for errors in rows[-1]) + " |")
    means = np.sqrt(np.mean(np.square(rows), 0))
    typer.echo("| RMS of all | " + " | ".join(", ".join(f"{e:.1f}" for e in errors) for errors in means) + " |")


if __name__ == "__main__":
    typer.run(main)
