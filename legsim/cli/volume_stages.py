"""Volumes from format to format: the work of `legsim convert` where an image is given."""

from pathlib import Path
from typing import Literal

from legsim.core.errors import LegsimError
from legsim.geometry import ct_series, image_files
from legsim.phantom import materials


def is_volume(path: Path) -> bool:
    """Whether a file's ending is that of an image with three dimensions."""
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
        path: attenuation in 1/mm.
        out: file of another format, or a folder.
        axes: what the physical axes of ``path`` are, where its directions do not tell.
        water_per_mm: attenuation of water, for Hounsfield units.
        energy_kev: photon energy that gives it instead; 60 keV where neither is given.
    """
    to_image = is_volume(out)
    if to_image and (water_per_mm is not None or energy_kev is not None):
        raise LegsimError(
            f"{out}: Hounsfield units are of DICOM series only; leave out the option, or name a "
            "folder"
        )
    if not to_image and out.suffix and not out.is_dir():
        raise LegsimError(
            f"{out}: volumes are not written in this format; end the name in "
            f"{', '.join(image_files.WRITABLE)}, or name a folder for a DICOM series"
        )
    if water_per_mm is not None and energy_kev is not None:
        raise LegsimError("--water-per-mm and --energy-kev both say water's attenuation; give one")
    volume = image_files.load_volume(path, axes=axes)
    voxels = "x".join(map(str, volume.grid.shape_zyx[::-1]))
    if to_image:
        image_files.save_volume(out, volume)
        return [f"{voxels} voxels (x, y, z), 1/mm: {out}"]
    if water_per_mm is not None:
        water, said = 1e3 * water_per_mm, "as given"
    else:
        energy = 60.0 if energy_kev is None else energy_kev
        water, said = materials.attenuation("water", energy), f"at {energy:g} keV"
    paths = ct_series.save(out, volume, water=water)
    return [
        f"Hounsfield units with water at {1e-3 * water:.5g}/mm ({said})",
        f"{len(paths)} axial slices, lowest first: {out}",
    ]
