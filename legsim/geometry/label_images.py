"""Segmentations: whole numbers on a grid that may be oblique, placed in world.

ITK's physical axes of a patient's image are +x left, +y posterior, +z superior (LPS); NIfTI's
opposite signs are ITK's business. World is x anterior, y superior, z right.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.files import is_file
from legsim.core.values import FloatArray, frozen, frozen_owned
from legsim.geometry import _whole_files, image_files, label_names
from legsim.geometry.image_files import LPS_FROM_WORLD, Axes

_SPACING_MM = (0.02, 20.0)
"""least and largest voxel spacing of a segmentation; beyond, its unit is taken for mistaken"""

_HEADER_BYTES = 1 << 14

_META = re.compile(rb"^\s*(TransformMatrix|Rotation|Orientation)\s*=", re.M)

_NRRD = re.compile(rb"^space: *(left|right|[LR]AS|LPS)(?s:.*)^space directions:", re.M | re.I)

_DIRECTIONS = {"mha": _META, "mhd": _META, "nrrd": _NRRD, "nhdr": _NRRD}
"""what states directions, by the ending of the file"""

_MOST_OFF = 0.01
"""of a whole number: what scaled integers and single precision leave; no image stays within"""

_LARGEST_NUMBER = 1 << 20
"""of a structure; no list of structures is that long"""


@dataclass(frozen=True, slots=True, eq=False)
class LabelImage:
    """One whole number per voxel."""

    path: Path
    labels: np.ndarray
    """(k, j, i) int32 in the file's order, 0 outside all"""
    world_from_index: FloatArray
    """(4, 4): indices (i, j, k, 1) to world, m"""
    remarks: tuple[str, ...] = ()
    names: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    """by number, as far as the file has its own; several of a number are in doubt"""
    counts: np.ndarray = field(init=False)
    """voxels of each number from 0"""

    def __post_init__(self) -> None:
        frozen_owned(self.labels)
        counts = np.zeros(int(self.labels.max()) + 1, np.int64)
        for layer in self.labels:  # of all at once, bincount would make a copy of twice the size
            counts += np.bincount(layer.ravel(), minlength=len(counts))
        object.__setattr__(self, "counts", frozen_owned(counts))
        object.__setattr__(
            self, "world_from_index", frozen("world_from_index", self.world_from_index, (4, 4))
        )

    def __repr__(self) -> str:
        sizes = "x".join(f"{1e3 * s:.4g}" for s in self.spacing)
        counts = "x".join(str(n) for n in self.labels.shape[::-1])
        return f"LabelImage({self.path.name}: {counts} voxels (i, j, k) of {sizes} mm)"

    @property
    def numbers(self) -> tuple[int, ...]:
        """The numbers above 0 that some voxel has."""
        return tuple(int(n) for n in np.flatnonzero(self.counts) if n > 0)

    @property
    def spacing(self) -> FloatArray:
        """(3,) m between voxels along i, j, k."""
        return np.linalg.norm(self.world_from_index[:3, :3], axis=0)

    def on_grid_of(self, other: LabelImage) -> bool:
        """Whether both images have the same voxels, to a hundredth of one."""
        if self.labels.shape != other.labels.shape:
            return False
        far = np.array([*self.labels.shape[::-1], 1.0])
        apart = np.abs((self.world_from_index - other.world_from_index) * far).sum(1).max()
        return bool(apart < 0.01 * self.spacing.min())


