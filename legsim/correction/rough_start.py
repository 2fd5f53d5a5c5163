"""Rough starts: what is known of a sensor's pose and velocity at the first view without any images.

A sensor is strapped on by hand. Its tilt follows from gravity to a degree or two, its turn about
the vertical and its place from where it was strapped, and its velocity only from the fact that its
wearer stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray, positive
from legsim.imu.signals import SensorStart


@dataclass(frozen=True, slots=True)
class StartErrors:
    """How far a start may be off: one standard deviation per axis; 0 is known exactly."""

    tilt: float = float(np.radians(1.5))
    """rad, about each of the two horizontal axes"""
    heading: float = float(np.radians(3.0))
    """rad, about the vertical"""
    velocity: float = 0.030
    """m/s along each axis"""
    place: float = 0.005
    """m along each axis"""

    def __post_init__(self) -> None:
        for field in fields(self):
            positive(f"StartErrors.{field.name}", getattr(self, field.name), zero=True)

    @property
    def sigmas(self) -> FloatArray:
        """(9,) tilt about x, heading, tilt about z (rad), velocity (m/s), place (m)."""
        turns = [self.tilt, self.heading, self.tilt]
        return np.array([*turns, *[self.velocity] * 3, *[self.place] * 3])


EXACT = StartErrors(0.0, 0.0, 0.0, 0.0)
"""errors of a start that is the truth"""


def turned(rotation: FloatArray, turns: FloatArray) -> FloatArray:
    """A start's rotation (3, 3), tilted and then turned about the vertical.

    ``turns`` (3,) are the tilt about x, the heading and the tilt about z, in rad. The heading comes
    last, so that it leaves gravity where it is: Ry(heading) exp(tilt_x, 0, tilt_z) R.
    """
    tilt_x, heading, tilt_z = turns
    tilted = transforms.rotation_from_vector([tilt_x, 0.0, tilt_z]) @ rotation
    return transforms.rotation_from_vector([0.0, heading, 0.0]) @ tilted


def rough(
    exact: Sequence[SensorStart], errors: StartErrors, rng: np.random.Generator
) -> tuple[SensorStart, ...]:
    """Draws starts around exact ones; the velocity is unknown and taken as zero."""
    starts = []
    for start in exact:
        draw = errors.sigmas * rng.standard_normal(9)
        pose = start.world_from_sensor
        rotation = turned(pose[:3, :3], draw[:3])
        starts.append(SensorStart(transforms.rigid(rotation, pose[:3, 3] + draw[6:]), np.zeros(3)))
    return tuple(starts)
