"""Frames that show the person: who walks through a laboratory is in view for a part of them."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray

_PELVIS_MARKERS = 2
"""that with some marker of each leg tell where the pelvis is and how it is turned"""


def span_in_view(roles: Mapping[str, FloatArray], segments: Mapping[str, str]) -> slice:
    """Frames from the first to the last that shows two markers of the pelvis and one of each
    leg.

    What lies between them may miss markers; inverse kinematics bridges such gaps from both ends.
    Before and after them nothing is known of the person.

    Args:
        roles: positions (n, 3) m by role, NaN where not seen.
        segments: segment of each role, "pelvis" or with the side at its end ("tibia_r").

    Returns:
        All frames where none shows that much.
    """
    count = len(next(iter(roles.values())))
    shown = {role: np.isfinite(positions).all(1) for role, positions in roles.items()}
    groups = [
        [role for role in roles if segments[role] == "pelvis"],
        *([role for role in roles if segments[role].endswith(f"_{side}")] for side in "rl"),
    ]
    needed = [min(_PELVIS_MARKERS, len(groups[0])), *(min(1, len(g)) for g in groups[1:])]
    in_view: NDArray[np.bool_] = np.ones(count, bool)
    for group, least in zip(groups, needed, strict=True):
        in_view &= sum((shown[role].astype(int) for role in group), np.zeros(count, int)) >= least
    frames = np.flatnonzero(in_view)
    return slice(int(frames[0]), int(frames[-1]) + 1) if len(frames) else slice(0, count)


def note_of(span: slice, times: FloatArray) -> tuple[str, ...]:
    """Sentence on what is left out of a recording with ``times`` (n,) s; none where nothing is."""
    ends = []
    if span.start > 0:
        ends.append(f"{span.start} frames before {times[span.start]:.3f} s")
    if span.stop < len(times):
        ends.append(f"{len(times) - span.stop} frames after {times[span.stop - 1]:.3f} s")
    if not ends:
        return ()
    return (
        f"{' and '.join(ends)} are left out: they show fewer than two markers of the pelvis or "
        "none of a leg",
    )
