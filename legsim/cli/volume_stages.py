"""Volumes from format to format: the work of `legsim convert` where an image is given."""

from pathlib import Path
from typing import Literal

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.geometry import attenuation_range, ct_series, ct_volume, image_files
from legsim.geometry.volume import Volume
from legsim.phantom import materials

_WATER_PER_MM = (0.005, 0.6)
"""1/mm, from 1 MeV to 10 keV"""

_SPACING_MM = (1e-3, 50.0)
"""mm between voxels of any image of a body"""


def is_volume(path: Path) -> bool:
    """Whether a file's ending is that of an image with three dimensions, or it is a folder."""
    if path.is_dir():
        return True
    endings = (*image_files.WRITABLE, ".mhd", ".nhdr")
    return path.name.lower().endswith(endings)


def convert_volume(
    path: Path,
    out: Path,
    *,
    axes: Literal["lps", "world"] | None = None,
    water_per_mm: float | None = None,
    energy_kev: float | None = None,
) -> list[str]:
    """Writes a volume as another image, or as a DICOM CT series where ``out`` is a folder; returns
    lines to print.

    Args:
        path: attenuation in 1/mm, or a folder of DICOM CT slices.
        out: file of another format, or a folder.
        axes: what the physical axes of ``path`` are, where its directions do not tell.
        water_per_mm: attenuation of water, for Hounsfield units.
        energy_kev: photon energy that gives it instead; 60 keV where neither is given.
    """
    to_image = out.name.lower().endswith(image_files.WRITABLE)
    hounsfield = path.is_dir() or not to_image
    if not hounsfield and (water_per_mm is not None or energy_kev is not None):
        raise LegsimError(
            f"{out}: Hounsfield units are of DICOM series only; leave out the option, or name a "
            "folder"
        )
    if not to_image and out.suffix and not out.is_dir():
        raise LegsimError(
            f"{out}: volumes are not written in this format; end the name in "
            f"{', '.join(image_files.WRITABLE)}, or name a folder for a DICOM series"
        )
    volume, notes = read_volume(path, axes=axes, water_per_mm=water_per_mm, energy_kev=energy_kev)
    if not attenuation_range.is_attenuation(volume.attenuation):
        low, high = 1e-3 * np.percentile(volume.attenuation, [1, 99])
        raise file_error(
            path,
            f"holds values from {low:.4g} to {high:.4g} (98 % of them), which are no attenuation "
            "in 1/mm",
            "of Hounsfield units H make (H / 1000 + 1) times that of water, 0.0206 at 60 keV, of "
            "1/m a thousandth",
        )
    spacing = 1e3 * np.array(volume.grid.spacing_xyz)
    if not (_SPACING_MM[0] <= spacing.min() and spacing.max() <= _SPACING_MM[1]):
        notes = [
            *notes,
            f"In doubt: voxels of {'x'.join(f'{x:.3g}' for x in spacing)} mm: is the spacing in "
            "another unit? headers hold mm",
        ]
    voxels = "x".join(map(str, volume.grid.shape_zyx[::-1]))
    if to_image:
        image_files.save_volume(out, volume)
        return [*notes, f"{voxels} voxels (x, y, z), 1/mm: {out}"]
    water, said = _water(water_per_mm, 60.0 if energy_kev is None else energy_kev)
    paths = ct_series.save(out, volume, water=water)
    return [
        *notes,
        f"Hounsfield units with water at {1e-3 * water:.5g}/mm ({said})",
        f"{len(paths)} axial slices, lowest first: {out}",
    ]


def read_volume(
    path: Path,
    *,
    axes: Literal["lps", "world"] | None = None,
    water_per_mm: float | None = None,
    energy_kev: float | None = None,
) -> tuple[Volume, list[str]]:
    """(attenuation in 1/m, lines to print) of a file in 1/mm, or a folder of DICOM CT slices.

    Slices need a word on water: they are in Hounsfield units.
    """
    if water_per_mm is not None and energy_kev is not None:
        raise LegsimError("--water-per-mm and --energy-kev both say water's attenuation; give one")
    if not path.is_dir():
        return image_files.load_volume(path, axes=axes), _axes_in_doubt(path, axes)
    if axes is not None:
        raise LegsimError(f"{path}: DICOM says its directions; leave --axes out")
    if water_per_mm is None and energy_kev is None:
        raise file_error(
            path,
            "is in Hounsfield units, which do not say water's attenuation",
            "give --water-per-mm, as in 0.0206, or --energy-kev",
        )
    water, said = _water(water_per_mm, energy_kev)
    found = ct_volume.load(path, water=water)
    count = found.volume.grid.shape_zyx[1]
    line = f"{path}: {count} slices up, water at {1e-3 * water:.5g}/mm ({said})"
    return found.volume, [line, *found.notes]


def _axes_in_doubt(path: Path, axes: Literal["lps", "world"] | None) -> list[str]:
    """A remark on a file without directions, which a patient's image may be that needs none."""
    if axes is not None or image_files.read_header(path).anatomical:
        return []
    return [
        f"In doubt: {path} does not state the directions of its axes, or that they are ITK's "
        "(left, posterior, superior); x, y and z are taken as world's (anterior, superior, right): "
        "--axes lps for a patient's image, --axes world if they are"
    ]


def _water(per_mm: float | None, energy_kev: float | None) -> tuple[float, str]:
    """(attenuation in 1/m, how it is known)."""
    if per_mm is not None:
        if not _WATER_PER_MM[0] <= per_mm <= _WATER_PER_MM[1]:
            raise LegsimError(
                f"--water-per-mm {per_mm:g}: water attenuates by {_WATER_PER_MM[0]:g} to "
                f"{_WATER_PER_MM[1]:g} in 1/mm; give as much, as in 0.0206 for 60 keV"
            )
        return 1e3 * per_mm, "as given"
    assert energy_kev is not None  # one of both is given
    return materials.attenuation("water", energy_kev), f"at {energy_kev:g} keV"
