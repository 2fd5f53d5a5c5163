"""A knee of simple solids: two shafts with balls that nearly touch, a kneecap, and muscle."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.correction.bone_regions import axis_distances
from legsim.geometry.volume import Volume, VolumeGrid

JOINTS = np.array([[0.0, 0.4, 0.0], [0.0, 0.0, 0.0], [-0.1, -0.38, 0.02]])
"""hip, knee, ankle, m"""

PATELLA = np.array([0.052, 0.012, 0.004])
"""middle of the kneecap, m"""

GRID = VolumeGrid((70, 90, 80), (0.002, 0.002, 0.002), (0.01, 0.0, 0.0))
"""18 cm high"""

SOFT, SPONGY, CORTEX, CARTILAGE = 20.0, 28.0, 45.0, 24.0
"""1/m"""


def bones(points: FloatArray) -> FloatArray:
    """(p, 3) m below the surface of femur, tibia and patella, negative outside."""
    to_thigh, to_shank = axis_distances(points, JOINTS).T
    shank = (JOINTS[2] - JOINTS[1]) / np.linalg.norm(JOINTS[2] - JOINTS[1])
    height = points @ shank
    # condyles about the knee's center, the shaft above them, the plateau 24 mm below
    condyles = 0.022 - np.linalg.norm(points * [1, 1, 0.55], axis=-1)
    shaft = np.minimum(0.014 - to_thigh, points[:, 1])
    plateau = np.minimum(np.minimum(height - 0.0245, 0.05 - height), 0.032 - to_shank)
    below = np.minimum(height - 0.03, 0.013 - to_shank)
    cap = 0.013 - np.linalg.norm((points - PATELLA) * [1, 0.7, 0.7], axis=-1)
    return np.stack([np.maximum(condyles, shaft), np.maximum(plateau, below), cap], -1)


def truth(grid: VolumeGrid = GRID) -> np.ndarray:
    """Labels (z, y, x) of the bones."""
    depth = bones(grid.positions())
    return np.where(depth.max(-1) > 0, depth.argmax(-1) + 1, 0).reshape(grid.shape_zyx)


def volume(rng: np.random.Generator, noise: float = 1.0, gap: float = CARTILAGE) -> Volume:
    """Attenuation of the knee, muscle around it, ``gap`` between the bones, and noise."""
    points = GRID.positions()
    depth = bones(points)
    deepest = depth.max(-1)
    nearby = np.sort(depth, -1)[:, -2:]
    leg = axis_distances(points, JOINTS).min(-1) < 0.065
    found = np.where(leg, SOFT, 0.0)
    found[(nearby > -0.004).all(-1)] = gap
    found[deepest > 0] = CORTEX
    found[deepest > 0.003] = SPONGY
    found += noise * rng.standard_normal(len(found))
    return Volume(GRID, found.reshape(GRID.shape_zyx).astype(np.float32))
