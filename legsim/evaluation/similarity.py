"""Similarity of a volume to the motion-free one and to the phantom, and its sharpness alone.

Volumes are scaled to 0..1 and registered; SSIM and RMSE are computed by region. The protocol is
Maier et al.'s ("Rigid and non-rigid motion compensation in weight-bearing cone-beam CT of the knee
using (noisy) inertial measurements", Section 3.1): every volume is scaled to 0..1 and registered to
the motion-free reference before SSIM (:mod:`legsim.evaluation.ssim`, data range 1) and RMSE are
taken. Where the paper does not say: one map, the range of the motion-free volume, scales all
volumes (:mod:`legsim.evaluation.scaling` has the others), because of a volume's own extremes a
few voxels of streaks would set the scale of all others; a registration is applied only where it
raises the correlation; and values from outside the grid do not count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.evaluation import registration as evaluation_registration
from legsim.evaluation import scaling as evaluation_scaling
from legsim.evaluation.regions import Box, Region, within
from legsim.evaluation.registration import Compared, Registration
from legsim.evaluation.scaling import SCALINGS, Scaling, ValueRange, value_range
from legsim.evaluation.ssim import WINDOWS, Window, ssim_map
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device

PROTOCOL = 6
"""version of the comparison, raised with every change of it

No older score is then taken for a current one.
"""

Registered = Literal["reconstructed", "resampled", "none"]
"""how a volume that lies elsewhere is brought to its reference"""

REGISTERED: dict[Registered, str] = {
    "reconstructed": "reconstructed where they lie",
    "resampled": "resampled",
    "none": "not registered",
}

ReconstructedAt = Callable[[FloatArray, Box], Volume]
"""reconstructs the voxels of a box of the grid, each where a matrix (4, 4) m carries it"""

SCORE_COLUMNS = ("region", "SSIM", "RMSE", "gradient entropy", "voxels")
"""Column names of :class:`Scores`"""


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
    ssim_phantom: float | None = None
    """SSIM of the registered volume to the phantom itself, which has no streaks; None where the
    phantom was not given"""
    rmse_phantom: float | None = None
    """the same of RMSE"""


@dataclass(frozen=True, slots=True, repr=False)
class Scores:
    """All regions of one volume against its reference."""

    regions: tuple[RegionScores, ...]
    registration: Registration | None
    """None where the volume is the reference itself or registration was not asked for"""
    scaling: Scaling = "reference"
    window: Window = "uniform"
    registered: Registered = "resampled"

    @property
    def protocol(self) -> str:
        """How volumes were scaled and registered, and which windows SSIM has, in words."""
        return protocol_sentence(self.scaling, self.window, self.registered)

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
        return html_table(self.protocol, SCORE_COLUMNS, self.rows())


def html_table(caption: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of texts for notebooks."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f"<table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )


def protocol_sentence(scaling: Scaling, window: Window, registered: Registered) -> str:
    """Says in one phrase how volumes are scaled and registered and which windows SSIM has."""
    return (
        f"Scaled to 0..1: {SCALINGS[scaling]}. Volumes that lie elsewhere are "
        f"{REGISTERED[registered]}. SSIM in {WINDOWS[window]}."
    )


def evaluate(
    volume: Volume,
    reference: Volume,
    regions: Sequence[Region],
    *,
    register: bool = True,
    scaling: Scaling = "reference",
    window: Window = "uniform",
    phantom: Volume | None = None,
    device: Device | None = None,
) -> Scores:
    """Scores ``volume`` against ``reference`` in every region.

    Args:
        volume: to score.
        reference: the motion-free one, on the same grid.
        regions: in which the measures are averaged.
        register: registers the volume to the reference first.
        scaling: which values become 0 and 1.
        window: of SSIM.
        phantom: the true attenuation on the same grid; None leaves it out.
        device: that resamples and computes SSIM; None opens the fastest.

    Raises:
        LegsimError: the grids differ by over a thousandth of a voxel, there is no region or an
            empty one, an unknown scaling or window, a volume holds NaN or is constant, or no device
            works.

    >>> evaluate(volume, truth, scan.regions(grid)).of("leg").ssim
    0.945
    """
    prepared = prepare(
        reference, regions, scaling=scaling, window=window, phantom=phantom, device=device
    )
    del reference, phantom
    return prepared.scores(volume, register=register)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PreparedReference:
    """What volumes are scored against, cut to the regions and scaled once for all of them."""

    grid: VolumeGrid
    """of the volumes, whole"""
    regions: tuple[Region, ...]
    fixed: Float32Array
    """(z, y, x) the motion-free volume in ``box``, scaled"""
    true: Float32Array | None
    """the same of the phantom; None where it is not known"""
    box: Box
    """around the regions"""
    wide: Box
    """what a registration may read besides"""
    mask: NDArray[np.bool_]
    """union of the regions in ``box``"""
    scale: _Scale
    window: Window
    device: Device

    def scores(
        self,
        volume: Volume,
        *,
        register: bool = True,
        reconstructed_at: ReconstructedAt | None = None,
    ) -> Scores:
        """Scores ``volume`` in every region, as :func:`evaluate` does.

        Args:
            volume: to score.
            register: registers the volume to the reference first.
            reconstructed_at: makes the volume anew where it was registered; None resamples it.

        Raises:
            LegsimError: its grid differs from the reference's, or its values cannot be compared.
        """
        _refuse_other_grid(volume.grid, self.grid)
        box, window, device = self.box, self.window, self.device
        moving, inner = self.scale.of(volume, self.wide, "volume"), within(box, self.wide)
        del volume  # of 512^3 voxels, each whole volume more is half a GiB of the peak
        registration, compared = None, moving[inner]
        if register and not np.array_equal(self.fixed, compared):
            around = self.grid.cropped(self.wide)
            pair = Compared(self.fixed, self.mask, moving, around, inner)
            again = None
            if reconstructed_at is not None:
                again = partial(self._scaled_at, reconstructed_at)
            registration, compared = evaluation_registration.register(pair, device, again)
        del moving
        known = np.isfinite(compared)
        seen = _agreement(compared, self.fixed, known, self.regions, box, window, device)
        true: Sequence[tuple[float, float] | tuple[None, None]] = [(None, None)] * len(seen)
        if self.true is not None:
            true = _agreement(compared, self.true, known, self.regions, box, window, device)
        steps = gradient_steps(compared)
        scores = []
        for region, beside, to_phantom in zip(self.regions, seen, true, strict=True):
            mask = region.mask[box] & known
            count = int(np.count_nonzero(mask))
            entropy = _entropy(steps, mask)
            scores.append(RegionScores(region.name, *beside, entropy, count, *to_phantom))
        how: Registered = "resampled" if reconstructed_at is None else "reconstructed"
        how = how if register else "none"
        return Scores(tuple(scores), registration, self.scale.scaling, window, how)

    def _scaled_at(self, reconstructed_at: ReconstructedAt, matrix: FloatArray) -> Float32Array:
        """The box, scaled, of the volume made anew with its voxels carried by ``matrix``."""
        if self.scale.common is None:  # its own range is that of the whole volume
            whole = tuple(slice(0, n) for n in self.grid.shape_zyx)
            volume = reconstructed_at(matrix, (whole[0], whole[1], whole[2]))
            return self.scale.of(volume, self.box, "volume")
        values = reconstructed_at(matrix, self.box).attenuation
        evaluation_scaling.check(values[self.mask], "volume")
        return self.scale.common.scaled(values)


def prepare(
    reference: Volume,
    regions: Sequence[Region],
    *,
    scaling: Scaling = "reference",
    window: Window = "uniform",
    phantom: Volume | None = None,
    device: Device | None = None,
) -> PreparedReference:
    """Prepares a motion-free volume for the scores of many others.

    What lies away from the regions is not kept. Arguments and errors are those of :func:`evaluate`.
    """
    for what, name, known in (("scaling", scaling, SCALINGS), ("window", window, WINDOWS)):
        if name not in tuple(known):
            raise LegsimError(f"unknown {what} {name!r}; choose one of {', '.join(known)}")
    regions = tuple(regions)
    if not regions:
        raise LegsimError("there is no region to compare volumes in; give one or more")
    if phantom is not None:
        _refuse_other_grid(phantom.grid, reference.grid)
    for region in regions:
        if region.mask.shape != reference.grid.shape_zyx or not region.mask.any():
            raise LegsimError(
                f"region {region.name!r} holds no voxel of the {reference.grid.shape_zyx} grid"
            )
    union = np.logical_or.reduce([region.mask for region in regions])
    wide, box = evaluation_registration.boxes(union, reference.grid)
    mask = union[box]
    scale = _Scale(reference, box, mask, scaling)
    return PreparedReference(
        reference.grid,
        regions,
        scale.of(reference, box, "reference"),
        None if phantom is None else scale.of(phantom, box, "phantom"),
        box,
        wide,
        mask,
        scale,
        window,
        device or open_device(),
    )


def _refuse_other_grid(grid: VolumeGrid, wanted: VolumeGrid) -> None:
    if not grid.alike(wanted):
        raise LegsimError(
            f"volume and reference lie on different grids: {grid} and {wanted}; "
            "reconstruct both --like the same file, or resample the volume (--resample)"
        )


class _Scale:
    """How the volumes of one comparison are scaled."""

    def __init__(
        self, reference: Volume, box: Box, mask: NDArray[np.bool_], scaling: Scaling
    ) -> None:
        """``mask`` (z, y, x) is the union of the regions in ``box``."""
        self._box, self._mask = box, mask
        self.scaling: Scaling = scaling
        self.common: ValueRange | None = None
        if scaling in ("reference", "reference-leg"):
            self.common = self._range(reference, "reference")

    def _inside(self, volume: Volume) -> Float32Array:
        return volume.attenuation[self._box][self._mask]

    def _range(self, volume: Volume, name: str) -> ValueRange:
        return value_range(volume.attenuation, self._inside(volume), self.scaling, name)

    def of(self, volume: Volume, part: Box, name: str) -> Float32Array:
        """The values of ``volume`` in the box ``part``, scaled."""
        found = self.common
        if found is None:
            found = self._range(volume, name)
        else:
            evaluation_scaling.check(self._inside(volume), name)
        return found.scaled(volume.attenuation[part])


def _agreement(
    compared: Float32Array,
    other: Float32Array,
    known: NDArray[np.bool_],
    regions: Sequence[Region],
    box: Box,
    window: Window,
    device: Device,
) -> list[tuple[float, float]]:
    """SSIM and RMSE of two volumes (z, y, x) of ``box`` in each region, where ``known``."""
    similarity = ssim_map(compared, other, window=window, device=device)
    found = []
    for region in regions:
        mask = region.mask[box] & known
        seen, total = _total(similarity, mask & np.isfinite(similarity))
        if not seen:
            raise LegsimError(
                f"region {region.name!r} has no voxel far enough inside the grid for a window of "
                "SSIM"
            )
        count, squares = _total(
            compared, mask, lambda v, k, inside=mask: (v - other[k][inside[k]]) ** 2
        )
        found.append((total / seen, math.sqrt(squares / count)))
    return found


def _total(
    values: Float32Array,
    mask: NDArray[np.bool_],
    measure: Callable[[FloatArray, int], FloatArray] = lambda v, _: v,
) -> tuple[int, float]:
    """Count and sum of a measure of the values (z, y, x) inside the mask.

    Slice by slice, which stays in the cache, in an order that no number of cores changes.
    ``measure`` gets the values (n,) of a slice and its number.
    """
    sums = [
        float(measure(values[k][inside].astype(np.float64), k).sum())
        for k, inside in enumerate(mask)
    ]
    return int(np.count_nonzero(mask)), math.fsum(sums)


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
    return _entropy(gradient_steps(volume), mask & np.isfinite(volume))


def gradient_steps(volume: Float32Array) -> Float32Array:
    """Magnitude (z, y, x) of the differences between the neighbors along all three axes.

    NaN at the grid's border and beside NaN.
    """
    steps = np.full(volume.shape, np.nan, np.float32)
    inner = slice(1, -1)
    for z in range(1, len(volume) - 1):  # slice by slice: what is read stays in the cache
        squared = (volume[z + 1, inner, inner] - volume[z - 1, inner, inner]) ** 2
        squared += (volume[z, 2:, inner] - volume[z, :-2, inner]) ** 2
        squared += (volume[z, inner, 2:] - volume[z, inner, :-2]) ** 2
        np.sqrt(squared, out=steps[z, inner, inner])
    return steps


def _entropy(steps: Float32Array, mask: NDArray[np.bool_]) -> float:
    """Entropy of the magnitudes (z, y, x) inside the mask; NaN and 0 are left out."""
    known = mask & (steps > 0)
    _, total = _total(steps, known)
    if total == 0:
        return 0.0
    _, moment = _total(steps, known, lambda v, _: v * np.log(v))
    return math.log(total) - moment / total
