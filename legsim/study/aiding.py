"""What a sensor and its aids find of a motion, against the truth; no image is made.

One sensor with all its errors and a rough start follows the bone that carries it. Shadows of beads
and fiducials are projected exactly and then missed by some noise. The measure is the motion's own:
pixels after the one constant similarity that images cannot see, pixels, millimeters, degrees.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.progress import OnProgress
from legsim.correction import initialization, rough_start
from legsim.correction.fused import FusedBeads, FusedFiducials, SensorPriors, Standing
from legsim.correction.initialization import Starts
from legsim.correction.method import CorrectionMethod, Scan
from legsim.correction.rigid import Rigid, Uncorrected
from legsim.deformation.models import Motion, RigidMotion
from legsim.evaluation import residual_motion
from legsim.evaluation.residual_motion import Structure
from legsim.geometry.cone_beam import Projections
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import scores, stages, volumes
from legsim.run import sensors as run_sensors
from legsim.simulation.setup import PhantomOptions, ScanSetup, prepare_scan


class Left(NamedTuple):
    """What one estimate leaves of the motion, RMS over views and points of the bone."""

    px_after_similarity: float
    px: float
    mm: float
    degrees: float
    followed: bool
    """whether a motion was followed"""


def measure(
    settings: RunConfig, aids: Sequence[str], seeds: Sequence[int], on_progress: OnProgress
) -> list[dict[str, Left]]:
    """Errors by aid of each draw of the sensor's errors, its start and the shadows."""
    setup = placed(settings)
    bone = _followed_bone(settings, setup)
    found = []
    for draw, seed in enumerate(seeds):
        on_progress("aided sensors", draw, len(seeds))
        own = settings.model_copy(update={"seed": seed})
        scan = sensed(own, setup)
        found.append(
            {aid: _left(method(aid, own, setup)(scan).motion, bone, setup) for aid in aids}
        )
    on_progress("aided sensors", len(seeds), len(seeds))
    return found


def placed(settings: RunConfig) -> ScanSetup:
    """The person in the C-arm, as a run has them."""
    person = run_motion.solve(settings.motion)
    stages.refuse_implausible(settings, person.name, person.implausible)
    scan, wanted = settings.scan, settings.phantom
    return prepare_scan(
        person,
        run_c_arm.c_arm(scan),
        side=scan.side,
        center=None if scan.center == "knee" else 1e-3 * np.array(scan.center),
        sensors=run_sensors.sensors(settings.imu),
        phantom=PhantomOptions(wanted.legs, wanted.detail, wanted.energy_kev),
    )


def _followed_bone(settings: RunConfig, setup: ScanSetup) -> Structure:
    """Points of the bone that carries the sensor, as the scores of a run have them."""
    grid = run_c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
    name = volumes.followed_segment(settings).rpartition("_")[0]
    shown = {structure.name: structure for structure in scores.structures(setup, grid)}
    if name not in shown:
        raise LegsimError(
            f"methods.sensor: {settings.methods.sensor} is on {name}, which the scan does not "
            f"see; name a sensor on one of {', '.join(shown)}"
        )
    return shown[name]


def sensed(settings: RunConfig, setup: ScanSetup) -> Scan:
    """What the sensors read and where they seem to start; the images are empty."""
    person, first = setup.person, float(setup.times[0])
    signals = run_sensors.record(
        person,
        settings.imu,
        view_rate_hz=settings.scan.rate_hz,
        rest_at=first,
        rng=np.random.default_rng([settings.seed, stages.NOISE]),
        shaking=np.random.default_rng([settings.seed, stages.VIBRATION]),
    )
    exact = initialization.from_truth(person.leg, person.splines, setup.sensors, first)
    if settings.methods.start == "rough":
        rng = np.random.default_rng([settings.seed, stages.STARTS])
        errors = stages.start_errors(settings.methods)
        exact = Starts(rough_start.rough(exact.starts, errors, rng), ())
    starts = initialization.leveled(exact, signals).starts
    empty = np.zeros((len(setup.geometry), *setup.geometry.shape_vu), np.float32)
    return Scan(Projections(setup.geometry, empty), signals, starts)


def method(aid: str, settings: RunConfig, setup: ScanSetup) -> CorrectionMethod:
    """The method that uses an aid."""
    sensor, priors = settings.methods.sensor, volumes.sensor_priors(settings)
    makers: dict[str, Callable[[], CorrectionMethod]] = {
        "uncorrected": Uncorrected,
        "dead-reckoning": lambda: Rigid(sensor, settings.methods.scheme),
        "standing": lambda: Standing(sensor, priors),
        "fiducials": lambda: FusedFiducials(
            volumes.fused_fiducials(settings, setup), sensor, priors
        ),
    }
    if aid in makers:
        return makers[aid]()
    return _with_beads(int(aid.rpartition("-")[2]), settings, setup, sensor, priors)


def _with_beads(
    count: int, settings: RunConfig, setup: ScanSetup, sensor: str, priors: SensorPriors
) -> FusedBeads:
    fused = settings.methods.fused.model_copy(update={"beads": count})
    methods = settings.methods.model_copy(update={"fused": fused})
    own = settings.model_copy(update={"methods": methods})
    return FusedBeads(volumes.exact_beads(own, setup), sensor, priors)


def _left(motion: Motion | None, bone: Structure, setup: ScanSetup) -> Left:
    # meters off, a tried similarity may leave all numbers; such a step is worse, and is not taken
    with np.errstate(over="ignore", invalid="ignore"):
        (left,) = residual_motion.of_motion(motion, (bone,), setup.geometry)
    still = motion is None or (
        isinstance(motion, RigidMotion)
        and np.array_equal(
            motion.moved_from_reference, RigidMotion.identity(motion.times).moved_from_reference
        )
    )
    # a rigid bone that moves with its volume has all four
    numbers = (left.pixels_after_similarity, left.pixels, left.mm, left.degrees)
    return Left(*(float("nan") if n is None else n for n in numbers), followed=not still)
