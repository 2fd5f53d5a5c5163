"""Draws the leg phantom for the documentation: slices through the knee and the leg at several
flexions.

Usage: python -m tools.experiments.figures.phantom [--detail fine] [--out docs/images]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from legsim.kinematics.skeleton import SEGMENTS
from legsim.phantom import leg_phantom
from legsim.phantom.leg_phantom import LegPhantom

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from tools.leg_phantom.fields import Array
from tools.leg_phantom.motion import leg_poses

FOLDER = Path(__file__).parents[3] / "docs/images"
AXES = "xyz"


def flexed(degrees: float, *, hip_degrees: float = 0.0) -> Array:
    """world_from_segment (13, 4, 4) with both knees flexed by ``degrees`` and both hips by
    ``hip_degrees``.
    """
    return leg_poses(
        np.radians([degrees]), hip_flexion=float(np.radians(hip_degrees))
    ).world_from_segment[0]


def crossing_segments(vertices: Array, triangles: np.ndarray, axis: int, position: float) -> Array:
    """Segments (n, 2, 2) in which a plane across ``axis`` cuts a mesh, in the two other
    coordinates.
    """
    side = vertices[:, axis] > position
    cut = triangles[np.isin(side[triangles].sum(1), (1, 2))]
    others = [k for k in range(3) if k != axis]
    alone = side[cut].sum(1) == 1
    lone = np.argmax(side[cut] == alone[:, None], axis=1)
    apex = np.take_along_axis(cut, lone[:, None], 1)
    ends = [np.take_along_axis(cut, ((lone + k) % 3)[:, None], 1) for k in (1, 2)]
    points = []
    for end in ends:
        a, b = vertices[apex[:, 0]], vertices[end[:, 0]]
        t = (position - a[:, axis]) / (b[:, axis] - a[:, axis])
        points.append((a + t[:, None] * (b - a))[:, others])
    return np.stack(points, 1)


def inside(segments: Array, columns: Array, rows: Array) -> np.ndarray:
    """Even-odd inside test (rows, columns) of an outline given as segments (n, 2, 2) of (column,
    row) positions.
    """
    flips = np.zeros((len(rows), len(columns) + 1), int)
    low, high = segments[..., 1].min(1), segments[..., 1].max(1)
    for k, row in enumerate(rows):
        hit = segments[(low <= row) & (high > row)]
        a, b = hit[:, 0], hit[:, 1]
        at = a[:, 0] + (row - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        flips[k] += np.bincount(np.searchsorted(columns, at), minlength=len(columns) + 1)
    return np.cumsum(flips, axis=1)[:, :-1] % 2 == 1


def slice_image(
    phantom: LegPhantom,
    vertices: Sequence[Array],
    axis: int,
    position: float,
    low: Sequence[float],
    high: Sequence[float],
    step: float,
) -> Array:
    """Attenuation in 1/m on a plane across ``axis``; rows are the later of the two other
    coordinates, upwards.
    """
    columns, rows = (np.arange(lo, hi, step) for lo, hi in zip(low, high, strict=True))
    image = np.zeros((len(rows), len(columns)))
    for part, moved in zip(phantom.phantom.parts, vertices, strict=True):
        segments = crossing_segments(np.asarray(moved), part.triangles, axis, position)
        if len(segments):
            image[inside(segments, columns, rows)] = part.attenuation
    return image


def draw_slices(
    phantom: LegPhantom,
    vertices: Sequence[Array],
    path: Path,
    planes: Sequence[tuple[int, float]],
    around: Array,
    half: float,
) -> None:
    """Pictures of several planes, (axis, offset from ``around``), in gray like a scan."""
    figure, frames = plt.subplots(
        2,
        (len(planes) + 1) // 2,
        figsize=(4.1 * ((len(planes) + 1) // 2), 8.8),
        layout="constrained",
    )
    for frame in frames.flat:
        frame.axis("off")
    for (axis, offset), frame in zip(planes, frames.flat, strict=False):
        others = [k for k in range(3) if k != axis]
        low, high = [around[k] - half for k in others], [around[k] + half for k in others]
        image = slice_image(phantom, vertices, axis, around[axis] + offset, low, high, 0.0004)
        if axis == 0:  # rows upwards: transpose so that y is vertical
            image = image.T
        frame.imshow(
            image, cmap="gray", origin="lower", vmin=14, vmax=45, extent=(-half, half, -half, half)
        )
        name = {0: "coronal", 1: "axial", 2: "sagittal"}[axis]
        frame.set_title(f"{name}, {AXES[axis]} {offset * 1e3:+.0f} mm", fontsize=10)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def draw_poses(phantom: LegPhantom, path: Path, angles: Sequence[float]) -> None:
    """The right leg from its side at several flexions: the bones, shaded, in front of a pale
    skin.
    """
    figure, frames = plt.subplots(1, len(angles), figsize=(4.2 * len(angles), 7))
    for angle, frame in zip(angles, frames.flat, strict=True):
        vertices = phantom.posed(flexed(angle, hip_degrees=0.5 * angle), SEGMENTS)
        for part, moved in zip(phantom.phantom.parts, vertices, strict=True):
            if part.name.endswith("_r") and (
                part.name.startswith("skin") or part.material in ("cortical_bone", "cartilage")
            ):
                _shade(frame, np.asarray(moved), part.triangles, pale=part.name.startswith("skin"))
        frame.set_title(f"{angle:g}° of flexion")
        frame.set_aspect("equal")
        frame.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=60)
    plt.close(figure)


def _shade(frame: Axes, vertices: Array, triangles: np.ndarray, *, pale: bool) -> None:
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-20
    front = np.flatnonzero(normal[:, 2] > 0)
    front = front[np.argsort(corners[front, :, 2].mean(1))]
    shade = 0.35 + 0.6 * np.clip(normal[front] @ np.array([0.4, 0.4, 0.82]), 0, 1)
    colors = shade[:, None] * np.array([1.0, 0.98, 0.9])
    if pale:
        colors = 0.75 + 0.25 * shade[:, None] * np.array([0.85, 0.65, 0.55])
    # edges of the face's color close the seams that antialiasing leaves between neighbors
    frame.add_collection(
        PolyCollection(
            list(corners[front][:, :, :2]), facecolors=colors, edgecolors="face", linewidths=0.3
        )
    )
    frame.autoscale_view()


def main() -> None:
    """Writes phantom_slices.png, phantom_slices_60.png and phantom_poses.png."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--detail", choices=("coarse", "fine"), default="fine")
    parser.add_argument("--out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    phantom = leg_phantom.load_leg_phantom(detail=arguments.detail)
    upright = [(2, 0.0), (2, 0.024), (2, -0.024), (0, -0.012)]
    # axial planes of the bent knee that do not pass below it
    for degrees, lowest in ((0, -0.08), (60, 0.03)):
        planes = [(1, 0.004), (1, -0.018), (1, -0.042), (1, lowest), *upright]
        poses = flexed(degrees)
        knee = poses[SEGMENTS.index("tibia_r"), :3, 3]
        name = "phantom_slices.png" if degrees == 0 else f"phantom_slices_{degrees}.png"
        draw_slices(
            phantom, phantom.posed(poses, SEGMENTS), arguments.out / name, planes, knee, 0.085
        )
    draw_poses(phantom, arguments.out / "phantom_poses.png", (0, 30, 60, 100))


if __name__ == "__main__":
    main()
