"""Triangle meshes intersected by the rays of an image: closed, placed, sorted into tiles.

This happens on the device and serves projector and voxelizer. The device code and why it is
watertight: ``kernels/mesh_crossings.cl``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.opencl.device import Device
from legsim.phantom import surfaces
from legsim.phantom.meshes import Part, Phantom

TILE = 8
"""pixels along each side of a tile"""

CAPACITY = 48
"""crossings per pixel that fit in local memory: 24 kB per work-group

Fuller tiles are repeated with lists in global memory.
"""

_CHUNK = 256
"""vertices or triangles of a work-group at most"""

_SPARE_BYTES = 1 << 28

_CROSSING_BYTES = 8
"""a depth and a tag"""


@dataclass(frozen=True, slots=True, eq=False)
class TiledImage:
    """Triangles sorted into the tiles of one image, on the device."""

    pixels: np.ndarray
    """(2,) int32: columns, rows"""
    tiles: np.ndarray
    """(2,) int32: tiles along columns, rows"""
    entries: Any
    """buffer of uint32: triangles, tile after tile"""
    starts: Any
    """buffer of uint64 (tiles + 1,): where each tile's triangles begin"""
    listed: np.ndarray
    """uint32: the tiles that hold triangles"""


class MeshRaster:
    """A phantom's triangles on a device.

    Vertices move part by part; only what moved is sent again.
    """

    def __init__(self, phantom: Phantom, device: Device) -> None:
        """Uploads the triangles.

        Raises:
            LegsimError: a part is not a closed surface.
        """
        for part in phantom.parts:
            require_closed(part)
        self.device, self.parts = device, phantom.parts
        # on a CPU a work-item takes four pixels of a tile, so that the triangles are fetched once
        # for all; a GPU rather has more work-items
        self.group_bands = 1 if device.is_cpu else group_bands(device.group_size)
        self.chunk = min(_CHUNK, device.group_size)
        lists = device.local_bytes // (_CROSSING_BYTES * TILE * TILE)
        self.capacity = max(1, min(CAPACITY, lists))
        self.words = (len(phantom.parts) + 31) // 32
        firsts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in phantom.parts])])
        triangles = np.concatenate(
            [part.triangles + first for part, first in zip(phantom.parts, firsts[:-1], strict=True)]
        )
        numbers = np.repeat(
            np.arange(len(phantom.parts), dtype=np.int32),
            [len(part.triangles) for part in phantom.parts],
        )
        self.count, self._firsts = len(triangles), firsts
        self.triangles, self.part_numbers = (
            device.upload(triangles.astype(np.int32)),
            device.upload(numbers),
        )
        self.whole, self.rest = device.zeros(2 * firsts[-1], np.int32), device.zeros(4 * firsts[-1])
        low, high = bounds(
            np.concatenate([np.stack(bounds(part.vertices)) for part in phantom.parts])
        )
        self.center = (low + high) / 2
        self._points: list[Any] = [None] * len(phantom.parts)
        self.vertices: list[FloatArray] = [np.empty(0)] * len(phantom.parts)
        self.boxes = np.zeros((len(phantom.parts), 2, 3))
        self._place = device.kernel(
            "place_vertices",
            "mesh_crossings.cl",
            TILE=TILE,
            WORDS=self.words,
            CAPACITY=CAPACITY,
            GROUP_BANDS=1,
        )
        self._sort = device.kernel(
            "sort_into_tiles",
            "mesh_crossings.cl",
            TILE=TILE,
            WORDS=self.words,
            CAPACITY=CAPACITY,
            GROUP_BANDS=1,
        )

    def move(self, vertices: Sequence[FloatArray] | None) -> None:
        """Sets the world vertices of each part, (p, 3) m; None for the phantom at rest.

        The same read-only array as in the last call is not sent again.

        Raises:
            LegsimError: a wrong number of parts or vertices, or a coordinate that is not finite.
        """
        vertices = [part.vertices for part in self.parts] if vertices is None else vertices
        if len(vertices) != len(self.parts):
            raise LegsimError(
                f"posed vertices for {len(vertices)} parts; the phantom has {len(self.parts)}"
            )
        for k, (part, points) in enumerate(zip(self.parts, vertices, strict=True)):
            if points is self.vertices[k] and not points.flags.writeable:
                continue
            if points.shape != part.vertices.shape:
                raise LegsimError(
                    f"posed vertices of part {part.name!r} have shape {points.shape}; expected "
                    f"{part.vertices.shape}"
                )
            self.boxes[k] = bounds(points)
            if not np.isfinite(self.boxes[k]).all():
                raise LegsimError(
                    f"posed vertices of part {part.name!r} hold a coordinate that is not a finite "
                    "number"
                )
            self._points[k], self.vertices[k] = (
                self.device.upload(_pairs(np.asarray(points, float) - self.center)),
                points,
            )

    def place(self, rows: FloatArray) -> None:
        """Maps all vertices by ``rows`` (4, 4): world (x, y, z, 1) to (U, V, depth, W).

        Pixel coordinates are U/W and V/W.
        """
        about_center = rows.copy()
        about_center[:, 3] += rows[:, :3] @ self.center
        pairs = _pairs(about_center)
        buffer = self.device.upload(pairs)
        for k, part in enumerate(self.parts):
            count = len(part.vertices)
            self._place(
                *(
                    self.device.queue,
                    _padded(count, self.chunk),
                    (self.chunk,),
                    self._points[k],
                    np.uint32(count),
                    buffer,
                ),
                *(np.uint64(self._firsts[k]), self.whole, self.rest),
            )

    def sort(self, shape_vu: tuple[int, int]) -> TiledImage:
        """Sorts the placed triangles into tiles of an image of ``shape_vu`` (rows, columns)."""
        pixels = np.array(shape_vu[::-1], np.int32)
        tiles = (pixels + TILE - 1) // TILE
        total = int(np.prod(tiles.astype(np.int64)))
        counts = np.empty(total, np.int32)
        slots = self.device.zeros(total, np.int32)
        nothing = self.device.zeros(1, np.uint64)
        self._launch_sort(pixels, tiles, slots, nothing, False, nothing)
        self.device.download(slots, counts)
        starts = np.concatenate([np.zeros(1, np.uint64), np.cumsum(counts, dtype=np.uint64)])
        entries = self.device.zeros(max(int(starts[-1]), 1), np.uint32)
        uploaded = self.device.upload(starts)
        self._launch_sort(
            pixels, tiles, self.device.zeros(total, np.int32), uploaded, True, entries
        )
        return TiledImage(
            pixels, tiles, entries, uploaded, np.flatnonzero(counts).astype(np.uint32)
        )

    def _launch_sort(
        self,
        pixels: np.ndarray,
        tiles: np.ndarray,
        slots: Any,
        starts: Any,
        filling: bool,
        entries: Any,
    ) -> None:
        self._sort(
            *(
                self.device.queue,
                _padded(self.count, self.chunk),
                (self.chunk,),
                self.triangles,
                np.uint32(self.count),
                self.whole,
                self.rest,
            ),
            *(pixels, tiles, slots, starts, np.int32(filling), entries),
        )


