"""Every method's volume: what the methods are built from, and the files they leave in the run folder."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from legsim import artifacts, bead_scan, correction, fdk, images, imu, methods, motion_paths, true_field, whole_files
from legsim.artifacts import key_of
from legsim.bead_scan import BeadScan
from legsim.correction import Correction, Scan
from legsim.errors import LegsimError
from legsim.geometry import Projections, VolumeGrid
from legsim.methods import Setup
from legsim.mls import AttachedPoint
from legsim.motion_paths import Motion
from legsim.motions import ControlPointMotion
from legsim.scanned_leg import ScannedLeg, Stage
from legsim.scene import NamedVolume

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


def reconstruct(stage: Stage, body: ScannedLeg, scan: Scan, still: Projections, grid: VolumeGrid) -> tuple[Reconstructed, ...]:
    """A volume a method, the motion-free one first."""
    setup = setup_of(stage, body, scan, grid)
    names = list(dict.fromkeys([methods.REFERENCE, *stage.settings.methods.run]))
    # all are built before the first is run: a wrong name is told at once
    built = {name: methods.build(name, setup) for name in names if name != methods.REFERENCE}
    outcomes = []
    for name in names:
        label, key = methods.label(name), _key(stage, name)
        if not stage.folder.done(f"volume-{label}", key):
            _make(stage, name, key, lambda name=name: built[name](scan) if name in built else Correction(name, still, None), grid)
        outcomes.append(_load(stage, label))
    return tuple(outcomes)


def _key(stage: Stage, name: str) -> str:
    settings = stage.settings
    always = stage.scan_key, settings.grid.model_dump(), methods.fingerprint(name)
    if name in _NEED_NOTHING:
        return key_of(*always)
    return key_of(*always, settings.imu.model_dump(), settings.methods.model_dump(exclude={"run"}), settings.seed)


def _make(stage: Stage, name: str, key: str, correct: Callable[[], Correction], grid: VolumeGrid) -> None:
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
                artifacts.save_motion(folder.path / files[-1], motion)
        whole_files.write_text(folder.path / files[1], json.dumps({"method": label, "notes": found.notes}, indent=1) + "\n")
        volume = fdk.reconstruct(
            found.projections, grid, stage.device, motion=found.motion, progress=partial(stage.on_progress, f"reconstructing {label}")
        )
        images.save_volume(folder.path / files[0], volume)


def _load(stage: Stage, label: str) -> Reconstructed:
    folder = stage.folder
    motion, warp = (
        artifacts.load_motion(folder.path / name) if folder.has(name) else None for name in (f"motion-{label}.npz", f"warp-{label}.npz")
    )
    notes = json.loads((folder.path / f"correction-{label}.json").read_text("utf-8"))["notes"]
    volume = NamedVolume(label, images.load_volume(folder.path / f"volume-{label}.mha"))
    return Reconstructed(volume, motion, warp if isinstance(warp, ControlPointMotion) else None, tuple(notes))


def setup_of(stage: Stage, body: ScannedLeg, scan: Scan, grid: VolumeGrid) -> Setup:
    """What the package's own methods are built from."""
    settings = stage.settings
    nodes = motion_paths.nodes_over(grid, 1e-3 * settings.methods.node_mm)

    def beads() -> BeadScan:
        return bead_scan.expose(
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
        true_shank=correction.rigid_motion(body.times, body.poses.of("tibia_l")),
        true_field=partial(true_field.of_phantom, body.phantom, body.poses, nodes, stage.device),
        beads=beads,
    )


def followed_points(stage: Stage, body: ScannedLeg) -> tuple[tuple[AttachedPoint, ...], ...]:
    """Of each leg hip (by the thigh's sensor), knee and ankle (by the shank's), and the points between them that are asked for.

    The first sensor on each segment is taken; its place on the segment is known. A left leg without both has no points.

    Raises:
        LegsimError: both legs are asked for and a segment has no sensor.
    """
    wanted = stage.settings.methods
    poses = imu.sensor_poses(body.recovery.leg, body.splines, body.sensors, body.times[:2])
    centers = body.recovery.leg.joint_centers(body.poses)
    legs = []
    for side in ("l", "r") if wanted.legs == "both" else ("l",):
        carriers = [next((s.name for s in body.sensors if s.segment == f"{bone}_{side}"), None) for bone in ("femur", "tibia")]
        if carriers[0] is None or carriers[1] is None:
            if wanted.legs == "both":
                raise LegsimError(f'methods.legs = "both" needs sensors on femur_{side} and tibia_{side}; add them to imu.sensors')
            continue
        thigh, shank = carriers[0], carriers[1]
        hip, knee, ankle = (centers.of(f"{joint}_{side}")[0] for joint in ("hip", "knee", "ankle"))
        shares = np.arange(1, wanted.points_per_segment + 1)[:, None] / (wanted.points_per_segment + 1)
        between = [(thigh, p) for p in hip + shares * (knee - hip)] + [(shank, p) for p in knee + shares * (ankle - knee)]
        points = [(thigh, hip), (shank, knee), (shank, ankle), *between]
        legs.append(tuple(AttachedPoint.at_start(sensor, poses.of(sensor)[0], point) for sensor, point in points))
    return tuple(legs)
