"""Box plots and heat maps show their numbers."""

from dataclasses import replace

import numpy as np
import pytest

from legsim import figures
from legsim.core.errors import LegsimError
from legsim.figures import BoxGroup, HeatMap


def test_heat_maps_write_their_numbers_in_one_scale():
    tables = [
        HeatMap(title, factor * np.array([[1.0, 250.0], [0.0, np.nan]]), ("a", "b"), ("0", "1"))
        for title, factor in (("SI", 1.0), ("paper", 100.0))
    ]
    figure = figures.heat_maps(tables, row_axis="f_a", column_axis="f_g", unit="mm")
    assert [t.get_text() for t in figure.axes[0].texts] == ["1", "250", "0", "–"]
    assert (
        figure.axes[0].images[0].get_clim() == figure.axes[1].images[0].get_clim() == (1.0, 25000.0)
    )
    with pytest.raises(LegsimError, match="labels for"):
        figures.heat_maps(
            [replace(tables[0], row_labels=("a",))], row_axis="", column_axis="", unit=""
        )


def test_small_numbers_of_heat_maps_fit_their_cells():
    table = HeatMap("SI", np.array([[0.0123, 0.00123, 1.5e-5]]), ("a",), ("0", "1", "2"))
    figure = figures.heat_maps([table], row_axis="", column_axis="", unit="mm")
    assert [t.get_text() for t in figure.axes[0].texts] == ["0.012", "1.2e-3", "1.5e-5"]


def test_boxes_carry_the_published_mean():
    groups = [
        BoxGroup("rigid", "30", np.array([0.9, 1.0]), 0.993),
        BoxGroup("rigid", "60", np.array([0.8, 0.9])),
    ]
    figure = figures.box_plots(groups, axis_label="SSIM")
    diamonds = [
        np.asarray(line.get_ydata())
        for line in figure.axes[0].lines
        if line.get_marker() == "D" and np.size(line.get_ydata())
    ]
    assert [d[0] for d in diamonds] == [0.993]
    legend = figure.axes[0].get_legend()
    assert [t.get_text() for t in legend.get_texts()] == ["30", "60", "published mean"]
