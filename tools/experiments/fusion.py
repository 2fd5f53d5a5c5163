"""Sensors fused with a standing person and with beads. `python -m tools.experiments.fusion`, for
docs/fusion.md.

One sensor on the shank with the errors of one that can be bought, a rough start, and beads on the
skin below the knee whose shadows are projected exactly and then missed by 0.2 px; no image is made
(:mod:`legsim.study.aiding`, as in `legsim study sensors`). The truth is the tibia's.
"""

from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.core.progress import silent
from legsim.study import aiding
from legsim.study.aiding import Left

AIDS = ("uncorrected", "dead-reckoning", "standing", "beads-1", "beads-2", "beads-4")


def row(draws: list[Left]) -> str:
    """Cells: mean and greatest over the draws, and how many motions were followed."""
    numbers = (
        f"{np.mean(c):.3g} ({np.max(c):.3g})" for c in zip(*(d[:4] for d in draws), strict=True)
    )
    return " | ".join([*numbers, str(sum(d.followed for d in draws))])


def main(
    files: Annotated[str, typer.Option()] = "subject01/squat_60.trc",
    sensor: str = "bmi160",
    calibration: str = "none",
    seeds: int = 3,
) -> None:
    """Prints one row per scan and aid."""
    columns = ("scan", "aid", "px after similarity", "px", "mm", "deg", "followed")
    typer.echo(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for file in files.split():
        given = (
            *(f"motion.file={file}", "methods.start=rough"),
            *(f"imu.noise.kind={sensor}", f"imu.noise.calibration={calibration}"),
        )
        settings = config.load_settings(preset="demo", overrides=given)
        found = aiding.measure(settings, AIDS, range(seeds), silent)
        for aid in AIDS:
            typer.echo(f"| {file} | {aid} | {row([draw[aid] for draw in found])} |")


if __name__ == "__main__":
    typer.run(main)
