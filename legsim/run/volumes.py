"""Every method's volume of a simulated scan: which methods can run, and their inputs."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np

from legsim.config import RunConfig
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.files import key_of
from legsim.correction import bead_scan, initialization
from legsim.correction.articulated_beads import BeadedLeg
from legsim.correction.bead_scan import Beads, BeadScan
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Correction, CorrectionMethod
from legsim.correction.path_measurements import SHADOW_ERROR_PX, BeadShadows, FiducialShadows
from legsim.geometry.volume import VolumeGrid
from legsim.imu import simulation
from legsim.opencl.device import Device
from legsim.run import code, methods, reconstruction, stages
from legsim.run import sensors as run_sensors
from legsim.run.corrected import Reconstructed, Reconstructor
from legsim.run.methods import MethodInputs
from legsim.run.stages import StageContext
from legsim.simulation.setup import ScanSetup, Side, knee_on_thigh
from legsim.simulation.simulated_scan import SimulatedScan

_BEADS = 3
"""random stream of the run's seed"""

_FUSED = 6
"""random stream of the run's seed, of few beads"""

_TIED = 8
"""random stream of the run's seed, of few beads on both segments"""

_FIDUCIALS = 7
"""random stream of the run's seed, of fiducials in all views"""

_NEED_NOTHING = (methods.REFERENCE, "uncorrected")
"""names whose volumes depend on the scan and the grid only"""


def check(settings: RunConfig) -> None:
    """Refuses, before anything is computed, methods that this configuration cannot run.

    Raises:
        LegsimError: an unknown name, two methods of one label, a missing sensor, or an option that
            the reconstruction does not read.
    """
    reconstruction.check(settings.reconstruction)
    run = [name for name in dict.fromkeys(settings.methods.run) if name != methods.REFERENCE]
    methods.check_names(run, "methods.run")
    names = [sensor.name for sensor in settings.imu.sensors]
    followed = [(f"methods.run: {name}", methods.rigid_sensor(name)) for name in run]
    followed += (
        [("methods.sensor", settings.methods.sensor)] if set(run) & set(methods.FOLLOW_ONE) else []
    )
    for place, sensor in followed:
        if sensor is not None and sensor not in names:
            raise LegsimError(
                f"{place}: unknown sensor {sensor!r}; name one of {', '.join(names)}, or add "
                "it to imu.sensors"
            )
    for place, sensor in followed:
        _warn_of_other_leg(settings, place, sensor)
    if set(run) & set(methods.FOLLOW_JOINTS):
        _check_carriers(settings)
    _warn_of_slow_sensors(settings)


def _warn_of_other_leg(settings: RunConfig, place: str, name: str | None) -> None:
    """Says where a rigid method follows the leg that is not scanned."""
    other = "r" if settings.scan.side == "left" else "l"
    for sensor in settings.imu.sensors:
        if sensor.name == name and sensor.segment.endswith(f"_{other}"):
            warnings.warn(
                f"{place}: sensor {name!r} is on {sensor.segment}, but the {settings.scan.side} "
                "leg is scanned, whose motion it does not follow; name a sensor on that leg, or "
                "set scan.side",
                stacklevel=3,
            )


def _warn_of_slow_sensors(settings: RunConfig) -> None:
    """Says where sensors give fewer samples than the scan takes views."""
    rate, views = settings.imu.rate_hz, settings.scan.rate_hz
    if rate < views:
        warnings.warn(
            f"imu.rate_hz is {rate:g}, but {views:g} views are taken per second: motion between "
            f"samples is lost; set imu.rate_hz to {views:g} or more",
            stacklevel=3,
        )


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
                else "nonrigid-2d, nonrigid-3d and the articulated methods need"
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
    maker = Reconstructor(
        stage.folder,
        stage.settings.reconstruction,
        grid,
        stage.device,
        stage.on_progress,
        scan.seen.projections,
    )
    return tuple(
        maker.of(name, _key(stage, name), partial(_correction, name, built.get(name), scan))
        for name in names
    )


def _correction(name: str, method: CorrectionMethod | None, scan: SimulatedScan) -> Correction:
    """What the method finds; None is the scan at rest."""
    return Correction(name, scan.at_rest, None) if method is None else method(scan.seen)


