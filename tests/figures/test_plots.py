"""Figures of single values: what they show, and that notebooks draw them by themselves."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.figures import plots
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.imu.signals import ImuSignals

GRID = VolumeGrid.cubic(24, 0.01, (0.0, 0.5, 0.0))


def volume(level: float) -> Volume:
    values = np.zeros(GRID.shape_zyx, np.float32)
    values[8:16, 8:16, 8:16] = level
    return Volume(GRID, values)


def test_each_volume_has_a_column_under_its_name():
    figure = plots.plot_slices(truth=volume(20.0), rigid=volume(10.0))
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert titles == ["truth", "rigid"]


def test_one_gray_window_serves_all_columns():
    figure = plots.plot_slices(truth=volume(20.0), rigid=volume(10.0))
    limits = {image.get_clim() for ax in figure.axes for image in ax.images}
    assert len(limits) == 1


def test_a_notebook_draws_a_figure_by_itself():
    png = plots.plot_slices(truth=volume(20.0))._repr_png_()  # type: ignore[attr-defined]
    assert png.startswith(b"\x89PNG")


def test_no_volume_is_refused():
    with pytest.raises(LegsimError, match="needs volumes by name"):
        plots.plot_slices()


def test_signals_have_a_curve_per_sensor_and_axis():
    times = np.arange(20) / 100
    signals = ImuSignals(times, ("a", "b"), np.zeros((20, 2, 3)), np.ones((20, 2, 3)))
    figure = plots.plot_imu(signals)
    assert sum(len(ax.lines) for ax in figure.axes) >= 12
