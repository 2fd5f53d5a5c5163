"""A made-up squat and a scan of it, small enough for tests of recordings, figures and reports."""

import numpy as np

from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import NamedVolume, Volume, VolumeGrid
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import JointCenters, SegmentPoses
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.scene.slices import VolumeSlices
from legsim.scene.values import MovingSurface, ReplayScene, ScanScene, SegmentMesh

BENDS = tuple(
    f"{name}_{side}" for side in "rl" for name in ("hip_flexion", "knee_angle", "ankle_angle")
)
COORDINATES = ("pelvis_tilt", "pelvis_tx", "pelvis_ty", "pelvis_tz", *BENDS)
THIGH, SHANK, FOOT = 0.41, 0.40, 0.15


def squat(seconds: float = 1.0, rate_hz: float = 120.0, bend: float = 1.0) -> JointTrajectories:
    """Knees held bent by ``bend`` rad with a slow sway."""
    times = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    knee = bend + 0.03 * np.sin(2 * np.pi * 0.4 * times)
    leg = [0.5 * knee, -knee, 0.5 * knee]
    height = 0.08 + THIGH * np.cos(0.5 * knee) + SHANK * np.cos(0.5 * knee)
    zero = np.zeros_like(times)
    return JointTrajectories(
        times, COORDINATES, np.stack([zero, 0.01 * np.sin(times), height, zero, *leg, *leg], -1)
    )


def joint_centers(trajectories: JointTrajectories) -> JointCenters:
    """A flat chain of thigh and shank on each side."""
    centers = []
    for side, z in (("l", -0.09), ("r", 0.09)):
        hip_angle, knee_angle = (
            trajectories.coordinate(f"hip_flexion_{side}"),
            trajectories.coordinate(f"knee_angle_{side}"),
        )
        hip = np.stack(
            [
                trajectories.coordinate("pelvis_tx"),
                trajectories.coordinate("pelvis_ty"),
                np.full_like(hip_angle, z),
            ],
            -1,
        )
        knee = hip + THIGH * _down(hip_angle)
        ankle = knee + SHANK * _down(hip_angle + knee_angle)
        centers += [hip, knee, ankle]
    return JointCenters(trajectories.times, np.stack(centers, 1))


def _down(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(angle), -np.cos(angle), np.zeros_like(angle)], -1)


def poses(trajectories: JointTrajectories, centers: JointCenters) -> SegmentPoses:
    """femur, tibia, heel and toes of both sides, y along the segment."""
    names, stacked = [], []
    for side in "rl":
        hip = trajectories.coordinate(f"hip_flexion_{side}")
        shank = hip + trajectories.coordinate(f"knee_angle_{side}")
        ankle = centers.of(f"ankle_{side}")
        names += [f"{segment}_{side}" for segment in ("femur", "tibia", "calcn", "toes")]
        stacked += [
            transforms.rigid(transforms.axis_rotation([0, 0, 1], hip), centers.of(f"hip_{side}")),
            transforms.rigid(
                transforms.axis_rotation([0, 0, 1], shank), centers.of(f"knee_{side}")
            ),
            transforms.translation(ankle + np.array([-0.04, -0.05, 0])),
            transforms.translation(ankle + np.array([FOOT, -0.05, 0])),
        ]
    return SegmentPoses(trajectories.times, tuple(names), np.stack(stacked, 1))


def tube(
    radius: float, length: float, *, rings: int = 12, around: int = 16
) -> tuple[np.ndarray, np.ndarray]:
    """A closed cylinder from the origin down to -length: vertices (p, 3), triangles (t, 3) with
    normals outwards.
    """
    turn = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], -1) * radius
    heights = -length * np.arange(rings) / (rings - 1)
    vertices = np.concatenate(
        [circle + np.array([0, y, 0]) for y in heights] + [np.array([[0, 0, 0], [0, -length, 0]])]
    )
    triangles = []
    top, bottom = rings * around, rings * around + 1
    for k in range(around):
        n = (k + 1) % around
        triangles += [(top, n, k), (bottom, (rings - 1) * around + k, (rings - 1) * around + n)]
        for r in range(rings - 1):
            a, b, c, d = r * around + k, r * around + n, (r + 1) * around + k, (r + 1) * around + n
            triangles += [(a, b, c), (b, d, c)]
    return vertices, np.array(triangles)


