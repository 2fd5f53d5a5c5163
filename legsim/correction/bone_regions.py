"""The bones of a knee in a reconstructed volume: femur, tibia with fibula, patella.

Nothing is known of them but where hip, knee and ankle are. Bone is what attenuates clearly more
than the soft tissue around the leg's axes. Bones that touch in the image are parted where they are
thin: only cores deeper than some millimeters are kept, deeper and deeper, then denser ones, until
those of femur and tibia are two. From the cores the bones grow again, deepest voxels first, so that
they meet at the narrowest places (watershed of the depth).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage
from skimage.segmentation import watershed

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen_owned
from legsim.geometry.volume import Volume, VolumeGrid

FEMUR, TIBIA, PATELLA = 1, 2, 3
"""labels; the tibia's region holds the fibula"""

_BONE, _DENSER = 1.25, (1.3, 1.4, 1.5, 1.6, 1.7)
"""attenuation of bone over that of soft tissue, at least: 250 Hounsfield units; and of cores"""

NEAR_AXES = 0.08
"""m from the axes of thigh and shank, within which bone is the leg's"""

_DEPTHS = (0.0, 0.002, 0.003, 0.004, 0.005, 0.006)
"""m below the surface of bone, deeper than which cores lie"""

_SHAFT = 0.035
"""m from its axis, within which most of femur or tibia lies"""

_LEAST_BONE = 15e-6
"""m^3 of the smallest femur or tibia: a scan of a knee sees ten times as much"""

_LEAST_PART = 1e-6
"""m^3 of the smallest part of a bone: what is smaller is noise"""

_PATELLA_VOLUME = (4e-6, 60e-6)
"""m^3 of the smallest and the largest patella"""

_PATELLA_LENGTH = 0.07
"""m along the world's axes, at most"""

_PATELLA_TOUCHES = 0.33
"""share of its surface that touches other bone, at most: a piece of a condyle touches by half"""

_PATELLA_FROM_AXES, _PATELLA_FROM_KNEE = 0.015, 0.09
"""m from the patella's middle to the axes at least, to the knee at most"""


_THICKNESS = 0.5
"""half the thickness of a patella by the radius of a ball of its volume"""


@dataclass(frozen=True, slots=True, eq=False)
class BoneRegions:
    """Which voxels are bone, and of which bone."""

    grid: VolumeGrid
    labels: np.ndarray
    """(z, y, x) uint8: 0 none, 1 femur, 2 tibia with fibula, 3 patella"""

    def points(self, label: int) -> FloatArray:
        """(p, 3) m in world, the voxels of one bone."""
        return np.argwhere(self.labels == label)[:, ::-1] * self.grid.spacing_xyz + self.grid.origin

    def volume(self, label: int) -> float:
        """m^3 of one bone."""
        return float((self.labels == label).sum() * np.prod(self.grid.spacing_xyz))

    def middle(self, label: int) -> FloatArray | None:
        """(3,) m in world, the mean of one bone's voxels; None where it was not found."""
        points = self.points(label)
        return points.mean(0) if len(points) else None

    def with_patella(self, world_from_patella: FloatArray, radius: float) -> "BoneRegions":
        """The same bones with a patella at a place (4, 4; x forward) in place of what was found.

        It is a ball (m) without the bone that lies behind its back, and what bone lies no farther
        behind, to twice the radius.
        """
        arms = self.grid.positions() - world_from_patella[:3, 3]
        away = np.linalg.norm(arms, axis=-1).reshape(self.labels.shape)
        ahead = (arms @ world_from_patella[:3, 0]).reshape(self.labels.shape)
        before = ahead > -_THICKNESS * radius
        others = np.where(self.labels == PATELLA, np.uint8(0), self.labels)
        ball = (away < radius) & (before | (others == 0))
        fits = (away < 2 * radius) & before & (self.labels > 0)
        whole = np.where(ball | fits, np.uint8(PATELLA), others)
        return BoneRegions(self.grid, frozen_owned(whole))


def find_bones(volume: Volume, joints: FloatArray) -> BoneRegions:
    """Finds the bones of the leg whose hip, knee and ankle are at ``joints`` (3, 3) m in world.

    A patella that cannot be told from the femur is left out.

    Raises:
        LegsimError: no bone, or femur and tibia are not two in the image.
    """
    grid = volume.grid
    to_axes = axis_distances(grid.positions(), joints).T.reshape(2, *grid.shape_zyx)
    near = to_axes.min(0) < NEAR_AXES
    soft = soft_tissue(volume.attenuation[near])
    bone = _dense(volume, near, _BONE * soft)
    if not bone.any():
        raise LegsimError("no bone is seen around the leg's axes in the volume")
    found: list[np.ndarray] = []
    for level in (_BONE, *_DENSER):
        dense = bone if level == _BONE else bone & _dense(volume, near, level * soft)
        depth = ndimage.distance_transform_edt(dense, sampling=grid.spacing_xyz[::-1])
        for least in _DEPTHS:
            cores = ndimage.label(depth > least)[0]
            found += _Parts(watershed(-depth, cores, mask=bone), to_axes, joints[1], grid).labels()
        if any((labels == PATELLA).any() for labels in found):
            break
    if not found:
        raise LegsimError("femur and tibia are not seen as two bones in the volume")
    # the first cores that are two part femur and tibia best; too shallow ones hold a part of the
    # patella only, so that the largest is whole
    whole = max((labels == PATELLA for labels in found), key=lambda mask: int(mask.sum()))
    return BoneRegions(grid, frozen_owned(np.where(whole, np.uint8(PATELLA), found[0])))