class TileKernel:
    """A kernel on a tiled image, one work-group per tile, in two builds.

    Crossings are in local memory, or in global memory where more rays of a tile cross than fit.
    """

    def __init__(self, raster: MeshRaster, name: str, file: str, **defines: int | str) -> None:
        defines = {
            "TILE": TILE,
            "WORDS": raster.words,
            "GROUP_BANDS": raster.group_bands,
            **defines,
        }
        self._raster = raster
        self._fast = raster.device.kernel(
            name, "mesh_crossings.cl", file, CAPACITY=raster.capacity, **defines
        )
        self._roomy = raster.device.kernel(
            name, "mesh_crossings.cl", file, LISTS_IN_GLOBAL_MEMORY=1, **defines
        )

    def run(self, tiled: TiledImage, arguments: Sequence[Any], target: Any) -> None:
        """Runs the kernel over the tiles that hold triangles.

        ``arguments`` are the kernel's own; ``target`` is its output.
        """
        device = self._raster.device
        total = int(np.prod(tiled.tiles.astype(np.int64)))
        if len(tiled.listed) == 0:
            return
        needed, nothing = device.zeros(total, np.int32), device.zeros(1)
        self._launch(
            self._fast,
            tiled,
            tiled.listed,
            (*arguments, needed, target),
            self._raster.capacity,
            (nothing, nothing),
        )
        fullest = device.download(needed, np.empty(total, np.int32))
        full = np.flatnonzero(fullest).astype(np.uint32)
        if len(full) == 0:
            return
        capacity = int(fullest.max())
        tiles_at_once = max(1, _SPARE_BYTES // (capacity * TILE * TILE * 8))
        for first in range(0, len(full), tiles_at_once):
            listed = full[first : first + tiles_at_once]
            spare = [
                device.zeros(len(listed) * capacity * TILE * TILE, dtype)
                for dtype in (np.float32, np.int32)
            ]
            self._launch(self._roomy, tiled, listed, (*arguments, needed, target), capacity, spare)

    def _launch(
        self,
        kernel: Any,
        tiled: TiledImage,
        listed: np.ndarray,
        own: Sequence[Any],
        capacity: int,
        spare: Sequence[Any],
    ) -> None:
        raster = self._raster
        kernel(
            *(
                raster.device.queue,
                (len(listed) * 2 * TILE, raster.group_bands),
                (2 * TILE, raster.group_bands),
            ),
            *(raster.triangles, raster.part_numbers, raster.whole, raster.rest),
            *(tiled.entries, tiled.starts, raster.device.upload(listed), tiled.pixels, tiled.tiles),
            *(*own, np.int32(capacity), *spare),
        )


def group_bands(limit: int) -> int:
    """Bands of a tile that a work-group of at most ``limit`` work-items can take at once."""
    bands = TILE // 2
    while bands > 1 and bands * 2 * TILE > limit:
        bands //= 2
    return bands


def bounds(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest coordinates (3,) of points (p, 3)."""
    return points.min(axis=0), points.max(axis=0)


def require_closed(part: Part) -> None:
    """Checks that no ray can enter the part without leaving it.

    Raises:
        LegsimError: the surface is open, or neighbors disagree about which side is outside.
    """
    if surfaces.is_closed(part.triangles):
        return
    raise LegsimError(
        f"part {part.name!r} is not a closed, consistently oriented surface: "
        f"{len(surfaces.unpaired(part.triangles))} of its edges lack "
        "a neighbor of opposite direction; fill the holes, merge doubled vertices and orient the "
        "triangles"
    )


def _pairs(values: FloatArray) -> np.ndarray:
    """Splits (n, m) float64 into float32 (n, 2 m): rounded values, then the remainders."""
    high = values.astype(np.float32)
    return np.concatenate([high, (values - high).astype(np.float32)], axis=1)


def _padded(count: int, chunk: int) -> tuple[int]:
    return (-(-count // chunk) * chunk,)
