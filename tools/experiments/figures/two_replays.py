"""Draws two replays of one recording beside each other: legs seen from the front at the two frames
between which the first one's femur turns fastest, joint angles, and the turn rate of its sensors.

Usage: python -m tools.experiments.figures.two_replays BEFORE AFTER --out PICTURE.png

BEFORE and AFTER are folders that `legsim replay` wrote, of any version. The arrow at each knee is
the femur's forward axis: it shows where the knee points, which a stick does not.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from legsim.core.values import FloatArray
from legsim.figures.canvas import COLORS, new_figure, plain, png
from legsim.imu.files import load_imu
from legsim.imu.signals import ImuSignals
from legsim.mocap import opensim

ANGLES = ("hip_rotation_r", "hip_rotation_l", "knee_angle_r", "knee_angle_l")
STICK = ("femur", "tibia", "talus")
ARROW_M = 0.12


@dataclass(frozen=True, slots=True)
class Replay:
    """What one folder holds."""

    name: str
    times: FloatArray
    world_from_segment: dict[str, FloatArray]
    """(frames, 4, 4) by segment"""
    angles: dict[str, FloatArray]
    """degrees, by coordinate"""
    signals: ImuSignals


def load(folder: Path) -> Replay:
    """Reads poses, joint angles and sensors of a replay."""
    poses = np.load(folder / "poses.npz")
    motion = opensim.load(folder / "coordinates.mot")
    return Replay(
        folder.name,
        poses["times"],
        dict(zip(poses["segment_names"], poses["world_from_segment"].swapaxes(0, 1), strict=True)),
        {name: np.degrees(motion.coordinate(name)) for name in ANGLES},
        load_imu(folder / "imu.csv"),
    )


def fastest_turn(replay: Replay) -> int:
    """The frame after which a femur turns by the largest angle."""
    turns = []
    for side in "rl":
        rotations = replay.world_from_segment[f"femur_{side}"][:, :3, :3]
        trace = np.einsum("tij,tij->t", rotations[1:], rotations[:-1])
        turns.append(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    return int(np.max(turns, axis=0).argmax())


def draw_legs(ax: Axes, replay: Replay, frame: int, color: str, heading: FloatArray) -> None:
    """Both legs along ``heading``, the world's forward direction of the person, upright."""
    right = np.cross(heading, (0.0, 1.0, 0.0))
    view = np.array([-right, (0.0, 1.0, 0.0)])
    origin = replay.world_from_segment["pelvis"][0, :3, 3] * (1, 0, 1)
    for side in "rl":
        poses = [replay.world_from_segment[f"{name}_{side}"][frame] for name in STICK]
        points = np.array([view @ (pose[:3, 3] - origin) for pose in poses])
        ax.plot(*points.T, color=color, lw=2.5, marker="o", ms=4)
        tip = view @ (poses[0][:3, 0] * ARROW_M)
        ax.annotate(
            "",
            points[1] + tip,
            points[1],
            arrowprops={"arrowstyle": "-|>", "color": color, "lw": 2.0},
        )
    ax.set_aspect("equal")
    ax.set_xlim(-0.45, 0.45)
    ax.set_ylim(0, 1.05)
    ax.set_title(f"{replay.name}, {replay.times[frame]:.2f} s", fontsize=9)
    ax.set_xlabel("toward the person's left (m)", fontsize=8)
    plain(ax, ticks=4)


def main() -> None:
    """Writes the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    replays = [load(asked.before), load(asked.after)]
    frame = fastest_turn(replays[0])
    heading = replays[1].world_from_segment["pelvis"][frame, :3, 0] * (1, 0, 1)
    heading /= np.linalg.norm(heading)

    figure = new_figure(11, 7.5)
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.0, 1.1), squeeze=False).ravel()
    for ax, (which, at) in zip(
        top.subplots(1, 4, sharey=True), [(r, f) for r in (0, 1) for f in (0, 1)], strict=True
    ):
        draw_legs(ax, replays[which], frame + at, COLORS[1 - which], heading)
    axes = bottom.subplots(2, 3, sharex=True)
    for ax, name in zip(axes[:, :2].T.ravel(), ANGLES, strict=True):
        for which, replay in enumerate(replays):
            ax.plot(replay.times, replay.angles[name], color=COLORS[1 - which], lw=1.2)
        ax.set_title(f"{name} (°)", fontsize=9)
        plain(ax, ticks=4)
    for ax, sensor in zip(axes[:, 2], replays[1].signals.sensor_names[:2], strict=True):
        for which, replay in enumerate(replays):
            rate = np.degrees(np.linalg.norm(replay.signals.sensor(sensor)[0], axis=-1))
            label = f"{replay.name}: at most {rate.max():.0f} °/s"
            ax.semilogy(replay.signals.times, rate, color=COLORS[1 - which], lw=1.0, label=label)
        ax.set_title(f"{sensor}: turn rate (°/s)", fontsize=9)
        ax.set_ylim(1e-2, 1e6)  # room for the legend
        ax.legend(fontsize=7, loc="upper right")
        plain(ax)
    for ax in axes[1]:
        ax.set_xlabel("time (s)", fontsize=8)
    asked.out.write_bytes(png(figure))


if __name__ == "__main__":
    main()
