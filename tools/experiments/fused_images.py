"""Methods that look at sharpness, on rendered images. `python -m tools.experiments.fused_images`,
for docs/methods.md.

One sensor on the shank with the errors of one that can be bought, a rough start, the preset "demo"
with both legs. Columns as in tools/experiments/fusion.py: RMS distance of the tibia's projections
after the constant similarity that fits best, which is what blurs a volume; the same without it;
millimeters; degrees; seconds of processor time.
"""

import time
from dataclasses import replace
from typing import Annotated

import numpy as np
import typer

from legsim.correction.autofocus import Autofocus
from legsim.correction.fused_images import FusedImages
from legsim.correction.method import CorrectionMethod
from legsim.correction.rigid import Uncorrected
from legsim.deformation.models import RigidMotion
from legsim.evaluation import similarity
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import Volume
from legsim.opencl.device import open_device
from legsim.reconstruction.fdk import fdk
from legsim.run import c_arm as run_c_arm
from legsim.run import volumes
from legsim.simulation.setup import scan_regions
from legsim.simulation.simulated_scan import expose
from tools.experiments import fusion


def main(
    files: Annotated[str, typer.Option()] = "subject01/squat_60.trc",
    sensor: str = "bmi160",
    seeds: int = 1,
    only: Annotated[str, typer.Option(help="Methods, separated by spaces.")] = "autofocus fused",
    scores: Annotated[bool, typer.Option(help="SSIM and RMSE of volumes, too.")] = False,
) -> None:
    """Prints one row per scan, method and seed."""
    device = open_device()
    typer.echo("| scan | method | px after similarity | px | mm | deg | CPU s | SSIM leg, shank |")
    typer.echo("|" + "---|" * 8)
    for file in files.split():
        settings, setup = fusion.placed(file, sensor)
        priors, paths = volumes.sensor_priors(settings), fusion.tibia(settings, setup)
        images, still = (
            expose(setup, moving, device, np.random.default_rng([0, k]))
            for k, moving in enumerate((True, False))
        )
        grid = run_c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
        regions = scan_regions(setup, grid, device) if scores else ()
        reference = fdk(still, grid, device=device) if scores else None

        def compared(
            images: Projections,
            motion: RigidMotion,
            grid=grid,
            reference: Volume | None = reference,
            regions=regions,
        ) -> str:
            if reference is None:
                return "-"
            volume = fdk(images, grid, motion=motion, device=device)
            found = similarity.evaluate(volume, reference, regions, device=device)
            return ", ".join(f"{found.of(name).ssim:.4f}" for name in ("leg", "shank"))

        for seed in range(seeds):
            scan = replace(fusion.scanned(settings, setup, seed), projections=images)
            offered: dict[str, CorrectionMethod] = {
                "autofocus": Autofocus(priors.spread, device=device),
                "fused": FusedImages("shank_l", priors, device),
            }
            chosen = {"uncorrected": Uncorrected()} | {n: offered[n] for n in only.split()}
            for name, method in chosen.items():
                began = time.process_time()
                found = method(scan)
                seconds = time.process_time() - began
                none = RigidMotion.identity(scan.times)
                motion = found.motion if isinstance(found.motion, RigidMotion) else none
                cells = " | ".join(f"{c:.3g}" for c in fusion.row(motion, setup, paths))
                typer.echo(
                    f"| {file} | {name} | {cells} | {seconds:.0f} | {compared(images, motion)} |"
                )
                typer.echo(" ".join(found.notes), err=True)


if __name__ == "__main__":
    typer.run(main)
