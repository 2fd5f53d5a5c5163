"""The scan: C-arm and projections, the deforming skin, slices of the reconstructions."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.scene.slices import VolumeSlices
from legsim.scene.values import MovingSurface
from legsim.view.motion import vertex_normals
from legsim.view.stream import Recorder, entity_path

IMAGE_COLUMNS = 200
"""approximate columns kept of a projection: a recording is to look at, the .mha file to measure"""
PATH = (110, 150, 190)
SURFACE_VALUES = 500_000  # vertices times logged times that a surface may take: 6 MB
SURFACE_VERTICES = 6_000


def log_c_arm(recorder: Recorder, projections: Projections) -> None:
    """Logs source, its path, and the detector with its image, turning with the views."""
    rows, columns = projections.geometry.shape_vu
    binned = projections.coarser(max(1, min(columns // IMAGE_COLUMNS, rows)))
    geometry = binned.geometry
    intrinsics, world_from_camera, mirrored = cameras(geometry)
    times, rows = recorder.from_start(geometry.times)
    recorder.poses("world/c_arm", times, world_from_camera[rows])
    # the viewer needs a complete pinhole: split into static and moving parts it finds no transform
    pinholes = rr.Pinhole.columns(
        image_from_camera=intrinsics[rows],
        resolution=np.tile(geometry.shape_vu[::-1], (len(rows), 1)),
        image_plane_distance=intrinsics[rows, 0, 0] * geometry.pixel_pitch,
        color=[PATH] * len(rows),
    )
    recorder.columns("world/c_arm/detector", times, pinholes)
    recorder.static(
        "world/c_arm/detector", rr.TransformAxes3D(0.0)
    )  # a camera's axes would be as long as the image plane is far
    upright = binned.line_integrals[:, ::-1, ::-1] if mirrored else binned.line_integrals[:, ::-1]
    _log_images(
        recorder,
        "world/c_arm/detector/projection",
        times,
        _gray(upright, float(np.percentile(upright, 99.9)))[rows],
    )
    recorder.static(
        "world/source_path",
        rr.LineStrips3D([geometry.sources()], radii=rr.Radius.ui_points(1.0), colors=PATH),
    )
    recorder.static(
        "world/c_arm",
        rr.Points3D(
            [[0, 0, 0]], radii=0.02, colors=(255, 220, 80), labels="source", show_labels=False
        ),
    )


def cameras(geometry: ConeBeamGeometry) -> tuple[FloatArray, FloatArray, bool]:
    """Splits the matrices into rerun's: intrinsics (v, 3, 3) and world_from_camera (v, 4, 4).

    Also returns whether columns are mirrored. Pictures have their first row above, so rows are
    reversed; rerun's pixel centers lie at halves. The split is an RQ decomposition; where rotation
    and rows' sense do not make a right-handed camera, the columns are reversed too.
    """
    rows, columns = geometry.shape_vu
    left_handed = bool(np.linalg.det(geometry.matrices[0, :, :3]) > 0)
    flip = np.array([[1, 0, 0.5], [0, -1, rows - 0.5], [0, 0, 1.0]])
    if left_handed:
        flip = np.array([[-1, 0, columns - 0.5], [0, -1, rows - 0.5], [0, 0, 1.0]])
    matrices = flip @ geometry.matrices
    intrinsics, rotations = _rq(matrices[:, :, :3])
    poses = np.tile(np.eye(4), (len(matrices), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = np.swapaxes(rotations, -1, -2), geometry.sources()
    return intrinsics, poses, left_handed


def _rq(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Decomposes (v, 3, 3) into upper-triangular with positive diagonal times orthonormal."""
    reverse = np.eye(3)[::-1]
    q, r = np.linalg.qr(np.swapaxes(reverse @ matrices, -1, -2))
    upper = reverse @ np.swapaxes(r, -1, -2) @ reverse
    rotation = reverse @ np.swapaxes(q, -1, -2)
    signs = np.sign(np.diagonal(upper, axis1=-2, axis2=-1))
    return upper * signs[:, None, :], rotation * signs[:, :, None]


