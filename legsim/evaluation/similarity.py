"""Similarity of a volume to the motion-free one, and its sharpness alone.

Volumes are scaled to 0..1 and registered; SSIM and RMSE are computed by region. The protocol is
Maier et al.'s ("Rigid and non-rigid motion compensation in weight-bearing cone-beam CT of the knee
using (noisy) inertial measurements", Section 3.1): every volume is scaled to 0..1 and registered to
the motion-free reference before SSIM (Wang et al. 2004: uniform window of 7 voxels, data range 1)
and RMSE are taken. Where the paper does not say: a volume is scaled by its 0.5 and 99.5 percentiles
inside the union of the regions (air and cortical bone), because a few voxels of streaks would
otherwise set the scale of all others; a registration is applied only where it raises the
correlation; and values from outside the grid do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from skimage.metrics import structural_similarity

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.evaluation import registration as evaluation_registration
from legsim.evaluation.regions import SSIM_WINDOW, Region, bounding_box, normalized
from legsim.evaluation.registration import Registration
from legsim.geometry.volume import Volume

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


PROTOCOL = 4
"""version of the comparison, raised with every change of it

No older score is then taken for a current one.
"""

SCORE_COLUMNS = ("region", "SSIM", "RMSE", "gradient entropy", "voxels")
"""Column names of :class:`Scores`"""

_SLAB = 32


@dataclass(frozen=True, slots=True)
class RegionScores:
    """Agreement with the reference inside one region."""

    region: str
    ssim: float
    rmse: float
    """of volumes scaled to 0..1"""
    gradient_entropy: float
    """nats, of the registered volume alone; needs no reference

    It compares only within one region of one grid.
    """
    voxels: int
    """that were compared: those of the region that the registered volume still covers"""


@dataclass(frozen=True, slots=True, repr=False)
class Scores:
    """All regions of one volume against its reference."""

    regions: tuple[RegionScores, ...]
    registration: Registration | None
    """None where the volume is the reference itself or registration was not asked for"""

    def of(self, region: str) -> RegionScores:
        """Finds the scores of a region."""
        for metrics in self.regions:
            if metrics.region == region:
                return metrics
        raise LegsimError(
            f"unknown region {region!r}; known: {', '.join(m.region for m in self.regions)}"
        )

    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Region, SSIM, RMSE, gradient entropy and voxels as text, one row per region."""
        return tuple(
            (m.region, f"{m.ssim:.4f}", f"{m.rmse:.4f}", f"{m.gradient_entropy:.3f}", f"{m.voxels}")
            for m in self.regions
        )

    def __repr__(self) -> str:
        cells = (f"{m.region}: SSIM {m.ssim:.4f}, RMSE {m.rmse:.4f}" for m in self.regions)
        return f"Scores({'; '.join(cells)})"

    def _repr_html_(self) -> str:
        """Formats the scores as an HTML table for notebooks."""
        head = "".join(f"<th>{name}</th>" for name in SCORE_COLUMNS)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in self.rows()
        )
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def evaluate(
    volume: Volume, reference: Volume, regions: Sequence[Region], *, register: bool = True
) -> Scores:
    """Scores ``volume`` against ``reference`` in every region.

    Raises:
        LegsimError: the grids differ by over a thousandth of a voxel, a region is empty, or a
            volume holds NaN or is constant.
    """
    if not volume.grid.alike(reference.grid):
        raise LegsimError(
            f"volume and reference lie on different grids: {volume.grid} and {reference.grid}; "
            "reconstruct both --like the same file, or resample the volume (--resample)"
        )
    for region in regions:
        if region.mask.shape != reference.grid.shape_zyx or not region.mask.any():
            raise LegsimError(
                f"region {region.name!r} holds no voxel of the {reference.grid.shape_zyx} grid"
            )
    union = np.logical_or.reduce([region.mask for region in regions])
    box = bounding_box(union, reference.grid)
    regions = [Region(region.name, region.mask[box]) for region in regions]
    union, grid = union[box], reference.grid.cropped(box)
    fixed, moving = (
        normalized(reference.attenuation[box], union, "reference"),
        normalized(volume.attenuation[box], union, "volume"),
    )
    registration = None
    if register and not np.array_equal(fixed, moving):
        registration, moving = evaluation_registration.register(moving, fixed, grid, union)
    similarity = ssim_map(moving, fixed)
    return Scores(
        tuple(_in_region(region, moving, fixed, similarity) for region in regions), registration
    )


