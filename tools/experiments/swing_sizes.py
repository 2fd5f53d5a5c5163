"""How far the phantom's soft tissue swings in the scans of some recordings, by the resonance of the
tissue.

Usage: python -m tools.experiments.swing_sizes [RECORDING ...] (names under motions/)
"""

import sys

import numpy as np

from legsim.imu.skin_mount import SkinMount
from legsim.kinematics import from_recording, joint_splines
from legsim.phantom import tissue_swing
from legsim.phantom.skinning import swing_of
from legsim.scan.c_arm import CArm

RECORDINGS = ("subject01/squat_60.trc", "subject06/squat_60.trc", "subject01/squats.trc")


def main() -> None:
    """Prints the farthest swing of thigh and shank in mm."""
    for name in sys.argv[1:] or RECORDINGS:
        person = from_recording.solve_kinematics(name)
        times = CArm.paper().view_times(person.trajectories.times)
        poses = joint_splines.segment_poses_at(person.leg, person.splines, times)
        for frequency in (10.0, 5.0):
            swung = tissue_swing.with_swing(
                poses, person.leg, person.splines, SkinMount(frequency, 0.25)
            )
            thigh, shank = (
                1e3 * np.linalg.norm(swung.of(swing_of(f"{bone}_l"))[:, :3, 3], axis=1).max()
                for bone in ("femur", "tibia")
            )
            print(f"{name:26} {frequency:4.0f} Hz: thigh {thigh:.3f} mm, shank {shank:.3f} mm")


if __name__ == "__main__":
    main()
