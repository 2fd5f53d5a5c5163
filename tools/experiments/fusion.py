"""Sensors fused with a standing person and with beads. `python -m tools.experiments.fusion`, for
docs/methods.md.

One sensor on the shank with the errors of one that can be bought, a rough start, and beads on the
skin below the knee whose shadows are projected exactly and then missed by some noise; no image is
made. The truth is the tibia's. Columns: RMS distance of the tibia's projections after the constant
similarity that fits best, which is what blurs a volume; the same without it; millimeters; degrees;
seconds of processor time.
"""

import time
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import typer

from legsim import config
from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction import bead_scan, initialization
from legsim.correction.bead_scan import Beads
from legsim.correction.fused import FusedBeads, SensorPriors, Standing
from legsim.correction.initialization import Starts
from legsim.correction.method import CorrectionMethod, Scan
from legsim.correction.rigid import Rigid, Uncorrected, rigid_motion
from legsim.correction.rough_start import rough
from legsim.correction.smoother import BeadShadows
from legsim.deformation.models import RigidMotion
from legsim.evaluation import image_gauge
from legsim.geometry.cone_beam import Projections
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import scores, stages, volumes
from legsim.run import sensors as run_sensors
from legsim.simulation.setup import ScanSetup, prepare_scan

_SHADOWS, _STARTS, _NOISE = 21, 2, 1


def placed(file: str, sensor: str, calibration: str = "none") -> tuple[config.RunConfig, ScanSetup]:
    """A person in the C-arm of the preset "demo"."""
    settings = config.load_settings(
        preset="demo",
        overrides=(
            f"motion.file={file}",
            f"imu.noise.kind={sensor}",
            f"imu.noise.calibration={calibration}",
            "methods.start=rough",
        ),
    )
    person = run_motion.solve(settings.motion)
    sensors = run_sensors.sensors(settings.imu)
    return settings, prepare_scan(person, run_c_arm.c_arm(settings.scan), sensors=sensors)


def scanned(settings: config.RunConfig, setup: ScanSetup, seed: int) -> Scan:
    """What the sensors read and where they seem to start; the images are empty."""
    person, first = setup.person, float(setup.times[0])
    signals = run_sensors.record(
        person,
        settings.imu,
        view_rate_hz=settings.scan.rate_hz,
        rest_at=first,
        rng=np.random.default_rng([seed, _NOISE]),
    )
    exact = initialization.from_truth(person.leg, person.splines, setup.sensors, first).starts
    errors = stages.start_errors(settings.methods)
    drawn = rough(exact, errors, np.random.default_rng([seed, _STARTS]))
    starts = initialization.leveled(Starts(drawn, ()), signals).starts
    empty = np.zeros((len(setup.geometry), *setup.geometry.shape_vu), np.float32)
    return Scan(Projections(setup.geometry, empty), signals, starts)


def shadows(setup: ScanSetup, count: int, error_px: float, seed: int) -> BeadShadows:
    """Shadows of beads on the skin below the knee."""
    beads = Beads.on_one_side(count)
    paths = bead_scan.bead_paths(setup.phantom, setup.poses, beads, setup.side[0])
    exact = setup.geometry.project(paths)[0]
    noise = np.random.default_rng([seed, _SHADOWS]).standard_normal(exact.shape)
    return BeadShadows(exact + error_px * noise)


def tibia(settings: config.RunConfig, setup: ScanSetup) -> FloatArray:
    """True paths (v, p, 3) m of points on the tibia, as the scores of a run have them."""
    grid = run_c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
    return next(s.paths for s in scores.structures(setup, grid) if s.name == "tibia")


def row(
    motion: RigidMotion, setup: ScanSetup, paths: FloatArray
) -> tuple[float, float, float, float]:
    """Residuals: px after the best similarity, px, mm, degrees."""
    points, geometry = paths[0], setup.geometry
    true = rigid_motion(setup.times, setup.poses.of(setup.named("tibia")))
    target, carried = geometry.project(paths)[0], motion.carry(points)
    off = motion.moved_from_reference @ transforms.inverse(true.moved_from_reference)

    def seen(at: FloatArray) -> FloatArray:
        return geometry.project(motion.carry(at))[0]

    similarity = image_gauge.best_similarity(seen, points, target)
    return (
        rms(seen(transforms.apply(similarity, points)) - target),
        rms(geometry.project(carried)[0] - target),
        1e3 * rms(carried - paths),
        float(np.degrees(rms(transforms.vector_from_rotation(off[:, :3, :3])))),
    )


def rms(vectors: FloatArray) -> float:
    """Root mean square length."""
    return float(np.sqrt((vectors**2).sum(-1).mean()))


def methods(
    setup: ScanSetup, priors: SensorPriors, error_px: float, seed: int
) -> dict[str, CorrectionMethod]:
    """The methods of the table."""
    found: dict[str, CorrectionMethod] = {
        "uncorrected": Uncorrected(),
        "rigid": Rigid("shank_l"),
        "standing": Standing("shank_l", priors),
    }
    for count in (1, 2, 4):
        found[f"fused-beads, {count}"] = FusedBeads(
            shadows(setup, count, error_px, seed), "shank_l", priors
        )
    return found


def main(
    files: Annotated[str, typer.Option()] = "subject01/squat_60.trc",
    sensor: str = "bmi160",
    calibration: str = "none",
    seeds: int = 3,
    error_px: float = 0.2,
    notes: bool = False,
) -> None:
    """Prints one row per scan and method: mean and greatest over the seeds."""
    typer.echo("| scan | method | px after similarity | px | mm | deg | CPU s |\n|" + "---|" * 7)
    for file in files.split():
        settings, setup = placed(file, sensor, calibration)
        priors = volumes.sensor_priors(settings)
        paths = tibia(settings, setup)
        table: dict[str, list[Sequence[float]]] = {}
        for seed in range(seeds):
            scan = scanned(settings, setup, seed)
            for name, method in methods(setup, priors, error_px, seed).items():
                began = time.process_time()
                found = method(scan)
                seconds = time.process_time() - began
                none = RigidMotion.identity(scan.times)
                motion = found.motion if isinstance(found.motion, RigidMotion) else none
                table.setdefault(name, []).append((*row(motion, setup, paths), seconds))
                if notes:
                    typer.echo(f"{name}: {' '.join(found.notes)}", err=True)
        for name, rows in table.items():
            cells = (f"{np.mean(c):.3g} ({np.max(c):.3g})" for c in zip(*rows, strict=True))
            typer.echo(f"| {file} | {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    typer.run(main)