def load_label_image(path: Path | str, *, axes: Axes = "lps") -> LabelImage:
    """Reads a segmentation (NIfTI, NRRD, MHA and whatever else ITK reads).

    Args:
        path: the file.
        axes: what the file's physical axes are: "lps" (left, posterior, superior), as of a scanner
            and of volumes that legsim writes, or "world".

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, values that are no
            whole numbers or are below 0, an implausible spacing, nothing but 0, or segments of
            several layers.
    """
    path = Path(path)
    if path.is_dir():
        cure = "give the segmentations in it, as in femur_left.nii.gz tibia.nii.gz"
        raise file_error(path, "is a folder", cure)
    names = label_names.read(path) if is_file(path) else {}
    samples, spacing_mm, origin_mm, direction = image_files.read_samples(path)
    if not _SPACING_MM[0] <= min(spacing_mm) <= max(spacing_mm) <= _SPACING_MM[1]:
        raise file_error(
            path,
            f"has voxels of {', '.join(f'{s:.4g}' for s in spacing_mm)} mm",
            f"expected {_SPACING_MM[0]:g} to {_SPACING_MM[1]:g} mm: fix the unit of its spacing",
        )
    whole, off = _whole_numbers(np.asarray(samples))
    if not off <= _MOST_OFF:
        raise file_error(
            path,
            "holds values that are no whole numbers",
            "give the segmentation, one whole number per structure, not the image",
        )
    if whole.max() > _LARGEST_NUMBER:
        problem = f"holds the number {whole.max()}"
        raise file_error(path, problem, f"number its structures up to {_LARGEST_NUMBER}")
    if whole.min() < 0 or whole.max() == 0:
        problem = f"its values go from {whole.min()} to {whole.max()}"
        raise file_error(path, problem, "expected 0 outside and a number above 0 per structure")
    turn = LPS_FROM_WORLD.T if axes == "lps" else np.eye(3)
    matrix = np.eye(4)
    matrix[:3, :3] = 1e-3 * turn @ direction * spacing_mm
    matrix[:3, 3] = 1e-3 * turn @ origin_mm
    remarks = _unstated(path, spacing_mm, axes)
    if off > 0:
        remarks = (*remarks, f"{path}: values up to {off:.1g} off whole numbers were rounded")
    return LabelImage(path, whole, matrix, remarks, names)


def _whole_numbers(samples: np.ndarray) -> tuple[np.ndarray, float]:
    """(the nearest whole numbers, int32; by how much samples are off them)."""
    if samples.dtype.kind in "iub":
        whole = samples.astype(np.int32)
        return whole, 0.0 if np.array_equal(whole, samples) else np.inf
    with np.errstate(invalid="ignore"):  # NaN is no whole number either
        whole = np.rint(samples).astype(np.int32)
        return whole, float(np.abs(whole - samples).max())


def _unstated(path: Path, spacing_mm: FloatArray, axes: Axes) -> tuple[str, ...]:
    """A remark on a file that does not say how its axes lie: readers then take what is usual."""
    with _whole_files.opened(path) as stream:
        head = stream.read(_HEADER_BYTES)
    ending = path.name.lower().removesuffix(".gz").rpartition(".")[2]
    if ending == "img":  # its header is beside it; ITK takes a packed one where there is no other
        header = re.sub(r"img(\.gz)?$", "hdr", path.name.lower())
        names = (header, f"{header}.gz")
        beside = [other for other in path.parent.iterdir() if other.name.lower() in names]
        if beside:
            return _unstated(min(beside, key=lambda p: len(p.name)), spacing_mm, axes)
    if ending in ("nii", "hdr"):
        order, second = _whole_files.nifti_layout(head)
        codes = struct.unpack_from(
            f"{order}{'2i' if second else '2h'}", head, 344 if second else 252
        )
        stated = max(codes) > 0
    else:
        stated = ending in _DIRECTIONS and _DIRECTIONS[ending].search(head) is not None
    if stated:
        return ()
    sizes = " x ".join(f"{s:.4g}" for s in spacing_mm)
    taken = "left, posterior, superior" if axes == "lps" else "those of world"
    return (
        f"In doubt: {path} does not state the directions of its axes, which are taken as {taken}, "
        f"nor perhaps its voxels, taken as {sizes} mm: check both, and that the leg is upright; "
        "an .nrrd or .nii.gz that 3D Slicer or ITK-SNAP writes states them",
    )
