"""Volumes and projections in image files (MHA, NIfTI, NRRD), through SimpleITK.

World's axes are anterior, superior and right; ITK's physical axes are left, posterior and superior
(NIfTI's opposite signs are ITK's business). A volume's direction cosines say how the one lies in
the other, so that 3D Slicer and ITK-SNAP show the right letters. Files without any turn, with
direction cosines of 1, are taken to know no patient, as those of RTK and of legsim before it wrote
directions: their physical axes are world's, unless ``axes`` says otherwise. Projections are in
columns, rows and views, without directions. Files hold mm and 1/mm; memory m and 1/m. Files appear
whole or not at all.
"""

from __future__ import annotations

import locale
import math
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file
from legsim.core.memory import in_words
from legsim.core.values import LARGEST, Float32Array, FloatArray, within
from legsim.geometry import _meta_header, _nifti_header, _nrrd_header, _whole_files, dicom
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


WRITABLE = (".mha", ".nii", ".nii.gz", ".nrrd")

Axes = Literal["lps", "world"]

LPS_FROM_WORLD = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
"""(3, 3) from world's axes (anterior, superior, right) to ITK's (left, posterior, superior)"""

_MHA_START = """ObjectType = Image
NDims = 3
BinaryData = True
BinaryDataByteOrderMSB = False
CompressedData = False
TransformMatrix = 0 -1 0 0 0 1 -1 0 0
CenterOfRotation = 0 0 0
AnatomicalOrientation = PIL
"""
"""MetaImage lists the directions of x, y and z one after the other"""


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """An image file's samples; axes x, y, z (for projections: column, row, view)."""

    size: tuple[int, int, int]
    spacing_mm: tuple[float, float, float]
    origin_mm: tuple[float, float, float]
    """center of the first sample"""
    anatomical: bool = False
    """the file says where left, posterior and superior are; else its physical axes are world's"""

    def grid(self) -> VolumeGrid:
        """The grid of a volume with this header, in m."""
        (nx, ny, nz), (dx, dy, dz), (x, y, z) = self.size, self.spacing_mm, self.origin_mm
        center = (x + 0.5 * (nx - 1) * dx, y + 0.5 * (ny - 1) * dy, z + 0.5 * (nz - 1) * dz)
        return VolumeGrid(
            (nz, ny, nx),
            (1e-3 * dx, 1e-3 * dy, 1e-3 * dz),
            (1e-3 * center[0], 1e-3 * center[1], 1e-3 * center[2]),
        )


def save_volume(path: Path | str, volume: Volume) -> None:
    """Writes attenuation in 1/mm on a grid in mm, float32.

    Raises:
        LegsimError: the name's ending is none of :data:`WRITABLE`, or the file cannot be written.

    >>> save_volume("volume.nii.gz", load_volume("volume.mha"))
    """
    image = sitk.GetImageFromArray(volume.attenuation * np.float32(1e-3))
    image.SetSpacing([1e3 * s for s in volume.grid.spacing_xyz])
    image.SetOrigin((1e3 * LPS_FROM_WORLD @ volume.grid.origin).tolist())
    image.SetDirection(LPS_FROM_WORLD.ravel().tolist())
    _write(Path(path), image)


def load_volume(path: Path | str, *, axes: Axes | None = None) -> Volume:
    """Reads attenuation in 1/mm on a grid in mm; puts flipped or swapped axes in order.

    Args:
        path: any image that ITK reads.
        axes: what the file's physical axes are: "lps" (left, posterior, superior) or "world";
            None: "lps" where its direction cosines turn anything, else "world".

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, axes oblique to the
            world's, or values that are not finite.

    >>> load_volume("volume-rigid.mha").grid.shape_zyx
    (256, 256, 256)
    """
    path = Path(path)
    values, header = _read(path, axes)
    if not within(values):
        raise file_error(
            path,
            f"{np.count_nonzero(~(np.abs(values) <= LARGEST))} voxels are not finite numbers, or "
            "too large for an attenuation",
            "replace them before reading the volume",
        )
    values *= np.float32(1e3)
    return Volume(header.grid(), values)


