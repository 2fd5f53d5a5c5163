"""An object that shows a flip at a glance: an L of bone in a block of water, with a bead in front
of its corner.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from legsim.core.values import FloatArray
from legsim.phantom.meshes import Part, Phantom

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


WATER, BONE = 20.6, 60.5
"""1/m, about those at 60 keV"""

# outline of the L in x and y, anticlockwise, in units of its height
_OUTLINE = np.array(
    [[-0.3, -0.5], [0.3, -0.5], [0.3, -0.3], [-0.1, -0.3], [-0.1, 0.5], [-0.3, 0.5]]
)

_FACE = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 4], [0, 4, 5]])


def phantom(center: Sequence[float], *, height: float = 0.08) -> Phantom:
    """The object around ``center`` (m, world), the L ``height`` m high.

    Its stroke points along +y, its foot along +x, the bead lies on the +z side of the corner. Seen
    from +z (the first view of a circular scan, drawn with the origin below) it reads as an L;
    mirrored, turned or seen from behind it does not.
    """
    middle = np.asarray(center, float)
    corner = middle + height * np.array([-0.2, -0.4, 0.25])
    block = trimesh.creation.box(extents=height * np.array([1.1, 1.5, 0.8]))
    bead = trimesh.creation.icosphere(subdivisions=3, radius=0.08 * height)
    letter, triangles = _letter(height)
    return Phantom(
        (
            Part("block", "water", WATER, block.vertices + middle, block.faces),
            Part("letter", "cortical_bone", BONE, letter + middle, triangles),
            Part("bead", "cortical_bone", 2 * BONE, bead.vertices + corner, bead.faces),
        )
    )


def _letter(height: float) -> tuple[FloatArray, np.ndarray]:
    """A prism over the outline, from -0.1 to 0.1 heights along z."""
    count = len(_OUTLINE)
    vertices = np.concatenate([np.column_stack([_OUTLINE, np.full(count, z)]) for z in (-0.1, 0.1)])
    here = np.arange(count)
    following = (here + 1) % count
    sides = np.concatenate(
        [
            np.stack([here, following, following + count], 1),
            np.stack([here, following + count, here + count], 1),
        ]
    )
    return height * vertices, np.concatenate([_FACE[:, ::-1], _FACE + count, sides])
