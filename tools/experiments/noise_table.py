"""How far the estimated pose drifts: without noise by scheme and rate, and with noise as in the
paper's Table 2 (Maier et al. 2022).

    python -m tools.experiments.noise_table [--repeats 5] [--scheme accurate]

A standing sway of the leg model is sampled by the shank sensor at 120 Hz for 8 s. Each cell is the
RMSE of the sensor's translation (mm) and rotation (deg) against the noise-free estimate, at 248
views, averaged over three axes and over the repeats, in both readings of the paper's noise. The
first table is the error against the true pose without noise; the paper's scheme runs at the
sensor's rate there.
"""

import argparse

import numpy as np

from legsim.core.values import FloatArray
from legsim.imu import drift, simulation, strapdown
from legsim.imu.drift import Drift
from legsim.imu.noise import Convention, ImuNoise
from legsim.imu.sensors import default_sensors
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.strapdown import Scheme
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel
from legsim.mocap.trajectories import JointTrajectories
from legsim.report.published_values import EXPONENTS

RATE_HZ, VIEW_RATE_HZ, VIEWS = 120.0, 31.0, 248


def standing(leg: LegModel, times: FloatArray, rng: np.random.Generator) -> JointTrajectories:
    """All coordinates swaying slowly, by millimeters and tenths of a degree, about a squat of 30
    degrees.
    """
    base = leg.default_coordinates.copy()
    for name, degrees in (("hip_flexion", 25.0), ("knee_angle", -30.0), ("ankle_angle", 15.0)):
        for side in "lr":
            base[leg.coordinate_names.index(f"{name}_{side}")] = np.radians(degrees)
    rate_hz = np.geomspace(0.15, 1.7, 3)[:, None] * rng.uniform(0.8, 1.2, (3, len(base)))
    phase = rng.uniform(0, 2 * np.pi, rate_hz.shape)
    waves = (
        np.sin(2 * np.pi * rate_hz * times[:, None, None] + phase) * 2e-3 * rate_hz.min(0) / rate_hz
    )
    return JointTrajectories(times, leg.coordinate_names, base + waves.sum(1))


def cell(
    clean: ImuSignals,
    start: SensorStart,
    views: FloatArray,
    noise: ImuNoise,
    scheme: Scheme,
    repeats: int,
) -> tuple[float, float]:
    """(mm, deg) mean deviation of ``repeats`` draws; the same draws in every cell."""
    draws = [
        in_mm_and_degrees(d)
        for d in drift.deviations(clean, start, views, noise, scheme, range(repeats))
    ]
    millimeters, degrees = np.mean(draws, 0)
    return float(millimeters), float(degrees)


def in_mm_and_degrees(deviation: Drift) -> tuple[float, float]:
    return 1e3 * deviation.translation, float(np.degrees(deviation.rotation))


def table(
    clean: ImuSignals,
    start: SensorStart,
    views: FloatArray,
    convention: Convention,
    scheme: Scheme,
    repeats: int,
) -> list[str]:
    """Lines of text: f_a down, f_g across, mm / deg."""
    names = ["none" if f is None else f"{f:.0f}" for f in EXPONENTS]
    lines = [
        f"convention: {convention}, scheme: {scheme} (mm / deg)",
        "f_a\\f_g " + " ".join(f"{name:>18}" for name in names),
    ]
    for name, f_a in zip(names, EXPONENTS, strict=True):
        cells = []
        for f_g in EXPONENTS:
            noise = ImuNoise.paper(
                acceleration_exponent=f_a,
                angular_velocity_exponent=f_g,
                imu_rate_hz=RATE_HZ,
                projection_rate_hz=VIEW_RATE_HZ,
                convention=convention,
            )
            cells.append(
                "{:8.3g} / {:<7.2g}".format(*cell(clean, start, views, noise, scheme, repeats))
            )
        lines.append(f"{name:>7} " + " ".join(f"{text:>18}" for text in cells))
    return lines


def drift_lines(leg: LegModel, splines: JointSplines, views: FloatArray) -> list[str]:
    """Lines of text: scheme and rate down, RMS of the error against the truth across."""
    sensor = default_sensors()[0]
    start, lines = (
        simulation.true_start(leg, splines, sensor, 0.0),
        ["noise-free drift over 8 s: scheme, rate, mm and deg RMS an axis"],
    )
    for rate_hz in (31.0, 60.0, 120.0, 200.0, 1000.0):
        times = np.arange(int(8.1 * rate_hz)) / rate_hz
        rate, force = simulation.simulate(leg, splines, [sensor], times).sensor(sensor.name)
        schemes: tuple[tuple[Scheme, FloatArray], ...] = (
            ("accurate", views),
            ("paper", times[times <= views[-1]]),
        )
        for scheme, at in schemes:
            truth = simulation.sensor_poses(leg, splines, [sensor], at).of(sensor.name)
            millimeters, degrees = in_mm_and_degrees(
                drift.deviation(
                    strapdown.integrate(times, rate, force, start, at, scheme=scheme), truth
                )
            )
            lines.append(
                f"{scheme:>9} {rate_hz:6.0f} Hz {millimeters:10.2g} mm {degrees:10.2g} deg"
            )
    return lines


def main() -> None:
    """Prints all tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scheme", choices=("accurate", "paper"), default="accurate")
    options = parser.parse_args()
    leg, times = LegModel.load(), np.arange(int(8.2 * RATE_HZ)) / RATE_HZ
    splines, views = (
        JointSplines(standing(leg, times, np.random.default_rng(0))),
        np.arange(VIEWS) / VIEW_RATE_HZ,
    )
    sensor = default_sensors()[0]
    clean, start = (
        simulation.simulate(leg, splines, [sensor], times),
        simulation.true_start(leg, splines, sensor, 0.0),
    )
    print("\n".join(drift_lines(leg, splines, views)), end="\n\n")
    for convention in ("SI", "per-sample"):
        print(
            "\n".join(table(clean, start, views, convention, options.scheme, options.repeats)),
            end="\n\n",
        )


if __name__ == "__main__":
    main()