def _in_region(
    region: Region, moving: Float32Array, fixed: Float32Array, similarity: Float32Array
) -> RegionScores:
    covered = region.mask & np.isfinite(moving)
    difference = moving[covered].astype(np.float64) - fixed[covered]
    seen = similarity[covered]
    seen = seen[np.isfinite(seen)]
    if not seen.size:
        raise LegsimError(
            f"region {region.name!r} has no voxel at least {SSIM_WINDOW // 2} voxels inside the "
            "grid, where SSIM is defined"
        )
    ssim, rmse = float(seen.mean(dtype=np.float64)), float(np.sqrt(np.mean(difference**2)))
    return RegionScores(
        region.name, ssim, rmse, gradient_entropy(moving, covered), int(covered.sum())
    )


def gradient_entropy(volume: Float32Array, mask: NDArray[np.bool_]) -> float:
    """Entropy -sum(p ln p), in nats, of the gradient's normalized magnitude p.

    The p sum to 1 inside ``mask`` (z, y, x). Low where few voxels hold all edges: blur and streaks
    raise it, scale and offset of the values do not change it. The criterion is McGee et al.'s
    ("Image metric-based correction (autocorrection) of motion effects: analysis of image metrics",
    J Magn Reson Imaging 11, 2000), with the magnitude of the gradient by central differences along
    all three axes, per voxel. Its greatest value is the logarithm of the number of voxels. It is 0
    where one voxel has all of the gradient, or none has any. Voxels that are NaN, have a NaN
    neighbor or lie at the grid's border are left out.
    """
    squared = np.zeros([n - 2 for n in volume.shape], np.float32)
    inner = slice(1, -1)
    for axis in range(3):
        ahead, behind = ([inner] * 3 for _ in range(2))
        ahead[axis], behind[axis] = slice(2, None), slice(None, -2)
        squared += (volume[tuple(ahead)] - volume[tuple(behind)]) ** 2
    known = mask & np.isfinite(volume)
    steps = np.sqrt(squared[known[inner, inner, inner]], dtype=np.float64)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    p = steps / steps.sum()
    return float((p * -np.log(p)).sum())


def ssim_map(moving: Float32Array, fixed: Float32Array) -> Float32Array:
    """SSIM (z, y, x) at every voxel whose window lies inside the grid and holds no NaN.

    NaN elsewhere. It is computed in slabs to bound memory.
    """
    reach, depth = SSIM_WINDOW // 2, fixed.shape[0]
    if min(fixed.shape) < SSIM_WINDOW:
        raise LegsimError(
            f"SSIM needs at least {SSIM_WINDOW} voxels along each axis; the grid has {fixed.shape}"
        )
    unknown = ~np.isfinite(moving)
    moving = np.where(unknown, np.float32(0), moving)
    result = np.full(fixed.shape, np.nan, np.float32)
    for start in range(reach, depth - reach, _SLAB):
        stop = min(start + _SLAB, depth - reach)
        padded = slice(start - reach, stop + reach)
        full = np.asarray(
            structural_similarity(
                moving[padded], fixed[padded], data_range=1.0, win_size=SSIM_WINDOW, full=True
            )[1]
        )
        inner = slice(reach, -reach)
        result[start:stop, inner, inner] = full[reach : reach + stop - start, inner, inner]
    if unknown.any():
        result[maximum_filter(unknown.view(np.uint8), SSIM_WINDOW) > 0] = np.nan
    return result
