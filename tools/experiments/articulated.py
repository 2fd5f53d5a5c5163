"""What rigid bones with tissue between them leave. `python -m tools.experiments.articulated`, for
docs/methods.md.

Sensors without errors, exact starts, one scan per recording. Residual motion at points of femur,
tibia, patella and skin: RMS in mm over points and views. "No bones" is the same motion where no
bone was looked for. With --ssim volumes are reconstructed and compared with the scan at rest.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.config import RunConfig
from legsim.correction.articulated import Articulated, limbs_of
from legsim.correction.initialization import from_truth, leveled
from legsim.correction.limb_motion import articulated_motion
from legsim.correction.method import Correction, Scan
from legsim.correction.nonrigid import NonRigid3D
from legsim.correction.oracle import Oracle
from legsim.correction.rigid import Uncorrected
from legsim.evaluation import residual_motion, similarity
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.imu.simulation import simulate_imu
from legsim.opencl.device import Device, open_device
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import reconstruction
from legsim.run.scores import structures
from legsim.simulation.setup import (
    PhantomOptions,
    ScanSetup,
    joints_on_sensors,
    prepare_scan,
    scan_regions,
)
from legsim.simulation.simulated_scan import ScanTruth, expose

_HELD = " ".join(f"subject0{k}/squat_{angle}.trc" for k in range(1, 8) for angle in (30, 60))
_SHOWN = ("femur", "tibia", "patella", "skin")


@dataclass(frozen=True)
class Scanned:
    """A person in the C-arm, and what the scanner and sensors without errors record."""

    settings: RunConfig
    setup: ScanSetup
    seen: Scan
    grid: VolumeGrid
    device: Device

    @classmethod
    def of(cls, settings: RunConfig, device: Device) -> "Scanned":
        """The scan of a recording, moving."""
        wanted, person = settings.phantom, run_motion.solve(settings.motion)
        setup = prepare_scan(
            person,
            run_c_arm.c_arm(settings.scan),
            side=settings.scan.side,
            phantom=PhantomOptions(wanted.legs, wanted.detail, wanted.energy_kev),
        )
        signals = simulate_imu(person, setup.sensors)
        exact = from_truth(person.leg, person.splines, setup.sensors, float(setup.times[0]))
        starts = leveled(exact, signals).starts
        images = expose(setup, True, device, np.random.default_rng(settings.seed))
        seen = Scan(images, signals, starts, joints_on_sensors(setup))
        grid = run_c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
        return cls(settings, setup, seen, grid, device)

    @property
    def nodes(self) -> VolumeGrid:
        """Nodes of the displacement fields."""
        return self.grid.coarse(1e-3 * self.settings.methods.node_mm)


def corrections(scan: Scanned) -> Iterator[tuple[str, Correction]]:
    """What each method of the table makes of the scan."""
    seen, nodes = scan.seen, scan.nodes
    yield "uncorrected", Uncorrected()(seen)
    yield "nonrigid-3d", NonRigid3D(nodes)(seen)
    loose = articulated_motion(seen.times, limbs_of(seen), nodes).on_grid(nodes)
    yield "articulated, no bones", Correction("loose", seen.projections, loose)
    yield "articulated", Articulated(nodes, device=scan.device)(seen)
    truth = ScanTruth(scan.setup, scan.device)
    yield "oracle-nonrigid", Oracle(lambda: truth.field(nodes), "oracle-nonrigid")(seen)


class Scores:
    """SSIM and RMSE of a scan's volumes against the one at rest."""

    def __init__(self, scan: Scanned) -> None:
        self.scan = scan
        self.regions = scan_regions(scan.setup, scan.grid, scan.device)
        at_rest = expose(scan.setup, False, scan.device, np.random.default_rng(1))
        self.reference = self._volume(Correction("static", at_rest, None))

    def _volume(self, correction: Correction) -> Volume:
        options = self.scan.settings.reconstruction
        return reconstruction.reconstruct(
            options, correction, self.scan.grid, device=self.scan.device
        )

    def of(self, correction: Correction) -> list[str]:
        """Cells of the whole leg."""
        volume, evaluation = self._volume(correction), self.scan.settings.evaluation
        leg = similarity.evaluate(
            volume,
            self.reference,
            self.regions,
            scaling=evaluation.scaling,
            window=evaluation.window,
            device=self.scan.device,
        ).of("leg")
        return [f"{leg.ssim:.4f}", f"{leg.rmse:.4f}"]


def main(
    files: Annotated[str, typer.Option()] = _HELD,
    preset: str = "demo",
    change: Annotated[list[str] | None, typer.Option("--set")] = None,
    ssim: bool = False,
) -> None:
    """Prints one row per recording and method."""
    device = open_device()
    more = "SSIM leg | RMSE leg | " if ssim else ""
    head = f"| recording | method | {' | '.join(_SHOWN)} | {more}CPU s |"
    typer.echo(f"{head}\n|{'---|' * (head.count('|') - 1)}")
    for file in files.split():
        settings = config.load_settings(
            preset=preset, overrides=(f"motion.file={file}", *(change or ()))
        )
        scan = Scanned.of(settings, device)
        shown = structures(scan.setup, scan.grid)
        scores = Scores(scan) if ssim else None
        began = time.process_time()
        for name, correction in corrections(scan):
            seconds = time.process_time() - began
            left = residual_motion.of_motion(correction.motion, shown, scan.setup.geometry)
            mm = {r.structure: f"{r.mm:.3f}" for r in left}
            cells = [mm.get(structure, "–") for structure in _SHOWN]
            cells += scores.of(correction) if scores else []
            typer.echo(f"| {file} | {name} | {' | '.join(cells)} | {seconds:.0f} |")
            for note in correction.notes:
                typer.echo(f"  {note}", err=True)
            began = time.process_time()


if __name__ == "__main__":
    typer.run(main)
