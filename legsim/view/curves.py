"""Curves over time: coordinates, IMU signals, marker residuals."""

import numpy as np
import rerun as rr

from legsim.imu.signals import ImuSignals
from legsim.scene.values import ReplayScene
from legsim.view.stream import Recorder, entity_path

HUES = (
    (90, 180, 255),
    (255, 150, 70),
    (110, 220, 120),
    (235, 120, 200),
    (240, 220, 90),
    (170, 140, 255),
    (130, 220, 220),
    (220, 160, 130),
)


def log_coordinates(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs angles in degrees under `angles/`, the pelvis's path under `translations/`.

    The path is in millimeters from its start.
    """
    trajectories = scene.trajectories
    for name in trajectories.coordinate_names:
        values = trajectories.coordinate(name)
        if name in scene.shifts:
            entity, values = entity_path("translations", name), 1e3 * (values - values[0])
        else:
            entity, values = entity_path("angles", name), np.rad2deg(values)
        recorder.columns(entity, trajectories.times, rr.Scalars.columns(scalars=values))
        recorder.static(entity, rr.SeriesLines(names=name, widths=1.5, colors=_color(name)))


def _color(name: str) -> tuple[int, ...]:
    """A hue for each kind of coordinate, the left side darker than the right."""
    kinds = (
        "knee_angle",
        "hip_flexion",
        "ankle_angle",
        "hip_adduction",
        "hip_rotation",
        "subtalar_angle",
        "mtp_angle",
    )
    shifts = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
    places = {name: k for some in (kinds, shifts) for k, name in enumerate(some)}
    hue = HUES[places.get(name.removesuffix("_l").removesuffix("_r"), len(name) % len(HUES))]
    return tuple(c * 6 // 10 for c in hue) if name.endswith("_l") else hue


def log_imu(recorder: Recorder, imu: ImuSignals) -> None:
    """Logs specific force (m/s^2) and angular velocity (rad/s) of each sensor, three lines each."""
    for name in imu.sensor_names:
        angular_velocity, specific_force = imu.sensor(name)
        for kind, unit, values in (
            ("specific_force", "m/s²", specific_force),
            ("angular_velocity", "rad/s", angular_velocity),
        ):
            entity = entity_path("imu", name, kind)
            recorder.columns(
                entity,
                imu.times,
                rr.Scalars.columns(scalars=values.ravel()).partition(np.full(len(values), 3)),
            )
            colors = [(235, 80, 80), (90, 210, 90), (90, 140, 255)]
            recorder.static(
                entity,
                rr.SeriesLines(
                    names=[f"{axis} ({unit})" for axis in "xyz"], colors=colors, widths=[1.5] * 3
                ),
            )


def log_residuals(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs RMS and worst distance between measured and modeled markers per frame, in mm."""
    residuals = scene.marker_residuals()
    if residuals is None or scene.measured is None:
        return
    seen = np.isfinite(residuals).any(-1)
    millimeters = 1e3 * residuals[seen]
    for name, values in (
        ("rms", np.sqrt(np.nanmean(millimeters**2, -1))),
        ("worst", np.nanmax(millimeters, -1)),
    ):
        recorder.columns(
            f"residuals/{name}", scene.measured.times[seen], rr.Scalars.columns(scalars=values)
        )
        recorder.static(f"residuals/{name}", rr.SeriesLines(names=f"{name} (mm)", widths=1.5))
