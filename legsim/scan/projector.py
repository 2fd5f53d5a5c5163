"""Phantom and geometry to projections: exact line integrals through triangle meshes.

There are no voxels and there is no sampling along the ray.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.opencl.device import Device
from legsim.phantom import clipping, materials, winding
from legsim.phantom.meshes import Part, Phantom
from legsim.phantom.raster import MeshRaster, TileKernel
from legsim.scan.spectrum import Spectrum

NEAREST_DEPTH = 1e-3
"""m in front of the source, along the principal ray, from which on parts are projected"""


def project(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    *,
    posed: Callable[[int], Sequence[FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Line integrals of attenuation from the source through each pixel's center.

    They run through all of the phantom, also the part beyond the detector. At each point the
    attenuation is that of the last part that contains it, 0 outside all. A part contains a point
    that its surface winds around, in either direction; so inner surfaces that face inward leave
    hollows.

    Args:
        posed: world vertices of every part, (p, 3) m each, at a view; None leaves the phantom at
            rest. Return the same read-only array again (such as ``Part.vertices``) for a part that
            did not move: it is then not sent to the device again.
        progress: called as progress(views done, views).

    Raises:
        LegsimError: a part is not closed or surrounds the source, or posed vertices do not fit.
    """
    images = np.empty((len(geometry), *geometry.shape_vu), np.float32)
    attenuations = np.array([[0.0], *([part.attenuation] for part in phantom.parts)], np.float32)
    for view, (image,) in enumerate(_views(phantom, geometry, device, attenuations, posed)):
        images[view] = image
        if progress is not None:
            progress(view + 1, len(geometry))
    return Projections(geometry, images)