def load_labels(path: Path | str, grid: VolumeGrid) -> NDArray[np.int32]:
    """Reads whole numbers (z, y, x) that mark regions of a volume on ``grid``.

    Raises:
        LegsimError: no image, another grid than the volume's (by more than a hundredth of a voxel),
            or values that are no whole numbers.
    """
    path = Path(path)
    values, header = _read(path)
    spacing_mm, origin_mm = 1e3 * np.array(grid.spacing_xyz), 1e3 * grid.origin
    tolerance = 0.01 * spacing_mm.min()
    far = np.abs(np.array(header.origin_mm) - origin_mm).max() > tolerance
    if (
        values.shape != grid.shape_zyx
        or far
        or np.abs(np.array(header.spacing_mm) - spacing_mm).max() * max(header.size) > tolerance
    ):
        raise file_error(
            path,
            f"has {header.size} voxels of {header.spacing_mm} mm from {header.origin_mm} mm, the "
            f"volume {grid.shape_zyx[::-1]} of "
            f"{tuple(spacing_mm.tolist())} mm from {tuple(origin_mm.tolist())} mm",
            "resample the labels to the volume's grid",
        )
    if not (values == np.rint(values)).all():
        raise file_error(
            path,
            "holds values that are no whole numbers",
            "expected one whole number a region, 0 outside",
        )
    return values.astype(np.int32)


class VolumeWriter:
    """Takes the slabs of a volume as they come; :func:`volume_writer` makes it."""

    def __init__(self, path: Path, grid: VolumeGrid, stream: BinaryIO) -> None:
        self._path, self._grid, self._stream = path, grid, stream
        self.slices = 0
        """how many have come"""

    def write(self, first_slice: int, slab: Float32Array) -> None:
        """Appends slices (n, y, x) in 1/m; the first one's number must be that of the next slice.

        Raises:
            LegsimError: it is another one, or the slices are of another size than the grid's.
        """
        if first_slice != self.slices or slab.shape[1:] != self._grid.shape_zyx[1:]:
            raise LegsimError(
                f"{self._path}: slices {slab.shape} from {first_slice} do not follow slice "
                f"{self.slices - 1} of the grid"
            )
        self.slices += len(slab)
        for part in slab:
            self._stream.write((part * np.float32(1e-3)).astype("<f4").tobytes())


@contextmanager
def volume_writer(path: Path | str, grid: VolumeGrid) -> Iterator[VolumeWriter]:
    """Opens an .mha file for a volume that is written slab by slab and is never in memory whole.

    Use it in a ``with`` statement and call :meth:`VolumeWriter.write` for consecutive slabs. The
    file appears when the block ends well and every slice has come; otherwise nothing is left.

    Raises:
        LegsimError: the name does not end in .mha, the file cannot be written, the disk has too
            little room, or slices are missing.
    """
    path = Path(path)
    if path.suffix.lower() != ".mha":
        raise LegsimError(f"{path}: slabs can only be written to .mha; name such a file")
    numbers = {
        "Offset": 1e3 * LPS_FROM_WORLD @ grid.origin,
        "ElementSpacing": 1e3 * np.array(grid.spacing_xyz),
        "DimSize": np.array(grid.shape_zyx[::-1]),
    }
    placed = "".join(
        f"{key} = {' '.join(map(repr, values.tolist()))}\n" for key, values in numbers.items()
    )
    with files.whole(path) as partial, partial.open("wb") as stream:
        free, needed = shutil.disk_usage(path.parent).free, 4 * math.prod(grid.shape_zyx)
        if free < needed:
            raise file_error(
                path,
                f"needs {in_words(needed)}, the disk has {in_words(free)}",
                "make room or take another disk",
            )
        stream.write(
            f"{_MHA_START}{placed}ElementType = MET_FLOAT\nElementDataFile = LOCAL\n".encode()
        )
        writer = VolumeWriter(path, grid, stream)
        yield writer
        if writer.slices < grid.shape_zyx[0]:
            raise LegsimError(
                f"{path}: only {writer.slices} of {grid.shape_zyx[0]} slices came; write all of "
                "them"
            )


