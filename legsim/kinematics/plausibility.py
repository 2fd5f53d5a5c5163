"""What no leg does: rates, steps, lengths and limits that say that a recording or its solution is
wrong somewhere.
"""

from collections.abc import Sequence

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.kinematics.inverse_kinematics import IkReport
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import LegModel
from legsim.mocap.trajectories import JointTrajectories

_FASTEST_DEG_PER_S = 1500.0
"""a sprinter's knee turns by 1200 deg/s"""

_FASTEST_M_PER_S = 12.0
"""a sprinter's pelvis"""

_STRONGEST = 20 * STANDARD_GRAVITY
"""m/s^2 of a segment's origin: impacts at the shank of a runner are 10 g"""

_UNLIKE = 0.04
"""of the lengths of a person's thighs or shanks; 5 of 100 people differ by more than 2 %"""

_OVEREXTENDED = np.radians(15.0)
"""rad of a knee; 10 degrees count as lax (Beighton et al. 1973)"""

_STRAIGHT = np.radians(5.0)
"""rad from a straight knee"""

_PEOPLES_DEG = {
    "hip_flexion": (-50.0, 150.0),
    "hip_adduction": (-70.0, 60.0),
}
"""what people's hips do, and some more: Kapandji, The physiology of the joints, vol. 2"""

_LONG_AT_LIMIT = 0.2
"""share of the frames"""

_UNTOLD = np.radians(20.0)
"""rad; seven markers tell hips and knees to 5 degrees, clusters without landmarks to 11"""

_POOR_RMS, _POOR_MARKER, _POOR_WORST = 0.015, 0.03, 0.1
"""m of all markers, of one over the frames, in one frame

Twenty recordings of ten marker sets stay within 7, 15 and 45 mm.
"""


def objections(leg: Leg, trajectories: JointTrajectories) -> tuple[str, ...]:
    """Sentences on what a person's leg cannot do, each with names and times; none where all is
    plausible.

    First and last frames are held to the same as all others.
    """
    values = leg.values_of(trajectories)
    return (
        *_too_fast(leg, values, trajectories.times),
        *_too_strong(leg, values, trajectories.times),
        *_unlike_lengths(leg),
    )


def beyond_limits(
    leg: Leg, trajectories: JointTrajectories, *, by_markers: bool = True
) -> tuple[str, ...]:
    """Sentences on joints that are, for long, where few people's are.

    They are knees that stay at a limit, where the markers would bend them further, or
    overextended by more than people's, and hips beyond people's range.
    The straight end of the knees of a user's model counts as none.
    """
    why = "its markers do not sit where the model has them" if by_markers else "is another model's"
    lines = []
    for name in ("knee_angle_r", "knee_angle_l"):
        if name not in leg.coordinate_names:
            continue
        angle = trajectories.coordinate(name)
        low, high = leg.coordinate_ranges[leg.coordinate_names.index(name)]
        for limit, beyond in ((low, angle < low + 1e-6), (high, angle > high - 1e-6)):
            # a user's model may end where a knee is straight, and people stand there
            straight = not isinstance(leg, LegModel) and abs(limit) < _STRAIGHT
            share = float(np.mean(beyond))
            if share > _LONG_AT_LIMIT and not straight:
                lines.append(
                    f"{name} is at its limit of {np.degrees(limit):.0f} deg in "
                    f"{100 * share:.0f} % of the frames: that knee goes beyond what the model has, "
                    f"or {why}"
                )
        back = float(np.mean(angle > _OVEREXTENDED)) if isinstance(leg, LegModel) else 0.0
        if back > _LONG_AT_LIMIT and not any(line.startswith(name) for line in lines):
            lines.append(
                f"{name} is overextended by more than {np.degrees(_OVEREXTENDED):.0f} deg in "
                f"{100 * back:.0f} % of the frames, which few people's knees are"
                + (
                    ": see whether knee and ankle markers are exchanged, or give a static trial "
                    "(motion.scaling_file)"
                    if by_markers
                    else ""
                )
            )
    return (*lines, *_beyond_people(trajectories))