def project_spectrum(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    spectrum: Spectrum,
    *,
    posed: Callable[[int], Sequence[FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Projects as :func:`project`, by -ln of the transmitted share of a spectrum: beams harden.

    The path through each material is exact, and the share of each energy follows from it. Parts of
    a known material attenuate as it does, at every energy; others by their own attenuation, the
    same at all energies.
    """
    known = materials.names()
    fillings = [
        (part.material, 0.0) if part.material in known else ("", part.attenuation)
        for part in phantom.parts
    ]
    channels = sorted(set(fillings))
    coefficients = np.stack(
        [
            spectrum.attenuations(name) if name else np.full(len(spectrum.energies_kev), value)
            for name, value in channels
        ]
    )
    present = np.zeros((len(phantom.parts) + 1, len(channels)), np.float32)
    present[np.arange(len(fillings)) + 1, [channels.index(filling) for filling in fillings]] = 1
    images = np.empty((len(geometry), *geometry.shape_vu), np.float32)
    for view, lengths in enumerate(_views(phantom, geometry, device, present, posed)):
        images[view] = spectrum.line_integral(coefficients, np.moveaxis(lengths, 0, -1))
        if progress is not None:
            progress(view + 1, len(geometry))
    return Projections(geometry, images)


def _views(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    values: np.ndarray,
    posed: Callable[[int], Sequence[FloatArray]] | None,
) -> Iterator[Float32Array]:
    """Integrals (channels, rows, columns) of ``values`` (parts + 1, channels), view by view.

    The array is reused for the next view.
    """
    raster = MeshRaster(phantom, device)
    images = np.empty((values.shape[1], *geometry.shape_vu), np.float32)
    integrate = TileKernel(raster, "integrate", "project_mesh.cl", CHANNELS=values.shape[1])
    uploaded = device.upload(values)
    sources = geometry.sources()
    for view, matrix in enumerate(geometry.matrices):
        vertices = [p.vertices for p in phantom.parts] if posed is None else posed(view)
        met = [
            _met(points, part, matrix, geometry.shape_vu)
            for points, part in zip(vertices, phantom.parts, strict=False)
        ]
        raster.move([*met, *vertices[len(met) :]])  # which refuses another number of parts
        _require_outside(raster, sources[view], view)
        clipped = _clipped(raster, matrix)
        if clipped is not None:
            yield _of_clipped(clipped, geometry, view, device, values)
            continue
        # (u w, v w, depth, w), depth measured from the phantom's middle so that float32 resolves it
        rows = np.vstack([matrix, matrix[2]])
        rows[2, 3] = -rows[2, :3] @ raster.center
        raster.place(rows)
        # columns of the map from (u, v, 1) to a ray of unit depth
        directions = device.upload(np.ascontiguousarray(np.linalg.inv(matrix[:, :3]).T, np.float32))
        target = device.zeros(images.size)
        integrate.run(raster.sort(geometry.shape_vu), (uploaded, directions), target)
        yield device.download(target, images)


def _met(
    points: FloatArray, part: Part, matrix: FloatArray, shape_vu: tuple[int, int]
) -> FloatArray:
    """The vertices (p, 3), without what reaches behind the source where no ray meets it.

    What lies on the outer side of one of the planes about the rays is not met. A part that lies
    there as a whole becomes one place in front of the source, where its triangles cover nothing. Of
    others the vertices behind become one of their neighbors in front, if all of their triangles lie
    on the outer side of the same plane: there they stay, and are as closed as before.
    """
    depths = points @ matrix[2, :3] + matrix[2, 3]
    if depths.min() >= NEAREST_DEPTH or points.shape != part.vertices.shape:
        return points
    rows, columns = shape_vu
    planes = np.stack(
        [
            matrix[2],
            matrix[0] + 0.5 * matrix[2],
            (columns - 0.5) * matrix[2] - matrix[0],
            matrix[1] + 0.5 * matrix[2],
            (rows - 0.5) * matrix[2] - matrix[1],
        ]
    )
    outside = points @ planes[:, :3].T + planes[:, 3] < 0
    if outside.all(axis=0).any():
        ahead = np.linalg.solve(matrix[:, :3], [0.0, 0.0, 1.0] - matrix[:, 3])
        return np.broadcast_to(np.asarray(ahead, np.float64), points.shape)
    behind = depths < NEAREST_DEPTH
    of_behind = part.triangles[behind[part.triangles].any(axis=1)]
    neighbors = np.unique(of_behind[~behind[of_behind]])
    if len(neighbors) == 0 or not outside[of_behind, 1:].all(axis=(0, 1)).any():
        return points
    return np.where(behind[:, None], points[neighbors[0]], points)


def _require_outside(raster: MeshRaster, source: FloatArray, view: int) -> None:
    for part, (low, high), points in zip(raster.parts, raster.boxes, raster.vertices, strict=True):
        near = ((low <= source) & (source <= high)).all()
        if near and winding.numbers(points, part.triangles, source[None]).any():
            raise LegsimError(
                f"view {view}: the source is inside of part {part.name!r}; move the phantom or the "
                "source apart"
            )


def _clipped(raster: MeshRaster, matrix: FloatArray) -> Phantom | None:
    """The phantom as it was moved, cut off right before the source; None if nothing is nearer."""
    normal, offset = matrix[2, :3], matrix[2, 3]
    corners = np.where(normal > 0, raster.boxes[:, 0], raster.boxes[:, 1])
    if (corners @ normal + offset).min() >= NEAREST_DEPTH:
        return None
    depths = [points @ normal + offset for points in raster.vertices]
    if min(one.min() for one in depths) >= NEAREST_DEPTH:
        return None
    ahead = np.linalg.solve(matrix[:, :3], [0.0, 0.0, 1.0] - matrix[:, 3])
    parts = []
    for part, points, deep in zip(raster.parts, raster.vertices, depths, strict=True):
        # farther by what rounding cannot bring back
        cut = clipping.in_front(points, part.triangles, deep, (1 + 1e-6) * NEAREST_DEPTH)
        # one place in front of the source, where triangles cover nothing, stands for nothing
        vertices, triangles = cut if len(cut[1]) else (0 * points + ahead, part.triangles)
        used, renumbered = np.unique(triangles, return_inverse=True)
        renumbered = renumbered.reshape(-1, 3).astype(np.int32)
        parts.append(replace(part, vertices=vertices[used], triangles=renumbered))
    return Phantom(tuple(parts))


def _of_clipped(
    phantom: Phantom, geometry: ConeBeamGeometry, view: int, device: Device, values: np.ndarray
) -> Float32Array:
    """Integrals (channels, rows, columns) of one view of what is in front of its source."""
    (images,) = _views(phantom, geometry[view : view + 1], device, values, None)
    return images
