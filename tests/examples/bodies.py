"""Bodies of simple shapes, and scanners that look at them."""

import numpy as np
import trimesh

from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom.meshes import Part


def circular(
    views: int = 3, shape_vu: tuple[int, int] = (48, 62), pitch: float = 6.16e-3, **options
) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31.0,
        angles=np.deg2rad(37.0 * np.arange(views) + 5.0),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=shape_vu,
        pixel_pitch=pitch,
        **options,
    )


def looking_along_z(shape_vu: tuple[int, int], focal: float = 64.0) -> ConeBeamGeometry:
    """Source at the origin, u = focal x / z + middle: powers of two hit pixel centers exactly."""
    rows, columns = shape_vu
    matrix = [[focal, 0, columns // 2, 0], [0, focal, rows // 2, 0], [0, 0, 1, 0]]
    return ConeBeamGeometry(np.zeros(1), np.array([matrix], float), shape_vu)


def part(
    name: str, mesh: trimesh.Trimesh, attenuation: float = 1.0, moved: np.ndarray | None = None
) -> Part:
    vertices = np.asarray(mesh.vertices)
    return Part(
        name,
        "water",
        attenuation,
        vertices if moved is None else transforms.apply(moved, vertices),
        np.asarray(mesh.faces),
    )


def sphere(
    name: str,
    radius: float,
    center=(0.0, 0.0, 0.0),
    attenuation: float = 1.0,
    subdivisions: int = 3,
) -> Part:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return part(name, mesh, attenuation, transforms.translation(center))
