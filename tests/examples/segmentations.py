"""Segmentations to import: written by ITK in a patient's axes, and of the leg phantom."""

from pathlib import Path

import numpy as np
import SimpleITK as sitk

from legsim.geometry.image_files import LPS_FROM_WORLD
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.phantom import voxelize
from legsim.phantom.leg_phantom import LegPhantom


def write(path: Path, labels: np.ndarray, grid: VolumeGrid) -> Path:
    """Labels (z, y, x) on a grid of world as a scanner's image: its axes are along world's."""
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * LPS_FROM_WORLD @ grid.origin).tolist())
    image.SetDirection(LPS_FROM_WORLD.ravel().tolist())
    sitk.WriteImage(image, str(path))
    return path


def of_phantom(
    legs: LegPhantom, vertices: tuple, grid: VolumeGrid, device: Device
) -> tuple[np.ndarray, str]:
    """Labels of posed legs, a bone and its layers one number, and the text of their map."""
    found = voxelize.labels(legs.phantom, grid, device, posed=vertices)
    numbers: dict[tuple[str, str, str], int] = {}
    table = np.zeros(len(legs.phantom.parts) + 1, np.uint8)
    for k, (part, segment) in enumerate(zip(legs.phantom.parts, legs.segments, strict=True), 1):
        base, tissue = part.name[:-2], part.material
        for layer in ("_cortex", "_cancellous", "_marrow"):
            if base.endswith(layer):
                base, tissue = base.removesuffix(layer), "bone"
        table[k] = numbers.setdefault((base, tissue, segment), len(numbers) + 1)
    lines = []
    for (base, tissue, segment), number in numbers.items():
        lines += ["[[label]]", f"number = {number}", f'name = "{base}"', f'tissue = "{tissue}"']
        lines += [f'segment = "{segment}"']
        lines += ["envelope = true"] if base in ("skin", "fat") else []
    return table[found], "\n".join(lines) + "\n"
