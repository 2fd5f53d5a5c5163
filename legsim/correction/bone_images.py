"""What projections show of one bone along a motion, and how that changes as the bone moves.

A bone is what a volume has above soft tissue in and around its region; its projections are those of
the matched projector (:mod:`legsim.reconstruction.system_matrix`). Moved by a small twist (w, t)
about its middle c, before its motion, a bone's attenuation b changes by -grad b (w x (x - c) + t):
six volumes, whose projections are the derivatives.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from legsim.core.values import Float32Array, FloatArray, frozen_owned
from legsim.correction.bone_regions import BoneRegions
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction.system_matrix import SystemMatrix

_BEYOND = 2
"""voxels beyond its region over which a bone fades out: blurred edges lie there"""

_SMOOTH = 0.5
"""voxels, standard deviation by which a bone is smoothed so that its slopes are those of its
images"""


@dataclass(frozen=True, slots=True, eq=False)
class BoneTemplate:
    """A bone as a volume shows it."""

    grid: VolumeGrid
    attenuation: Float32Array
    """(z, y, x) 1/m above soft tissue"""

    @property
    def middle(self) -> FloatArray:
        """(3,) m, about which it turns."""
        return np.array(self.grid.center)

    def images(self, geometry: ConeBeamGeometry, motion: FloatArray, device: Device) -> np.ndarray:
        """Line integrals (v, rows, columns) along M(i) (v, 4, 4)."""
        return self._system(geometry, motion, device).forward(self.attenuation)

    def derivatives(
        self, geometry: ConeBeamGeometry, motion: FloatArray, device: Device
    ) -> list[np.ndarray]:
        """Six (v, rows, columns): by turns (rad) about the middle and shifts (m) before M(i)."""
        system = self._system(geometry, motion, device)
        by_zyx = np.gradient(np.asarray(self.attenuation, float), *self.grid.spacing_xyz[::-1])
        slopes = np.stack([np.asarray(part) for part in by_zyx[::-1]], -1)
        arms = (self.grid.positions() - self.middle).reshape(slopes.shape)
        by_twist = np.concatenate([np.cross(slopes, arms), -slopes], -1).astype(np.float32)
        return [system.forward(np.ascontiguousarray(by_twist[..., k])) for k in range(6)]

    def _system(
        self, geometry: ConeBeamGeometry, motion: FloatArray, device: Device
    ) -> SystemMatrix:
        return SystemMatrix(geometry, self.grid, device, RigidMotion(geometry.times, motion))


def bone_template(
    volume: Volume, bones: BoneRegions, label: int, soft: float
) -> BoneTemplate | None:
    """One bone of a volume, above soft tissue of that attenuation (1/m); None if it is not there.

    It fades out over a few voxels beyond its region, and ends where another bone begins.
    """
    own = bones.labels == label
    if not own.any():
        return None
    found, margin = np.argwhere(own), _BEYOND + 2
    low = np.maximum(found.min(0) - margin, 0)
    high = np.minimum(found.max(0) + 1 + margin, own.shape)
    box = (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))
    inside = own[box]
    beyond = ndimage.distance_transform_edt(~inside)
    share = np.clip((_BEYOND + 1 - np.asarray(beyond)) / _BEYOND, 0, 1)
    share[(bones.labels[box] > 0) & ~inside] = 0
    above = share * np.maximum(volume.attenuation[box] - soft, 0)
    smooth = ndimage.gaussian_filter(above, _SMOOTH).astype(np.float32)
    return BoneTemplate(volume.grid.cropped(box), frozen_owned(smooth))


@dataclass(frozen=True, slots=True)
class EdgeFilter:
    """Keeps the edges of bones: a band of frequencies, away from the first and last rows.

    What is smooth is soft tissue, scatter, and what lies beside the volume. What is finer than a
    pixel is the projector's own pattern. The first and last rows see ends that a volume lacks.
    """

    fine: float = 1.0
    """px, standard deviation of the blur that both keep"""
    coarse: float = 5.0
    """px, standard deviation of the blur that is taken off"""
    margin: float = 0.1
    """share of the rows at either end that do not count"""

    def __call__(self, images: np.ndarray) -> Float32Array:
        """(v, rows, columns) filtered."""
        sigmas = ((0.0, s, s) for s in (self.fine, self.coarse))
        sharp, smooth = (ndimage.gaussian_filter(images, s, mode="nearest") for s in sigmas)
        rows = images.shape[1]
        first = round(self.margin * rows)
        counts = np.zeros(rows, np.float32)
        counts[first : rows - first] = 1
        counts = ndimage.gaussian_filter1d(counts, 2.0, mode="constant")
        return (counts[:, None] * (sharp - smooth)).astype(np.float32)
