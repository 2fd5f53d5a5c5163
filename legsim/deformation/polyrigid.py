"""Several rigid bodies and what lies between them: a blend of their motions by given shares.

Each point moves by one rigid transform, the blend of the bodies' as unit dual quaternions (Kavan,
Collins, Zara and O'Sullivan, Geometric skinning with approximate dual quaternion blending, ACM
Transactions on Graphics 27, 2008). The blend does not depend on the frame, bodies that move alike
carry everything with them, and a point with all its share on one body moves with that body exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen
from legsim.deformation.models import Motion
from legsim.geometry.volume import VolumeGrid

_SUM = 1e-5
"""greatest difference of the shares' sum from 1: rounding of single precision"""


@dataclass(frozen=True, slots=True, eq=False)
class PolyrigidMotion(Motion):
    """Bodies that move rigidly, and between them space that takes a share of each motion.

    The back-projection follows its samples: :meth:`on_grid`, best on the grid of the shares.
    """

    bodies: FloatArray
    """(v, k, 4, 4) moved_from_reference of each body at times[v]"""
    grid: VolumeGrid
    """where the shares are given, in world at the reference time; linear between, constant beyond
    """
    shares: Float32Array
    """(k, z, y, x) from 0 to 1, how much of each body's motion a point takes; they sum to 1"""

    def __post_init__(self) -> None:
        Motion.__post_init__(self)
        shares = frozen(
            "PolyrigidMotion.shares", self.shares, (None, *self.grid.shape_zyx), np.float32
        )
        shape = (len(self.times), len(shares), 4, 4)
        object.__setattr__(self, "shares", shares)
        object.__setattr__(self, "bodies", frozen("PolyrigidMotion.bodies", self.bodies, shape))
        if not np.isfinite(self.bodies).all():
            raise LegsimError("PolyrigidMotion.bodies holds a value that is not a finite number")
        if not (shares >= 0).all() or not np.allclose(shares.sum(0), 1, rtol=0, atol=_SUM):
            raise LegsimError(
                "the shares of a PolyrigidMotion are at least 0 and sum to 1 at every node"
            )

    def __repr__(self) -> str:
        return f"PolyrigidMotion({self._span()}, {len(self.shares)} bodies)"

    def arrays(self) -> dict[str, np.ndarray]:
        return {
            "bodies": self.bodies,
            "shares": self.shares,
            "grid_spacing_xyz": np.array(self.grid.spacing_xyz),
            "grid_center": np.array(self.grid.center),
        }

    def shares_at(self, points: FloatArray) -> FloatArray:
        """Shares (p, k) of points (p, 3) in world at the reference time; each row sums to 1."""
        index_zyx = ((points - self.grid.origin) / self.grid.spacing_xyz).T[::-1]
        found = np.stack(
            [
                ndimage.map_coordinates(
                    np.asarray(share, float), index_zyx, order=1, mode="nearest"
                )
                for share in self.shares
            ],
            -1,
        )
        return found / found.sum(-1, keepdims=True)

    def _views(self, points: FloatArray) -> Iterator[FloatArray]:
        shares = self.shares_at(points)
        whole = shares.max(-1) == 1
        leader = shares.argmax(-1)
        for matrices in self.bodies:
            moved = np.empty_like(points)
            for k, matrix in enumerate(matrices):
                led = whole & (leader == k)
                moved[led] = transforms.apply(matrix, points[led])
            moved[~whole] = blended(points[~whole], shares[~whole], matrices)
            yield moved


def blended(points: FloatArray, shares: FloatArray, matrices: FloatArray) -> FloatArray:
    """Moves points (p, 3) by the blend of rigid transforms (k, 4, 4) in shares (p, k)."""
    turns = transforms.quaternion_from_rotation(matrices[:, :3, :3])
    # q and -q are one rotation; the sign nearer to the first body's turns the shorter way
    turns = np.where((turns @ turns[0])[:, None] < 0, -turns, turns)
    shifts = 0.5 * _product_with_vector(matrices[:, :3, 3], turns)
    turn, shift = shares @ turns, shares @ shifts
    length = np.linalg.norm(turn, axis=-1, keepdims=True)
    turn, shift = turn / length, shift / length
    w, v, dw, dv = turn[:, :1], turn[:, 1:], shift[:, :1], shift[:, 1:]
    turned = np.cross(v, np.cross(v, points) + w * points)
    return points + 2 * (turned + w * dv - dw * v + np.cross(v, dv))


def _product_with_vector(vectors: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Quaternion products (k, 4) of (0, vector) and quaternions wxyz."""
    w, v = quaternions[:, :1], quaternions[:, 1:]
    scalar = -(vectors * v).sum(-1, keepdims=True)
    return np.concatenate([scalar, w * vectors + np.cross(vectors, v)], -1)