def save_projections(path: Path | str, projections: Projections) -> None:
    """Writes line integrals as float32 (column, row, view), detector centered as RTK expects.

    Raises:
        LegsimError: the name's ending is none of :data:`WRITABLE`, or the file cannot be written.
    """
    image = sitk.GetImageFromArray(projections.line_integrals)
    wide, high = 1e3 * projections.geometry.pixel_pitch, 1e3 * projections.geometry.row_pitch()
    rows, columns = projections.geometry.shape_vu
    image.SetSpacing([wide, high, 1.0])
    image.SetOrigin([-0.5 * (columns - 1) * wide, -0.5 * (rows - 1) * high, 0.0])
    _write(Path(path), image)


def load_projections(path: Path | str, geometry: ConeBeamGeometry) -> Projections:
    """Reads line integrals of ``geometry``, whose matrices place the pixels.

    Spacing and origin in the file are not used.
    :func:`legsim.geometry.projection_images.read_projections` reads counts and other formats.

    Raises:
        LegsimError: no image, whole numbers, other counts of views, rows or columns than the
            geometry's, or values that are not finite.
    """
    path = Path(path)
    if _open(path).GetPixelID() not in (sitk.sitkFloat32, sitk.sitkFloat64):
        raise file_error(
            path,
            "holds whole numbers, counts of a detector",
            "say how they become line integrals (read_projections with counts)",
        )
    values, header = _read(path, "world")
    expected = (*geometry.shape_vu[::-1], len(geometry))
    if header.size != expected:
        raise file_error(
            path,
            f"holds {header.size} columns, rows and views, but the geometry describes {expected}",
            "give the geometry file that belongs to these projections",
        )
    check_finite(path, values)
    return Projections(geometry, values)


def check_finite(path: Path | str, views: NDArray) -> None:
    """Refuses views (v, rows, columns) with a value that is not finite, naming the first."""
    finite = np.isfinite(views).all(axis=(1, 2))
    if not finite.all():
        raise file_error(
            path,
            "holds values that are not finite numbers",
            "replace them before reconstructing",
            place=f"view {int(np.argmin(finite))}",
        )


def read_stored(
    path: Path,
) -> tuple[NDArray, tuple[float, float] | None, tuple[float, float] | None]:
    """((v, rows, columns), pixel size, origin) of views in any image that ITK reads.

    Numbers are of the file's kind. Pixel size (between columns, between rows) and origin of the
    first pixel's center are in mm on the detector, and None where the header does not say them.

    Raises:
        LegsimError: no image, not of two or three dimensions, or more than one channel.
    """
    reader = _open(path, dimensions=(2, 3))
    values = sitk.GetArrayFromImage(_executed(path, reader))
    if np.iscomplexobj(values):
        raise file_error(path, "holds complex numbers", "expected real ones")
    (wide, high), (u, v) = reader.GetSpacing()[:2], reader.GetOrigin()[:2]
    says_spacing, says_origin = _says(path)
    return (
        values[None] if values.ndim == 2 else values,
        (wide, high) if says_spacing else None,
        (u, v) if says_origin else None,
    )


def _says(path: Path) -> tuple[bool, bool]:
    """Whether a header states (spacing, origin): ITK takes 1 and 0 where it does not."""
    suffix = path.suffix.lower()
    if suffix in (".mha", ".mhd"):
        with path.open("rb") as stream:
            head = stream.read(1 << 16).partition(b"ElementDataFile")[0]
        keys = {line.partition(b"=")[0].strip().lower() for line in head.splitlines()}
        spacing = bool({b"elementspacing", b"elementsize"} & keys)
        return spacing, bool({b"offset", b"position", b"origin"} & keys)
    known = suffix in (".nii", ".nrrd", ".nhdr") or path.name.lower().endswith(".nii.gz")
    return known, known


