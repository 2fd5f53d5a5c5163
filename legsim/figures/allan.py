"""Allan deviations of sensors at rest, beside the points of their data sheets."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from legsim.core.values import FloatArray
from legsim.figures.canvas import COLORS, new_figure, plot_axes


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan deviation of one sensor over the averaging time, and what its data sheet states."""

    label: str
    seconds: FloatArray
    """(n,) averaging times"""
    deviation: FloatArray
    """(n,) in the panel's unit"""
    noise: float | None
    """unit at 1 s, from the noise density: density / sqrt(2); None where it is not stated"""
    instability: float | None
    """unit, the lowest Allan deviation; None where it is not stated"""


@dataclass(frozen=True, slots=True, eq=False)
class AllanPanel:
    """One plot: the curves of one kind of sensor."""

    title: str
    unit: str
    curves: tuple[AllanCurve, ...]


def allan_deviations(panels: Sequence[AllanPanel]) -> Figure:
    """Plots the panels side by side, double-logarithmic.

    A circle is the stated noise at 1 s, a dashed line the stated instability.
    """
    figure = new_figure(4.2 * len(panels) + 0.3, 3.6)
    for ax, panel in zip(plot_axes(figure, 1, len(panels)), panels, strict=True):
        _draw(ax, panel)
    return figure


def _draw(ax: Axes, panel: AllanPanel) -> None:
    for k, curve in enumerate(panel.curves):
        color = COLORS[k % len(COLORS)]
        ax.plot(curve.seconds, curve.deviation, color=color, linewidth=1.3, label=curve.label)
        if curve.noise is not None:
            ax.plot([1.0], [curve.noise], color=color, marker="o", markerfacecolor="white")
        if curve.instability is not None:
            ax.axhline(curve.instability, color=color, linestyle="--", linewidth=0.9)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_title(panel.title, fontsize=9)
    ax.set_xlabel("averaging time (s)", fontsize=8)
    ax.set_ylabel(f"Allan deviation ({panel.unit})", fontsize=8)
    ax.legend(fontsize=8, frameon=False)
