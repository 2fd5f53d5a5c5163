"""Many results in one figure: box plots over groups, heat maps over two factors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.figures.canvas import COLORS, new_figure, plot_axes


@dataclass(frozen=True, slots=True, eq=False)
class BoxGroup:
    """One box: the values of a method under a condition."""

    label: str
    """the method: its position on the axis"""
    series: str
    """the condition: its color"""
    values: FloatArray
    """(n,)"""
    published: float | None = None
    """the published mean, a diamond next to the dots"""


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """One table of numbers over two factors."""

    title: str
    """states the convention of the numbers"""
    values: FloatArray
    """(rows, columns), NaN where there is none"""
    row_labels: tuple[str, ...]
    column_labels: tuple[str, ...]


def box_plots(groups: Sequence[BoxGroup], *, axis_label: str) -> Figure:
    """Draws median, quartiles and whiskers to the 5th and 95th percentile, and all values.

    Every value is a dot.
    """
    labels = list(dict.fromkeys(group.label for group in groups))
    series = list(dict.fromkeys(group.series for group in groups))
    figure = new_figure(1.5 + 0.8 * len(labels) * max(1.0, 0.6 * len(series)), 3.6)
    ax = plot_axes(figure, 1)[0]
    width = 0.8 / len(series)
    for group in groups:
        k = series.index(group.series)
        place = labels.index(group.label) + (k - (len(series) - 1) / 2) * width
        color = COLORS[k % len(COLORS)]
        parts = ax.boxplot(
            [group.values],
            positions=[place],
            widths=0.8 * width,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
        )
        for box in parts["boxes"]:
            box.set(facecolor=color, alpha=0.35, edgecolor=color)
        for line in (*parts["medians"], *parts["whiskers"], *parts["caps"]):
            line.set(color=color)
        # spread evenly, so that equal values can be counted and the picture never changes
        ax.plot(
            place + width * 0.25 * np.linspace(-1, 1, len(group.values)),
            group.values,
            ".",
            color=color,
            markersize=4,
        )
        if group.published is not None:
            ax.plot(
                place, group.published, "D", markerfacecolor="none", color="black", markersize=5
            )
    for k, name in enumerate(series):
        ax.plot([], [], "s", color=COLORS[k % len(COLORS)], label=name)
    if any(group.published is not None for group in groups):
        ax.plot([], [], "D", markerfacecolor="none", color="black", label="published mean")
    ax.set_xticks(range(len(labels)), labels, rotation=20, ha="right", fontsize=8)
    ax.set_ylabel(axis_label, fontsize=9)
    ax.legend(fontsize=8, frameon=False)
    return figure


def heat_maps(
    maps: Sequence[HeatMap], *, row_axis: str, column_axis: str, unit: str, log: bool = True
) -> Figure:
    """Draws tables next to each other in one color scale, each number written in its cell.

    Raises:
        LegsimError: labels do not fit the numbers.
    """
    for table in maps:
        if table.values.shape != (len(table.row_labels), len(table.column_labels)):
            labels = (len(table.row_labels), len(table.column_labels))
            raise LegsimError(
                f"heat map {table.title!r} has values {table.values.shape} but labels for "
                f"{labels} rows and columns"
            )
    columns = max(len(table.column_labels) for table in maps)
    figure = new_figure(
        1.6 + len(maps) * (0.6 + 0.5 * columns),
        1.4 + 0.38 * max(len(table.row_labels) for table in maps),
    )
    axes = figure.subplots(1, len(maps), squeeze=False)[0]
    scale = _scale(np.concatenate([table.values.ravel() for table in maps]), log)
    image = None
    for ax, table in zip(axes, maps, strict=True):
        image = ax.imshow(table.values, norm=scale, cmap="viridis", aspect="auto")
        ax.set_title(table.title, fontsize=9)
        ax.set_xticks(range(len(table.column_labels)), table.column_labels, fontsize=8)
        ax.set_yticks(range(len(table.row_labels)), table.row_labels, fontsize=8)
        ax.set_xlabel(column_axis, fontsize=8)
        for (row, column), value in np.ndenumerate(table.values):
            dark = np.isfinite(value) and scale(value) < 0.55
            ax.text(
                column,
                row,
                _short(value),
                ha="center",
                va="center",
                fontsize=7,
                color="white" if dark else "black",
            )
    axes[0].set_ylabel(row_axis, fontsize=8)
    if image is not None:
        figure.colorbar(image, ax=list(axes), pad=0.01).set_label(unit, fontsize=8)
    return figure


def _scale(values: FloatArray, log: bool) -> Normalize:
    usable = values[np.isfinite(values) & ((values > 0) | (not log))]
    if len(usable) == 0:
        return Normalize(0, 1)
    low, high = float(usable.min()), float(usable.max())
    return LogNorm(low, max(high, 1.0001 * low), clip=True) if log else Normalize(low, high)


def _short(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    if value == 0 or abs(value) >= 0.01:
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.2g}"
    mantissa, _, power = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(power)}"
