"""Curves over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.deformation.models import Motion, RigidMotion
from legsim.figures.canvas import COLORS, at_least, new_figure, plain, plot_axes, spaced
from legsim.imu.comparison import SensorComparison
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import JointCenters
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories
from legsim.scene.values import ReplayScene

_TITLE = 0.18
"""inches of a line of title"""


def joint_angles(trajectories: JointTrajectories, names: Sequence[str]) -> Figure:
    """Plots coordinates ``names`` in degrees over time, right and left of a kind in one plot."""
    chosen = list(names)
    kinds = list(dict.fromkeys(_kind(name) for name in chosen))
    columns = 2 if len(kinds) > 3 else 1
    rows = -(-len(kinds) // columns)
    figure = new_figure(8.0, 0.6 + 1.35 * rows)
    axes = plot_axes(figure, rows, columns)
    for ax, kind in zip(axes, kinds, strict=False):
        for name in (n for n in chosen if _kind(n) == kind):
            style = (COLORS[1], "--") if name.endswith("_l") else (COLORS[0], "-")
            values = np.rad2deg(trajectories.coordinate(name))
            ax.plot(
                trajectories.times,
                values,
                color=style[0],
                linestyle=style[1],
                linewidth=1,
                label=name,
            )
        ax.set_ylabel(f"{kind}\ndeg", fontsize=8)
        at_least(ax, 1.0)
    for ax in axes[len(kinds) :]:
        ax.set_axis_off()
    right_and_left = [
        next(
            (line for ax in axes for line in ax.lines if str(line.get_label()).endswith(end)), None
        )
        for end in ("_r", "_l")
    ]
    room = _legend(
        figure,
        [
            (line, word)
            for line, word in zip(right_and_left, ("right", "left"), strict=True)
            if line
        ],
    )
    _time_axis(axes[: len(kinds)][-columns:])
    spaced(figure, axes, columns=columns, top=room)
    return figure


def imu_curves(imu: ImuSignals) -> Figure:
    """Plots specific force and angular velocity of each sensor, in its own axes."""
    figure = new_figure(8.0, 0.5 + 1.6 * len(imu.sensor_names))
    axes = plot_axes(figure, len(imu.sensor_names), 2)
    for row, name in enumerate(imu.sensor_names):
        angular_velocity, specific_force = imu.sensor(name)
        for ax, values, unit in (
            (axes[2 * row], specific_force, "m/s²"),
            (axes[2 * row + 1], np.rad2deg(angular_velocity), "deg/s"),
        ):
            for k, axis in enumerate("xyz"):
                ax.plot(
                    imu.times,
                    values[:, k],
                    color=(COLORS[3], COLORS[2], COLORS[0])[k],
                    linewidth=0.8,
                    label=axis,
                )
            ax.set_ylabel(f"{name}\n{unit}", fontsize=8)
    axes[0].set_title("specific force", fontsize=9)
    axes[1].set_title("angular velocity", fontsize=9)
    _time_axis(axes[-2:])
    room = _legend(figure, [(line, str(line.get_label())) for line in axes[0].lines])
    spaced(figure, axes, columns=2, top=room + _TITLE)
    return figure


def sway(centers: JointCenters, names: Sequence[str] = ()) -> Figure:
    """Plots how far joint centers deviate from their mean: forward, up and right, in mm.

    The path seen from above is next to it.
    """
    chosen = tuple(names) or tuple(
        n for n in centers.names if n.startswith(("hip", "knee", "ankle"))
    )
    figure = new_figure(8.0, 4.6)
    over_time, above = plot_axes(figure, 3), figure.add_subplot()
    plain(above, ticks=5)
    kinds = list(dict.fromkeys(_kind(name) for name in chosen))
    for name in chosen:
        place = centers.positions_world[:, centers.names.index(name)]
        away = 1e3 * (place - place.mean(0))
        color, line = (
            COLORS[kinds.index(_kind(name)) % len(COLORS)],
            "--" if name.endswith("_l") else "-",
        )
        for ax, values in zip(over_time, away.T, strict=True):
            ax.plot(centers.times, values, color=color, linestyle=line, linewidth=0.9, label=name)
        above.plot(away[:, 2], away[:, 0], color=color, linestyle=line, linewidth=0.7, label=name)
    for ax, label in zip(over_time, ("forward", "up", "to the right"), strict=True):
        ax.set_ylabel(f"{label} (mm)", fontsize=8)
        at_least(ax, 1.0)
    _time_axis(over_time[-1:])
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("to the right (mm)", fontsize=8)
    above.set_ylabel("forward (mm)", fontsize=8)
    above.set_title("from above", fontsize=9)
    room = _legend(figure, [(line, str(line.get_label())) for line in above.lines])
    spaced(figure, over_time, left=0.65, right=3.45, top=room + _TITLE)
    spaced(figure, [above], start=4.6, left=0.65, top=room + _TITLE)
    return figure


def marker_residuals(scene: ReplayScene) -> Figure:
    """Plots the distance between measured and modeled markers.

    RMS and worst over time, and the spread of each marker.
    """
    figure = new_figure(8.0, 4.8)
    over_time, each = plot_axes(figure, 2, share_x=False)
    residuals = scene.marker_residuals()
    if residuals is None or scene.measured is None:
        over_time.text(0.5, 0.5, "no markers", transform=over_time.transAxes, ha="center")
        return figure
    seen = np.isfinite(residuals).any(-1)
    millimeters = 1e3 * residuals
    rms = np.sqrt(np.nanmean(millimeters[seen] ** 2, -1))
    over_time.plot(
        scene.measured.times[seen],
        np.nanmax(millimeters[seen], -1),
        color=COLORS[1],
        linewidth=0.7,
        label="worst marker",
    )
    over_time.plot(
        scene.measured.times[seen], rms, color=COLORS[0], linewidth=1.0, label="RMS of all markers"
    )
    over_time.set_ylabel("residual (mm)", fontsize=8)
    over_time.set_ylim(bottom=0)
    room = _legend(figure, [(line, str(line.get_label())) for line in over_time.lines])
    _time_axis([over_time])
    longest = max(len(name) for name in scene.measured.marker_names)
    spaced(
        figure, [over_time, each], left=0.65, top=room, between=0.5, bottom=0.25 + 0.048 * longest
    )
    spread = [column[np.isfinite(column)] for column in millimeters.T]
    each.boxplot(spread, whis=(5, 95), showfliers=False, medianprops={"color": COLORS[0]})
    each.set_xticklabels(scene.measured.marker_names, rotation=60, ha="right", fontsize=7)
    each.set_ylabel("residual (mm)", fontsize=8)
    each.set_ylim(bottom=0)
    return figure


def motion_errors(
    truth: RigidMotion, estimates: Sequence[tuple[str, RigidMotion]], point: FloatArray
) -> Figure:
    """Plots errors of each (name, estimate) over time.

    They are the position error of ``point`` (3,) world m, in mm, and the rotation error, in
    degrees.
    """
    figure = new_figure(8.0, 3.8)
    distance, angle = plot_axes(figure, 2)
    for k, (name, estimate) in enumerate(estimates):
        difference = transforms.inverse(truth.moved_from_reference) @ estimate.moved_from_reference
        moved = (estimate.moved_from_reference - truth.moved_from_reference)[:, :3] @ np.append(
            point, 1.0
        )
        turned = np.rad2deg(transforms.rotation_angle(difference[:, :3, :3]))
        distance.plot(
            truth.times,
            1e3 * np.linalg.norm(moved, axis=-1),
            color=COLORS[k % len(COLORS)],
            linewidth=1,
            label=name,
        )
        angle.plot(truth.times, turned, color=COLORS[k % len(COLORS)], linewidth=1)
    at_least(distance, 0.01)
    at_least(angle, 0.001)
    distance.set_ylabel("position error (mm)", fontsize=8)
    angle.set_ylabel("rotation error (deg)", fontsize=8)
    room = _legend(figure, [(line, str(line.get_label())) for line in distance.lines])
    _time_axis([angle])
    spaced(figure, [distance, angle], left=0.65, top=room)
    return figure


def motion_paths(motions: Sequence[tuple[str, Motion]], point: FloatArray) -> Figure:
    """Plots where each (name, motion) carries ``point`` (3,) world m: forward, up and right, mm."""
    figure = new_figure(8.0, 4.2)
    axes = plot_axes(figure, 3)
    for k, (name, motion) in enumerate(motions):
        away = 1e3 * (motion.carry(point[None])[:, 0] - point)
        for ax, values in zip(axes, away.T, strict=True):
            ax.plot(motion.times, values, color=COLORS[k % len(COLORS)], linewidth=1, label=name)
    for ax, label in zip(axes, ("x (mm)", "y, up (mm)", "z (mm)"), strict=True):
        ax.set_ylabel(label, fontsize=8)
        at_least(ax, 0.1)
    room = _legend(figure, [(line, str(line.get_label())) for line in axes[0].lines])
    _time_axis(axes[-1:])
    spaced(figure, axes, left=0.65, top=room)
    return figure


def imu_comparison(compared: Sequence[SensorComparison]) -> Figure:
    """Plots measured and predicted angular velocity of each sensor up to 6 Hz, axis by axis."""
    figure = new_figure(8.0, 0.8 + 1.5 * len(compared))
    axes = plot_axes(figure, len(compared), 3)
    for row, one in enumerate(compared):
        for k, axis in enumerate("xyz"):
            ax = axes[3 * row + k]
            for color, recording, label in (
                (COLORS[1], one.measured, "measured"),
                (COLORS[0], one.predicted, "predicted from the markers"),
            ):
                rate = low_pass(recording.angular_velocity[:, k : k + 1], recording.rate_hz, 6.0)
                ax.plot(recording.times, np.degrees(rate), color=color, linewidth=0.8, label=label)
            ax.set_title(f"{one.measured.name}, {axis}", fontsize=8)
        axes[3 * row].set_ylabel("deg/s", fontsize=8)
    _time_axis(axes[-3:])
    room = _legend(figure, [(line, str(line.get_label())) for line in axes[0].lines])
    spaced(figure, axes, columns=3, left=0.55, top=room + _TITLE, between=0.3)
    return figure


def _kind(name: str) -> str:
    return name.removesuffix("_r").removesuffix("_l")


def _legend(figure: Figure, entries: Sequence[tuple[Line2D, str]]) -> float:
    """Adds one legend for all plots above them; returns its height in inches.

    It hides no curve there.
    """
    lines, words = zip(*entries, strict=True) if entries else ((), ())
    figure.legend(
        lines, words, loc="upper center", ncols=min(len(words), 6) or 1, fontsize=8, frameon=False
    )
    return 0.2 + 0.17 * -(-len(words) // 6)


def _time_axis(axes: Sequence[Axes]) -> None:
    for ax in axes:
        ax.set_xlabel("time (s)", fontsize=8)