def read_header(path: Path | str) -> ImageHeader:
    """Size, spacing and origin of a 3D image, axes in order, without reading its samples.

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, or axes oblique to the
            world's.
    """
    path = Path(path)
    reader = _open(path)
    return _ordered_header(path, reader)[0]


def read_samples(path: Path | str) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray]:
    """Reads a 3D image as it is: samples (k, j, i), spacing (3,) mm, origin (3,) mm, direction.

    The columns of the direction (3, 3) are the index axes in ITK's physical axes.

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, no voxels, axes that
            are not at right angles, or cut short.
    """
    path = Path(path)
    reader = _open(path)
    direction = np.array(reader.GetDirection()).reshape(3, 3)
    if not np.allclose(direction.T @ direction, np.eye(3), atol=1e-3):
        raise file_error(
            path,
            f"its axes are not at right angles (direction cosines {direction.ravel().tolist()})",
            "resample it to axes that are",
        )
    spacing, origin = np.array(reader.GetSpacing()), np.array(reader.GetOrigin())
    return sitk.GetArrayFromImage(_executed(path, reader)), spacing, origin, direction


def _open(path: Path, dimensions: tuple[int, ...] = (3,)) -> sitk.ImageFileReader:
    if not is_file(path):
        raise file_error(path, "no such file", "check the name")
    dicom.refuse_as_volume(path)
    _nrrd_header.check(path)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    if path.suffix.lower() in (".mha", ".mhd"):
        _meta_header.check(path)
        reader.SetImageIO("MetaImageIO")  # ITK itself knows it by small letters alone
    try:
        with _quiet():
            reader.ReadImageInformation()
    except RuntimeError as error:
        _whole_files.refuse_other_kinds(path)
        if "orthonormal" in str(error):
            raise file_error(
                path,
                "its axes are not at right angles, as of a tilted gantry",
                "resample it to axes that are",
            ) from error
        raise file_error(
            path,
            f"not an image that ITK can read ({_last_line(error)})",
            f"give one of {', '.join(WRITABLE)}",
        ) from error
    if reader.GetDimension() not in dimensions or reader.GetNumberOfComponents() != 1:
        raise file_error(
            path,
            f"has {reader.GetDimension()} dimensions and {reader.GetNumberOfComponents()} channels",
            "expected 3 dimensions and 1 channel; extract those first",
        )
    if 0 in reader.GetSize():
        raise file_error(path, f"has a size of {reader.GetSize()}: no pixels", "export it again")
    if path.name.lower().endswith((".nii", ".nii.gz")):
        fields = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
        _nifti_header.check(path, fields)
    stated = (reader.GetOrigin(), reader.GetSpacing(), reader.GetDirection())
    if not all(within(np.array(numbers)) for numbers in stated):
        problem = "its first voxel is at {} mm, its spacing {} mm, its axes along {}"
        raise file_error(path, problem.format(*stated), "write it again with finite numbers")
    return reader


def _last_line(error: RuntimeError) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[-1].strip()


