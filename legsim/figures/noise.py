"""Errors over the factor by which sensor noise is divided, in double-logarithmic plots."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from legsim.core.values import FloatArray
from legsim.figures.canvas import COLORS, new_figure, plot_axes


@dataclass(frozen=True, slots=True, eq=False)
class ErrorLine:
    """One curve."""

    label: str
    """the convention of the numbers, or their source"""
    exponents: FloatArray
    """(n,): the noise is divided by ten to these powers"""
    values: FloatArray
    """(n,), in the panel's unit; zeros are not drawn"""
    published: bool = False
    """markers only, in black"""


@dataclass(frozen=True, slots=True, eq=False)
class ErrorPanel:
    """One plot: a kind of error under a kind of noise."""

    title: str
    axis_label: str
    limit: float
    """drawn as a horizontal line"""
    lines: tuple[ErrorLine, ...]


def error_lines(panels: Sequence[ErrorPanel], *, columns: int = 2) -> Figure:
    """Plots the panels row by row; those of equal axis label share their vertical scale."""
    rows = -(-len(panels) // columns)
    figure = new_figure(3.7 * columns + 0.4, 2.6 * rows + 0.5)
    axes = plot_axes(figure, rows, columns, share_x=False)
    for ax, panel in zip(axes, panels, strict=False):
        _draw(ax, panel)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for kind in {panel.axis_label for panel in panels}:
        alike = [ax for ax, panel in zip(axes, panels, strict=False) if panel.axis_label == kind]
        low, high = min(ax.get_ylim()[0] for ax in alike), max(ax.get_ylim()[1] for ax in alike)
        for ax in alike:
            ax.set_ylim(low, high)
    handles = {
        str(h.get_label()): h
        for ax in axes[: len(panels)]
        for h in ax.lines
        if not str(h.get_label()).startswith("_")
    }
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside upper center",
        ncols=len(handles),
        fontsize=8,
        frameon=False,
    )
    return figure


def _draw(ax: Axes, panel: ErrorPanel) -> None:
    ours = 0
    for line in panel.lines:
        drawn = np.where(line.values > 0, line.values, np.nan)
        if line.published:
            ax.plot(
                line.exponents,
                drawn,
                linestyle="none",
                marker="D",
                markersize=5,
                markerfacecolor="none",
                color="black",
                label=line.label,
            )
        else:
            ax.plot(
                line.exponents,
                drawn,
                marker="o",
                markersize=3,
                linewidth=1.2,
                color=COLORS[ours % len(COLORS)],
                label=line.label,
            )
            ours += 1
    ax.axhline(panel.limit, color="#444444", linestyle="--", linewidth=0.9)
    unit = panel.axis_label.partition("(")[2].removesuffix(")")
    ax.annotate(
        f"{panel.limit:g} {unit}",
        (1, panel.limit),
        xycoords=("axes fraction", "data"),
        fontsize=7,
        ha="right",
        va="bottom",
    )
    ax.set_yscale("log")
    ax.minorticks_off()
    ax.set_title(panel.title, fontsize=9)
    ax.set_ylabel(panel.axis_label, fontsize=8)
    ticks = sorted({float(x) for line in panel.lines for x in line.exponents})
    ax.set_xticks(ticks, [f"$10^{{{x:g}}}$" for x in ticks])
    ax.set_xlabel("noise divided by", fontsize=8)
