"""Every method's volume: what the methods are built from, and the files they leave in the run
folder.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.files import key_of, write_text
from legsim.correction import bead_scan, oracle, rigid
from legsim.correction.bead_scan import BeadScan
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Correction, Scan
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import NamedVolume, VolumeGrid
from legsim.imu import simulation
from legsim.reconstruction import fdk
from legsim.run import methods
from legsim.run.methods import Setup
from legsim.run.stages import ScanSetup, StageContext

_BEADS = 3
"""stream of the run's seed"""

_NEED_NOTHING = (methods.REFERENCE, "uncorrected")
"""names whose volumes hang on the scan and the grid alone"""


@dataclass(frozen=True, slots=True, eq=False)
class Reconstructed:
    """One method's outcome."""

    volume: NamedVolume
    motion: Motion | None
    """that the back-projection followed"""
    warped_by: ControlPointMotion | None
    """points by which the images were warped"""
    notes: tuple[str, ...]


_FOLLOW_ONE, _FOLLOW_JOINTS = ("rigid", "rigid-paper-order"), ("nonrigid-2d", "nonrigid-3d")
"""methods that need the sensor of methods.sensor, and those that need thigh and shank"""


def check(settings: RunConfig) -> None:
    """Refuses, before anything is computed, methods that this configuration cannot run.

    Raises:
        LegsimError: a name that is not there, two methods of one label, or a sensor that a method
            needs and nobody carries.
    """
    run = [name for name in dict.fromkeys(settings.methods.run) if name != methods.REFERENCE]
    labels = [methods.label(name) for name in run]
    for name, label in zip(run, labels, strict=True):
        methods.find(name)
        if labels.count(label) > 1 or label == methods.REFERENCE:
            raise LegsimError(
                f"methods.run: {name} would be called {label!r} like another method; rename its "
                "function"
            )
    names = [sensor.name for sensor in settings.imu.sensors]
    followed = [(f"methods.run: {name}", methods.rigid_sensor(name)) for name in run]
    followed += [("methods.sensor", settings.methods.sensor)] if set(run) & set(_FOLLOW_ONE) else []
    for place, sensor in followed:
        if sensor is not None and sensor not in names:
            raise LegsimError(
                f"{place}: there is no sensor {sensor!r}; name one of {', '.join(names)}, or add "
                "it to imu.sensors"
            )
    if set(run) & set(_FOLLOW_JOINTS):
        carriers(settings)


def carriers(settings: RunConfig) -> tuple[tuple[str, str, str], ...]:
    """(side, thigh's sensor, shank's sensor) of each leg whose joints are followed; the first
    sensor on each segment is taken.

    Raises:
        LegsimError: a segment of a leg that is to be followed has no sensor.
    """
    legs = []
    for side in ("l", "r") if settings.methods.legs == "both" else ("l",):
        found = [
            next((s.name for s in settings.imu.sensors if s.segment == f"{bone}_{side}"), None)
            for bone in ("femur", "tibia")
        ]
        if found[0] is None or found[1] is None:
            asked = (
                'methods.legs = "both" needs'
                if settings.methods.legs == "both"
                else "nonrigid-2d and nonrigid-3d need"
            )
            raise LegsimError(
                f"{asked} sensors on femur_{side} and tibia_{side}; add them to imu.sensors"
            )
        legs.append((side, found[0], found[1]))
    return tuple(legs)


def reconstruct_methods(
    stage: StageContext, body: ScanSetup, scan: Scan, still: Projections, grid: VolumeGrid
) -> tuple[Reconstructed, ...]:
    """A volume a method, the motion-free one first."""
    setup = setup_of(stage, body, scan, grid)
    names = list(dict.fromkeys([methods.REFERENCE, *stage.settings.methods.run]))
    # all are built before the first is run: a wrong name is told at once
    built = {name: methods.build(name, setup) for name in names if name != methods.REFERENCE}
    outcomes = []
    for name in names:
        label, key = methods.label(name), _key(stage, name)
        if not stage.folder.done(f"volume-{label}", key):
            _make(
                stage,
                name,
                key,
                lambda name=name: (
                    built[name](scan) if name in built else Correction(name, still, None)
                ),
                grid,
            )
        outcomes.append(_load(stage, label))
    return tuple(outcomes)


