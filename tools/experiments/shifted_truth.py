"""What the comparison takes off a volume that is right, but elsewhere by a part of a voxel.

    python -m tools.experiments.shifted_truth [--set motion.file=... --set phantom.legs=scanned ...]

The true rigid motion, and the same with the whole volume moved by a constant shift along x. Nothing
is wrong with either: registration takes a constant away. What SSIM and RMSE of the leg lose by
--set evaluation.registered=resampled is what resampling does to noise and streaks finer than the
voxels. For docs/methods.md.
"""

import warnings
from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.core import transforms
from legsim.correction.oracle import Oracle
from legsim.deformation.models import RigidMotion
from legsim.reconstruction.weights import ShortScanWarning
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.simulation import comparison
from legsim.simulation.setup import PhantomOptions
from legsim.simulation.simulated_scan import simulate_scan

SHIFTS = (0.0, 0.1, 0.2, 0.4, 0.5, 1.0)
"""voxels"""


def main(
    preset: str = "demo", change: Annotated[list[str] | None, typer.Option("--set")] = None
) -> None:
    """Prints one row per shift."""
    warnings.simplefilter("ignore", ShortScanWarning)
    settings = config.load_settings(preset=preset, overrides=tuple(change or ()))
    wanted = settings.phantom
    scan = simulate_scan(
        run_motion.solve(settings.motion),
        run_c_arm.c_arm(settings.scan),
        side=settings.scan.side,
        phantom=PhantomOptions(wanted.legs, wanted.detail, wanted.energy_kev),
    )
    grid = run_c_arm.volume_grid(settings.grid, scan.setup.geometry.rotation_center())
    true = scan.truth.motion_of(scan.setup.named("tibia"))
    methods = {}
    for shift in SHIFTS:
        moved = transforms.translation(np.array([shift * grid.spacing_xyz[0], 0.0, 0.0]))
        methods[f"{shift:g} voxels"] = Oracle(
            RigidMotion(true.times, moved @ true.moved_from_reference)
        )
    table = comparison.compare(scan, methods, grid, registered=settings.evaluation.registered).table
    typer.echo("| moved by | SSIM leg | RMSE leg |\n|---|---|---|")
    for name in methods:
        leg = table[name].of("leg")
        typer.echo(f"| {name} | {leg.ssim:.4f} | {leg.rmse:.4f} |")


if __name__ == "__main__":
    typer.run(main)
