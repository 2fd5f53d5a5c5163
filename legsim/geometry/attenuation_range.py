"""What values of a volume can be attenuation of a body in 1/m, and whether two have one unit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_DENSE = 300.0
"""1/m: cortical bone is at 130 for 40 keV"""

_THIN = 2.0
"""1/m: water is at 15 for 150 keV"""

_SHARE = 0.01
"""of all voxels that metal may be"""

_APART = 4.0
"""times that ranges of two volumes of the same object may differ"""


@dataclass(slots=True)
class AttenuationRange:
    """Collects slab by slab what the values of a volume are."""

    voxels: int = 0
    dense: int = 0
    largest: float = -np.inf

    def add(self, attenuation: NDArray) -> None:
        """Adds voxels, 1/m."""
        self.voxels += attenuation.size
        self.dense += int(np.count_nonzero(attenuation > _DENSE))
        self.largest = max(self.largest, float(attenuation.max()))

    def objection(self) -> str | None:
        """A line where the values are no body's attenuation; None where they may be."""
        if self.dense > _SHARE * self.voxels:
            return (
                f"{100 * self.dense / self.voxels:.2g} % of the voxels attenuate by more than "
                f"{1e-3 * _DENSE:g}/mm, up to {1e-3 * self.largest:.3g}/mm, as no body does: check "
                "the unit of the geometry (mm) and that the images hold line integrals"
            )
        if self.voxels and self.largest < _THIN:
            return (
                f"no voxel attenuates by more than {1e-3 * self.largest:.2g}/mm, a tenth of water: "
                "check the unit of the geometry (mm), the place of the grid and that the images "
                "hold line integrals"
            )
        return None


def objection(attenuation: NDArray) -> str | None:
    """:meth:`AttenuationRange.objection` of a whole volume in 1/m."""
    values = AttenuationRange()
    values.add(attenuation)
    return values.objection()


def is_attenuation(attenuation: NDArray) -> bool:
    """Whether values in 1/m can be attenuation at all, metal included; Hounsfield units cannot."""
    low, high = np.percentile(attenuation, [1, 99])
    return bool(low > -1e3 and high < 3e3)


def other_unit(volume: NDArray, reference: NDArray) -> str | None:
    """A line where two volumes of one object do not have one unit; None where they may."""
    ranges = [np.percentile(values, [1, 99.5]) for values in (volume, reference)]
    own, wanted = (float(high - low) for low, high in ranges)
    if min(own, wanted) <= 0 or 1 / _APART < own / wanted < _APART:
        return None
    said = [f"{1e-3 * low:.3g} to {1e-3 * high:.3g}" for low, high in ranges]
    return f"its values are {said[0]}, those of the reference {said[1]} (98.5 % of the voxels)"
