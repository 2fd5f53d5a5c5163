"""Where thigh and shank run from a knee at the rotation center, as a volume shows it.

For scans whose joints are on no sensor. Of the directions upward that one is the thigh's along
which most bone lies, and of those downward the shank's.
"""

import numpy as np
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.geometry.volume import Volume

_FROM, _TO = 0.03, 0.085
"""m from the knee between which bone decides"""

_STEEPEST = 60.0
"""degrees of a thigh or shank from the vertical, at most"""

_LENGTH = 0.4
"""m of thigh and shank; what is seen of them is much shorter"""

_NEAR = 0.08
"""m from the vertical through the knee, within which tissue is the leg's"""

_BONE, _AIR = 1.25, 0.4
"""attenuation of bone over that of soft tissue, at least, and of air at most"""

_SMOOTH = 0.006
"""m, standard deviation by which bone is smoothed: about half a shaft"""

_LEAST_BONE = 0.15
"""share of bone along an axis, at least"""


def find_axes(volume: Volume, knee: FloatArray) -> FloatArray:
    """Points (3, 3) m for hip, knee and ankle, as far from the knee as in a grown person.

    Only their directions are seen.

    Raises:
        LegsimError: no bone is seen above or below the knee.
    """
    grid = volume.grid
    beside = grid.positions() - knee
    near = (np.hypot(beside[:, 0], beside[:, 2]) < _NEAR).reshape(grid.shape_zyx)
    values = volume.attenuation[near]
    dense = values[values > _AIR * np.percentile(values, 90)] if len(values) else values
    if not len(dense) or not np.median(dense) > 0:
        raise LegsimError("nothing but air is seen around the rotation center")
    bone = np.where(near, volume.attenuation > _BONE * float(np.median(dense)), 0.0)
    smooth = ndimage.gaussian_filter(bone, _SMOOTH / np.array(grid.spacing_xyz[::-1]))
    ends = []
    for name, sign in (("above", 1.0), ("below", -1.0)):
        ways = _directions() * [1.0, sign, 1.0]
        steps = np.arange(_FROM, _TO, min(grid.spacing_xyz))
        points = knee + ways[:, None] * steps[:, None]
        index_zyx = np.moveaxis((points - grid.origin) / grid.spacing_xyz, -1, 0)[::-1]
        share = ndimage.map_coordinates(smooth, index_zyx, order=1).mean(-1)
        if share.max() < _LEAST_BONE:
            raise LegsimError(f"no bone is seen {name} the rotation center")
        ends.append(knee + _LENGTH * ways[int(np.argmax(share))])
    return np.stack([ends[0], knee, ends[1]])


def _directions() -> FloatArray:
    """(n, 3) unit vectors about the vertical, some degrees apart."""
    slopes = np.tan(np.radians(_STEEPEST)) * np.linspace(-1, 1, 41)
    x, z = (part.ravel() for part in np.meshgrid(slopes, slopes))
    inside = np.hypot(x, z) <= slopes.max()
    ways = np.stack([x[inside], np.ones(int(inside.sum())), z[inside]], -1)
    return ways / np.linalg.norm(ways, axis=-1, keepdims=True)
