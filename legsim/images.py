"""Volumes and projections in image files (MHA, NIfTI, NRRD), through SimpleITK.

World axes are the file's physical axes as ITK has them, without any turn, so that 3D Slicer and ITK-SNAP show a volume where it stands in
world (they call +x left, +y posterior, +z superior; NIfTI's opposite signs are ITK's business). Files hold mm and 1/mm; memory m and 1/m.
Files appear whole or not at all.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from legsim.arrays import Float32Array
from legsim.errors import LegsimError, at
from legsim.geometry import ConeBeamGeometry, Projections, Volume, VolumeGrid

WRITABLE = (".mha", ".nii", ".nii.gz", ".nrrd")


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """What an image file says about its samples; axes in the order x, y, z (for projections: column, row, view)."""

    size: tuple[int, int, int]
    spacing_mm: tuple[float, float, float]
    origin_mm: tuple[float, float, float]
    """center of the first sample"""


def save_volume(path: Path | str, volume: Volume) -> None:
    """Writes attenuation in 1/mm on a grid in mm, float32.

    Raises:
        LegsimError: the name's ending is none of :data:`WRITABLE`, or the folder cannot be written.
    """
    image = sitk.GetImageFromArray(volume.attenuation * np.float32(1e-3))
    image.SetSpacing([1e3 * s for s in volume.grid.spacing_xyz])
    image.SetOrigin([1e3 * float(o) for o in volume.grid.origin])
    _write(Path(path), image)


def load_volume(path: Path | str) -> Volume:
    """Reads attenuation in 1/mm on a grid in mm. Axes that the file has flipped or swapped are put in order.

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, axes oblique to the world's, or values that are not finite.
    """
    path = Path(path)
    values, header = _read(path)
    if not np.isfinite(values).all():
        raise at(path, f"{np.count_nonzero(~np.isfinite(values))} voxels are not finite numbers", "replace them before reading the volume")
    values *= np.float32(1e3)
    spacing = tuple(1e-3 * s for s in header.spacing_mm)
    center = tuple(1e-3 * (o + 0.5 * (n - 1) * s) for o, n, s in zip(header.origin_mm, header.size, header.spacing_mm, strict=True))
    return Volume(VolumeGrid(values.shape, spacing, center), values)  # type: ignore[arg-type]


def save_projections(path: Path | str, projections: Projections) -> None:
    """Writes line integrals as float32, (column, row, view) with the detector's center at the physical origin, as RTK expects.

    Raises:
        LegsimError: the name's ending is none of :data:`WRITABLE`, or the folder cannot be written.
    """
    image = sitk.GetImageFromArray(projections.line_integrals)
    pitch_mm = 1e3 * projections.geometry.pixel_pitch
    rows, columns = projections.geometry.shape_vu
    image.SetSpacing([pitch_mm, pitch_mm, 1.0])
    image.SetOrigin([-0.5 * (columns - 1) * pitch_mm, -0.5 * (rows - 1) * pitch_mm, 0.0])
    _write(Path(path), image)


def load_projections(path: Path | str, geometry: ConeBeamGeometry) -> Projections:
    """Reads line integrals that belong to ``geometry``. Spacing and origin in the file are not used: the matrices say where pixels are.

    Raises:
        LegsimError: no image, other counts of views, rows or columns than the geometry's, or values that are not finite.
    """
    path = Path(path)
    values, header = _read(path)
    expected = (*geometry.shape_vu[::-1], len(geometry))
    if header.size != expected:
        raise at(
            path,
            f"holds {header.size} columns, rows and views, but the geometry describes {expected}",
            "give the geometry file that belongs to these projections",
        )
    if not np.isfinite(values).all():
        view = int(np.flatnonzero(~np.isfinite(values).all(axis=(1, 2)))[0])
        raise at(path, "holds values that are not finite numbers", "replace them before reconstructing", place=f"view {view}")
    return Projections(geometry, values)


def read_header(path: Path | str) -> ImageHeader:
    """Size, spacing and origin of a 3D image, axes in order, without reading its samples.

    Raises:
        LegsimError: no image, not three-dimensional, more than one channel, or axes oblique to the world's.
    """
    path = Path(path)
    reader = _open(path)
    return _ordered_header(path, reader)[0]


def _open(path: Path) -> sitk.ImageFileReader:
    if not path.is_file():
        raise at(path, "no such file", "check the name")
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise at(path, f"not an image that ITK can read ({_last_line(error)})", f"give one of {', '.join(WRITABLE)}") from error
    if reader.GetDimension() != 3 or reader.GetNumberOfComponents() != 1:
        raise at(
            path,
            f"has {reader.GetDimension()} dimensions and {reader.GetNumberOfComponents()} channels",
            "expected 3 dimensions and 1 channel; extract those first",
        )
    return reader


def _last_line(error: RuntimeError) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[-1].strip()


def _ordered_header(path: Path, reader: sitk.ImageFileReader) -> tuple[ImageHeader, list[int], list[bool]]:
    """(header along world axes, file axis of each world axis, whether that axis runs backwards)."""
    direction = np.array(reader.GetDirection()).reshape(3, 3)
    axes = [int(k) for k in np.argmax(np.abs(direction), axis=1)]
    signs = np.array([direction[row, axis] for row, axis in enumerate(axes)])
    if sorted(axes) != [0, 1, 2] or not np.allclose(np.abs(signs), 1.0, atol=1e-4):
        raise at(
            path,
            f"its axes are oblique (direction cosines {np.round(direction, 4).ravel().tolist()})",
            "resample it to axes along x, y and z first",
        )
    size, spacing = np.array(reader.GetSize())[axes], np.array(reader.GetSpacing())[axes]
    flipped = signs < 0
    origin = np.array(reader.GetOrigin()) - np.where(flipped, (size - 1) * spacing, 0.0)
    header = ImageHeader(tuple(int(n) for n in size), tuple(map(float, spacing)), tuple(map(float, origin)))  # type: ignore[arg-type]
    return header, axes, [bool(f) for f in flipped]


def _read(path: Path) -> tuple[Float32Array, ImageHeader]:
    """(samples (z, y, x) float32, header), axes in order."""
    reader = _open(path)
    header, axes, flipped = _ordered_header(path, reader)
    try:
        image = reader.Execute()
    except RuntimeError as error:
        raise at(path, f"cannot be read to its end ({_last_line(error)})", "write or copy it again") from error
    samples = sitk.GetArrayViewFromImage(image)
    if np.iscomplexobj(samples):
        raise at(path, "holds complex numbers", "expected real ones")
    # world axis w is array axis 2 - w; the file's axis axes[w] is array axis 2 - axes[w]
    ordered = samples.transpose([2 - axes[w] for w in (2, 1, 0)])
    ordered = ordered[tuple(slice(None, None, -1 if flipped[w] else 1) for w in (2, 1, 0))]
    return np.array(ordered, np.float32, order="C"), header


def _write(path: Path, image: sitk.Image) -> None:
    ending = next((e for e in sorted(WRITABLE, key=len, reverse=True) if path.name.lower().endswith(e)), None)
    if ending is None:
        raise LegsimError(f"{path}: images are not written in this format; name a file that ends in {', '.join(WRITABLE)}")
    partial = path.with_name(f".{path.name[: -len(ending)]}.partial-{os.getpid()}{ending}")
    try:
        sitk.WriteImage(image, str(partial), ending == ".nii.gz")
        partial.replace(path)
    except (RuntimeError, OSError) as error:
        raise at(path, f"cannot be written ({_last_line(RuntimeError(str(error)))})", "check the folder and the space left") from error
    finally:
        partial.unlink(missing_ok=True)
