"""A lopsided smooth body in a small grid, with the regions of a leg."""

import numpy as np

from legsim.core import transforms
from legsim.evaluation import regions as evaluation_regions
from legsim.evaluation.regions import Region, leg_regions
from legsim.geometry.volume import Volume, VolumeGrid

GRID = VolumeGrid.cubic(48, 0.002, (0.1, 0.5, -0.2))


def blob(grid: VolumeGrid, moved: np.ndarray | None = None) -> Volume:
    """A lopsided smooth body, seen after a rigid motion of it."""
    x, y, z = grid.axes()
    points = np.stack(np.meshgrid(z, y, x, indexing="ij"), -1)[..., ::-1]
    if moved is not None:
        points = transforms.apply(transforms.inverse(moved), points.reshape(-1, 3)).reshape(
            points.shape
        )
    offsets = points - np.array(grid.center)
    body = np.exp(-np.sum((offsets / [0.02, 0.03, 0.015]) ** 2, -1))
    bump = np.exp(-np.sum(((offsets - [0.015, 0.01, 0.02]) / 0.008) ** 2, -1))
    return Volume(grid, (20 * (body + bump)).astype(np.float32))


def regions(grid: VolumeGrid) -> tuple[Region, ...]:
    return leg_regions(
        blob(grid).attenuation > 2, grid, 0.5, evaluation_regions.cylinder(grid, 0.045)
    )
