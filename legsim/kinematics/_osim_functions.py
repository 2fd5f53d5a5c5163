"""Functions of one variable as an OpenSim model writes them, with two derivatives.

Meaning of each: OpenSim's API documentation of the class of the same name; a polynomial's
coefficients start with the highest power.
"""

from typing import NamedTuple, Protocol
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics._simm_spline import SimmSpline

SUPPORTED = (
    "Constant",
    "LinearFunction",
    "PolynomialFunction",
    "SimmSpline",
    "NaturalCubicSpline",
    "PiecewiseLinearFunction",
    "MultiplierFunction",
)

_LARGEST = 1e9
"""of any unit: what is beyond it overflows where poses of joints are multiplied"""


class Function(Protocol):
    """A function of one variable."""

    def with_derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative at ``x``, each of its shape."""
        ...


class Polynomial(NamedTuple):
    """Also what OpenSim calls Constant and LinearFunction."""

    coefficients: tuple[float, ...]
    """highest power first"""

    def with_derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative."""
        x = np.asarray(x, float)
        value = first = second = np.zeros(x.shape)
        for coefficient in self.coefficients:
            second = second * x + 2 * first
            first = first * x + value
            value = value * x + coefficient
        return np.asarray(value), np.asarray(first), np.asarray(second)

    @property
    def is_identity(self) -> bool:
        """Whether it returns its variable: the axis is the coordinate itself."""
        return self.coefficients == (1.0, 0.0)

    @property
    def is_zero(self) -> bool:
        """Whether it is 0 everywhere."""
        return not any(self.coefficients)


class PiecewiseLinear(NamedTuple):
    """Straight between knots, and on with the end slopes beyond them."""

    x: FloatArray
    y: FloatArray

    def with_derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, slope (a knot's is that of the interval it starts) and 0."""
        x = np.asarray(x, float)
        k = np.clip(np.searchsorted(self.x, x, side="right") - 1, 0, len(self.x) - 2)
        slope = np.diff(self.y)[k] / np.diff(self.x)[k]
        return self.y[k] + slope * (x - self.x[k]), slope, np.zeros_like(x)


class Scaled(NamedTuple):
    """A function times a number."""

    function: Function
    scale: float

    def with_derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative."""
        value, first, second = self.function.with_derivatives(x)
        return self.scale * value, self.scale * first, self.scale * second


ZERO = Polynomial((0.0,))

IDENTITY = Polynomial((1.0, 0.0))


def is_identity(function: Function) -> bool:
    """Whether a function returns its variable."""
    return isinstance(function, Polynomial) and function.is_identity


def is_linear(function: Function) -> bool:
    """Whether a function is its variable, forwards or backwards: OpenSim then calls the coordinate
    rotational, else coupled. Old models write it as a spline through two points (Arnold 2010).
    """
    if isinstance(function, SimmSpline | PiecewiseLinear):
        return len(function.x) == 2 and bool(abs(np.diff(function.y)[0]) == np.diff(function.x)[0])
    return isinstance(function, Polynomial) and (
        len(function.coefficients) == 2 and bool(abs(function.coefficients[0]) == 1)
    )


def is_zero(function: Function) -> bool:
    """Whether a function is 0 everywhere."""
    if isinstance(function, Scaled):
        return function.scale == 0 or is_zero(function.function)
    return isinstance(function, Polynomial) and function.is_zero


def times(function: Function, scale: float) -> Function:
    """The function times ``scale``; itself where that is 1."""
    return function if scale == 1 or is_zero(function) else Scaled(function, scale)


def read(element: Element, place: str) -> Function:
    """The function that an XML element holds.

    Raises:
        LegsimError: the type is not among SUPPORTED, or its numbers do not make a function; the
            message starts with ``place``.
    """
    kind = element.tag
    if kind == "Constant":
        return Polynomial((_one(element, "value", place, default=0.0),))
    if kind in ("LinearFunction", "PolynomialFunction"):
        return Polynomial(tuple(_coefficients(element, kind, place)))
    if kind == "MultiplierFunction":
        holder = element.find("function")
        inner = [] if holder is None else list(holder)
        if len(inner) != 1:
            raise LegsimError(f"{place}: a MultiplierFunction holds one function, not {len(inner)}")
        return times(read(inner[0], place), _one(element, "scale", place, default=1.0))
    if kind in ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "PiecewiseLinearFunction"):
        x, y = numbers(element, "x", place), numbers(element, "y", place)
        if len(x) != len(y) or len(x) < 2 or (np.diff(x) <= 0).any():
            raise LegsimError(
                f"{place}: a {kind} needs as many y as x, two at least, with x strictly "
                f"increasing; it has {len(x)} x and {len(y)} y"
            )
        return PiecewiseLinear(x, y) if kind.startswith("Piece") else SimmSpline(x, y)
    raise LegsimError(
        f"{place}: the function type {kind} is not supported; supported are {', '.join(SUPPORTED)}"
    )


def numbers(element: Element, tag: str, place: str, *, endless: bool = False) -> FloatArray:
    """The numbers in a child element, none where it is missing; ``endless`` allows infinity, and
    takes as such what is beyond all that a model measures.

    Raises:
        LegsimError: a word is not a finite number, or is beyond all that a model measures.
    """
    text = element.findtext(tag) or ""
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        values = np.array([np.nan])
    if np.isnan(values).any() or not (endless or np.isfinite(values).all()):
        raise LegsimError(f"{place}: <{tag}> holds {text.strip()[:40]!r}, not finite numbers")
    if endless:
        # 1e10, or the largest number of a double, as programs write that there is no limit
        return np.where(np.abs(values) > _LARGEST, np.copysign(np.inf, values), values)
    if (np.abs(values[np.isfinite(values)]) > _LARGEST).any():
        raise LegsimError(
            f"{place}: <{tag}> holds {text.strip()[:40]!r}; no number of a model is beyond "
            f"{_LARGEST:.0e}, the file is damaged"
        )
    return values


def _coefficients(element: Element, kind: str, place: str) -> FloatArray:
    values = numbers(element, "coefficients", place)
    if kind == "LinearFunction" and len(values) == 0:
        return np.array([1.0, 0.0])
    if len(values) == 0 or (kind == "LinearFunction" and len(values) != 2):
        raise LegsimError(
            f"{place}: a {kind} of one coordinate has {len(values)} coefficients; expected "
            f"{'two, slope and offset' if kind == 'LinearFunction' else 'one at least'}"
        )
    return values


def _one(element: Element, tag: str, place: str, default: float) -> float:
    values = numbers(element, tag, place)
    if len(values) > 1:
        raise LegsimError(f"{place}: <{tag}> holds {len(values)} numbers, expected one")
    return float(values[0]) if len(values) else default
