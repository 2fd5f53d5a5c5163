"""Allan plots show curves, and the points of the data sheet in the color of their curve."""

import numpy as np

from legsim import figures
from legsim.figures import AllanCurve, AllanPanel


def test_stated_points_are_drawn_where_there_are_some():
    seconds = np.geomspace(0.1, 100, 7)
    curves = (
        AllanCurve("a", seconds, 3 / np.sqrt(seconds), 3.0, 0.5),
        AllanCurve("b", seconds, 1 / np.sqrt(seconds), None, None),
    )
    panels = [AllanPanel("gyroscope", "deg/h", curves), AllanPanel("other", "µg", curves[1:])]
    left, right = figures.allan_deviations(panels).axes
    curve, point, floor, plain = left.lines
    np.testing.assert_allclose(np.asarray(curve.get_ydata()), 3 / np.sqrt(seconds))
    assert (list(point.get_xdata()), list(point.get_ydata())) == ([1.0], [3.0])
    assert set(np.asarray(floor.get_ydata())) == {0.5}
    assert curve.get_color() == point.get_color() == floor.get_color() != plain.get_color()
    assert left.get_xscale() == left.get_yscale() == "log"
    assert left.get_ylabel() == "Allan deviation (deg/h)"
    assert len(right.lines) == 1
