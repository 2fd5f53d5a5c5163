"""SimmSpline: OpenSim's values, and the laws that define it."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics._simm_spline import SimmSpline

KNEE_X = (
    -2.0944,
    -1.74533,
    -1.39626,
    -1.0472,
    -0.698132,
    -0.349066,
    -0.174533,
    0.197344,
    0.337395,
    0.490178,
    1.52146,
    2.0944,
)
KNEE_Y = (
    -0.0032,
    0.00179,
    0.00411,
    0.0041,
    0.00212,
    -0.001,
    -0.0031,
    -0.005227,
    -0.005435,
    -0.005574,
    -0.005435,
    -0.00525,
)


@pytest.mark.parametrize(
    ("degrees", "value", "slope", "bend"),
    [  # computed by OpenSim 4.6 from gait2392's knee_r.translation1
        (-120, -0.0031999095627856956, 0.0184655322853543, -0.02482505844026957),
        (-70, 0.004388084896837755, -2.6346719463505273e-05, -0.018586879932138214),
        (0, -0.004499856517536013, -0.005646884209557036, 0.02376783442245496),
        (10, -0.005175702595597733, -0.0023973047766110683, 0.013469602917608896),
    ],
)
def test_values_and_derivatives_are_opensims(degrees, value, slope, bend):
    found = SimmSpline(KNEE_X, KNEE_Y).with_derivatives(np.radians(degrees))
    np.testing.assert_allclose(found, (value, slope, bend), atol=2e-15)


def test_a_cubic_is_reproduced(rng):
    cubic = np.polynomial.Polynomial(rng.normal(size=4))
    x = np.sort(rng.uniform(-2, 2, 9))
    at = rng.uniform(x[0], x[-1], 50)
    value, slope, bend = SimmSpline(x, cubic(x)).with_derivatives(at)
    np.testing.assert_allclose(value, cubic(at), atol=1e-11)
    np.testing.assert_allclose(slope, cubic.deriv()(at), atol=1e-10)
    np.testing.assert_allclose(bend, cubic.deriv(2)(at), atol=1e-9)


def test_value_slope_and_bend_are_continuous_at_the_knots():
    spline, inner = SimmSpline(KNEE_X, KNEE_Y), np.array(KNEE_X[1:-1])
    before, after = spline.with_derivatives(inner - 1e-12), spline.with_derivatives(inner + 1e-12)
    np.testing.assert_allclose(before, after, atol=1e-11)
    np.testing.assert_array_equal(spline(inner), KNEE_Y[1:-1])


def test_outside_the_knots_it_is_straight():
    spline = SimmSpline(KNEE_X, KNEE_Y)
    value, slope, bend = spline.with_derivatives(np.array([KNEE_X[-1], KNEE_X[-1] + 0.5]))
    assert value[1] == pytest.approx(value[0] + 0.5 * slope[0])
    assert slope[1] == slope[0]
    assert bend[1] == 0


@pytest.mark.parametrize(("x", "y"), [([0], [0]), ([0, 1, 1, 2], [0, 1, 2, 3])])
def test_too_few_or_unordered_knots_are_refused(x, y):
    with pytest.raises(LegsimError, match="two knots with x strictly increasing"):
        SimmSpline(x, y)
