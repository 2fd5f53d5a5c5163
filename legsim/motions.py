"""How space moves during a scan where it is no rigid motion: followed points, or displacements sampled on a coarse grid."""

from dataclasses import dataclass

import numpy as np

from legsim.arrays import Float32Array, FloatArray, frozen, increasing_times
from legsim.errors import LegsimError
from legsim.geometry import VolumeGrid


@dataclass(frozen=True, slots=True, eq=False)
class ControlPointMotion:
    """A few points that were followed through the scan; in between, space moves by moving least squares."""

    times: FloatArray
    """(v,) s"""
    reference: FloatArray
    """(m, 3) m in world at the reference time: where the reconstruction holds them"""
    moved: FloatArray
    """(v, m, 3) m in world at each view"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("ControlPointMotion.times", self.times))
        object.__setattr__(self, "reference", frozen("ControlPointMotion.reference", self.reference, (None, 3)))
        shape = (len(self.times), len(self.reference), 3)
        object.__setattr__(self, "moved", frozen("ControlPointMotion.moved", self.moved, shape))
        if len(self.reference) < 1 or not (np.isfinite(self.reference).all() and np.isfinite(self.moved).all()):
            raise LegsimError("ControlPointMotion needs at least one control point, all coordinates finite")


@dataclass(frozen=True, slots=True, eq=False)
class FieldMotion:
    """Displacements on a coarse grid, one field a view; linear between nodes, and as on its border beyond it."""

    times: FloatArray
    """(v,) s"""
    grid: VolumeGrid
    """nodes, in world; may be much coarser than the volume, and should cover it"""
    displacements: Float32Array
    """(v, z, y, x, 3) m, x, y, z in world: where the point that rests at a node is at times[v], less the node"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("FieldMotion.times", self.times))
        shape = (len(self.times), *self.grid.shape_zyx, 3)
        object.__setattr__(self, "displacements", frozen("FieldMotion.displacements", self.displacements, shape, np.float32))
        if not np.isfinite(self.displacements).all():
            raise LegsimError("FieldMotion.displacements holds a value that is not a finite number")
