"""A folder of DICOM CT slices as a volume of attenuation: mu = mu_water (1 + HU / 1000).

Slices are put in order by their positions. Needs pydicom (`pip install legsim[dicom]`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import Float32Array, FloatArray, within
from legsim.geometry.dicom import is_image, require_pydicom
from legsim.geometry.image_files import LPS_FROM_WORLD
from legsim.geometry.volume import Volume, VolumeGrid

if TYPE_CHECKING:
    from pydicom.dataset import Dataset  # pyright: ignore[reportMissingImports]  # an extra

_UNEVEN = 0.01
"""share of a slice's spacing or a pixel by which positions may be off"""

_OBLIQUE = 1e-4
"""by which direction cosines may differ from an axis"""


@dataclass(frozen=True, slots=True, eq=False)
class CtVolume:
    """A volume as it was read."""

    volume: Volume
    """1/m, along world's axes"""
    notes: tuple[str, ...]
    """what a user may not expect"""


@dataclass(frozen=True, slots=True, eq=False)
class _Slice:
    """One file."""

    path: Path
    data: "Dataset"
    position: FloatArray
    """(3,) mm in ITK's axes, center of the first pixel"""
    along_row: FloatArray
    """(3,) direction in which columns are counted"""
    along_column: FloatArray
    pitch: tuple[float, float]
    """mm between (columns, rows)"""
    shape: tuple[object, object]
    """rows, columns"""
    series: str
    modality: str
    unit: str
    """of the rescaled values; empty where the file does not say it"""
    slope: float | None
    """of the rescaling; None without one"""
    shift: float
    padding: float | None
    """stored number of pixels that are none"""

    def rescaled(self, values: FloatArray) -> FloatArray:
        """Values in Hounsfield units, of stored ones."""
        return values * (1.0 if self.slope is None else self.slope) + self.shift


def load(folder: Path | str, *, water: float) -> CtVolume:
    """Reads the slices of a folder.

    Args:
        folder: the files of one series; others that are not DICOM are left out.
        water: attenuation of water in 1/m, which Hounsfield units do not say.

    Raises:
        LegsimError: pydicom is missing, no slices or those of several series, not CT in Hounsfield
            units, slices of several sizes or directions, a gantry's tilt, axes oblique to the
            body's, or positions that are uneven or there twice.
    """
    folder = Path(folder)
    require_pydicom(folder)
    if not (np.isfinite(water) and water > 0):
        raise LegsimError(f"water's attenuation is {water:g}/m; it must be positive")
    slices = [_read(path) for path in sorted(folder.iterdir()) if is_image(path)]
    if len(slices) < 2:
        raise file_error(
            folder, f"holds {len(slices)} DICOM slices", "give the folder of a whole CT series"
        )
    _check_alike(folder, slices)
    ordered, step = _in_order(folder, slices)
    values = np.stack([_hounsfield(one) for one in ordered])
    notes, values = _without_padding(ordered, values)
    if not within(values):
        raise file_error(folder, "its values are beyond any Hounsfield unit", "export it again")
    values = (water * (1 + 1e-3 * values)).astype(np.float32)
    return CtVolume(_along_world(ordered[0], values, step), notes)


def _read(path: Path) -> _Slice:
    pydicom = require_pydicom(path)
    try:
        return _slice(path, pydicom.dcmread(path))
    except Exception as error:
        # pydicom raises many kinds of errors on broken files and missing elements, also when an
        # element is looked at
        line = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise file_error(
            path,
            f"does not say where its slice is ({line})",
            "export the series as single CT slices, or leave this file out",
        ) from error


def _slice(path: Path, data: "Dataset") -> _Slice:
    directions = np.array(data.ImageOrientationPatient, float).reshape(2, 3)
    position = np.array(data.ImagePositionPatient, float).reshape(3)
    between_rows, between_columns = (float(size) for size in data.PixelSpacing)
    series, modality, unit = (
        str(data.get(name, "")) for name in ("SeriesInstanceUID", "Modality", "RescaleType")
    )
    slope, shift, padding = (
        None if (found := data.get(name)) is None else float(found)
        for name in ("RescaleSlope", "RescaleIntercept", "PixelPaddingValue")
    )
    numbers = [*directions.flat, *position, between_rows, between_columns]
    numbers += [number for number in (slope, shift, padding) if number is not None]
    if not within(np.array(numbers)) or min(between_rows, between_columns) <= 0:
        raise ValueError("its numbers are not finite, or its pixels have no size")
    return _Slice(
        path,
        data,
        position,
        directions[0],
        directions[1],
        (between_columns, between_rows),
        (data.get("Rows"), data.get("Columns")),
        series,
        modality,
        unit,
        slope,
        shift or 0.0,
        padding,
    )


