"""Correction by one consumer sensor whose drift is found in the images: no metal, no fiducials.

The sensor says how a segment moves in fractions of a second, a person who stands where it stays,
and sharpness the rest. Where the images do not show that what is found is right, the scan is left
as it is.
"""

from dataclasses import dataclass, field, replace

from legsim.correction import image_motion
from legsim.correction.fused import (
    SensorPriors,
    foot_note,
    left_as_it_is,
    sensor_state,
    standing_foot,
)
from legsim.correction.image_motion import FocusPlan
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import StandingPrior
from legsim.correction.path_problem import DivergedError
from legsim.correction.smoother import smooth
from legsim.opencl.device import Device, open_device


@dataclass(frozen=True, slots=True)
class FusedImages:
    """Rigid motion from one sensor, a person who stands, and the sharpness of the images.

    >>> FusedImages("shank_l", SensorPriors(load_sensor("bmi160").errors))(scan)
    """

    sensor: str = ""
    """the sensor to follow; empty: the first one of the scan"""
    priors: SensorPriors = field(default_factory=SensorPriors)
    device: Device | None = None
    """None opens the fastest one"""
    plan: FocusPlan | None = None

    def __call__(self, scan: Scan, /) -> Correction:
        name = scan.sensor(self.sensor)
        start, knee = scan.start(name), scan.projections.geometry.rotation_center()
        # sharpness says too little of the clocks to find their offset
        state = sensor_state(scan, name, self.priors, clock=0.0)
        standing = StandingPrior.at(knee, self.priors.spread)
        foot, doubted = standing_foot(scan, name)
        try:
            begun = smooth(state, standing=standing, foot=foot)
        except DivergedError as error:
            return left_as_it_is("fused", scan, error)
        found = image_motion.followed(
            "fused",
            scan,
            state,
            begun.errors,
            begun.standing or standing,
            self.device or open_device(),
            foot=begun.foot,
            # the part of the leg that carries the sensor
            below=bool(start.world_from_sensor[1, 3] < knee[1]),
            plan=self.plan,
        )
        return replace(found, notes=(*doubted, *foot_note(foot, begun), *found.notes))
