"""What a scanner would know of a simulated scan, as a SCAN.toml that `legsim correct` reads."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.config import WHITE, MethodsConfig, RunConfig, measured_scan
from legsim.config.imu import AccelerometerConfig, GyroscopeConfig, NoiseConfig
from legsim.config.imu_file import ImuFileConfig, StartConfig, WornSensorConfig
from legsim.config.measured_scan import (
    ExpectedErrorsConfig,
    JointConfig,
    MeasuredGridConfig,
    MeasuredMethodsConfig,
    MeasuredScanConfig,
)
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.files import write_text
from legsim.core.values import in_millimeters
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Scan
from legsim.imu.sensors import Sensor
from legsim.imu.signals import SensorStart
from legsim.run import sensors

NAME = "scan.toml"

_HEAD = """# What scanner and sensors would know of this scan; legsim correct {name} --method rigid
# Starts are by methods.start = "{start}" of the run; no clock offset is known.
"""


def write(
    folder: Path,
    settings: RunConfig,
    scan: Scan,
    placed: Sequence[Sensor],
    knee_on_thigh: AttachedPoint | None,
) -> None:
    """Writes scan.toml beside the run's projections, geometry and imu.csv."""
    head = _HEAD.format(name=NAME, start=settings.methods.start)
    text = measured_scan.dump(known_of(settings, scan, placed, knee_on_thigh))
    write_text(folder / NAME, f"{head}\n{text}")


def known_of(
    settings: RunConfig,
    scan: Scan,
    placed: Sequence[Sensor],
    knee_on_thigh: AttachedPoint | None = None,
) -> MeasuredScanConfig:
    """Settings of the measured scan that a simulated one would be.

    ``knee_on_thigh`` is the scanned knee on the thigh's sensor.
    """
    worn = tuple(
        WornSensorConfig(
            name=sensor.name, segment=sensor.segment, start=_start(start, settings.methods)
        )
        for sensor, start in zip(placed, scan.starts, strict=True)
    )
    voxels, size = settings.grid.voxels, settings.grid.voxel_mm
    used = settings.methods
    return MeasuredScanConfig(
        projections="projections.mha",
        geometry="geometry.json",
        line_integrals=True,
        imu=(ImuFileConfig(file="imu.csv", sensors=worn),),
        joints=(
            *_joints(scan, placed),
            *_on_thigh(knee_on_thigh if scan.joints else None, placed),
        ),
        grid=MeasuredGridConfig(shape_zyx=(voxels, voxels, voxels), spacing_mm=(size, size, size)),
        reconstruction=settings.reconstruction,
        methods=MeasuredMethodsConfig(
            sensor=used.sensor if used.sensor in scan.signals.sensor_names else "",
            scheme=used.scheme,
            node_mm=used.node_mm,
            sensor_model=_sensor_model(settings.imu.noise),
            sensor_errors=_sensor_errors(settings),
            spread_mm=used.fused.spread_mm,
            clock_ms=used.fused.clock_ms,
        ),
    )


def _sensor_model(noise: NoiseConfig) -> str:
    """The sensor whose errors the run's methods expect; "custom" where it has no name."""
    if noise.kind in ("none", "custom", *WHITE):
        return "custom"
    return str(Path(noise.kind).resolve()) if noise.kind.endswith(".toml") else noise.kind


def _sensor_errors(settings: RunConfig) -> ExpectedErrorsConfig:
    """What the run's methods expect of it else: changed numbers, white noise, its calibration."""
    noise = settings.imu.noise
    if noise.kind not in ("none", *WHITE):
        return ExpectedErrorsConfig(
            accelerometer=noise.accelerometer,
            gyroscope=noise.gyroscope,
            off=noise.off,
            calibration=noise.calibration,
            rest_s=noise.rest_s,
            warms=bool(noise.temperature_course),
        )
    known = sensors.prior_errors(settings.imu, view_rate_hz=settings.scan.rate_hz)
    force, turn = known.accelerometer, known.gyroscope
    return ExpectedErrorsConfig(
        accelerometer=AccelerometerConfig(
            noise_density_ug_per_sqrt_hz=1e6 * force.noise_density / STANDARD_GRAVITY,
            turn_on_bias_mg=1e3 * force.turn_on_bias / STANDARD_GRAVITY,
        ),
        gyroscope=GyroscopeConfig(
            noise_density_deg_per_s_per_sqrt_hz=float(np.degrees(turn.noise_density)),
            turn_on_bias_deg_per_s=float(np.degrees(turn.turn_on_bias)),
        ),
    )


def _start(start: SensorStart, methods: MethodsConfig) -> StartConfig:
    """The start that methods were given, with how far off it may be."""
    place, rows = start.world_from_sensor[:3, 3], start.world_from_sensor[:3, :3]
    (a, b, c), (u, v, w) = (in_millimeters(k).tolist() for k in (place, start.velocity))
    first, second, third = ((x, y, z) for x, y, z in rows.tolist())
    return StartConfig(
        position_mm=(a, b, c),
        rotation=(first, second, third),
        velocity_mm_s=(u, v, w),
        position_sd_mm=methods.rough.place_mm if methods.start == "rough" else 0.0,
        heading_sd_deg=methods.rough.heading_deg if methods.start == "rough" else 0.0,
    )


def _joints(scan: Scan, placed: Sequence[Sensor]) -> tuple[JointConfig, ...]:
    """Hip, knee and ankle of each leg, then its further points by number; ankles of other legs."""
    found, whole = [], set()
    for points in scan.joints:
        side = _side(points[0], placed)
        names = ["hip", "knee", "ankle", *(f"point_{k}" for k in range(1, len(points) - 2))]
        found += [
            _joint(f"{name}_{side}", point) for name, point in zip(names, points, strict=True)
        ]
        whole.add(side)
    alone = [(ankle, _side(ankle, placed)) for ankle in scan.ankles]
    return (*found, *(_joint(f"ankle_{side}", at) for at, side in alone if side not in whole))


def _on_thigh(knee: AttachedPoint | None, placed: Sequence[Sensor]) -> tuple[JointConfig, ...]:
    """The scanned knee once more, on the thigh's sensor; nothing where there is none."""
    return () if knee is None else (_joint(f"knee_{_side(knee, placed)}", knee),)


def _side(point: AttachedPoint, placed: Sequence[Sensor]) -> str:
    """Of the leg whose sensor carries a point."""
    return next(sensor.segment[-1] for sensor in placed if sensor.name == point.sensor)


def _joint(name: str, point: AttachedPoint) -> JointConfig:
    x, y, z = in_millimeters(point.position_sensor).tolist()
    return JointConfig(name=name, sensor=point.sensor, position_mm=(x, y, z))
