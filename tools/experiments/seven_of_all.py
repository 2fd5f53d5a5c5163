"""Real squats by seven markers beside the same squats by all of them: `python -m
tools.experiments.seven_of_all DATA`, for docs/biomechanics.md.

Both are registered from themselves. The feet carry markers in these recordings, so that the
solution with all of them has no planted feet; it is not the truth, but knows more.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

from legsim.kinematics.from_recording import solve_kinematics
from legsim.mocap import files, marker_sets
from legsim.mocap.labels import PAPER_ROLES

TRIALS = "squats_subject4/squats1.trc", "squat_dart/squat.c3d"
ANGLES = "hip_rotation", "knee_angle"


def seven_of(recording: Path) -> str:
    """A marker map (TOML) of the seven roles alone; a sacrum that has no marker is the middle of
    the PSIS.
    """
    names = files.read_markers(recording, unit=None, up=None)[0].marker_names
    labels = marker_sets.guess(names).found_in(names)
    labels.setdefault("sacrum", (*labels["psis_r"], *labels["psis_l"]))
    quoted = {role: ", ".join(f'"{label}"' for label in labels[role]) for role in PAPER_ROLES}
    return "\n".join(["[roles]", *(f"{role} = [{text}]" for role, text in quoted.items())])


def main(data: Annotated[Path, typer.Argument(help="Folder with mocap/.")]) -> None:
    """RMS of the differences over the frames, degrees."""
    typer.echo("| recording | hip rotation right, left (deg) | knee right, left (deg) |")
    typer.echo("|---|---|---|")
    for trial in TRIALS:
        recording = data / "mocap" / trial
        with TemporaryDirectory() as folder:
            seven = Path(folder) / "seven.toml"
            seven.write_text(seven_of(recording), "utf-8")
            found, whole = (
                solve_kinematics(recording, marker_map=chosen).trajectories
                for chosen in (seven, "auto")
            )
        cells = []
        for angle in ANGLES:
            sides = [
                found.coordinate(f"{angle}_{s}") - whole.coordinate(f"{angle}_{s}") for s in "rl"
            ]
            cells.append(", ".join(f"{np.degrees(np.sqrt(np.mean(d**2))):.1f}" for d in sides))
        typer.echo(f"| {trial} | {' | '.join(cells)} |")


if __name__ == "__main__":
    typer.run(main)
