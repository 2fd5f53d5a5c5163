"""What a scanner would know of a simulated scan, as a SCAN.toml that `legsim correct` reads."""

from collections.abc import Sequence
from pathlib import Path

from legsim.config import WHITE, MethodsConfig, RunConfig, measured_scan
from legsim.config.imu_file import ImuFileConfig, StartConfig, WornSensorConfig
from legsim.config.measured_scan import (
    JointConfig,
    MeasuredGridConfig,
    MeasuredMethodsConfig,
    MeasuredScanConfig,
)
from legsim.core.files import write_text
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Scan
from legsim.imu.sensors import Sensor
from legsim.imu.signals import SensorStart

NAME = "scan.toml"

_HEAD = """# What scanner and sensors would know of this scan; legsim correct {name} --method rigid
# Starts are by methods.start = "{start}" of the run; no clock offset is known.
"""


def write(folder: Path, settings: RunConfig, scan: Scan, sensors: Sequence[Sensor]) -> None:
    """Writes scan.toml beside the run's projections, geometry and imu.csv."""
    head = _HEAD.format(name=NAME, start=settings.methods.start)
    text = measured_scan.dump(known_of(settings, scan, sensors))
    write_text(folder / NAME, f"{head}\n{text}")


def known_of(settings: RunConfig, scan: Scan, sensors: Sequence[Sensor]) -> MeasuredScanConfig:
    """Settings of the measured scan that a simulated one would be."""
    worn = tuple(
        WornSensorConfig(
            name=sensor.name, segment=sensor.segment, start=_start(start, settings.methods)
        )
        for sensor, start in zip(sensors, scan.starts, strict=True)
    )
    voxels, size = settings.grid.voxels, settings.grid.voxel_mm
    used = settings.methods
    return MeasuredScanConfig(
        projections="projections.mha",
        geometry="geometry.json",
        line_integrals=True,
        imu=(ImuFileConfig(file="imu.csv", sensors=worn),),
        joints=_joints(scan.joints, sensors),
        grid=MeasuredGridConfig(shape_zyx=(voxels, voxels, voxels), spacing_mm=(size, size, size)),
        reconstruction=settings.reconstruction,
        methods=MeasuredMethodsConfig(
            sensor=used.sensor if used.sensor in scan.signals.sensor_names else "",
            scheme=used.scheme,
            node_mm=used.node_mm,
            sensor_model=_sensor_model(settings),
            spread_mm=used.fused.spread_mm,
            clock_ms=used.fused.clock_ms,
        ),
    )


def _sensor_model(settings: RunConfig) -> str:
    """The sensor whose errors the run's methods expect, as bought; the usual one where it has no
    name.
    """
    kind = settings.imu.noise.kind
    if kind in ("none", "custom", *WHITE):
        return MeasuredMethodsConfig().sensor_model
    return str(Path(kind).resolve()) if kind.endswith(".toml") else kind


def _start(start: SensorStart, methods: MethodsConfig) -> StartConfig:
    """The start that methods were given, with how far off it may be."""
    place, rows = start.world_from_sensor[:3, 3], start.world_from_sensor[:3, :3]
    (a, b, c), (u, v, w) = (1e3 * place).tolist(), (1e3 * start.velocity).tolist()
    first, second, third = ((x, y, z) for x, y, z in rows.tolist())
    return StartConfig(
        position_mm=(a, b, c),
        rotation=(first, second, third),
        velocity_mm_s=(u, v, w),
        position_sd_mm=methods.rough.place_mm if methods.start == "rough" else 0.0,
        heading_sd_deg=methods.rough.heading_deg if methods.start == "rough" else 0.0,
    )


def _joints(
    legs: Sequence[Sequence[AttachedPoint]], sensors: Sequence[Sensor]
) -> tuple[JointConfig, ...]:
    """Hip, knee and ankle of each leg, then its further points by number."""
    segments = {sensor.name: sensor.segment for sensor in sensors}
    found = []
    for points in legs:
        side = segments[points[0].sensor][-1]
        names = ["hip", "knee", "ankle", *(f"point_{k}" for k in range(1, len(points) - 2))]
        for name, point in zip(names, points, strict=True):
            x, y, z = (1e3 * point.position_sensor).tolist()
            found.append(
                JointConfig(name=f"{name}_{side}", sensor=point.sensor, position_mm=(x, y, z))
            )
    return tuple(found)
