"""What marker noise becomes in the sensors' signals: `python -m tools.experiments.marker_noise`.
Writes a table for docs/signals.md.

A rigid body sways on a known quintic spline; four markers on it carry white noise; they are
filtered at 6 Hz, the pose is fitted, filtered once more, and a spline through it gives what an
accelerometer and a gyroscope on the body would read. Then the same through the whole leg: the
study's seven markers on a swaying leg, inverse kinematics, and the two sensors of the study.
"""

from typing import Annotated

import numpy as np
import typer
from scipy.interpolate import make_interp_spline

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.imu import simulation
from legsim.imu.sensors import default_sensors
from legsim.kinematics import inverse_kinematics, marker_sites, smoothing
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

RATE = 120.0
TIMES = np.arange(0, 20, 1 / RATE)
INSIDE = slice(120, -120)
MARKERS = 0.05 * np.array([[1.0, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0.5]])
"""m: a plate of 10 cm"""
BMI160 = 1.8, 0.07
"""mg and deg/s, RMS of an axis"""


def sway(rng: np.random.Generator, columns: int, size: float) -> FloatArray:
    """(n, columns) values of a quintic spline with knots every half second: known, smooth, below 1
    Hz.
    """
    knots = np.arange(-2, 23, 0.5)
    return make_interp_spline(knots, size * rng.standard_normal((len(knots), columns)), k=5)(TIMES)


def second(values: FloatArray) -> FloatArray:
    """Second derivative of the quintic spline through all samples, as legsim takes it."""
    return make_interp_spline(TIMES, values, k=5)(TIMES, 2)


def rigid_body(noise: float, cutoff_hz: float, rng: np.random.Generator) -> tuple[float, float]:
    """RMS an axis of what noise adds: acceleration of the body's middle in mg, angular rate in
    deg/s.
    """
    shift, turn = sway(rng, 3, 2e-3), sway(rng, 3, np.radians(0.3))
    true = np.einsum("nij,mj->nmi", transforms.rotation_from_vector(turn), MARKERS) + shift[:, None]
    seen = true + noise * rng.standard_normal(true.shape)
    seen = low_pass(seen.reshape(len(TIMES), -1), RATE, 6.0).reshape(true.shape)
    middle = seen.mean(1)
    cross = np.einsum("nmi,mj->nij", seen - middle[:, None], MARKERS - MARKERS.mean(0))
    u, _, vt = np.linalg.svd(cross)
    found = transforms.vector_from_rotation(u @ vt)
    found_shift = middle - (transforms.rotation_from_vector(found) @ MARKERS.mean(0))
    if cutoff_hz:
        found, found_shift = (low_pass(v, RATE, cutoff_hz, order=4) for v in (found, found_shift))
    acceleration = (second(found_shift) - second(shift))[INSIDE]
    # turns are small: the rate is the vector's derivative
    rate = (make_interp_spline(TIMES, found - turn, k=5)(TIMES, 1))[INSIDE]
    return 1e3 * acceleration.std() / STANDARD_GRAVITY, float(np.degrees(rate.std()))


def whole_leg(
    noise: float, settle: bool, rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """RMS an axis of what noise adds to (shank mg, shank deg/s, thigh mg, thigh deg/s) in a held
    squat of 60 degrees.
    """
    leg, sites = LegModel.load(), marker_sites.load().only(PAPER_ROLES)
    base = leg.default_coordinates.copy()
    for side in "lr":
        for name, degrees in (("hip_flexion", 50), ("knee_angle", -60), ("ankle_angle", 25)):
            base[COORDINATES.index(f"{name}_{side}")] = np.radians(degrees)
    values = base + sway(rng, len(COORDINATES), 0.003)
    truth = JointTrajectories(TIMES, COORDINATES, values)
    places = leg.marker_positions(values, sites)
    seen = places + noise * rng.standard_normal(places.shape)
    seen = low_pass(seen.reshape(len(TIMES), -1), RATE, 6.0).reshape(places.shape)
    found = inverse_kinematics.solve(
        leg, MarkerTrajectories(TIMES, sites.names, seen), sites
    ).trajectories
    if settle:
        found, _ = smoothing.smooth_below_noise(leg, found, sites, noise=noise, filter_hz=6.0)
    ours, true = (
        simulation.simulate(leg, JointSplines(t), default_sensors(), TIMES[INSIDE])
        for t in (found, truth)
    )
    force = 1e3 * (ours.specific_force - true.specific_force) / STANDARD_GRAVITY
    rate = np.degrees(ours.angular_velocity - true.angular_velocity)
    # the posture is off by what the priors decide, so only what changes counts
    return (
        force[:, 0].std(0).mean(),
        rate[:, 0].std(0).mean(),
        force[:, 1].std(0).mean(),
        rate[:, 1].std(0).mean(),
    )


def main(
    noise_mm: Annotated[float, typer.Option(help="RMS of a marker's white noise per axis.")] = 0.2,
) -> None:
    """Marker noise in accelerometer and gyroscope, with and without the second low-pass."""
    noise = 1e-3 * noise_mm
    one = 1e3 * smoothing.left_by_filter(noise, 6.0, RATE)[1] / STANDARD_GRAVITY
    typer.echo(
        f"one marker behind the 6 Hz filter, by the law: {one:.2f} mg; BMI160 {BMI160[0]} mg, "
        f"{BMI160[1]} deg/s\n"
    )
    typer.echo("| rigid body, 4 markers | accelerometer (mg) | gyroscope (deg/s) |\n|---|---|---|")
    for cutoff in (0.0, 5.0, 4.0, 3.0):
        force, rate = rigid_body(noise, cutoff, np.random.default_rng(1))
        typer.echo(
            f"| {f'filtered again at {cutoff:g} Hz' if cutoff else 'spline through every sample'} "
            f"| {force:.2f} | {rate:.3f} |"
        )
    typer.echo(
        "\n| leg, 7 markers | shank (mg) | shank (deg/s) | thigh (mg) | thigh (deg/s) "
        "|\n|---|---|---|---|---|"
    )
    for settle, label in ((False, "spline through every sample"), (True, "settled")):
        numbers = whole_leg(noise, settle, np.random.default_rng(2))
        typer.echo(f"| {label} | " + " | ".join(f"{n:.3f}" for n in numbers) + " |")


if __name__ == "__main__":
    typer.run(main)
