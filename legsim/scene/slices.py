"""What pictures show of a volume: three slices, so that whole volumes need not stay in memory."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.values import Float32Array, FloatArray, frozen_owned
from legsim.geometry.volume import NamedVolume, Volume, VolumeGrid

_AXIAL_OFFSET = 0.05

_WHITE_SAMPLES = 128
"""voxels along each axis whose attenuations decide what is white"""


@dataclass(frozen=True, slots=True)
class SlicePlanes:
    """The three planes of the study's pictures, in world meters."""

    shank_y: float
    """height of the axial slice through the shank"""
    thigh_y: float
    """height of the axial slice through the thigh"""
    sagittal_z: float
    """how far to the subject's right the sagittal slice lies"""

    @classmethod
    def through(cls, center: Sequence[float] | FloatArray) -> "SlicePlanes":
        """Planes 5 cm below and above the knee ``center`` (3,), and sagittal through it."""
        _, y, z = (float(c) for c in center)
        return cls(y - _AXIAL_OFFSET, y + _AXIAL_OFFSET, z)


@dataclass(frozen=True, slots=True, eq=False)
class VolumeSlices:
    """Three slices of a reconstruction, under the name of its method.

    >>> VolumeSlices.of(NamedVolume("rigid", volume)).shank
    """

    name: str
    grid: VolumeGrid
    """of the whole volume"""
    planes: SlicePlanes
    shank: Float32Array
    """(x, z) 1/m, as :func:`axial` has it"""
    thigh: Float32Array
    """(x, z) 1/m"""
    sagittal: Float32Array
    """(y, x) 1/m, as :func:`sagittal` has it"""
    white: float
    """1/m that pictures show as white, by :func:`white_level`"""

    def __post_init__(self) -> None:
        for values in (self.shank, self.thigh, self.sagittal):
            frozen_owned(values)

    @classmethod
    def of(cls, named: NamedVolume, planes: SlicePlanes | None = None) -> "VolumeSlices":
        """Cuts a volume; holds copies, so that the volume itself can go.

        ``planes=None`` takes those of its grid's center.
        """
        volume = named.volume
        planes = planes or SlicePlanes.through(volume.grid.center)
        return cls(
            named.name,
            volume.grid,
            planes,
            axial(volume, planes.shank_y).copy(),
            axial(volume, planes.thigh_y).copy(),
            sagittal(volume, planes.sagittal_z).copy(),
            white_level(volume),
        )


def axial(volume: Volume, y: float) -> Float32Array:
    """Slice (x, z) at world height ``y`` (m, nearest voxel), 1/m.

    Rows run towards the front, columns towards the subject's left. Drawn with the origin below it
    is the radiological view from the feet: front above, the subject's right on the left.
    """
    return volume.attenuation[:, _nearest(volume.grid.axes()[1], y), :].T[:, ::-1]


def sagittal(volume: Volume, z: float) -> Float32Array:
    """Slice (y, x) at world ``z`` (m, nearest voxel), 1/m.

    Rows run upwards, columns towards the back (seen from the subject's left).
    """
    return volume.attenuation[_nearest(volume.grid.axes()[2], z)][:, ::-1]


def white_level(volume: Volume) -> float:
    """Attenuation in 1/m that pictures show as white: the 99.6th percentile.

    It leaves the gray of soft tissue in the middle of the scale. A large volume is sampled.
    """
    steps = tuple(slice(None, None, max(1, n // _WHITE_SAMPLES)) for n in volume.grid.shape_zyx)
    return float(np.percentile(volume.attenuation[steps], 99.6)) or 1.0


def _nearest(axis: FloatArray, value: float) -> int:
    return int(np.argmin(np.abs(axis - value)))
