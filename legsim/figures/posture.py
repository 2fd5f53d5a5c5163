"""A still picture of a replay, drawn without a viewer, a screen or a graphics driver."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.figures.canvas import TEXT, new_figure
from legsim.scene.values import ReplayScene

VIEWS = (
    ("from the front right", (1.0, 0.35, 0.75)),
    ("from the right", (0.0, 0.0, 1.0)),
    ("from the front", (1.0, 0.0, 0.0)),
)
"""title and direction towards the eye: forward, up and to the right of the subject

The subject faces along world x.
"""
BONE, JOINT, MEASURED, MODELLED = "#e6dac0", "#d98e04", "#0a78c2", "#c2185b"
GRID = 0.1  # m


def still(scene: ReplayScene, time_s: float) -> Figure:
    """Draws the body at the frame nearest to ``time_s`` from three sides.

    Bones, joint centers, markers with residuals, sensors, floor.
    """
    figure = new_figure(10.0, 5.0)
    figure.set_layout_engine("none")  # the places are known
    axes = [figure.add_axes((0.0, 0.08, 1.0, 0.83)) for _ in VIEWS]
    frame = int(np.argmin(np.abs(scene.joint_centers.times - time_s)))
    for ax, (title, towards_eye) in zip(axes, VIEWS, strict=True):
        camera = _camera(_facing(scene, frame) @ np.array(towards_eye))
        _draw_floor(ax, scene, frame, camera)
        _draw_meshes(ax, scene, frame, camera)
        _draw_skeleton(ax, scene, frame, camera)
        _draw_markers(ax, scene, frame, camera)
        _draw_sensors(ax, scene, frame, camera)
        ax.set_axis_off()
        ax.set_title(title, fontsize=9, color=TEXT)
    _to_one_scale(axes)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=5, fontsize=8, frameon=False)
    figure.suptitle(
        f"{scene.name}, {scene.joint_centers.times[frame]:.3f} s (floor lines every 10 cm)",
        fontsize=10,
        color=TEXT,
    )
    return figure


def _to_one_scale(axes: Sequence[Axes]) -> None:
    """Scales all pictures to the same height in meters.

    Their widths on paper are in proportion to their widths in meters.
    """
    for ax in axes:
        ax.autoscale_view()
        ax.set_aspect("equal", anchor="S")
    low, high = (pick(ax.get_ylim()[k] for ax in axes) for k, pick in ((0, min), (1, max)))
    widths = np.array([float(np.ptp(ax.get_xlim())) for ax in axes])
    ends = np.cumsum(widths / widths.sum())
    for ax, end, share in zip(axes, ends, widths / widths.sum(), strict=True):
        ax.set_ylim(low, high)
        box = ax.get_position()
        ax.set_position((end - share, box.y0, share, box.height))


def _facing(scene: ReplayScene, frame: int) -> FloatArray:
    """Rotation (3, 3) about the vertical from facing along world x to the pelvis's direction."""
    if "pelvis" not in scene.poses.segment_names:
        return np.eye(3)
    right = scene.poses.of("pelvis")[frame, :3, 2]
    return transforms.rotation_from_vector([0.0, float(np.arctan2(right[0], right[2])), 0.0])


def _camera(towards_eye: FloatArray) -> FloatArray:
    """Rows right, up and towards the eye (3, 3), for an orthographic picture, world y upright."""
    towards = towards_eye / np.linalg.norm(towards_eye)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _draw_floor(ax: Axes, scene: ReplayScene, frame: int, camera: FloatArray) -> None:
    centers = scene.joint_centers.positions_world[frame][:, [0, 2]]
    low, high = (
        np.floor(centers.min(0) / GRID - 1.5) * GRID,
        np.ceil(centers.max(0) / GRID + 1.5) * GRID,
    )
    xs, zs = (np.arange(a, b + GRID / 2, GRID) for a, b in zip(low, high, strict=True))
    y = scene.floor_height
    lines = [[[x, y, low[1]], [x, y, high[1]]] for x in xs] + [
        [[low[0], y, z], [high[0], y, z]] for z in zs
    ]
    ax.add_collection(
        LineCollection(
            list((np.array(lines) @ camera.T)[..., :2]), colors="#c4c8cc", linewidths=0.6, zorder=0
        )
    )


