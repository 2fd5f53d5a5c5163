"""Functions of an OpenSim model: each against its formula, its slopes against differences."""

from xml.etree import ElementTree

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import _osim_functions as functions

AT = np.array([-1.5, -0.3, 0.2, 0.9, 2.5])


def read(xml: str):
    return functions.read(ElementTree.fromstring(xml), "joint knee")


CASES = {
    "<Constant><value>0.7</value></Constant>": lambda x: 0 * x + 0.7,
    "<LinearFunction><coefficients>2 -1</coefficients></LinearFunction>": lambda x: 2 * x - 1,
    "<LinearFunction/>": lambda x: x,
    "<PolynomialFunction><coefficients>3 0 -1 2</coefficients></PolynomialFunction>": lambda x: (
        3 * x**3 - x + 2
    ),
    "<PiecewiseLinearFunction><x>-1 0 1</x><y>1 0 3</y></PiecewiseLinearFunction>": lambda x: (
        np.where(x < 0, -x, 3 * x)
    ),
    "<MultiplierFunction><function><LinearFunction><coefficients>1 1</coefficients>"
    "</LinearFunction></function><scale>2.5</scale></MultiplierFunction>": lambda x: 2.5 * (x + 1),
    "<SimmSpline><x>0 2</x><y>1 2</y></SimmSpline>": lambda x: 1 + x / 2,
}


@pytest.mark.parametrize("xml", CASES)
def test_values_are_the_formulas_and_slopes_their_differences(xml):
    function, h = read(xml), 1e-5
    value, first, second = function.with_derivatives(AT)
    np.testing.assert_allclose(value, CASES[xml](AT), atol=1e-12)
    np.testing.assert_allclose(first, (CASES[xml](AT + h) - CASES[xml](AT - h)) / 2 / h, atol=1e-6)
    bend = (CASES[xml](AT + h) - 2 * value + CASES[xml](AT - h)) / h**2
    np.testing.assert_allclose(second, bend, atol=1e-4)


@pytest.mark.parametrize(
    ("xml", "linear"),
    [
        ("<LinearFunction><coefficients>-1 0</coefficients></LinearFunction>", True),
        ("<NaturalCubicSpline><x>-6.3 6.3</x><y>-6.3 6.3</y></NaturalCubicSpline>", True),
        ("<SimmSpline><x>-6.3 6.3</x><y>6.3 -6.3</y></SimmSpline>", True),
        ("<SimmSpline><x>0 2</x><y>1 2</y></SimmSpline>", False),
        ("<SimmSpline><x>0 1 2</x><y>0 1 3</y></SimmSpline>", False),
        ("<LinearFunction><coefficients>2 0</coefficients></LinearFunction>", False),
    ],
)
def test_a_spline_through_two_points_of_the_variable_is_the_variable(xml, linear):
    assert functions.is_linear(read(xml)) is linear


def test_a_parabola_goes_through_three_knots():
    x = np.array([-1.0, 0.5, 2.0])
    text = "<SimmSpline><x>-1 0.5 2</x><y>1 0.25 4</y></SimmSpline>"
    value, _, second = read(text).with_derivatives(np.array([*x, 1.0]))
    np.testing.assert_allclose(value, [1, 0.25, 4, 1], atol=1e-12)
    np.testing.assert_allclose(second, 2.0)


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        ("<SineFunction/>", "joint knee: the function type SineFunction is not supported"),
        ("<SimmSpline><x>0 1 1</x><y>0 1 2</y></SimmSpline>", "strictly increasing"),
        ("<Constant><value>one</value></Constant>", "'one', not finite numbers"),
        ("<Constant><value>-1e200</value></Constant>", "'-1e200'; no number of a model is beyond"),
        ("<LinearFunction><coefficients>1 2 3</coefficients></LinearFunction>", "3 coefficients"),
        ("<MultiplierFunction><scale>2</scale></MultiplierFunction>", "one function, not 0"),
    ],
)
def test_what_is_no_function_is_refused_by_name(xml, said):
    with pytest.raises(LegsimError, match=said):
        read(xml)
