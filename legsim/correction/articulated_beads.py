"""Rigid bones by two consumer sensors and few beads on each segment, tied at the knee.

The tied smoother says how thigh and shank move from rough starts and biased signals; bones and the
tissue between them follow as in :mod:`legsim.correction.articulated`. What beads do not tell of how
the two move against each other is held as small as in a person who holds a posture.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.articulated import around_center, follow_limbs, scanned_leg
from legsim.correction.bead_scan import BeadScan, shadows_of
from legsim.correction.control_points import AttachedPoint
from legsim.correction.fused import (
    DISCERNED,
    FusedBeads,
    SensorPriors,
    doubts_of_shadows,
    left_as_it_is,
)
from legsim.correction.limb_motion import Limb
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import BeadShadows, StandingPrior
from legsim.correction.path_problem import DivergedError
from legsim.correction.smoother import SmoothedPath
from legsim.correction.tied_sensors import LegTie, TiedPaths, tied_paths
from legsim.deformation.models import RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device

_ABOVE_KNEE = np.array([0.0, 0.04, 0.08])
"""m along the thigh, of the points at which it is compared with the shank"""


@dataclass(frozen=True, slots=True, eq=False)
class BeadedLeg:
    """What is seen and known of a leg with beads on thigh and shank."""

    beads: Callable[[str], BeadShadows | BeadScan]
    """from the name of the thigh's or the shank's sensor to what shows its segment's beads"""
    knee_on_thigh: FloatArray
    """(3,) m, the knee in the thigh's sensor: as well known as the joints of the scan are"""


@dataclass(frozen=True, slots=True)
class ArticulatedBeads:
    """Femur, tibia and patella move as rigid bodies along two sensors whose drift beads show.

    >>> ArticulatedBeads(BeadedLeg(shadows.get, knee), SensorPriors(load_sensor("bmi160").errors))
    """

    leg: BeadedLeg
    priors: SensorPriors = field(default_factory=SensorPriors)
    nodes: VolumeGrid | None = None
    """coarse grid over the volume; None: as :class:`legsim.correction.articulated.Articulated`"""
    device: Device | None = None
    """None opens the fastest"""

    def __call__(self, scan: Scan, /) -> Correction:
        hip, knee, ankle = _joints(scan)
        sensors = (hip.sensor, knee.sensor)
        shadows = [shadows_of(self.leg.beads(name)) for name in sensors]
        for hidden, shown in ((0, 1), (1, 0)):
            if not shadows[hidden].placed.any():
                one = FusedBeads(shadows[shown], sensors[shown], self.priors)(scan)
                return _as_one(one, sensors[hidden], sensors[shown])
        tie = LegTie(
            self.leg.knee_on_thigh, knee.position_sensor, ankle.position_sensor, hip.position_sensor
        )
        try:
            found = tied_paths(scan, sensors, tie, self.priors, (shadows[0], shadows[1]))
        except DivergedError as error:
            return left_as_it_is("articulated-beads", scan, error)
        noted = [
            f"articulated-beads, {name}: {beads.pixels.shape[1]} beads, "
            f"{100 * np.isfinite(beads.pixels).all(-1).mean():.0f} % of their shadows found, "
            f"{path.residual_px:.2f} px RMS from the sensor's path."
            for name, beads, path in zip(sensors, shadows, (found.thigh, found.shank), strict=True)
        ]
        noted += [
            doubt
            for name, beads, path in zip(sensors, shadows, (found.thigh, found.shank), strict=True)
            for doubt in doubts_of_shadows(f"articulated-beads, {name}", path, beads.error_px)
        ]
        said, determined = _judged(scan, found)
        if not determined:
            still = RigidMotion.identity(scan.times)
            return Correction("articulated-beads", scan.projections, still, notes=(*noted, said))
        joints = found.joints(tie)
        parting = _parted(found, joints)
        limb = Limb(joints, found.thigh.path.poses, found.shank.path.poses)
        nodes = self.nodes or around_center(scan.projections)
        motion, seen = follow_limbs(scan.projections, [limb], nodes, self.device)
        return Correction(
            "articulated-beads", scan.projections, motion, notes=(*noted, said, parting, *seen)
        )


def _as_one(followed: Correction, hidden: str, shown: str) -> Correction:
    """What one segment says of the leg, where no bead of the other has a place."""
    note = (
        f"In doubt: articulated-beads: no bead beside {hidden} is seen often enough to have a "
        f"place. The whole leg is left to {shown} and its beads, as fused-beads has it."
    )
    return replace(followed, method="articulated-beads", notes=(note, *followed.notes))


def _joints(scan: Scan) -> tuple[AttachedPoint, AttachedPoint, AttachedPoint]:
    """Hip, knee and ankle of the leg whose knee starts nearest to the rotation center.

    Raises:
        LegsimError: joints are on no sensors, or hip and knee on the same one.
    """
    if not scan.joints:
        raise LegsimError(
            "articulated-beads follows thigh and shank, and this scan knows the place of hip, knee "
            "and ankle on no sensor: configure a sensor on the femur and one on the tibia "
            "(imu.sensors)"
        )
    hip, knee, ankle = scanned_leg(scan)[:3]
    if hip.sensor == knee.sensor or knee.sensor != ankle.sensor:
        raise LegsimError(
            "articulated-beads needs the hip on the thigh's sensor, knee and ankle on the shank's; "
            f"they are on {hip.sensor}, {knee.sensor} and {ankle.sensor}"
        )
    return hip, knee, ankle


def _judged(scan: Scan, found: TiedPaths) -> tuple[str, bool]:
    """A sentence on what images see of both motions and their errors, and whether to follow them.

    Both are followed where either is discerned: alone each would part the leg.
    """
    geometry = scan.projections.geometry
    points = StandingPrior.at(geometry.rotation_center()).points

    def seen(path: SmoothedPath) -> tuple[float, float]:
        return path.seen_motion(geometry, points)

    thigh, shank = seen(found.thigh), seen(found.shank)
    discerned = any(motion > DISCERNED * error for motion, error in (thigh, shank))
    said = (
        f"articulated-beads: the images see {thigh[0]:.2g} and {shank[0]:.2g} px RMS of the motion "
        f"of thigh and shank that was found, and should see {thigh[1]:.2g} and {shank[1]:.2g} px "
        "of its errors"
    )
    if found.settled and discerned:
        return f"{said}.", True
    why = "the data do not determine it" if found.settled else "its estimate did not settle"
    return f"{said}: {why}, and the scan is left as it is.", False


def _parted(found: TiedPaths, joints: FloatArray) -> str:
    """A sentence on how thigh and shank move against each other.

    An error of it displaces one bone against the other, and no registration takes that away.
    """
    upward = (joints[0] - joints[1]) / np.linalg.norm(joints[0] - joints[1])
    size, error = found.parting(joints[1] + _ABOVE_KNEE[:, None] * upward)
    return (
        f"articulated-beads: near the knee, thigh and shank move against each other by "
        f"{1e3 * size:.2g} mm RMS with an error of {1e3 * error:.2g} mm."
    )