def _key(stage: StageContext, name: str) -> str:
    settings = stage.settings
    always = stage.scan_key, settings.grid.model_dump(), methods.fingerprint(name)
    if name in _NEED_NOTHING:
        return key_of(*always)
    return key_of(
        *always,
        settings.imu.model_dump(),
        settings.methods.model_dump(exclude={"run"}),
        settings.seed,
    )


def _make(
    stage: StageContext, name: str, key: str, correct: Callable[[], Correction], grid: VolumeGrid
) -> None:
    """Runs one method and writes its volume, motion and notes."""
    label, folder = methods.label(name), stage.folder
    files = [f"volume-{label}.mha", f"correction-{label}.json"]
    stage.on_progress(f"estimating {label}", 0, 1)
    with folder.stage(f"volume-{label}", key, files):
        found = correct()
        stage.on_progress(f"estimating {label}", 1, 1)
        for kind, motion in (("motion", found.motion), ("warp", found.warped_by)):
            if motion is not None:
                files.append(f"{kind}-{label}.npz")
                save_motion(folder.path / files[-1], motion)
        write_text(
            folder.path / files[1],
            json.dumps({"method": label, "notes": found.notes}, indent=1) + "\n",
        )
        volume = fdk.fdk(
            found.projections,
            grid,
            device=stage.device,
            motion=found.motion,
            progress=partial(stage.on_progress, f"reconstructing {label}"),
        )
        image_files.save_volume(folder.path / files[0], volume)


def _load(stage: StageContext, label: str) -> Reconstructed:
    folder = stage.folder
    motion, warp = (
        load_motion(folder.path / name) if folder.has(name) else None
        for name in (f"motion-{label}.npz", f"warp-{label}.npz")
    )
    notes = json.loads((folder.path / f"correction-{label}.json").read_text("utf-8"))["notes"]
    volume = NamedVolume(label, image_files.load_volume(folder.path / f"volume-{label}.mha"))
    return Reconstructed(
        volume, motion, warp if isinstance(warp, ControlPointMotion) else None, tuple(notes)
    )


def setup_of(stage: StageContext, body: ScanSetup, scan: Scan, grid: VolumeGrid) -> Setup:
    """What the package's own methods are built from."""
    settings = stage.settings
    nodes = grid.coarse(1e-3 * settings.methods.node_mm)

    def beads() -> BeadScan:
        return bead_scan.add_beads(
            scan.projections,
            body.phantom,
            body.poses,
            settings.methods.beads,
            stage.device,
            energy_kev=settings.phantom.energy_kev,
            rng=np.random.default_rng([settings.seed, _BEADS]),
            progress=partial(stage.on_progress, "projecting beads"),
        )

    return Setup(
        scheme=settings.methods.scheme,
        sensor=settings.methods.sensor,
        legs=followed_points(stage, body),
        device=stage.device,
        nodes=nodes,
        true_shank=rigid.rigid_motion(body.times, body.poses.of("tibia_l")),
        true_field=partial(oracle.phantom_motion, body.phantom, body.poses, nodes, stage.device),
        beads=beads,
    )


def followed_points(stage: StageContext, body: ScanSetup) -> tuple[tuple[AttachedPoint, ...], ...]:
    """Of each leg hip (by the thigh's sensor), knee and ankle (by the shank's), and the points
    between them that are asked for.

    Their places on the sensors are known. No leg has any where no method follows joints.
    """
    wanted = stage.settings.methods
    if not set(wanted.run) & set(_FOLLOW_JOINTS):
        return ()
    poses = simulation.sensor_poses(body.recovery.leg, body.splines, body.sensors, body.times[:2])
    centers = body.recovery.leg.joint_centers(body.poses)
    legs = []
    for side, thigh, shank in carriers(stage.settings):
        hip, knee, ankle = (centers.of(f"{joint}_{side}")[0] for joint in ("hip", "knee", "ankle"))
        shares = np.arange(1, wanted.points_per_segment + 1)[:, None] / (
            wanted.points_per_segment + 1
        )
        between = [(thigh, p) for p in hip + shares * (knee - hip)] + [
            (shank, p) for p in knee + shares * (ankle - knee)
        ]
        points = [(thigh, hip), (shank, knee), (shank, ankle), *between]
        legs.append(
            tuple(
                AttachedPoint.at_start(sensor, poses.of(sensor)[0], point)
                for sensor, point in points
            )
        )
    return tuple(legs)