def _check_alike(folder: Path, slices: list[_Slice]) -> None:
    """Refuses slices that do not make one volume in Hounsfield units."""
    series = {one.series for one in slices}
    if len(series) > 1:
        raise file_error(folder, f"holds {len(series)} series", "give a folder with one of them")
    first = slices[0]
    for one in slices:
        if one.modality != "CT" or one.unit not in ("", "HU") or not one.slope:
            raise file_error(
                one.path,
                f"is no CT in Hounsfield units (modality {one.modality or 'unknown'}, "
                f"unit {one.unit or 'unknown'})",
                "give a CT series, or a volume in 1/mm as .mha or .nii",
            )
        same = (
            one.shape == first.shape
            and np.allclose(one.pitch, first.pitch, rtol=1e-4)
            and np.abs(one.along_row - first.along_row).max() < _OBLIQUE
            and np.abs(one.along_column - first.along_column).max() < _OBLIQUE
        )
        if not same:
            raise file_error(
                one.path,
                f"differs from {first.path.name} in size, pixels or directions",
                "leave out scouts and reformatted slices",
            )


def _in_order(folder: Path, slices: list[_Slice]) -> tuple[list[_Slice], float]:
    """(slices along the normal of their planes, mm between them)."""
    first = slices[0]
    normal = np.cross(first.along_row, first.along_column)
    ordered = sorted(slices, key=lambda one: float(one.position @ normal))
    places = np.array([one.position for one in ordered])
    steps = np.diff(places @ normal)
    usual = float(np.median(steps))
    double = int(np.argmin(steps))
    if steps[double] < _UNEVEN * max(usual, 1e-3):
        names = f"{ordered[double].path.name} and {ordered[double + 1].path.name}"
        raise file_error(folder, f"{names} are at the same place", "leave one of them out")
    off = int(np.argmax(np.abs(steps - usual)))
    if abs(steps[off] - usual) > _UNEVEN * usual:
        names = f"{ordered[off].path.name} and {ordered[off + 1].path.name}"
        raise file_error(
            folder,
            f"its slices are {usual:g} mm apart, but {names} {steps[off]:g} mm: slices are missing "
            "or unevenly spaced",
            "export the whole series, or resample it to even slices",
        )
    aside = places - places[0] - np.outer((places - places[0]) @ normal, normal)
    if np.abs(aside).max() > _UNEVEN * min(first.pitch):
        raise file_error(
            folder,
            f"its slices are shifted against each other by {np.abs(aside).max():.3g} mm: the "
            "gantry was tilted",
            "resample it to slices that lie straight above each other",
        )
    return ordered, float(np.mean(steps))


def _hounsfield(one: _Slice) -> FloatArray:
    """(rows, columns) HU."""
    try:
        values = np.asarray(one.data.pixel_array, float)
    except Exception as error:
        # pydicom raises many kinds of errors on broken files and unknown compressions
        line = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise file_error(
            one.path, f"holds no image that can be read ({line})", "export it without compression"
        ) from error
    if values.ndim != 2:
        raise file_error(one.path, "holds several frames or colors", "export single gray slices")
    return one.rescaled(values)


def _without_padding(
    slices: list[_Slice], values: FloatArray
) -> tuple[tuple[str, ...], FloatArray]:
    """(notes, HU with air where a file says that a pixel is padding)."""
    count = 0
    for one, image in zip(slices, values, strict=True):
        if one.padding is not None:
            outside = image == one.rescaled(np.array(one.padding))
            image[outside] = -1000.0
            count += int(outside.sum())
    return ((f"{count} pixels of padding are air",) if count else ()), values


def _along_world(first: _Slice, values: Float32Array, step: float) -> Volume:
    """Values (slice, row, column) on a grid along world's axes."""
    normal = np.cross(first.along_row, first.along_column)
    # columns of this matrix: the world directions in which slices, rows and columns are counted
    turned = LPS_FROM_WORLD.T @ np.stack([normal, first.along_column, first.along_row], -1)
    axes = np.abs(turned).argmax(axis=1)
    whole = np.abs(np.abs(turned[np.arange(3), axes]) - 1).max() < _OBLIQUE
    if not whole or len(set(axes.tolist())) < 3:
        raise file_error(
            first.path,
            f"its axes are oblique (direction cosines {np.round(turned, 4).ravel().tolist()})",
            "resample it along the body's axes",
        )
    pitch = np.array([step, first.pitch[1], first.pitch[0]])[axes]
    signs = np.sign(turned[np.arange(3), axes])
    counts = np.array(values.shape)[axes]
    corner = LPS_FROM_WORLD.T @ first.position
    # the first voxel along a reversed axis is the last one in world
    center = 1e-3 * (corner + 0.5 * signs * (counts - 1) * pitch)
    ordered = values.transpose([axes[w] for w in (2, 1, 0)])
    ordered = ordered[tuple(slice(None, None, int(signs[w])) for w in (2, 1, 0))]
    x, y, z = (1e-3 * pitch).tolist()
    grid = VolumeGrid(ordered.shape, (x, y, z), (center[0], center[1], center[2]))
    return Volume(grid, np.ascontiguousarray(ordered))
