"""Thigh's and shank's sensor each alone and tied at the knee. `python -m
tools.experiments.tied_sensors`, for docs/fusion.md.

A BMI160 on thigh and shank, rough starts, two beads on each segment whose shadows are projected
exactly and then missed by some noise; no image is made. Columns: the constant part over the views
of the distance between where thigh and shank carry the knee, and of the turn between them, which no
registration takes away; that distance, RMS; the RMS distance of the projections of femur and tibia
after the one similarity of the whole scene that fits both best.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
import typer

from legsim import config
from legsim.config import RunConfig
from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction import tied_sensors
from legsim.correction.path_measurements import BeadShadows
from legsim.correction.tied_sensors import LegTie
from legsim.deformation.models import RigidMotion
from legsim.evaluation import image_gauge
from legsim.imu import simulation
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import scores, stages, volumes
from legsim.simulation.setup import ScanSetup
from legsim.study import aiding

SENSORS = ("thigh_l", "shank_l")
FREE = {"laxity": 1e3, "placement": 1e3, "together": None}


class Leg(NamedTuple):
    """Truth of the scanned leg."""

    motions: tuple[FloatArray, ...]
    """(v, 4, 4) of femur and tibia against the first view"""
    bones: tuple[FloatArray, ...]
    """(v, p, 3) m, paths of points of femur and tibia"""
    knee: FloatArray
    """(3,) m at the first view"""
    places: tuple[FloatArray, ...]
    """(3,) m of knee and hip in the thigh's sensor, of knee and ankle in the shank's"""


def truth(settings: RunConfig, setup: ScanSetup) -> Leg:
    """Where bones go, and where joints are on the sensors at the first view."""
    grid = run_c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
    shown = {s.name: s.paths for s in scores.structures(setup, grid)}
    own = simulation.sensor_poses(
        setup.person.leg, setup.person.splines, setup.sensors, setup.times[:2]
    )
    centers = setup.person.leg.joint_centers(setup.poses)
    hip, knee, ankle = (centers.of(setup.named(joint))[0] for joint in ("hip", "knee", "ankle"))
    thigh, shank = (transforms.inverse(own.of(name)[0]) for name in SENSORS)
    poses = [setup.poses.of(setup.named(bone)) for bone in ("femur", "tibia")]
    return Leg(
        tuple(p @ transforms.inverse(p[0]) for p in poses),
        (shown["femur"], shown["tibia"]),
        knee,
        tuple(
            transforms.apply(world, joint[None])[0]
            for world, joint in ((thigh, knee), (thigh, hip), (shank, knee), (shank, ankle))
        ),
    )


def beads(settings: RunConfig, setup: ScanSetup, sensor: str, seed: int) -> BeadShadows:
    """Two on the sensor's segment."""
    methods = settings.methods.model_copy(update={"sensor": sensor})
    own = settings.model_copy(update={"methods": methods, "seed": seed})
    return volumes.exact_beads(own, setup)


def row(motions: Sequence[RigidMotion], leg: Leg, setup: ScanSetup) -> list[float]:
    """mm constant, mm, degrees constant, px of femur, px of tibia."""
    knee, geometry = leg.knee[None], setup.geometry
    off = [
        m.carry(knee) - transforms.apply(t, knee) for m, t in zip(motions, leg.motions, strict=True)
    ]
    apart = 1e3 * (off[0] - off[1])[:, 0]
    turns = [
        transforms.vector_from_rotation(
            m.moved_from_reference[:, :3, :3] @ np.swapaxes(t[:, :3, :3], -1, -2)
        ).mean(0)
        for m, t in zip(motions, leg.motions, strict=True)
    ]
    true = np.concatenate([geometry.project(paths)[0] for paths in leg.bones], 1)
    resting, count = np.concatenate([p[0] for p in leg.bones]), leg.bones[0].shape[1]

    def seen(points: FloatArray) -> FloatArray:
        parts = (motions[0].carry(points[:count]), motions[1].carry(points[count:]))
        return geometry.project(np.concatenate(parts, 1))[0]

    similarity = image_gauge.best_similarity(seen, resting, true)
    left = seen(transforms.apply(similarity, resting)) - true
    constant = float(np.linalg.norm(apart.mean(0)))
    turned = float(np.degrees(np.linalg.norm(turns[0] - turns[1])))
    return [constant, rms(apart), turned, rms(left[:, :count]), rms(left[:, count:])]


def rms(vectors: FloatArray) -> float:
    """Root mean square length."""
    return float(np.sqrt((vectors**2).sum(-1).mean()))


def main(
    files: Annotated[str, typer.Option()] = "subject01/squat_60.trc subject03/squat_30.trc",
    sensor: str = "bmi160",
    seeds: int = 3,
    laxity_mm: float = 1.0,
    ankle_walk_mm: float = 0.2,
    together_mm: float = 0.25,
    views: int = 248,
) -> None:
    """Prints two rows per scan: mean and greatest over the seeds."""
    typer.echo(
        "| scan | sensors | apart, constant (mm) | apart (mm) | turned apart, constant (deg) | "
        "femur (px) | tibia (px) |\n|" + "---|" * 7
    )
    for file in files.split():
        settings = config.load_settings(
            preset="demo",
            overrides=(
                f"motion.file={file}",
                f"imu.noise.kind={sensor}",
                "methods.start=rough",
                f"scan.views={views}",
                f"scan.rate_hz={views / 8}",
            ),
        )
        setup = stages.place(settings, run_motion.solve(settings.motion))
        leg = truth(settings, setup)
        walk = 1e-3 * ankle_walk_mm or None
        free = LegTie(
            leg.places[0], leg.places[2], leg.places[3], leg.places[1], ankle_walk=walk, **FREE
        )
        tie = LegTie(
            leg.places[0],
            leg.places[2],
            leg.places[3],
            leg.places[1],
            laxity=1e-3 * laxity_mm,
            ankle_walk=walk,
            together=1e-3 * together_mm,
        )
        table: dict[str, list[list[float]]] = {"alone": [], "tied": []}
        for seed in range(seeds):
            scan = aiding.sensed(settings.model_copy(update={"seed": seed}), setup)
            priors = volumes.sensor_priors(settings)
            # of another seed, so that thigh and shank have noise of their own
            shown = [beads(settings, setup, n, seed + 1000 * k) for k, n in enumerate(SENSORS)]
            for name, by in (("alone", free), ("tied", tie)):
                found = tied_sensors.tied_paths(scan, SENSORS, by, priors, (shown[0], shown[1]))
                table[name].append(row(found.motions, leg, setup))
        for name, rows in table.items():
            cells = (f"{np.mean(c):.2f} ({np.max(c):.2f})" for c in zip(*rows, strict=True))
            typer.echo(f"| {file} | {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    typer.run(main)
