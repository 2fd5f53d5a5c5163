"""How far the phantom's soft tissue swings in the scans of some recordings, by the resonance of the
tissue.

Usage: python -m tools.experiments.swing_sizes [RECORDING ...] (names under motions/)
"""

import sys

import numpy as np

from legsim import config
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.phantom import tissue_swing
from legsim.phantom.skinning import swing_of
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm

RECORDINGS = ("subject01/squat_60.trc", "subject06/squat_60.trc", "subject01/squats.trc")


def main() -> None:
    """Prints the farthest swing of thigh and shank in mm."""
    for name in sys.argv[1:] or RECORDINGS:
        settings = config.load_settings(overrides=(f"motion.file={name}",))
        recovered = run_motion.solve(settings.motion)
        splines = JointSplines(recovered.trajectories)
        poses = joint_splines.segment_poses_at(
            recovered.leg, splines, c_arm(settings.scan).view_times(recovered.trajectories.times)
        )
        for frequency in (10.0, 5.0):
            swung = tissue_swing.with_swing(
                poses, recovered.leg, splines, SkinMount(frequency, 0.25)
            )
            thigh, shank = (
                1e3 * np.linalg.norm(swung.of(swing_of(f"{bone}_l"))[:, :3, 3], axis=1).max()
                for bone in ("femur", "tibia")
            )
            print(f"{name:26} {frequency:4.0f} Hz: thigh {thigh:.3f} mm, shank {shank:.3f} mm")


if __name__ == "__main__":
    main()
