"""What the beads' poses are fitted to: static mean positions, as published, or positions estimated
together with the poses. `python -m tools.experiments.bead_reference`, for docs/methods.md.

Beads are rendered into the images of a scan and tracked once; both references take the same
shadows. "Places known" is what would be left if somebody had measured the beads' places at the
first view. Residuals are RMS at the bones within the field of view, before any registration.
"""

import time
from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.config import RunConfig
from legsim.correction import bead_scan, bead_tracking
from legsim.correction.bead_scan import Beads, BeadScan
from legsim.deformation.models import RigidMotion
from legsim.evaluation import residual_motion
from legsim.evaluation.residual_motion import Residual
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm
from legsim.run.scores import structures
from legsim.simulation.setup import PhantomOptions, ScanSetup, prepare_scan
from legsim.simulation.simulated_scan import expose
from tools.experiments.bead_gauge import size

VOXEL, VOXELS = 1.6e-3, 160


def scanned(settings: RunConfig, device: Device) -> tuple[ScanSetup, BeadScan]:
    """The scan of a recording, and its images with beads."""
    person = run_motion.solve(settings.motion)
    wanted = settings.phantom
    setup = prepare_scan(
        person,
        c_arm(settings.scan),
        side=settings.scan.side,
        phantom=PhantomOptions(wanted.legs, wanted.detail, wanted.energy_kev),
    )
    rng = np.random.default_rng(settings.seed)
    images = expose(setup, True, device, rng)
    beads = settings.methods.beads
    made = Beads(
        beads.count,
        0.5e-3 * beads.diameter_mm,
        1e-3 * beads.reach_mm,
        # the search starts at the true places, so that these can serve as "known" as well
        0.0,
    )
    seen = bead_scan.add_beads(
        images,
        setup.phantom,
        setup.poses,
        made,
        device,
        side=setup.side[0],
        energy_kev=wanted.energy_kev,
        rng=rng,
        rays_per_pixel=setup.c_arm.rays_per_pixel,
    )
    return setup, seen


def left(setup: ScanSetup, motion: RigidMotion | None) -> tuple[Residual, ...]:
    """What a motion leaves, by structure."""
    center = [float(c) for c in setup.geometry.rotation_center()]
    shown = structures(setup, VolumeGrid.cubic(VOXELS, VOXEL, center))
    return residual_motion.of_motion(motion, shown, setup.geometry)


def row(name: str, reference: str, cells: tuple[str, ...], found: tuple[Residual, ...]) -> str:
    """One line of the table."""
    by_name = {r.structure: r for r in found}
    bones = [r for r in found if r.structure != "skin"]
    pixels = (
        float(np.sqrt(np.mean(np.square([getattr(r, field) for r in bones]))))
        for field in ("pixels", "pixels_after_similarity")
    )
    mm = (f"{by_name[bone].mm:.2f}" for bone in ("femur", "tibia"))
    shown = (*cells, *mm, *(f"{value:.3f}" for value in pixels))
    return f"| {name} | {reference} | {' | '.join(shown)} |"


def main(
    motion_files: Annotated[str, typer.Option()] = "subject01/squat_30.trc subject01/squat_60.trc",
    preset: str = "demo",
) -> None:
    """Prints the table."""
    device = open_device()
    typer.echo(
        "| scan | poses fitted to | size found | misfit (px) | femur (mm) | tibia (mm) "
        "| bones (px) | px after similarity |\n|---|---|---|---|---|---|---|---|"
    )
    for name in motion_files.split():
        settings = config.load_settings(preset=preset, overrides=(f"motion.file={name}",))
        setup, seen = scanned(settings, device)
        began = time.process_time()
        pixels = bead_tracking.track(seen.projections, seen.guesses, radius=seen.radius)
        spent = [time.process_time() - began]
        typer.echo(row(name, "nothing (uncorrected)", ("–", "–"), left(setup, None)))
        for reference in ("mean", "bundle"):
            began = time.process_time()
            found = bead_tracking.estimate(setup.geometry, pixels, reference=reference)
            spent.append(time.process_time() - began)
            cells = f"{size(found.positions, seen.guesses):.4f}", f"{found.residual_px:.3f}"
            typer.echo(row(name, reference, cells, left(setup, found.motion)))
        known = bead_tracking.poses(setup.geometry, pixels, seen.guesses)
        typer.echo(row(name, "places known", ("1", "–"), left(setup, known)))
        seconds = ", ".join(f"{value:.2f}" for value in spent)
        typer.echo(f"CPU seconds of tracking, mean, bundle: {seconds}", err=True)


if __name__ == "__main__":
    typer.run(main)
