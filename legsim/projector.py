"""Phantom and geometry to projections: exact line integrals through triangle meshes, no voxels and no sampling along the ray."""

from collections.abc import Callable, Sequence

import numpy as np

from legsim.arrays import FloatArray
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Projections
from legsim.opencl import Device
from legsim.phantom import Phantom
from legsim.rasterizer import MeshRaster, TileKernel

NEAREST_DEPTH = 1e-3
"""m in front of the source, along the principal ray, that every vertex must keep"""


def project(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    *,
    posed: Callable[[int], Sequence[FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Line integrals of attenuation from the source through each pixel's center and all of the phantom, also what lies beyond the detector.

    At each point the attenuation is that of the last part that contains it, 0 outside all. A part contains a point that its
    surface winds around, in either direction; so inner surfaces that face inward leave hollows.

    Args:
        posed: world vertices of every part, (p, 3) m each, at a view; None leaves the phantom at rest. Return the same read-only array
            again (such as ``Part.vertices``) for a part that did not move: it is then not sent to the device again.
        progress: called as progress(views done, views).

    Raises:
        LegsimError: a part is not closed, surrounds the source or reaches behind it, or posed vertices do not fit.
    """
    raster = MeshRaster(phantom, device)
    images = np.empty((len(geometry), *geometry.shape_vu), np.float32)
    integrate = TileKernel(raster, "integrate", "project_mesh.cl")
    attenuations = device.upload(np.array([0.0, *(part.attenuation for part in phantom.parts)], np.float32))
    sources = geometry.sources()
    for view, matrix in enumerate(geometry.matrices):
        raster.move(None if posed is None else posed(view))
        _require_in_front(raster, matrix, sources[view], view)
        # (u w, v w, depth, w), depth measured from the phantom's middle so that float32 resolves it
        rows = np.vstack([matrix, matrix[2]])
        rows[2, 3] = -rows[2, :3] @ raster.center
        raster.place(rows)
        # columns of the map from (u, v, 1) to a ray of unit depth
        directions = device.upload(np.ascontiguousarray(np.linalg.inv(matrix[:, :3]).T, np.float32))
        target = device.zeros(images[0].size)
        integrate.run(raster.sort(geometry.shape_vu), (attenuations, directions), target)
        device.download(target, images[view])
        if progress is not None:
            progress(view + 1, len(geometry))
    return Projections(geometry, images)


def _require_in_front(raster: MeshRaster, matrix: FloatArray, source: FloatArray, view: int) -> None:
    for part, (low, high), points in zip(raster.parts, raster.boxes, raster.vertices, strict=True):
        if ((low <= source) & (source <= high)).all():
            raise LegsimError(
                f"view {view}: the source is inside the bounding box of part {part.name!r}; move the phantom or the source apart"
            )
        nearest = np.where(matrix[2, :3] > 0, low, high) @ matrix[2, :3] + matrix[2, 3]
        if nearest < NEAREST_DEPTH and (points @ matrix[2, :3] + matrix[2, 3]).min() < NEAREST_DEPTH:
            raise LegsimError(
                f"view {view}: part {part.name!r} reaches the plane of the source or lies behind it; "
                "only what is in front of the source can be projected"
            )