def _beyond_people(trajectories: JointTrajectories) -> list[str]:
    """Sentences on hips that are, for long, where no person's are."""
    lines = []
    for name in trajectories.coordinate_names:
        low, high = _PEOPLES_DEG.get(name[:-2] if name[-2:] in ("_r", "_l") else "", (-1e9, 1e9))
        angle = np.degrees(trajectories.coordinate(name))
        share = float(np.mean((angle < low) | (angle > high)))
        if share > _LONG_AT_LIMIT:
            farthest = float(angle[int(np.maximum(low - angle, angle - high).argmax())])
            lines.append(
                f"{name} is beyond what people's hips do ({low:g} to {high:g} deg) in "
                f"{100 * share:.0f} % of the frames, up to {farthest:.0f} deg: see whether its "
                "sign is another, or markers are exchanged"
            )
    return lines


def poor_fit(ik: IkReport, times: FloatArray) -> tuple[str, ...]:
    """A sentence on markers that the model follows worse than skin and placement explain."""
    worst = int(np.nanargmax(ik.marker_worst))
    loosest = int(np.nanargmax(ik.marker_rms))
    if (
        ik.rms <= _POOR_RMS
        and ik.marker_rms[loosest] <= _POOR_MARKER
        and ik.marker_worst[worst] <= _POOR_WORST
    ):
        return ()
    frame = int(ik.marker_worst_frame[worst])
    return (
        f"the model follows the markers within {1e3 * ik.rms:.0f} mm RMS, and "
        f"{ik.marker_names[loosest]} within {1e3 * ik.marker_rms[loosest]:.0f} mm, which is no "
        f"good fit; worst is {ik.marker_names[worst]} in frame {frame} ({times[frame]:.2f} s): see "
        "whether labels are exchanged there, or a marker stands still",
    )


def untold(names: Sequence[str], spread: FloatArray) -> list[str]:
    """A sentence on the flexions of hips and knees that the markers do not tell, by one standard
    deviation (c,) rad of each of the coordinates ``names``.
    """
    bent = [k for k, name in enumerate(names) if name.startswith(("hip_flex", "knee"))]
    which = [f"{names[k]} ({np.degrees(spread[k]):.0f} deg)" for k in bent if spread[k] > _UNTOLD]
    if not which:
        return []
    return [
        "the markers do not tell, by one standard deviation, "
        f"{', '.join(which)}: too few of them are on those thighs and shanks"
    ]


def _too_fast(leg: Leg, values: FloatArray, times: FloatArray) -> list[str]:
    if len(times) < 2:
        return []
    rates = np.abs(np.diff(values, axis=0)) / np.diff(times)[:, None]
    slides = np.array([name in leg.shifts for name in leg.coordinate_names])
    limits = np.where(slides, _FASTEST_M_PER_S, np.radians(_FASTEST_DEG_PER_S))
    lines = []
    for k in np.flatnonzero((rates > limits).any(0)):
        frame = int(rates[:, k].argmax())
        fastest = (
            f"{rates[frame, k]:.0f} m/s"
            if slides[k]
            else f"{np.degrees(rates[frame, k]):.0f} deg/s"
        )
        count = int((rates[:, k] > limits[k]).sum())
        lines.append(
            f"{leg.coordinate_names[k]} steps at {fastest} from frame {frame} "
            f"({times[frame]:.3f} s) to the next, and in {count} places faster than any joint moves"
        )
    return lines


def _too_strong(leg: Leg, values: FloatArray, times: FloatArray) -> list[str]:
    if len(times) < 3:
        return []
    poses = leg.segment_poses(JointTrajectories(times, leg.coordinate_names, values))
    lines = []
    for segment in ("pelvis", "tibia_r", "tibia_l"):
        place = poses.of(segment)[:, :3, 3]
        speed = np.diff(place, axis=0) / np.diff(times)[:, None]
        middle = 0.5 * (times[2:] - times[:-2])
        strength = np.linalg.norm(np.diff(speed, axis=0), axis=1) / middle
        frame = int(strength.argmax()) + 1
        highest = float(strength.max())
        if highest > _STRONGEST:
            lines.append(
                f"{segment} is accelerated by {highest / STANDARD_GRAVITY:.0f} g at frame {frame} "
                f"({times[frame]:.3f} s), more than any impact"
            )
    return lines


def _unlike_lengths(leg: Leg) -> list[str]:
    lines = []
    for name, length in (("thighs", leg.thigh_length), ("shanks", leg.shank_length)):
        right, left = length("r"), length("l")
        unlike = abs(right - left) / (0.5 * (right + left))
        if unlike > _UNLIKE:
            lines.append(
                f"the {name} differ by {100 * unlike:.0f} % in length (right {1e3 * right:.0f} mm, "
                f"left {1e3 * left:.0f} mm): a marker of one leg sits elsewhere than its role says"
            )
    return lines
