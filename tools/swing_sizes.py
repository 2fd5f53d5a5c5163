"""How far the phantom's soft tissue swings in the scans of some recordings, by the resonance of the tissue.

Usage: python tools/swing_sizes.py [RECORDING ...] (names under motions/)
"""

import sys

import numpy as np

from legsim import acquisition, config, imu, recovery, wobble
from legsim.imu import JointSplines
from legsim.soft_tissue import SoftTissue
from legsim.swing_share import swing_of

RECORDINGS = ("subject01/squat_60.trc", "subject06/squat_60.trc", "subject01/squats.trc")


def main() -> None:
    """Prints the farthest swing of thigh and shank in mm."""
    for name in sys.argv[1:] or RECORDINGS:
        settings = config.load(overrides=(f"motion.file={name}",))
        recovered = recovery.recover(settings.motion)
        splines = JointSplines(recovered.trajectories)
        poses = imu.segment_poses_at(recovered.leg, splines, acquisition.view_times(settings.scan, recovered.trajectories.times))
        for frequency in (10.0, 5.0):
            swung = wobble.swinging(poses, recovered.leg, splines, SoftTissue(frequency, 0.25))
            thigh, shank = (1e3 * np.linalg.norm(swung.of(swing_of(f"{bone}_l"))[:, :3, 3], axis=1).max() for bone in ("femur", "tibia"))
            print(f"{name:26} {frequency:4.0f} Hz: thigh {thigh:.3f} mm, shank {shank:.3f} mm")


if __name__ == "__main__":
    main()
