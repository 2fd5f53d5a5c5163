"""How the viewer shows a recording when it first opens."""

import numpy as np
import rerun.blueprint as rrb

from legsim.scene.values import MeasuredScene, ReplayScene, ScanScene
from legsim.view.stream import entity_path


def replay(scene: ReplayScene) -> rrb.Blueprint:
    """Lays out the body on the left, curves on the right."""
    return _blueprint(rrb.Horizontal(_body(scene, 1.0), _curves(scene), column_shares=[3, 2]))


def scan(scene: ScanScene) -> rrb.Blueprint:
    """Lays out body and C-arm, projections, slices, and curves."""
    reach = float(
        np.linalg.norm(
            scene.projections.geometry.sources() - scene.projections.geometry.rotation_center(),
            axis=-1,
        ).max()
    )
    pictures = [rrb.Spatial2DView(origin="world/c_arm/detector", name="Projection")]
    if scene.slices:
        pictures.append(rrb.Spatial2DView(origin="slices", name="Slices: shank, thigh, sagittal"))
    left = rrb.Vertical(
        _body(scene.replay, 1.6 * reach),
        rrb.Horizontal(*pictures, column_shares=[1, 2][: len(pictures)]),
        row_shares=[3, 2],
    )
    return _blueprint(rrb.Horizontal(left, _curves(scene.replay), column_shares=[3, 2]))


def measured(scene: MeasuredScene) -> rrb.Blueprint:
    """Lays out C-arm, projections and slices on the left, what sensors read on the right."""
    geometry = scene.projections.geometry
    center = geometry.rotation_center()
    reach = float(np.linalg.norm(geometry.sources() - center, axis=-1).max())
    controls = rrb.EyeControls3D(
        position=center + 1.6 * reach * np.array([1.3, 0.45, 0.9]),
        look_target=center,
        eye_up=(0, 1, 0),
    )
    left = rrb.Vertical(
        rrb.Spatial3DView(origin="world", name="C-arm", eye_controls=controls, line_grid=False),
        rrb.Horizontal(
            rrb.Spatial2DView(origin="world/c_arm/detector", name="Projection"),
            rrb.Spatial2DView(origin="slices", name="Slices: below, above, sagittal"),
            column_shares=[1, 2],
        ),
        row_shares=[3, 2],
    )
    sensors = [_sensor(name) for name in scene.imu.sensor_names]
    if not sensors:
        return _blueprint(left)
    return _blueprint(rrb.Horizontal(left, rrb.Tabs(*sensors, name="IMU"), column_shares=[3, 2]))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(
        root,
        rrb.TimePanel(timeline="time", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _body(scene: ReplayScene, distance: float) -> rrb.Spatial3DView:
    """View from the front right, somewhat above.

    It shows all joints of the first frame and ``distance`` m around them.
    """
    centers = scene.joint_centers.positions_world[0]
    middle = 0.5 * (centers.min(0) + centers.max(0))
    eye = middle + max(distance, 1.1 * float(np.ptp(centers, axis=0).max())) * np.array(
        [1.3, 0.45, 0.9]
    )
    controls = rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0, 1, 0))
    return rrb.Spatial3DView(origin="world", name="Body", eye_controls=controls, line_grid=False)


def _curves(scene: ReplayScene) -> rrb.Vertical:
    parts: list[rrb.Container | rrb.View] = [_angles(scene)]
    if scene.modelled is not None:
        parts.append(rrb.TimeSeriesView(origin="residuals", name="Marker residuals (mm)"))
    if scene.imu is not None:
        parts.append(rrb.Tabs(*(_sensor(name) for name in scene.imu.sensor_names), name="IMU"))
    return rrb.Vertical(
        *parts, row_shares=[2, 1, 3][: len(parts)] if scene.modelled is not None else None
    )


def _angles(scene: ReplayScene) -> rrb.Tabs:
    names = scene.trajectories.coordinate_names
    bends = [
        entity_path("angles", name)
        for name in names
        if name.startswith(("hip_flexion", "knee_angle", "ankle_angle"))
    ]
    tabs = (
        [rrb.TimeSeriesView(origin="/", contents=bends, name="Hip, knee, ankle (deg)")]
        if bends
        else []
    )
    tabs.append(rrb.TimeSeriesView(origin="angles", name="All angles (deg)"))
    if set(names) & set(scene.shifts):
        tabs.append(rrb.TimeSeriesView(origin="translations", name="Pelvis (mm from start)"))
    return rrb.Tabs(*tabs, name="Coordinates", active_tab=0)


def _sensor(name: str) -> rrb.Vertical:
    return rrb.Vertical(
        rrb.TimeSeriesView(
            origin=entity_path("imu", name, "specific_force"), name=f"{name}: specific force (m/s²)"
        ),
        rrb.TimeSeriesView(
            origin=entity_path("imu", name, "angular_velocity"),
            name=f"{name}: angular velocity (rad/s)",
        ),
        name=name,
    )
