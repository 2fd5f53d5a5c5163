r"""A correction method of one's own: the pose of the shank's sensor without its slow drift.

Run it as

    legsim run --preset demo --out run \
        --set 'methods.run=["uncorrected", "rigid", "docs/examples/own_method.py:without_drift"]'
"""

import numpy as np

from legsim.core import transforms
from legsim.correction.method import Correction, Scan
from legsim.correction.rigid import rigid_motion, sensor_path


def without_drift(scan: Scan) -> Correction:
    """Rigid, with the straight line that the position drifts along taken out: people stand, and
    return to where they were.

    A method sees no more than ``scan``: projections with their geometry, IMU signals, and each
    sensor's start.
    """
    poses = sensor_path(scan, scan.signals.sensor_names[0], "accurate")
    since = scan.times - scan.times[0]
    positions = poses[:, :3, 3]
    slope = (since @ (positions - positions[0])) / (since @ since)
    steady = transforms.rigid(poses[:, :3, :3], positions - np.multiply.outer(since, slope))
    return Correction("without_drift", scan.projections, rigid_motion(scan.times, steady))
