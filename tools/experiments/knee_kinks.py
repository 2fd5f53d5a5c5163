"""How far the knots of the knee's splines show in the shank's accelerometer: `python -m
tools.experiments.knee_kinks`, for docs/signals.md.

The third derivative of a cubic spline jumps at its knots, and with it the jerk of everything below
the knee.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.imu import simulation
from legsim.imu.sensors import default_sensors
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.mocap.trajectories import JointTrajectories

RATE = 120.0
FINE = 5000.0
"""Hz; between two such instants smooth jerk changes by a hundredth of what a knot makes"""


@dataclass(frozen=True, slots=True)
class Kinks:
    """In the movement of the shank's sensor."""

    step: float
    """m/s^3, largest step of the jerk"""
    jerk: float
    """m/s^3, largest jerk"""

    @property
    def sample_mg(self) -> float:
        """What the step adds to the acceleration within one sample."""
        return 1e3 * self.step / RATE / STANDARD_GRAVITY


def squats(leg: LegModel, depth_deg: float, period_s: float) -> JointTrajectories:
    """Two smooth squats in which the thighs swing forward under a pelvis that stays in place."""
    times = np.arange(0, 2 * period_s, 1 / RATE)
    bend = np.radians(depth_deg) * (0.5 - 0.5 * np.cos(2 * np.pi * times / period_s))
    values = np.tile(leg.default_coordinates, (len(times), 1))
    for side in "rl":
        values[:, COORDINATES.index(f"hip_flexion_{side}")] += bend
        values[:, COORDINATES.index(f"knee_angle_{side}")] -= bend
    return JointTrajectories(times, COORDINATES, values)


def measure(depth_deg: float, period_s: float) -> Kinks:
    """Steps of the jerk over the second squat but for its ends."""
    leg = LegModel.load()
    splines = JointSplines(squats(leg, depth_deg, period_s))
    times = np.arange(0.5 * period_s, 1.5 * period_s, 1 / FINE)
    jerk = np.diff(_acceleration(leg, splines, times), axis=0) * FINE
    # a knot between two instants splits its step over two differences
    return Kinks(
        float(np.linalg.norm(jerk[2:] - jerk[:-2], axis=1).max()),
        float(np.linalg.norm(jerk, axis=1).max()),
    )


def _acceleration(leg: LegModel, splines: JointSplines, times: FloatArray) -> FloatArray:
    """(n, 3) m/s^2 in world of the shank's sensor, gravity's constant left in."""
    sensors = default_sensors()
    rotations = simulation.sensor_poses(leg, splines, sensors, times).world_from_segment[
        :, 0, :3, :3
    ]
    return np.einsum(
        "nij,nj->ni",
        rotations,
        simulation.simulate(leg, splines, sensors, times).specific_force[:, 0],
    )


def main(
    depth_deg: Annotated[float, typer.Option(help="Largest knee flexion.")] = 95.0,
    period_s: Annotated[float, typer.Option(help="Seconds a squat.")] = 3.0,
) -> None:
    """The largest step of the jerk in smooth squats."""
    found = measure(depth_deg, period_s)
    typer.echo(
        f"squats to {depth_deg:g} deg every {period_s:g} s: the jerk of the shank's sensor steps "
        f"by {found.step:.2f} m/s^3 at most "
        f"(largest jerk {found.jerk:.1f} m/s^3): {found.sample_mg:.2f} mg within a sample of "
        f"{RATE:g} Hz"
    )


if __name__ == "__main__":
    typer.run(main)