def log_surface(recorder: Recorder, surface: MovingSurface) -> None:
    """Logs a deforming surface, thinned in space and in time until it fits.

    It has the normals of its first shape.
    """
    kept, triangles = thinned(surface.vertices[0], surface.triangles, SURFACE_VERTICES)
    step = -(-len(surface.times) * len(kept) // SURFACE_VALUES)
    times, rows = recorder.from_start(surface.times[::step])
    vertices = surface.vertices[::step, kept][rows]
    entity = entity_path("world", "surfaces", surface.name)
    normals = vertex_normals(vertices[0].astype(float), triangles)
    style = rr.Mesh3D.from_fields(
        triangle_indices=triangles, vertex_normals=normals, albedo_factor=(224, 172, 140, 110)
    )
    recorder.static(entity, style)
    columns = rr.Mesh3D.columns(vertex_positions=vertices.reshape(-1, 3)).partition(
        np.full(len(vertices), len(kept))
    )
    recorder.columns(entity, times, columns)


def thinned(
    vertices: Float32Array, triangles: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Thins a surface: indices of kept vertices, and triangles among them.

    One vertex per cell of a grid is kept, coarse enough to keep at most ``count``. Vertex
    clustering (Rossignac and Borrel 1993). Indices, not positions, so that it holds for every shape
    of the surface.
    """
    low, high = vertices.min(0), vertices.max(0)
    cell = float((high - low).max()) / 512
    kept, group = np.arange(len(vertices)), np.arange(len(vertices))
    while len(kept) > count:
        _, kept, group = np.unique(
            np.floor((vertices - low) / cell).astype(int),
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        cell *= 1.2
    merged = group[triangles]
    whole = (
        (merged[:, 0] != merged[:, 1])
        & (merged[:, 1] != merged[:, 2])
        & (merged[:, 2] != merged[:, 0])
    )
    return kept, merged[whole].astype(np.int32)


def log_slices(recorder: Recorder, shown: Sequence[VolumeSlices]) -> None:
    """Logs all methods next to each other in one picture, in one gray window.

    Rows are shank, thigh and sagittal slices. Without a volume there is no picture.
    """
    if not shown:
        return
    rows = [
        [np.flipud(one.shank) for one in shown],
        [np.flipud(one.thigh) for one in shown],
        [np.flipud(one.sagittal) for one in shown],
    ]
    gap = 6
    heights = [max(image.shape[0] for image in row) for row in rows]
    width = max(image.shape[1] for row in rows for image in row)
    canvas = np.zeros((sum(heights) + 2 * gap, len(shown) * (width + gap) - gap), np.uint8)
    top = shown[0].white
    y = 0
    for row, height in zip(rows, heights, strict=True):
        for column, image in enumerate(row):
            x = column * (width + gap)
            canvas[y : y + image.shape[0], x : x + image.shape[1]] = _gray(image, top)
        y += height + gap
    recorder.static("slices/picture", rr.Image(canvas))
    places = [
        (column * (width + gap) + width / 2, -0.03 * canvas.shape[0])
        for column in range(len(shown))
    ]
    names = [one.name for one in shown]
    recorder.static(
        "slices/names",
        rr.Points2D(places, labels=names, radii=0.0, colors=(230, 230, 230), show_labels=True),
    )


def _gray(image: Float32Array, top: float) -> np.ndarray:
    return np.clip(image * (255 / max(top, 1e-30)), 0, 255).astype(np.uint8)


def _log_images(recorder: Recorder, entity: str, times: FloatArray, images: np.ndarray) -> None:
    """Logs (n, rows, columns) 8-bit pictures."""
    count, rows, columns = images.shape
    shape = rr.components.ImageFormat(
        width=columns, height=rows, color_model="L", channel_datatype="U8"
    )
    recorder.static(entity, rr.Image.from_fields(format=shape))
    recorder.columns(entity, times, rr.Image.columns(buffer=images.reshape(count, -1)))
