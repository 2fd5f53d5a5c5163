"""Common parts of all figures: an empty one, its axes, and its PNG."""

import io
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

COLORS = ("#1f5fa8", "#d1661b", "#2a8a4a", "#b0307f", "#7a5bc0", "#8a6a1f", "#1d8a93", "#6b6b6b")
"""Distinguishable in print and by most color-blind readers; used in this order."""
TEXT = "#1c1c1c"


class NotebookFigure(Figure):
    """A figure that a notebook draws by itself, whether or not pyplot is loaded.

    Names of files, sensors and markers are drawn as they are, dollar signs included.
    """

    def draw(self, renderer: RendererBase) -> None:
        powers = _powers(self)
        for text in self.findobj(Text):
            if isinstance(text, Text) and text not in powers:
                text.set_parse_math(False)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        return png(self, dpi=110)


def _powers(figure: Figure) -> set[Text]:
    """Numbers along the axes that are formulas, the powers of ten."""
    axes = [axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]
    labels = {axis: axis.get_majorticklabels() + axis.get_minorticklabels() for axis in axes}
    return {
        label
        for axis, found in labels.items()
        for label in found
        if isinstance(axis.get_major_formatter(), LogFormatter)
        or label.get_text().startswith("$10^{")
    }


def new_figure(width: float, height: float) -> Figure:
    """Creates an empty white figure of ``width`` x ``height`` inches, bound to Agg."""
    figure = NotebookFigure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def plot_axes(figure: Figure, rows: int, columns: int = 1, *, share_x: bool = True) -> list[Axes]:
    """Adds ``rows`` x ``columns`` plots with a light grid, row by row."""
    axes = figure.subplots(rows, columns, sharex=share_x, squeeze=False).ravel().tolist()
    for ax in axes:
        plain(ax, ticks=5)
    return axes


def plain(ax: Axes, *, ticks: int | None = None) -> None:
    """Styles axes: a light grid behind the curves, no frame, small numbers.

    An axis has at most about ``ticks`` numbers, which also draws faster.
    """
    if ticks is not None:
        ax.locator_params(nbins=ticks)
    ax.grid(True, color="#dddddd", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)


def spaced(
    figure: Figure,
    axes: Sequence[Axes],
    *,
    columns: int = 1,
    start: float = 0.0,
    left: float = 0.85,
    right: float = 0.12,
    top: float = 0.38,
    bottom: float = 0.42,
    between: float = 0.12,
) -> None:
    """Places the plots of a grid by margins in inches.

    It takes one pass, where measuring all texts takes as long as drawing. The vertical axes' names
    are aligned at the left of each column, over two lines at most.

    Args:
        figure: their own.
        axes: row by row.
        columns: of the grid.
        start: where the first column begins.
        left: of each column: room for the name and the numbers of a vertical axis.
        right: of the last column.
        top: above all plots: a line of a legend, or a legend and a title.
        bottom: below all plots: numbers and name of the horizontal axis.
        between: two rows of plots.
    """
    figure.set_layout_engine("none")
    (width, height), rows = figure.get_size_inches(), len(axes) // columns
    plot_width, plot_height = (
        (width - start - left * columns - right) / columns,
        (height - top - bottom - between * (rows - 1)) / rows,
    )
    for k, ax in enumerate(axes):
        row, column = divmod(k, columns)
        x, y = (
            start + left + column * (left + plot_width),
            bottom + (rows - 1 - row) * (between + plot_height),
        )
        ax.set_position((x / width, y / height, plot_width / width, plot_height / height))
        ax.yaxis.set_label_coords((0.03 - left) / plot_width, 0.5)
        ax.yaxis.label.set_verticalalignment("top")


def picture_axes(figure: Figure, rows: int, columns: int) -> list[list[Axes]]:
    """Adds ``rows`` x ``columns`` places for pictures, without ticks."""
    grid = figure.subplots(rows, columns, squeeze=False)
    for ax in grid.ravel():
        ax.set_xticks([])
        ax.set_yticks([])
    return grid.tolist()


def at_least(ax: Axes, span: float) -> None:
    """Widens the vertical axis to ``span``, so that rounding does not look like a curve."""
    low, high = ax.get_ylim()
    if high - low < span:
        middle = 0.5 * (low + high)
        ax.set_ylim(middle - span / 2, middle + span / 2)


def png(figure: Figure, *, dpi: int = 130) -> bytes:
    """Renders the figure as a PNG; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()