def axis_distances(points: FloatArray, joints: FloatArray) -> FloatArray:
    """Distances (p, 2) m of points (p, 3) from the lines hip to knee and knee to ankle."""
    found = []
    for start, end in pairwise(joints):
        along = end - start
        share = np.clip((points - start) @ along / (along @ along), 0, 1)
        found.append(np.linalg.norm(points - start - share[:, None] * along, axis=-1))
    return np.stack(found, -1)


def _dense(volume: Volume, near: np.ndarray, least: float) -> np.ndarray:
    """Mask (z, y, x) of parts that attenuate more than ``least`` (1/m), their cavities filled."""
    numbers, count = ndimage.label(near & (volume.attenuation > least))
    sizes = np.bincount(numbers.ravel(), minlength=count + 1) * np.prod(volume.grid.spacing_xyz)
    large = sizes >= _LEAST_PART
    large[0] = False
    dense = large[numbers]
    # shafts are open where the volume ends: cavities are closed in horizontal slices only
    return np.stack([ndimage.binary_fill_holes(dense[:, y]) for y in range(dense.shape[1])], 1)


def soft_tissue(attenuation: Float32Array) -> float:
    """Commonest attenuation (1/m) of what is not air.

    Raises:
        LegsimError: nothing but air.
    """
    dense = float(np.percentile(attenuation, 99)) if len(attenuation) else 0.0
    if not dense > 0:
        raise LegsimError("nothing but air is seen around the leg's axes in the volume")
    counts, edges = np.histogram(attenuation, bins=100, range=(0.2 * dense, dense))
    commonest = int(np.argmax(ndimage.uniform_filter1d(counts.astype(float), 5)))
    return float(0.5 * (edges[commonest] + edges[commonest + 1]))


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """Numbered parts of the bone, not yet named."""

    numbers: np.ndarray
    """(z, y, x) int: which part a voxel belongs to; 0 where there is no bone"""
    to_axes: FloatArray
    """(2, z, y, x) m from the axes of thigh and shank"""
    knee: FloatArray
    """(3,) m"""
    grid: VolumeGrid

    def sizes(self, among: np.ndarray | None = None) -> FloatArray:
        """m^3 of each part, of its voxels ``among`` some."""
        numbers = self.numbers.ravel() if among is None else self.numbers[among]
        counts = np.bincount(numbers, minlength=int(self.numbers.max()) + 1)
        counts[0] = 0
        return counts * np.prod(self.grid.spacing_xyz)

    def labels(self) -> list[np.ndarray]:
        """(z, y, x) uint8 labels; none where femur and tibia are one, or not there.

        What is neither of them nor the patella goes with the nearer axis.
        """
        nearer = np.argmin(self.to_axes, 0)
        femur, tibia = (self._along(k, nearer == k) for k in (0, 1))
        if femur == 0 or tibia == 0 or femur == tibia:
            return []
        named = np.zeros(int(self.numbers.max()) + 1, np.uint8)
        for part in np.flatnonzero(self.sizes() >= _LEAST_PART):
            middle = self.to_axes[:, self.numbers == part].mean(1)
            named[part] = FEMUR if middle[0] < middle[1] else TIBIA
        named[femur], named[tibia] = FEMUR, TIBIA
        named[self._patella(femur, tibia)] = PATELLA
        named[0] = 0
        return [named[self.numbers]]

    def _along(self, axis: int, nearer: np.ndarray) -> int:
        """The largest part along an axis; 0 where there is none of a bone's size."""
        sizes = self.sizes(nearer & (self.to_axes[axis] < _SHAFT))
        return int(np.argmax(sizes)) if sizes.max() >= _LEAST_BONE else 0

    def _patella(self, femur: int, tibia: int) -> int:
        """The largest part that has a patella's size and place; 0 where there is none."""
        sizes = self.sizes()
        sizes[[femur, tibia]] = 0
        fits = (sizes > _PATELLA_VOLUME[0]) & (sizes < _PATELLA_VOLUME[1])
        for part in np.argsort(-sizes):
            if fits[part] and self._in_front(int(part)):
                return int(part)
        return 0

    def _in_front(self, part: int) -> bool:
        """Whether a part is as short as a patella, near the knee, off both axes, and by itself."""
        mask = self.numbers == part
        voxels = np.argwhere(mask)[:, ::-1] * self.grid.spacing_xyz + self.grid.origin
        middle = voxels.mean(0)
        touching = (ndimage.binary_dilation(mask) & (self.numbers > 0) & ~mask).sum()
        surface = (mask & ~ndimage.binary_erosion(mask)).sum()
        return bool(
            np.ptp(voxels, axis=0).max() < _PATELLA_LENGTH
            and self.to_axes[:, mask].mean(1).min() > _PATELLA_FROM_AXES
            and np.linalg.norm(middle - self.knee) < _PATELLA_FROM_KNEE
            and touching < _PATELLA_TOUCHES * surface
        )
