"""Scaling of volumes before they are compared: which value becomes 0, and which 1.

RMSE is a share of the range that becomes 0 to 1, and SSIM's constants are shares of it: a narrower
range makes the same difference larger. docs/methods.md has what each choice changes, in numbers.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array

Scaling = Literal["reference", "reference-leg", "percentiles", "extremes"]

PERCENTILES = (0.5, 99.5)

SCALINGS: dict[Scaling, str] = {
    "reference": (
        "all volumes by one map, the range (minimum to maximum over the grid) of the "
        "motion-free one"
    ),
    "reference-leg": (
        "all volumes by one map, the range (minimum to maximum inside the regions) of the "
        "motion-free one"
    ),
    "percentiles": (
        f"each volume by its own {PERCENTILES[0]} and {PERCENTILES[1]} percentiles inside the "
        "regions"
    ),
    "extremes": "each volume by its own minimum and maximum over the grid",
}
"""each in words"""


@dataclass(frozen=True, slots=True)
class ValueRange:
    """The attenuations (1/m) that become 0 and 1."""

    low: float
    high: float

    def scaled(self, attenuation: Float32Array) -> Float32Array:
        """Maps attenuation (1/m) of any shape so that the range becomes 0 to 1."""
        return (attenuation - np.float32(self.low)) * np.float32(1.0 / (self.high - self.low))


def value_range(
    attenuation: Float32Array, inside: Float32Array, scaling: Scaling, name: str
) -> ValueRange:
    """The range of one volume.

    Args:
        attenuation: (z, y, x) over the whole grid, 1/m.
        inside: (n,) its values inside the regions.
        scaling: how the range is taken; of the motion-free volume for "reference" and
            "reference-leg".
        name: of the volume, for errors.

    Raises:
        LegsimError: a value that counts is not a number, or all are equal.
    """
    check(inside, name)
    if scaling == "percentiles":
        low, high = (float(p) for p in np.percentile(inside, PERCENTILES))
    else:
        values = inside if scaling == "reference-leg" else attenuation
        low, high = float(values.min()), float(values.max())
    if not np.isfinite([low, high]).all():
        raise LegsimError(
            f"the {name} holds values that are not numbers outside the regions, and its range over "
            'the grid scales it; choose the scaling "reference-leg" or "percentiles"'
        )
    if high <= low:
        raise LegsimError(
            f"the {name} is {low:g} everywhere inside the regions; there is nothing to compare"
        )
    return ValueRange(low, high)


def check(inside: Float32Array, name: str) -> None:
    """Refuses a volume whose values (n,) inside the regions cannot be compared.

    Raises:
        LegsimError: one is not a number, or all are equal.
    """
    low, high = float(inside.min()), float(inside.max())
    if not np.isfinite([low, high]).all():
        raise LegsimError(
            f"the {name} holds values that are not numbers inside the regions; it cannot be "
            "compared"
        )
    if high <= low:
        raise LegsimError(
            f"the {name} is {low:g} everywhere inside the regions; there is nothing to compare"
        )
