"""Correction by sharpness alone: no sensor, one rigid part, as smooth as splines are.

After Sisniega et al., Phys Med Biol 62, 2017 (autofocus of extremities), with the entropy of the
gradient, its exact derivatives, and a person who stands.
"""

from dataclasses import dataclass

import numpy as np

from legsim.correction import image_motion
from legsim.correction.image_fit import SplinePath
from legsim.correction.image_motion import FocusPlan
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import StandingPrior
from legsim.opencl.device import Device, open_device


@dataclass(frozen=True, slots=True)
class Autofocus:
    """Rigid motion of the shank by which its volume is sharpest; reads no sensor.

    >>> Autofocus()(scan)
    """

    spread: float = 2e-3
    """m, RMS of each coordinate by which a knee moves while its owner stands through a scan"""
    knots: int = 9
    """coefficients of each of six splines over the scan"""
    device: Device | None = None
    """None opens the fastest one"""
    plan: FocusPlan | None = None

    def __call__(self, scan: Scan, /) -> Correction:
        center = scan.projections.geometry.rotation_center()
        model = SplinePath(scan.times, center, self.knots)
        return image_motion.followed(
            "autofocus",
            scan,
            model,
            np.zeros(model.size),
            StandingPrior.at(center, self.spread),
            self.device or open_device(),
            plan=self.plan,
        )
