"""What a sensor and its aids find of a motion, against the truth; no image is made.

One sensor with all its errors, from a start as methods.start says, follows the bone that carries
it. Shadows of beads and fiducials are projected exactly and then missed by some noise. The measure
is the motion's own: pixels after the one constant similarity that images cannot see, pixels,
millimeters, degrees.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.progress import OnProgress
from legsim.correction.fused import FusedBeads, FusedFiducials, SensorPriors, Standing
from legsim.correction.method import CorrectionMethod, Scan
from legsim.correction.rigid import Rigid, Uncorrected
from legsim.deformation.models import Motion, RigidMotion
from legsim.evaluation import residual_motion
from legsim.evaluation.residual_motion import Structure
from legsim.geometry.cone_beam import Projections
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import scores, stages, volumes
from legsim.simulation.setup import ScanSetup, ankles_on_sensors, joints_on_sensors


class Left(NamedTuple):
    """What one estimate leaves of the motion, RMS over views and points of the bone."""

    px_after_similarity: float
    px: float
    mm: float
    degrees: float
    followed: bool
    """whether a motion was followed"""


def check(settings: RunConfig, aids: Sequence[str]) -> None:
    """Refuses, before anything is computed, what these estimates cannot be made of.

    Raises:
        LegsimError: an unknown sensor, or fiducials that are to be found in images.
    """
    names = [sensor.name for sensor in settings.imu.sensors]
    if settings.methods.sensor not in names:
        raise LegsimError(
            f"methods.sensor: unknown sensor {settings.methods.sensor!r}; name one of "
            f"{', '.join(names)}, or add it to imu.sensors"
        )
    seen = settings.methods.start == "fiducials" or "fiducials" in aids
    if seen and settings.methods.fiducials.found == "images":
        raise LegsimError(
            'methods.fiducials.found = "images" has no images in [aiding]; set it to "exact", or '
            "ask for volumes with aiding.volume_methods"
        )


def measure(
    settings: RunConfig, aids: Sequence[str], seeds: Sequence[int], on_progress: OnProgress
) -> list[dict[str, Left]]:
    """Errors by aid of each draw of the sensor's errors, its start and the shadows."""
    setup = stages.place(settings, run_motion.solve(settings.motion))
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
    signals = stages.record(settings, setup.person, rest_at=float(setup.times[0]))
    starts = stages.starts(settings, setup, signals).starts
    empty = np.zeros((len(setup.geometry), *setup.geometry.shape_vu), np.float32)
    return Scan(
        Projections(setup.geometry, empty),
        signals,
        starts,
        joints_on_sensors(setup),
        ankles_on_sensors(setup),
    )


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
