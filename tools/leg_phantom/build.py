"""Builds the meshes of the leg phantom: implicit surfaces, marching cubes, closed meshes in
models/leg_phantom/.

Usage: python -m tools.leg_phantom [--out FOLDER] [--detail coarse|fine]
The same script on the same library versions writes the same bytes. Only the right leg is built; the
left one is its mirror image.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from tools.leg_phantom.fields import Array, Field, graded_axis, mesh_of
from tools.leg_phantom.joint import (
    FOOT,
    Grid,
    femur_cartilage,
    femur_layers,
    fibula_layers,
    menisci,
    patella_layers,
    sparse,
    tibia_cartilages,
    tibia_layers,
)
from tools.leg_phantom.soft import MUSCLES, TENDONS, VESSELS, Rows, fat, muscle, skin, tendon

FOLDER = Path(__file__).parents[2] / "models/leg_phantom"
DETAILS = {"coarse": 1.0, "fine": 0.50}
"""factor on all grid spacings"""

Layers = Callable[[Grid], dict[str, Array]]


@dataclass(frozen=True)
class Block:
    """A grid and the surfaces that are found on it."""

    layers: Layers
    low: Sequence[float]
    """(3,) m"""
    high: Sequence[float]
    step: float
    """m, of the coarse mesh, across and within the fine ranges of y"""
    along: float
    """m, spacing along y elsewhere"""
    fine: Sequence[tuple[float, float]]

    def axes(self, factor: float) -> Grid:
        """Grid axes; spacing times ``factor``."""
        step = self.step * factor
        x = graded_axis(self.low[0], self.high[0], [], step, step)
        z = graded_axis(self.low[2], self.high[2], [], step, step)
        return x, graded_axis(self.low[1], self.high[1], self.fine, step, self.along * factor), z

    def meshes(self, factor: float) -> dict[str, trimesh.Trimesh]:
        """Closed meshes by name."""
        axes = self.axes(factor)
        return {name: mesh_of(values, axes, name) for name, values in self.layers(axes).items()}


def single(name: str, field: Field) -> Layers:
    """Layers of one surface."""
    return lambda axes: {name: field(*sparse(axes))}


def around(name: str, rows: Rows, field: Field, step: float, along: float) -> Block:
    """Block around a loft."""
    table = np.array(rows)
    low = [
        (table[:, 1] - table[:, 3]).min() - 0.006,
        table[:, 0].min() - 0.006,
        (table[:, 2] - table[:, 4]).min() - 0.006,
    ]
    high = [
        (table[:, 1] + table[:, 3]).max() + 0.006,
        table[:, 0].max() + 0.006,
        (table[:, 2] + table[:, 4]).max() + 0.006,
    ]
    return Block(single(name, field), low, high, step, along, [])


def blocks() -> list[Block]:
    """All surfaces of the right leg."""
    return [
        Block(
            single("skin", skin),
            (-0.13, -0.915, -0.10),
            (0.23, 0.10, 0.12),
            0.0130,
            0.020,
            [(-0.45, -0.34)],
        ),
        Block(
            single("fat", fat),
            (-0.13, -0.915, -0.10),
            (0.23, 0.10, 0.12),
            0.0130,
            0.020,
            [(-0.45, -0.34)],
        ),
        *(
            around(
                f"muscle_{name}",
                rows,
                muscle(name),
                0.0048 if name == "sartorius" else 0.0105,
                0.020,
            )
            for name, rows in MUSCLES.items()
        ),
        *(
            around(name, rows, tendon(name), 0.0030, 0.007)
            for name, rows in (TENDONS | VESSELS).items()
        ),
        Block(
            tibia_cartilages,
            (-0.034, -0.040, -0.042),
            (0.024, -0.029, 0.040),
            0.0019,
            0.0019,
            [(-0.05, 0.0)],
        ),
        Block(
            menisci,
            (-0.033, -0.036, -0.041),
            (0.022, -0.022, 0.040),
            0.0019,
            0.0019,
            [(-0.05, 0.0)],
        ),
        Block(
            femur_cartilage,
            (-0.036, -0.434, -0.044),
            (0.044, -0.355, 0.044),
            0.0023,
            0.0023,
            [(-1, 1)],
        ),
        Block(
            femur_layers,
            (-0.040, -0.436, -0.052),
            (0.048, 0.034, 0.084),
            0.0050,
            0.010,
            [(-0.44, -0.37)],
        ),
        Block(
            tibia_layers,
            (-0.040, -0.460, -0.046),
            (0.042, -0.018, 0.046),
            0.0050,
            0.012,
            [(-0.07, -0.02)],
        ),
        Block(
            fibula_layers,
            (-0.038, -0.464, 0.016),
            (0.012, -0.030, 0.048),
            0.0040,
            0.012,
            [(-0.05, -0.04)],
        ),
        Block(
            FOOT["talus"],
            (-0.030, -0.040, -0.026),
            (0.050, 0.012, 0.024),
            0.0062,
            0.0062,
            [(-1, 1)],
        ),
        Block(
            FOOT["calcaneus"],
            (-0.018, -0.016, -0.024),
            (0.090, 0.038, 0.018),
            0.0062,
            0.0062,
            [(-1, 1)],
        ),
        Block(
            FOOT["midfoot"],
            (0.070, -0.026, -0.036),
            (0.184, 0.032, 0.034),
            0.0062,
            0.0062,
            [(-1, 1)],
        ),
        Block(
            patella_layers,
            (-0.018, -0.006, -0.028),
            (0.020, 0.049, 0.028),
            0.0021,
            0.0021,
            [(-0.1, 0.1)],
        ),
    ]


def compact(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (p, 3) float32 and triangles (t, 3) int32 of a mesh that must be closed and
    outward.
    """
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
        raise ValueError("a surface is not closed and outward")
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)


def build(detail: str) -> dict[str, np.ndarray]:
    """Arrays ``<part>.vertices`` and ``<part>.triangles`` of one level of detail."""
    arrays: dict[str, np.ndarray] = {}
    for block in blocks():
        for name, mesh in block.meshes(DETAILS[detail]).items():
            arrays[f"{name}.vertices"], arrays[f"{name}.triangles"] = compact(mesh)
    return arrays


def main() -> None:
    """Writes coarse.npz and fine.npz."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=FOLDER)
    parser.add_argument("--detail", choices=DETAILS, action="append")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for detail in arguments.detail or DETAILS:
        arrays = build(detail)
        np.savez_compressed(arguments.out / f"{detail}.npz", allow_pickle=False, **arrays)
        for name, array in arrays.items():
            if name.endswith(".triangles"):
                print(
                    f"{detail:7s} {name.removesuffix('.triangles'):26s} {len(array):7d} triangles"
                )
        print(
            f"{detail:7s} {'in all':26s} "
            f"{sum(len(a) for n, a in arrays.items() if n.endswith('.triangles')):7d} triangles, "
            "one leg"
        )
