"""Somebody who sways, and a small scan of the left knee."""

from functools import cache

import numpy as np

from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.scan.c_arm import CArm
from legsim.simulation.simulated_scan import SimulatedScan, simulate_scan
from tests.examples.sway_of_joints import swaying


@cache
def person() -> MovingLeg:
    """A squat of 30 degrees with slow sway."""
    leg = LegModel.load()
    return MovingLeg("sway", leg, swaying(leg), fit=None)


def c_arm() -> CArm:
    """Views over the published arc within the person's recording, with few and large pixels."""
    return CArm.paper(
        angles=np.radians(np.linspace(-8.8, 188.8, 40)),
        rate_hz=5.0,
        shape_vu=(24, 31),
        pixel_pitch=12.32e-3,
        rays_per_pixel=1,
    )


@cache
def scan() -> SimulatedScan:
    """Projected once for all tests of a process."""
    return simulate_scan(person(), c_arm())
