"""The moving body in 3D: floor, skeleton, segments, markers, sensors."""

import numpy as np
import rerun as rr

from legsim.core.values import FloatArray
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.scene.values import ReplayScene
from legsim.view.stream import Recorder, entity_path

BONE = (226, 214, 188)
JOINT = (255, 196, 87)
MEASURED = (90, 200, 250)
MODELLED = (255, 105, 160)
FLOOR = (95, 100, 108)
GRID = 0.1  # m between the lines of the floor


def log_floor(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs a grid with a line every 10 cm under all positions of the joints.

    It extends half a meter further on each side.
    """
    centers = scene.joint_centers.positions_world.reshape(-1, 3)[:, [0, 2]]
    low = np.floor(np.nanmin(centers, 0) / GRID - 5) * GRID
    high = np.ceil(np.nanmax(centers, 0) / GRID + 5) * GRID
    xs, zs = (np.arange(a, b + GRID / 2, GRID) for a, b in zip(low, high, strict=True))
    y = scene.floor_height
    lines = [[[x, y, low[1]], [x, y, high[1]]] for x in xs] + [
        [[low[0], y, z], [high[0], y, z]] for z in zs
    ]
    recorder.static(
        "world/floor", rr.LineStrips3D(lines, radii=rr.Radius.ui_points(0.5), colors=FLOOR)
    )


def log_skeleton(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs joint centers as balls and bones as lines between them."""
    centers = scene.joint_centers
    count = len(centers.names)
    positions = centers.positions_world.astype(np.float32)
    recorder.columns(
        "world/joints",
        centers.times,
        _partition(rr.Points3D.columns(positions=positions.reshape(-1, 3)), count, len(positions)),
    )
    recorder.static(
        "world/joints",
        rr.Points3D.from_fields(
            radii=0.012, colors=JOINT, labels=list(centers.names), show_labels=False
        ),
    )
    bones = scene.bone_lines().astype(np.float32)
    if bones.shape[1]:
        columns = rr.LineStrips3D.columns(strips=bones.reshape(-1, 2, 3))
        recorder.columns(
            "world/bones", centers.times, _partition(columns, bones.shape[1], len(bones))
        )
        recorder.static("world/bones", rr.LineStrips3D.from_fields(radii=0.004, colors=BONE))


def log_segments(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs every segment's frame over time, and the meshes that move with it."""
    for segment in scene.poses.segment_names:
        recorder.poses(
            entity_path("world", "segments", segment), scene.poses.times, scene.poses.of(segment)
        )
    for mesh in scene.segment_meshes:
        normals = vertex_normals(mesh.vertices, mesh.triangles)
        content = rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.triangles,
            vertex_normals=normals,
            albedo_factor=BONE,
        )
        recorder.static(entity_path("world", "segments", mesh.segment, mesh.name), content)


def log_markers(recorder: Recorder, scene: ReplayScene) -> None:
    """Logs measured markers, the model's, and an arrow from each measured one to the model's."""
    if scene.measured is not None:
        _log_points(recorder, "world/markers/measured", scene.measured, MEASURED)
    if scene.measured is not None and scene.modelled is not None:
        _log_points(recorder, "world/markers/model", scene.modelled, MODELLED)
        vectors = scene.modelled.positions_world - scene.measured.positions_world
        seen = np.isfinite(vectors).all(-1)
        columns = rr.Arrows3D.columns(
            vectors=vectors[seen], origins=scene.measured.positions_world[seen]
        )
        recorder.columns(
            "world/markers/residual", scene.measured.times, columns.partition(seen.sum(-1))
        )
        recorder.static(
            "world/markers/residual", rr.Arrows3D.from_fields(radii=0.0015, colors=(255, 255, 255))
        )


def log_sensors(recorder: Recorder, sensor_poses: SegmentPoses) -> None:
    """Logs a box and the axes of each sensor: x red, y green, z blue."""
    for name in sensor_poses.segment_names:
        entity = entity_path("world", "sensors", name)
        recorder.poses(entity, sensor_poses.times, sensor_poses.of(name))
        recorder.static(
            entity,
            rr.Boxes3D(
                half_sizes=[0.012, 0.018, 0.006],
                colors=(90, 220, 120),
                labels=name,
                show_labels=False,
            ),
        )
        axes = rr.Arrows3D(
            vectors=0.08 * np.eye(3),
            radii=0.0025,
            colors=[(235, 80, 80), (90, 210, 90), (90, 140, 255)],
        )
        recorder.static(f"{entity}/axes", axes)


def _log_points(
    recorder: Recorder, entity: str, markers: MarkerTrajectories, color: tuple[int, int, int]
) -> None:
    seen = np.isfinite(markers.positions_world).all(-1)
    positions = markers.positions_world[seen]
    labels = np.broadcast_to(np.array(markers.marker_names), seen.shape)[seen]
    whole = rr.Points3D.columns(positions=positions).partition(seen.sum(-1))
    recorder.columns(entity, markers.times, whole)
    if seen.all():
        recorder.static(entity, rr.Points3D.from_fields(labels=list(markers.marker_names)))
    else:  # a gap shifts the points that follow it, so the names must travel with them
        recorder.columns(
            entity,
            markers.times,
            rr.Points3D.columns(labels=labels.tolist()).partition(seen.sum(-1)),
        )
    recorder.static(entity, rr.Points3D.from_fields(radii=0.008, colors=color, show_labels=False))


def vertex_normals(vertices: FloatArray, triangles: np.ndarray) -> FloatArray:
    """Unit normals (p, 3), each the area-weighted mean of the triangles around a vertex.

    Without them meshes are drawn unlit.
    """
    corners = vertices[triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.stack(
        [
            np.bincount(triangles.ravel(), np.repeat(faces[:, k], 3), len(vertices))
            for k in range(3)
        ],
        -1,
    )
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)


def _partition(columns: rr.ComponentColumnList, each: int, rows: int) -> rr.ComponentColumnList:
    return columns.partition(np.full(rows, each))
