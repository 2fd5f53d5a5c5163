"""Joint coordinates around a squat that sway as slow sines."""

import numpy as np

from legsim.kinematics.leg_model import LegModel
from legsim.mocap.trajectories import JointTrajectories

TIMES = np.arange(0, 9.0, 1 / 120)


def swaying(leg: LegModel, seed: int = 0, size: float = 0.01) -> JointTrajectories:
    """Coordinates around a 30 degree squat, three slow sines each."""
    rng = np.random.default_rng(seed)
    names = leg.coordinate_names
    base = leg.default_coordinates.copy()
    for side in "lr":
        for name, degrees in (("hip_flexion", 25), ("knee_angle", -30), ("ankle_angle", 15)):
            base[names.index(f"{name}_{side}")] = np.radians(degrees)
    rate = 2 * np.pi * rng.uniform(0.15, 1.5, (3, len(names)))
    waves = (
        np.sin(TIMES[:, None, None] * rate + rng.uniform(0, 6, rate.shape))
        * size
        * 0.3
        / (rate / rate.min())
    )
    return JointTrajectories(TIMES, names, base + waves.sum(1))
