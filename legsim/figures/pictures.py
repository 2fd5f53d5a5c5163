"""Pictures of volumes and projections, with the sides of the body written next to them."""

from collections.abc import Sequence

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from skimage import measure

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.figures.canvas import TEXT, new_figure, picture_axes
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.scene.slices import VolumeSlices

AXIAL = (
    "A",
    "P",
    "R",
    "L",
)  # above, below, left, right of the picture: anterior, posterior, the subject's right and left
SAGITTAL = ("S", "I", "A", "P")  # superior, inferior, anterior, posterior


def slices(
    shown: Sequence[VolumeSlices],
    *,
    window_per_mm: tuple[float, float] | None = None,
) -> Figure:
    """Draws slices of volumes: one column per method, one gray window for all.

    Rows: axial through the shank, axial through the thigh, sagittal. ``window_per_mm`` is (black,
    white) in 1/mm; by default from 0 to the first volume's :func:`legsim.scene.slices.white_level`.
    """
    low, high = window_per_mm or (0.0, 1e-3 * shown[0].white)
    figure = new_figure(1.2 + 1.9 * len(shown), 6.6)
    axes = picture_axes(figure, 3, len(shown))
    image = None
    for column, one in enumerate(shown):
        axes[0][column].set_title(one.name, fontsize=10, color=TEXT)
        rows = (
            (one.shank, _extent_axial(one.grid), AXIAL),
            (one.thigh, _extent_axial(one.grid), AXIAL),
            (one.sagittal, _extent_sagittal(one.grid), SAGITTAL),
        )
        for row, (values, extent, sides) in enumerate(rows):
            ax = axes[row][column]
            image = ax.imshow(
                1e-3 * values,
                cmap="gray",
                vmin=low,
                vmax=high,
                origin="lower",
                extent=extent,
                interpolation="nearest",
            )
            _write_sides(ax, sides)
    planes = shown[0].planes
    heights = (
        f"axial, shank\ny = {1e3 * planes.shank_y:.0f} mm",
        f"axial, thigh\ny = {1e3 * planes.thigh_y:.0f} mm",
    )
    for row, label in enumerate((*heights, f"sagittal\nz = {1e3 * planes.sagittal_z:.0f} mm")):
        axes[row][0].set_ylabel(label, fontsize=9, color=TEXT)
    _scale_bar(axes[2][0], 50)
    if image is not None:
        bar = figure.colorbar(image, ax=[ax for row in axes for ax in row], shrink=0.6, pad=0.01)
        bar.set_label("attenuation (1/mm)", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return figure


def overlay(
    reference: VolumeSlices,
    shown: Sequence[VolumeSlices],
    *,
    width_mm: float = 60.0,
) -> Figure:
    """Draws the motion-free reference in red and each method in green.

    Yellow where they agree, a red or green rim where they do not. Columns are methods. Rows: the
    whole axial slice through the thigh, then ``width_mm`` wide details of it around the densest
    part (the femur) and around the skin in front.

    Raises:
        LegsimError: a volume lies on another grid than the reference.
    """
    for one in shown:
        if one.grid != reference.grid:
            raise LegsimError(
                f"volume {one.name!r} lies on another grid than {reference.name!r}; reconstruct "
                "both on the same one"
            )
    extent, white = _extent_axial(reference.grid), reference.white
    red = np.clip(reference.thigh / white, 0, 1)
    details: list[tuple[float, float] | None] = [None, *_details(red, extent)]
    figure = new_figure(0.8 + 2.1 * len(shown), 6.6)
    axes = picture_axes(figure, 3, len(shown))
    for column, one in enumerate(shown):
        green = np.clip(one.thigh / white, 0, 1)
        colored = np.stack([red, green, np.zeros_like(red)], -1)
        for row, window in enumerate(details):
            ax = axes[row][column]
            ax.imshow(colored, origin="lower", extent=extent, interpolation="nearest")
            if window is not None:
                ax.set_xlim(window[0] - width_mm / 2, window[0] + width_mm / 2)
                ax.set_ylim(window[1] - width_mm / 2, window[1] + width_mm / 2)
            _write_sides(ax, AXIAL)
        axes[0][column].set_title(one.name, fontsize=10, color=TEXT)
    for row, label in enumerate(
        (f"axial, thigh\ny = {1e3 * reference.planes.thigh_y:.0f} mm", "femur", "skin in front")
    ):
        axes[row][0].set_ylabel(label, fontsize=9, color=TEXT)
    figure.supxlabel(f"red: {reference.name} only, green: method only, yellow: both", fontsize=9)
    return figure


def projection_montage(projections: Projections, *, count: int = 8) -> Figure:
    """Draws ``count`` projections spread over the scan, upright, in one gray window."""
    chosen = np.unique(np.linspace(0, len(projections.geometry) - 1, count).round().astype(int))
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = new_figure(1.0 + 2.2 * columns, 0.4 + 2.0 * rows)
    axes = [ax for row in picture_axes(figure, rows, columns) for ax in row]
    images = projections.line_integrals[chosen]
    top = float(np.percentile(images, 99.9)) or 1.0
    shown = None
    for ax, view, image in zip(axes, chosen, images, strict=False):
        shown = ax.imshow(
            image, cmap="gray", vmin=0, vmax=top, origin="lower", interpolation="nearest"
        )
        ax.set_title(
            f"view {view + 1}, {projections.geometry.times[view]:.2f} s", fontsize=8, color=TEXT
        )
    for ax in axes[len(chosen) :]:
        ax.set_axis_off()
    if shown is not None:
        bar = figure.colorbar(shown, ax=axes, shrink=0.7, pad=0.01)
        bar.set_label("line integral (no unit)", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return figure


def _extent_axial(grid: VolumeGrid) -> tuple[float, float, float, float]:
    """Extent (left, right, bottom, top) in mm of the axial picture.

    The axis z falls to the right, x rises upwards.
    """
    x, _, z = grid.axes()
    dx, _, dz = grid.spacing_xyz
    return (
        1e3 * (z[-1] + dz / 2),
        1e3 * (z[0] - dz / 2),
        1e3 * (x[0] - dx / 2),
        1e3 * (x[-1] + dx / 2),
    )


def _extent_sagittal(grid: VolumeGrid) -> tuple[float, float, float, float]:
    x, y, _ = grid.axes()
    dx, dy, _ = grid.spacing_xyz
    return (
        1e3 * (x[-1] + dx / 2),
        1e3 * (x[0] - dx / 2),
        1e3 * (y[0] - dy / 2),
        1e3 * (y[-1] + dy / 2),
    )


def _write_sides(ax: Axes, sides: tuple[str, str, str, str]) -> None:
    places = (
        (0.5, 0.97, "center", "top"),
        (0.5, 0.03, "center", "bottom"),
        (0.03, 0.5, "left", "center"),
        (0.97, 0.5, "right", "center"),
    )
    for text, (x, y, horizontal, vertical) in zip(sides, places, strict=True):
        written = ax.text(
            x,
            y,
            text,
            transform=ax.transAxes,
            ha=horizontal,
            va=vertical,
            color="#ffd75e",
            fontsize=7,
            # thin strokes of L and I may fall between two pixels
            fontweight="bold",
        )
        written.set_path_effects([patheffects.withStroke(linewidth=1.5, foreground="black")])


def _scale_bar(ax: Axes, length_mm: float) -> None:
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    length = min(length_mm, 10 * max(1, round(abs(right - left) / 40)))
    start, height = left + 0.06 * (right - left), bottom + 0.07 * (top - bottom)
    ax.plot(
        [start, start + np.sign(right - left) * length],
        [height, height],
        color="white",
        linewidth=2,
    )
    ax.text(
        start,
        height + 0.02 * (top - bottom),
        f"{length:g} mm",
        color="white",
        fontsize=7,
        va="bottom",
    )


def _details(
    red: Float32Array, extent: tuple[float, float, float, float]
) -> list[tuple[float, float]]:
    """Centers (horizontal, vertical) in mm of the two details.

    The largest dense part, and where the tissue ends in front of it.
    """
    rows, columns = red.shape
    parts = np.asarray(measure.label(red > 0.75 * red.max()))
    sizes = np.bincount(parts.ravel(), minlength=2)
    sizes[0] = 0
    row, column = np.argwhere(parts == int(np.argmax(sizes))).mean(0)
    tissue = np.flatnonzero(red[:, round(column)] > 0.15)
    front = int(tissue.max()) if len(tissue) else rows - 1
    step_u, step_v = (extent[1] - extent[0]) / columns, (extent[3] - extent[2]) / rows
    place_u = extent[0] + (column + 0.5) * step_u
    return [
        (place_u, extent[2] + (row + 0.5) * step_v),
        (place_u, extent[2] + (front + 0.5) * step_v),
    ]