def _ordered_header(
    path: Path, reader: sitk.ImageFileReader, physical: Axes | None = None
) -> tuple[ImageHeader, list[int], list[bool]]:
    """(header along world axes, file axis of each world axis, whether that axis runs backwards)."""
    direction, first = np.array(reader.GetDirection()).reshape(3, 3), np.array(reader.GetOrigin())
    turned = not np.allclose(direction, np.eye(3), atol=1e-6)
    anatomical = turned if physical is None else physical == "lps"
    if anatomical:
        direction, first = LPS_FROM_WORLD.T @ direction, LPS_FROM_WORLD.T @ first
    axes = [int(k) for k in np.argmax(np.abs(direction), axis=1)]
    signs = np.array([direction[row, axis] for row, axis in enumerate(axes)])
    if sorted(axes) != [0, 1, 2] or not np.allclose(np.abs(signs), 1.0, atol=1e-4):
        raise file_error(
            path,
            f"its axes are oblique (direction cosines {np.round(direction, 4).ravel().tolist()})",
            "resample it to axes along x, y and z first",
        )
    size, spacing = np.array(reader.GetSize())[axes], np.array(reader.GetSpacing())[axes]
    flipped = signs < 0
    origin = first - np.where(flipped, (size - 1) * spacing, 0.0)
    (nx, ny, nz), (dx, dy, dz), (x, y, z) = size.tolist(), spacing.tolist(), origin.tolist()
    header = ImageHeader((nx, ny, nz), (dx, dy, dz), (x, y, z), anatomical)
    return header, axes, [bool(f) for f in flipped]


def _read(path: Path, physical: Axes | None = None) -> tuple[Float32Array, ImageHeader]:
    """(samples (z, y, x) float32, header), axes in order."""
    reader = _open(path)
    header, axes, flipped = _ordered_header(path, reader, physical)
    image = _executed(path, reader)
    samples = sitk.GetArrayViewFromImage(image)
    if np.iscomplexobj(samples):
        raise file_error(path, "holds complex numbers", "expected real ones")
    # world axis w is array axis 2 - w; the file's axis axes[w] is array axis 2 - axes[w]
    ordered = samples.transpose([2 - axes[w] for w in (2, 1, 0)])
    ordered = ordered[tuple(slice(None, None, -1 if flipped[w] else 1) for w in (2, 1, 0))]
    return np.array(ordered, np.float32, order="C"), header


def _executed(path: Path, reader: sitk.ImageFileReader) -> sitk.Image:
    try:
        with _quiet():
            image = reader.Execute()
    except RuntimeError as error:
        raise file_error(path, "cannot be read to its end", "write or copy it again") from error
    _whole_files.check(path, sitk.GetArrayViewFromImage(image).nbytes)
    return image


@contextmanager
def _quiet() -> Iterator[None]:
    """Drops what ITK's readers write to standard error, and the locale that its .vtk reader sets.

    They raise the former as well; under the latter, text beyond ASCII can no longer be read.
    """
    before = locale.setlocale(locale.LC_ALL)
    with ExitStack() as undo:
        undo.callback(locale.setlocale, locale.LC_ALL, before)
        if sys.__stderr__ is not None:  # closed: nothing can be written there
            sys.__stderr__.flush()
            kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
            for descriptor in (kept, nowhere):
                undo.callback(os.close, descriptor)
            os.dup2(nowhere, 2)
            undo.callback(os.dup2, kept, 2)
        yield


def _write(path: Path, image: sitk.Image) -> None:
    ending = next(
        (e for e in sorted(WRITABLE, key=len, reverse=True) if path.name.lower().endswith(e)), None
    )
    if ending is None:
        raise LegsimError(
            f"{path}: images are not written in this format; name a file that ends in "
            f"{', '.join(WRITABLE)}"
        )
    try:
        # ITK's writers know endings in small letters alone
        with files.whole(path) as partial, _small(partial, ending) as small:
            sitk.WriteImage(image, str(small), ending == ".nii.gz")
            _whole_files.check_written(small, ending, sitk.GetArrayViewFromImage(image).nbytes)
    except RuntimeError as error:
        raise file_error(
            path, f"cannot be written ({_last_line(error)})", "check the folder and the space left"
        ) from error


@contextmanager
def _small(path: Path, ending: str) -> Iterator[Path]:
    """Yields the name with its ending in small letters; what is written there gets the name."""
    small = path.with_name(path.name[: -len(ending)] + ending)
    try:
        yield small
    except BaseException:
        if small != path:
            small.unlink(missing_ok=True)
        raise
    # where case does not matter this gives the file its name
    small.replace(path)
