"""Correction by one consumer sensor whose drift is found in the images: no metal, no fiducials.

The sensor says how a segment moves in fractions of a second, a person who stands where it stays,
and sharpness the rest. Where the images do not show that what is found is right, the scan is left
as it is.
"""

from dataclasses import dataclass, field

from legsim.core.errors import LegsimError
from legsim.correction import image_motion
from legsim.correction.error_state import error_state
from legsim.correction.fused import SensorPriors
from legsim.correction.image_motion import FocusPlan
from legsim.correction.method import Correction, Scan
from legsim.correction.smoother import StandingPrior, smooth
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
        if not scan.signals.sensor_names:
            raise LegsimError("fused follows a sensor, and the scan has none; take autofocus")
        name = self.sensor or scan.signals.sensor_names[0]
        start, knee = scan.start(name), scan.projections.geometry.rotation_center()
        priors = self.priors
        # sharpness says too little of the clocks to find their offset
        state = error_state(
            scan.signals, name, start, scan.times, priors.errors, priors.start, clock=0.0
        )
        standing = StandingPrior.at(knee, priors.spread)
        return image_motion.followed(
            "fused",
            scan,
            state,
            smooth(state, standing=standing).errors,
            standing,
            self.device or open_device(),
            # the part of the leg that carries the sensor
            below=bool(start.world_from_sensor[1, 3] < knee[1]),
            plan=self.plan,
        )