def replay_scene(seconds: float = 1.0, rate_hz: float = 120.0, *, gap: bool = True) -> ReplayScene:
    """All that a replay can have; with ``gap`` one marker is not seen for a while."""
    trajectories = squat(seconds, rate_hz)
    centers = joint_centers(trajectories)
    segment_poses = poses(trajectories, centers)
    rng = np.random.default_rng(3)
    modelled = np.concatenate(
        [centers.positions_world + offset for offset in ([0, 0, 0.05], [0.05, 0, 0])], 1
    )
    measured = (
        modelled + rng.normal(0, 0.004, modelled.shape[1:]) + rng.normal(0, 0.001, modelled.shape)
    )
    if gap:
        measured[10:30, 2] = np.nan
    names = tuple(f"M{k}" for k in range(modelled.shape[1]))
    sensors = ("shank_r", "thigh_r")
    mounts = transforms.translation([0.06, -0.14, 0])
    sensor_poses = np.stack(
        [segment_poses.of("tibia_r") @ mounts, segment_poses.of("femur_r") @ mounts], 1
    )
    force = np.einsum("nkji,j->nki", sensor_poses[..., :3, :3], [0, 9.80665, 0])
    rate = np.gradient(trajectories.coordinate("hip_flexion_r"), trajectories.times)[
        :, None, None
    ] * np.array([[0, 0, -1.0], [0, 0, 1.0]])
    meshes = []
    for side in "rl":
        meshes += [
            SegmentMesh(f"{name}_{side}", f"{name}_{side}", *tube(r, n))
            for name, r, n in (("femur", 0.016, THIGH), ("tibia", 0.014, SHANK))
        ]
    return ReplayScene(
        name="held squat",
        trajectories=trajectories,
        poses=segment_poses,
        joint_centers=centers,
        imu=ImuSignals(trajectories.times, sensors, rate, force),
        sensor_poses=SegmentPoses(trajectories.times, sensors, sensor_poses),
        measured=MarkerTrajectories(trajectories.times, names, measured),
        modelled=MarkerTrajectories(trajectories.times, names, modelled),
        segment_meshes=tuple(meshes),
    )


def scan_scene(views: int = 24, *, columns: int = 60, seconds: float = 1.0) -> ScanScene:
    """A short scan around the right knee; the pictures are shadows of points, the volumes a leg of
    two cylinders.
    """
    replay = replay_scene(seconds)
    knee = replay.joint_centers.of("knee_r")[0]
    times = np.linspace(0, seconds * 0.99, views)
    geometry = ConeBeamGeometry.circular(
        times=times,
        angles=np.deg2rad(np.linspace(0, 198, views)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(columns * 3 // 4, columns),
        pixel_pitch=620 * 0.616e-3 / columns,
        isocenter=knee,
    )
    frames = np.searchsorted(replay.trajectories.times, times)
    vertices, triangles = tube(0.065, THIGH, rings=30, around=40)
    skin = transforms.apply(replay.poses.of("femur_r")[frames], vertices)
    return ScanScene(
        replay,
        Projections(
            geometry,
            shadows(geometry, np.concatenate([skin[0], replay.joint_centers.positions_world[0]])),
        ),
        (MovingSurface("skin_r", times, skin, triangles),),
        tuple(
            VolumeSlices.of(NamedVolume(name, leg_volume(knee, blur)))
            for name, blur in (("motion-free", 0.0), ("uncorrected", 0.02), ("rigid", 0.004))
        ),
    )


def shadows(geometry: ConeBeamGeometry, points: np.ndarray) -> np.ndarray:
    """(v, rows, columns): how many points fall on each pixel."""
    pixels, _ = geometry.project(points)
    images = np.zeros((len(geometry), *geometry.shape_vu), np.float32)
    u, v = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
    view = np.broadcast_to(np.arange(len(geometry))[:, None], u.shape)
    inside = (u >= 0) & (u < geometry.shape_vu[1]) & (v >= 0) & (v < geometry.shape_vu[0])
    np.add.at(images, (view[inside], v[inside], u[inside]), 1)
    return images


def leg_volume(center: np.ndarray, blur: float, count: int = 48) -> Volume:
    """Soft tissue with a bone in front of its middle and a small fibula at its right; ``blur`` (m)
    doubles the edges.
    """
    grid = VolumeGrid.cubic(count, 0.2 / count, center)
    x, y, z = (axis - c for axis, c in zip(grid.axes(), center, strict=True))
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    total = np.zeros(grid.shape_zyx)
    for shift in (-blur / 2, blur / 2):
        soft = np.hypot(x - shift, z) < 0.06 + 0.1 * y
        total += (
            10.0 * soft
            + 12.0 * (np.hypot(x - shift - 0.015, z) < 0.02)
            + 12.0 * (np.hypot(x - shift + 0.02, z - 0.03) < 0.007)
        )
    return Volume(grid, (0.5 * total).astype(np.float32))
