"""Every method's volume: the inputs of the methods, and their files in the run folder."""

import json
from dataclasses import dataclass
from functools import partial

import numpy as np

from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.files import key_of, write_text
from legsim.correction import bead_scan
from legsim.correction.bead_scan import Beads, BeadScan
from legsim.correction.method import Correction, CorrectionMethod
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.geometry import image_files
from legsim.geometry.volume import NamedVolume, VolumeGrid
from legsim.run import methods, reconstruction
from legsim.run.methods import MethodInputs
from legsim.run.stages import StageContext
from legsim.simulation.setup import Side
from legsim.simulation.simulated_scan import SimulatedScan

_BEADS = 3
"""random stream of the run's seed"""

_NEED_NOTHING = (methods.REFERENCE, "uncorrected")
"""names whose volumes depend on the scan and the grid only"""


@dataclass(frozen=True, slots=True, eq=False)
class Reconstructed:
    """Result of one method."""

    volume: NamedVolume
    motion: Motion | None
    """motion that the back-projection followed"""
    warped_by: ControlPointMotion | None
    """points by which the images were warped"""
    notes: tuple[str, ...]


_FOLLOW_ONE, _FOLLOW_JOINTS = ("rigid", "rigid-paper-order"), ("nonrigid-2d", "nonrigid-3d")
"""methods that need the sensor of methods.sensor, and those that need thigh and shank"""


def check(settings: RunConfig) -> None:
    """Refuses, before anything is computed, methods that this configuration cannot run.

    Raises:
        LegsimError: an unknown name, two methods of one label, a missing sensor, or an option that
            the reconstruction does not read.
    """
    reconstruction.check(settings.reconstruction)
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
                f"{place}: unknown sensor {sensor!r}; name one of {', '.join(names)}, or add "
                "it to imu.sensors"
            )
    if set(run) & set(_FOLLOW_JOINTS):
        _check_carriers(settings)


def followed_sides(settings: RunConfig) -> tuple[Side, ...]:
    """Legs whose joints are followed."""
    return ("left", "right") if settings.methods.legs == "both" else (settings.scan.side,)


def _check_carriers(settings: RunConfig) -> None:
    """Refuses a leg that is to be followed without a sensor on thigh and shank."""
    for side in followed_sides(settings):
        segments = [f"{bone}_{side[0]}" for bone in ("femur", "tibia")]
        if not set(segments) <= {sensor.segment for sensor in settings.imu.sensors}:
            asked = (
                'methods.legs = "both" needs'
                if settings.methods.legs == "both"
                else "nonrigid-2d and nonrigid-3d need"
            )
            raise LegsimError(
                f"{asked} sensors on {' and '.join(segments)}; add them to imu.sensors"
            )


def reconstruct_methods(
    stage: StageContext, scan: SimulatedScan, grid: VolumeGrid
) -> tuple[Reconstructed, ...]:
    """Reconstructs one volume per method, the motion-free one first."""
    given = _method_inputs(stage, scan, grid)
    names = list(dict.fromkeys([methods.REFERENCE, *stage.settings.methods.run]))
    # all are built before the first is run: a wrong name is reported at once
    built = {name: methods.build(name, given) for name in names if name != methods.REFERENCE}
    outcomes = []
    for name in names:
        label = methods.label(name)
        make = partial(_make, stage, name, built.get(name), scan, grid)
        stage.folder.cached(f"volume-{label}", _key(stage, name), make)
        outcomes.append(_load(stage, label))
    return tuple(outcomes)


def _key(stage: StageContext, name: str) -> str:
    settings = stage.settings
    always = (
        stage.scan_key,
        settings.grid.model_dump(),
        settings.reconstruction.model_dump(),
        methods.fingerprint(name),
    )
    if name in _NEED_NOTHING:
        return key_of(*always)
    return key_of(
        *always,
        settings.imu.model_dump(),
        settings.methods.model_dump(exclude={"run"}),
        settings.seed,
    )


def _make(
    stage: StageContext,
    name: str,
    method: CorrectionMethod | None,
    scan: SimulatedScan,
    grid: VolumeGrid,
) -> list[str]:
    """Runs one method and writes its volume, motion and notes; None is the scan at rest."""
    label, folder = methods.label(name), stage.folder
    files = [f"volume-{label}.mha", f"correction-{label}.json"]
    stage.on_progress(f"estimating {label}", 0, 1)
    found = Correction(name, scan.at_rest, None) if method is None else method(scan.seen)
    stage.on_progress(f"estimating {label}", 1, 1)
    for kind, motion in (("motion", found.motion), ("warp", found.warped_by)):
        if motion is not None:
            files.append(f"{kind}-{label}.npz")
            save_motion(folder.path / files[-1], motion)
    notes = json.dumps({"method": label, "notes": found.notes}, indent=1) + "\n"
    write_text(folder.path / files[1], notes)
    volume = reconstruction.reconstruct(
        stage.settings.reconstruction,
        found,
        grid,
        device=stage.device,
        progress=partial(stage.on_progress, f"reconstructing {label}"),
    )
    image_files.save_volume(folder.path / files[0], volume)
    return files


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


def _method_inputs(stage: StageContext, scan: SimulatedScan, grid: VolumeGrid) -> MethodInputs:
    settings, setup = stage.settings, scan.setup
    wanted = settings.methods.beads

    def beads() -> BeadScan:
        return bead_scan.add_beads(
            scan.seen.projections,
            setup.phantom,
            setup.poses,
            Beads(
                wanted.count,
                0.5e-3 * wanted.diameter_mm,
                1e-3 * wanted.reach_mm,
                1e-3 * wanted.guess_error_mm,
            ),
            stage.device,
            side=setup.side[0],
            energy_kev=settings.phantom.energy_kev,
            rng=np.random.default_rng([settings.seed, _BEADS]),
            progress=partial(stage.on_progress, "projecting beads"),
        )

    return MethodInputs(
        sensor=settings.methods.sensor,
        scheme=settings.methods.scheme,
        device=stage.device,
        nodes=grid.coarse(1e-3 * settings.methods.node_mm),
        scanned_shank=setup.named("tibia"),
        truth=scan.truth,
        beads=beads,
        bead_reference=wanted.reference,
    )