def _draw_meshes(ax: Axes, scene: ReplayScene, frame: int, camera: FloatArray) -> None:
    """Draws the triangles that face the eye from far to near, shaded by their angle."""
    if not scene.segment_meshes:
        return
    corners = (
        np.concatenate(
            [
                transforms.apply(scene.poses.of(mesh.segment)[frame], mesh.vertices)[mesh.triangles]
                for mesh in scene.segment_meshes
            ]
        )
        @ camera.T
    )
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals[:, 2] > 0
    corners, normals = corners[facing], normals[facing]
    nearer = np.argsort(corners[:, :, 2].mean(-1))
    light = 0.45 + 0.55 * (
        normals @ np.array([-0.3, 0.5, 0.81]) / np.linalg.norm(normals, axis=-1)
    ).clip(0, 1)
    colors = light[:, None] * np.array([230, 218, 192]) / 255
    # the annotation asks for a list, but an array is converted to paths at once
    outlines: Any = corners[nearer][..., :2]
    bones = PolyCollection(
        outlines, facecolors=colors[nearer], edgecolors=colors[nearer], linewidths=0.2, zorder=1
    )
    ax.add_collection(bones, autolim=False)
    ax.update_datalim(outlines.reshape(-1, 2))


def _draw_skeleton(ax: Axes, scene: ReplayScene, frame: int, camera: FloatArray) -> None:
    places = scene.joint_centers.positions_world[frame] @ camera.T
    lines = (scene.bone_lines()[frame] @ camera.T)[..., :2]
    ax.add_collection(
        LineCollection(
            list(lines), colors="#8d7b53", linewidths=1.4, zorder=2, label="between joints"
        )
    )
    ax.plot(
        places[:, 0], places[:, 1], "o", color=JOINT, markersize=5, zorder=3, label="joint center"
    )


def _draw_markers(ax: Axes, scene: ReplayScene, frame: int, camera: FloatArray) -> None:
    if scene.measured is None:
        return
    at = int(np.argmin(np.abs(scene.measured.times - scene.joint_centers.times[frame])))
    measured = scene.measured.positions_world[at] @ camera.T
    if scene.modelled is not None:
        modelled = scene.modelled.positions_world[at] @ camera.T
        lines = np.stack([measured, modelled], 1)[np.isfinite(measured).all(-1), :, :2]
        ax.add_collection(LineCollection(list(lines), colors="#444444", linewidths=0.8, zorder=4))
        ax.plot(
            modelled[:, 0],
            modelled[:, 1],
            "o",
            color=MODELLED,
            markersize=3.2,
            zorder=4,
            label="marker on the model",
        )
    ax.plot(
        measured[:, 0],
        measured[:, 1],
        "o",
        color=MEASURED,
        markersize=3.2,
        zorder=5,
        label="measured marker",
    )


def _draw_sensors(ax: Axes, scene: ReplayScene, frame: int, camera: FloatArray) -> None:
    if scene.sensor_poses is None:
        return
    at = int(np.argmin(np.abs(scene.sensor_poses.times - scene.joint_centers.times[frame])))
    for k, pose in enumerate(scene.sensor_poses.world_from_segment[at]):
        origin = camera @ pose[:3, 3]
        ax.plot(
            origin[0],
            origin[1],
            "s",
            color="#2a8a4a",
            markersize=5,
            zorder=6,
            label="sensor (x red, y green, z blue)" if k == 0 else None,
        )
        for axis, color in zip(pose[:3, :3].T, ("#d43a3a", "#2f9e44", "#2f6fe0"), strict=True):
            tip = camera @ (pose[:3, 3] + 0.07 * axis)
            ax.plot([origin[0], tip[0]], [origin[1], tip[1]], color=color, linewidth=1.2, zorder=6)
