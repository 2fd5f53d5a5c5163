"""Files of one trial: the TRC that a motion-capture system would write, labeled synthetic, and the
truth beside it.
"""

from pathlib import Path

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import COORDINATES
from legsim.kinematics.skeleton import JOINT_CENTERS, SEGMENTS
from legsim.mocap.trajectories import MarkerTrajectories
from tools.virtual_subjects.body import Body, scale_of
from tools.virtual_subjects.markers import LABELS, MARKERS, Attachment
from tools.virtual_subjects.plan import RATE
from tools.virtual_subjects.simulation import Footing, Performance

NOTE = "synthetic: simulated by tools/virtual_subjects, nobody was measured"
_CENTER_BODY = {"hip": "femur", "knee": "tibia", "ankle": "talus"}


def write_trc(path: Path, motion: MarkerTrajectories) -> None:
    """Millimeters with two decimals, as camera systems export; line 1 says that nobody was
    measured.
    """
    n, m = len(motion.times), len(motion.marker_names)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\tsynthetic_{path.parent.name}_{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{RATE}\t{RATE}\t{n}\t{m}\tmm\t{RATE}\t1\t{n}",
        "Frame#\tTime\t" + "\t\t\t".join(motion.marker_names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, m + 1)),
        "",
    ]
    table = 1e3 * motion.positions_world.reshape(n, 3 * m)
    for k, (time, row) in enumerate(zip(motion.times, table, strict=True), start=1):
        lines.append(
            f"{k}\t{time:.4f}\t" + "\t".join("" if np.isnan(x) else f"{x:.2f}" for x in row)
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def write_truth(
    path: Path, body: Body, performance: Performance, attachment: Attachment, stood: Footing
) -> None:
    """What the markers only hint at, as .npz; see motions/README.md. Angles and lengths are counts
    of 1e-6 rad and 1e-6 m.
    """
    poses = body.poses(performance.q)
    centers = [poses[f"{_CENTER_BODY[name[:-2]]}_{name[-1]}"][:, :3, 3] for name in JOINT_CENTERS]
    # toes are part of the foot here
    columns = [
        performance.q[:, body.index[c]] if c in body.index else np.zeros(len(performance.q))
        for c in COORDINATES
    ]
    np.savez_compressed(
        path,
        note=NOTE,
        rate_hz=RATE,
        coordinate_names=np.array(COORDINATES),
        coordinate_micros=_micros(np.array(columns)),
        joint_names=np.array(JOINT_CENTERS),
        joint_center_micros=_micros(np.array(centers).transpose(0, 2, 1)),
        segment_names=np.array(SEGMENTS),
        segment_scales=np.array([scale_of(body.subject, name) for name in SEGMENTS]),
        mass_kg=body.subject.mass,
        marker_names=np.array(LABELS),
        marker_segments=np.array([marker.body for marker in MARKERS]),
        marker_places_m=attachment.places,
        pressure_range_m=stood.pressure_range,
        friction=stood.friction,
    )


def _micros(values: FloatArray) -> np.ndarray:
    return np.rint(1e6 * values).astype(np.int32)
