"""A shipped recording, its mirror image, and a small C-arm to scan them with."""

from dataclasses import replace

import numpy as np

from legsim.kinematics import from_recording
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.scan.c_arm import CArm

ARM = CArm.paper(
    angles=np.radians(-8.8 + 8.0 * np.arange(24)),
    rate_hz=3.0,
    shape_vu=(48, 62),
    pixel_pitch=6.16e-3,
    rays_per_pixel=1,
)
"""the published field and seconds, in 24 views of few pixels"""
GRID_VOXELS = 40


def squatting() -> MovingLeg:
    """The one of the shipped held squats that sways most."""
    return from_recording.solve_kinematics("subject06/squat_60.trc")


def other_side(name: str) -> str:
    """The name of the other leg's; what belongs to neither keeps its own."""
    ends = {"_l": "_r", "_r": "_l"}
    return name[:-2] + ends[name[-2:]] if name[-2:] in ends else name


def mirrored(person: MovingLeg) -> MovingLeg:
    """Who moves as the person does in a mirror, z to -z: sizes, too, change sides."""
    names = person.trajectories.coordinate_names
    values = person.trajectories.values[:, [names.index(other_side(name)) for name in names]]
    turns = [name in ("pelvis_list", "pelvis_rotation", "pelvis_tz") for name in names]
    moved = replace(person.trajectories, values=np.where(turns, -values, values))
    factors = person.leg.scales.factors[[SEGMENTS.index(other_side(name)) for name in SEGMENTS]]
    leg = LegModel.load(SegmentScales(factors, person.leg.scales.mass))
    return MovingLeg(f"{person.name}, mirrored", leg, moved, fit=None)


def mirrored_arm(arm: CArm) -> CArm:
    """The source goes where the mirror shows it."""
    return replace(arm, angles=np.pi - arm.angles)
