"""Joint angles beside those that experts found with OpenSim for the same markers: `python -m
tools.experiments.expert_angles DATA`, for docs/biomechanics.md.

The experts scaled a model with another pelvis and another knee by hand, so that the constant part
of a difference is one of the models too; its standard deviation over the frames is not.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from legsim.core.values import FloatArray
from legsim.kinematics.from_recording import solve_kinematics
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories

FOLDER = "mocap/squats_subject4"
TRIALS = (
    ("squats1, from itself", "squats1.trc", "", "squats1_manual_scaling_ik.mot"),
    ("squats1, from static1", "squats1.trc", "static1.trc", "squats1_manual_scaling_ik.mot"),
    ("static1, from itself", "static1.trc", "", "static1_ik.mot"),
)
ANGLES = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")


def difference(person: MovingLeg, expert: JointTrajectories, coordinate: str) -> FloatArray:
    """(n,) degrees, ours less the experts', at our times within theirs."""
    times = person.trajectories.times
    shown = (times >= expert.times[0]) & (times <= expert.times[-1])
    theirs = np.interp(times[shown], expert.times, expert.coordinate(coordinate))
    if coordinate.startswith("knee") and theirs.mean() > 0:
        theirs = -theirs
    return np.degrees(person.trajectories.coordinate(coordinate)[shown] - theirs)


def cell(off: FloatArray) -> str:
    """Mean and standard deviation, and root mean square."""
    return f"{off.mean():.1f} ± {off.std():.1f} ({np.sqrt(np.mean(off**2)):.1f})"


def main(data: Annotated[Path, typer.Argument(help="Folder with mocap/squats_subject4.")]) -> None:
    """Mean ± standard deviation (RMS) of the difference over the frames, degrees."""
    typer.echo(
        "| trial | coordinate | right, as scaled | registered | left, as scaled | registered |"
    )
    typer.echo("|---|---|---|---|---|---|")
    folder = data / FOLDER
    for label, file, source, theirs in TRIALS:
        expert = opensim.load(folder / theirs)
        people = [
            solve_kinematics(
                folder / file, scale_from=folder / source if source else None, register=register
            )
            for register in (False, True)
        ]
        for angle in ANGLES:
            cells = [
                cell(difference(person, expert, f"{angle}_{side}"))
                for side in "rl"
                for person in people
            ]
            typer.echo(f"| {label} | {angle.replace('_', ' ')} | {' | '.join(cells)} |")


if __name__ == "__main__":
    typer.run(main)