def _key(stage: StageContext, name: str) -> str:
    settings = stage.settings
    always = (
        stage.scan_key,
        code.fingerprint("volume", settings.reconstruction.algorithm),
        settings.grid.model_dump(),
        settings.reconstruction.model_dump(),
        methods.fingerprint(name),
    )
    if name in _NEED_NOTHING:
        return key_of(*always)
    return key_of(
        *always,
        code.fingerprint("correction", "imu"),
        settings.imu.model_dump(),
        run_sensors.fingerprint(settings.imu),
        settings.methods.model_dump(exclude={"run"}),
        settings.seed,
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
            rays_per_pixel=setup.c_arm.rays_per_pixel,
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
        priors=sensor_priors(settings),
        fused_beads=lambda: _fused_beads(stage, scan, settings, _FUSED),
        beaded_leg=_beaded_leg(stage, scan),
        fused_fiducials=lambda: fused_fiducials(settings, setup, stage.device),
    )


def sensor_priors(settings: RunConfig) -> SensorPriors:
    """What is known beforehand of a sensor: its data sheet, and how the start was found."""
    errors = run_sensors.prior_errors(settings.imu, view_rate_hz=settings.scan.rate_hz)
    start = stages.start_errors(settings.methods)
    if settings.imu.noise.calibration != "none":
        # a start that was leveled at rest is tilted by the accelerometer's bias
        leveled = errors.accelerometer.turn_on_bias / STANDARD_GRAVITY
        start = replace(start, tilt=max(start.tilt, leveled))
    return SensorPriors(
        errors,
        start,
        1e-3 * settings.methods.fused.spread_mm,
        1e-3 * settings.methods.fused.clock_ms,
    )


def _beaded_leg(stage: StageContext, scan: SimulatedScan) -> BeadedLeg | None:
    """Few beads on each segment of the scanned leg; None without sensors on both."""
    knee = knee_on_thigh(scan.setup)
    if knee is None:
        return None

    def beads(sensor: str) -> BeadScan | BeadShadows:
        methods = stage.settings.methods.model_copy(update={"sensor": sensor})
        settings = stage.settings.model_copy(update={"methods": methods})
        return _fused_beads(stage, scan, settings, _TIED)

    return BeadedLeg(beads, knee.position_sensor)


def _fused_beads(
    stage: StageContext, scan: SimulatedScan, settings: RunConfig, stream: int
) -> BeadScan | BeadShadows:
    """Few beads on the segment that carries the followed sensor."""
    setup = scan.setup
    if settings.methods.fused.found == "exact":
        return exact_beads(settings, setup, stream)
    return bead_scan.add_beads(
        scan.seen.projections,
        setup.phantom,
        setup.poses,
        _few_beads(settings),
        stage.device,
        side=setup.side[0],
        energy_kev=settings.phantom.energy_kev,
        rng=_stream(settings, stream),
        rays_per_pixel=setup.c_arm.rays_per_pixel,
        progress=partial(stage.on_progress, "projecting few beads"),
    )


def _stream(settings: RunConfig, stream: int) -> np.random.Generator:
    """Random numbers of few beads: each segment's are its own."""
    if stream == _FUSED:
        return np.random.default_rng([settings.seed, stream])
    below = not followed_segment(settings).startswith("femur")
    return np.random.default_rng([settings.seed, stream, int(below)])


def exact_beads(settings: RunConfig, setup: ScanSetup, stream: int = _FUSED) -> BeadShadows:
    """Projects the true places of few beads, with ``methods.fused.error_px`` of noise."""
    paths = bead_scan.bead_paths(setup.phantom, setup.poses, _few_beads(settings), setup.side[0])
    exact = setup.geometry.project(paths)[0]
    noise, error = _stream(settings, stream).standard_normal(exact.shape), settings.methods.fused
    # without noise too, beads slide with the skin
    stated = max(SHADOW_ERROR_PX, error.error_px)
    return BeadShadows(exact + error.error_px * noise, stated)


def _few_beads(settings: RunConfig) -> Beads:
    wanted = settings.methods.fused
    below = not followed_segment(settings).startswith("femur")
    return Beads.on_one_side(wanted.beads, below=below, radius=0.5e-3 * wanted.bead_mm)


def followed_segment(settings: RunConfig) -> str:
    """Segment that carries the sensor that rigid methods follow."""
    return next(s.segment for s in settings.imu.sensors if s.name == settings.methods.sensor)


def fused_fiducials(
    settings: RunConfig, setup: ScanSetup, device: Device | None = None
) -> FiducialShadows:
    """Shadows of the points in the followed sensor in all views, by ``methods.fiducials``."""
    person, name = setup.person, settings.methods.sensor
    sensor = next(s for s in setup.sensors if s.name == name)
    poses = simulation.sensor_poses(person.leg, person.splines, [sensor], setup.times)
    return initialization.fiducial_shadows(
        sensor,
        poses.of(name),
        stages.fiducial_scan(setup, device),
        stages.fiducial_options(settings.methods.fiducials),
        np.random.default_rng([settings.seed, _FIDUCIALS]),
    )
