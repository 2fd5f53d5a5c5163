"""How much a recording sways, measured as quiet standing was: 2nd-order 6 Hz zero-phase
Butterworth, then means over the recording.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.skeleton import SegmentScales
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

PELVIS = ("SACR", "RASI", "LASI")


@dataclass(frozen=True, slots=True)
class Truth:
    """What lies beside a recording; see motions/README.md."""

    trajectories: JointTrajectories
    joint_centers: FloatArray
    """(n, 6, 3) m, in the order of anatomy.JOINT_CENTERS"""
    leg: LegModel


@dataclass(frozen=True, slots=True)
class Sway:
    """Of one recording; vectors are x, y, z of world."""

    pelvis_std_mm: FloatArray
    pelvis_speed_mm_s: float
    marker_acceleration_mg: FloatArray
    """(m,) root mean square of the acceleration's length, each marker"""
    shank_rate_deg_s: FloatArray
    """(2,) root mean square of the angular velocity's length, right and left, from the truth"""
    knee_flexion_deg: FloatArray
    """(2,) mean, right and left"""
    knee_flexion_std_deg: FloatArray
    """(2,)"""
    missing_frames: int
    """marker samples not seen"""


def load_truth(path: str) -> Truth:
    """Reads a *_truth.npz; counts are micrometers and microradians."""
    with np.load(path) as stored:
        values = 1e-6 * stored["coordinate_micros"].T
        times = np.arange(len(values)) / float(stored["rate_hz"])
        trajectories = JointTrajectories(times, tuple(map(str, stored["coordinate_names"])), values)
        centers = 1e-6 * stored["joint_center_micros"].transpose(2, 0, 1)
        leg = LegModel.load(SegmentScales(stored["segment_scales"], float(stored["mass_kg"])))
    return Truth(trajectories, centers, leg)


def sway(motion: MarkerTrajectories, truth: Truth) -> Sway:
    """Statistics of a recording."""
    markers = smoothed(bridged(motion), motion.rate_hz)
    pelvis = np.mean([markers[:, motion.marker_names.index(name)] for name in PELVIS], 0)
    step = 1 / motion.rate_hz
    # the filter's ends are not part of the recording
    inner = slice(round(0.25 / step), -round(0.25 / step))
    acceleration = np.gradient(np.gradient(markers, step, axis=0), step, axis=0)[inner]
    poses = truth.leg.segment_poses(truth.trajectories)
    shanks = np.stack([poses.of(f"tibia_{side}")[:, :3, :3] for side in "rl"], 1)
    rates = smoothed(angular_velocity(shanks, step), motion.rate_hz)[inner]
    knees = np.stack(
        [-np.degrees(truth.trajectories.coordinate(f"knee_angle_{side}")) for side in "rl"], -1
    )
    return Sway(
        pelvis_std_mm=1e3 * pelvis.std(0),
        pelvis_speed_mm_s=1e3
        * float(np.linalg.norm(np.gradient(pelvis, step, axis=0)[inner], axis=-1).mean()),
        marker_acceleration_mg=1e3 / STANDARD_GRAVITY * np.sqrt((acceleration**2).sum(-1).mean(0)),
        shank_rate_deg_s=np.degrees(np.sqrt((rates**2).sum(-1).mean(0))),
        knee_flexion_deg=knees.mean(0),
        knee_flexion_std_deg=knees.std(0),
        missing_frames=int(np.isnan(motion.positions_world[..., 0]).sum()),
    )


def bridged(motion: MarkerTrajectories) -> FloatArray:
    """Marker positions (n, m, 3) with straight lines across the gaps."""
    filled = motion.positions_world.copy()
    for marker in range(filled.shape[1]):
        gone = np.isnan(filled[:, marker, 0])
        for axis in range(3):
            filled[gone, marker, axis] = np.interp(
                motion.times[gone], motion.times[~gone], filled[~gone, marker, axis]
            )
    return filled


def smoothed(values: FloatArray, rate_hz: float) -> FloatArray:
    """(n, ...) through the 6 Hz Butterworth, forwards and backwards."""
    return sosfiltfilt(butter(2, 6.0, fs=rate_hz, output="sos"), values, axis=0)


def angular_velocity(rotations: FloatArray, step: float) -> FloatArray:
    """(n, ..., 3) rad/s in world of rotations (n, ..., 3, 3), by central differences."""
    spin = np.gradient(rotations, step, axis=0) @ np.swapaxes(rotations, -1, -2)
    return np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], -1)


def knee_flexion_deg(truth: Truth) -> FloatArray:
    """(n,) mean flexion of both knees."""
    return -np.degrees(
        np.mean([truth.trajectories.coordinate(f"knee_angle_{side}") for side in "rl"], 0)
    )


def count_squats(flexion_deg: FloatArray) -> int:
    """How often the knees (n,) bend beyond 60 deg after having been straighter than 30 deg."""
    level = np.where(flexion_deg > 60, 1, np.where(flexion_deg < 30, 0, -1))
    steps = level[level >= 0]
    return int((np.diff(steps) > 0).sum())
