"""How much of the soft tissue's swing a point takes: none at the bones, all far from them, so that no surface opens or crosses a bone."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from scipy.spatial import KDTree

from legsim.arrays import FloatArray
from legsim.skinning import smooth_step

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")

NEAR, FAR = 0.004, 0.024
"""m from the nearest bone up to which tissue keeps to it, and from which on it swings freely"""
FARTHEST_SWING = (FAR - NEAR) / 1.875 / 2
"""m: half of what would press a layer on its neighbor's place (1.875 is the steepest slope of the step between)"""
_EDGE = 0.004
"""m that samples of a bone lie apart at most: no place of its surface is then farther than NEAR from one"""


def swing_of(bone: str) -> str:
    """The name under which poses hold the swing of a bone's soft tissue: a translation in world, by which the free tissue is shifted."""
    return f"swing_of_{bone}"


class SwingShare:
    """Of one leg, straight, in the frame of its femur."""

    def __init__(self, surfaces: Sequence[tuple[FloatArray, np.ndarray]]) -> None:
        """``surfaces`` are (vertices (p, 3), triangles (t, 3)) of all that is rigid."""
        samples = [trimesh.remesh.subdivide_to_size(vertices, triangles, _EDGE)[0] for vertices, triangles in surfaces]
        self._bones = KDTree(np.concatenate(samples))

    def at(self, points: FloatArray) -> FloatArray:
        """(p,) 0 to 1, of points (p, 3)."""
        distance = self._bones.query(points, distance_upper_bound=FAR)[0]
        return smooth_step((np.minimum(distance, FAR) - NEAR) / (FAR - NEAR))
