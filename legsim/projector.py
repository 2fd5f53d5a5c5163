"""Phantom and geometry to projections: exact line integrals through triangle meshes, no voxels and no sampling along the ray."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from legsim.arrays import FloatArray
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Projections
from legsim.opencl import Device
from legsim.phantom import Phantom
from legsim.rasterizer import CAPACITY, LOCAL_SIZE, TILE, MeshRaster, TiledImage

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
        posed: world vertices of every part, (p, 3) m each, at a view; None leaves the phantom at rest. Return the same array again
            for a part that did not move: it is then not sent to the device again.
        progress: called as progress(views done, views).

    Raises:
        LegsimError: a part is not closed, surrounds the source or reaches behind it, or posed vertices do not fit.
    """
    raster = MeshRaster(phantom, device)
    integrator = _Integrator(raster, phantom)
    images = np.empty((len(geometry), *geometry.shape_vu), np.float32)
    sources = geometry.sources()
    for view, matrix in enumerate(geometry.matrices):
        raster.move(None if posed is None else posed(view))
        _require_in_front(raster, matrix, sources[view], view)
        # (u w, v w, depth, w), depth measured from the phantom's middle so that float32 resolves it
        rows = np.vstack([matrix, matrix[2]])
        rows[2, 3] = -rows[2, :3] @ raster.center
        raster.place(rows)
        integrator.image(raster.sort(geometry.shape_vu), np.linalg.inv(matrix[:, :3]), images[view])
        if progress is not None:
            progress(view + 1, len(geometry))
    return Projections(geometry, images)


class _Integrator:
    """The kernel that integrates, in its two builds."""

    def __init__(self, raster: MeshRaster, phantom: Phantom) -> None:
        self.raster, device = raster, raster.device
        files = ("mesh_hits.cl", "project_mesh.cl")
        self._fast = device.kernel("integrate", *files, TILE=TILE, WORDS=raster.words, CAPACITY=CAPACITY)
        self._roomy = device.kernel("integrate", *files, TILE=TILE, WORDS=raster.words, LISTS_IN_GLOBAL_MEMORY=1)
        attenuations = [0.0, *(part.attenuation for part in phantom.parts)]
        self._attenuations = device.upload(np.array(attenuations, np.float32))

    def image(self, tiled: TiledImage, directions: FloatArray, image: np.ndarray) -> None:
        """Fills ``image`` (rows, columns); ``directions`` (3, 3) maps (u, v, 1) to a ray of unit depth."""
        device = self.raster.device
        total = len(tiled.listed)
        target, needed = device.zeros(image.size), device.zeros(total, np.int32)
        columns = device.upload(np.ascontiguousarray(directions.T, np.float32))
        nothing = device.zeros(1)
        self._launch(self._fast, tiled, tiled.listed, (columns, needed, target), CAPACITY, (nothing, nothing))
        fullest = device.download(needed, np.empty(total, np.int32))
        full = np.flatnonzero(fullest).astype(np.uint32)
        if len(full):
            capacity = int(fullest.max())
            batch = max(1, (1 << 28) // (capacity * TILE * TILE * 8))
            for listed in np.array_split(full, -(-len(full) // batch)):
                spare = [device.zeros(len(listed) * capacity * TILE * TILE, dtype) for dtype in (np.float32, np.int32)]
                self._launch(self._roomy, tiled, listed, (columns, needed, target), capacity, spare)
        device.download(target, image)

    def _launch(
        self, kernel: Any, tiled: TiledImage, listed: np.ndarray, buffers: Sequence[Any], capacity: int, spare: Sequence[Any]
    ) -> None:
        raster = self.raster
        columns, needed, target = buffers
        kernel(
            *(raster.device.queue, (len(listed) * LOCAL_SIZE[0], LOCAL_SIZE[1]), LOCAL_SIZE),
            *(raster.triangles, raster.part_numbers, raster.whole, raster.rest),
            *(tiled.entries, tiled.starts, raster.device.upload(listed), tiled.pixels, tiled.tiles),
            *(self._attenuations, columns, needed, target, np.int32(capacity), *spare),
        )


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
