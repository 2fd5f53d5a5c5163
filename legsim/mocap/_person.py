"""Whether markers, by role, are a person's: size of the pelvis, sides, knees above ankles."""

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.mocap.raw import unit_cure

BoolArray = NDArray[np.bool_]

_AGAINST = 0.2
"""of the pelvis' width: by more than this its right is not on its left side"""

_OF_PELVIS = ("psis", "iliac_crest")

_PELVIS_WIDTH = 0.25
"""m between the front spines of an adult"""

_CROSSED = 0.3
"""of the pelvis' width: by more than this nobody's right leg lies left of the other one
half of the time
"""

_LEG = ("epicondyle_lateral", "malleolus_lateral")

_BETWEEN, _OFTEN = 0.82, 0.2
"""of the way from pelvis to knee over the ankle, the straight way; share of the frames"""

_HEEL = 0.015
"""m by which no heel lies nearer to the knee than the ankle, half of the time: it lies below and
behind the ankle. Of 152 heels of public recordings none is nearer, most are 2 to 10 cm farther
"""

_APART, _INWARD = 0.04, -0.5
"""m between the two sides of a knee or ankle, and the cosine to the pelvis' right, half of the
time, with which the lateral one lies outside: 0.77 and more in 125 pairs of public recordings
"""


def check(means: dict[str, FloatArray], times: FloatArray) -> None:
    """Refuses markers that are not a person's.

    Args:
        means: positions (n, 3) m by role, NaN where not seen.
        times: (n,) s.

    Raises:
        LegsimError: a wrong unit, sides exchanged, or knee and ankle.
    """
    if {"psis_r", "psis_l"} <= means.keys():
        # a sacral marker beside them tells less of what is in front
        means = {**means, "sacrum": (means["psis_r"] + means["psis_l"]) / 2}
    if not {"sacrum", "asis_r", "asis_l"} <= means.keys():
        return
    right, left, back = (means[role] for role in ("asis_r", "asis_l", "sacrum"))
    together = np.asarray(np.isfinite(right + left + back).all(1))
    if not together.any():
        return
    # frame by frame: somebody who turns about has no mean direction
    across = (right - left)[together]
    width = float(np.median(np.linalg.norm(across, axis=1)))
    if not 0.08 < width < 0.8:
        raise LegsimError(
            f"the front of the pelvis is {width:.3g} m wide: the unit of length is wrong; "
            f"{unit_cure(width / _PELVIS_WIDTH)}"
        )
    forward = ((right + left) / 2 - back)[together]
    if np.median((_rightward(means, forward, together) * across).sum(1)) < -_AGAINST * width:
        raise LegsimError(
            "asis_r lies left of asis_l, seen from the sacrum: left and right, or front and back, "
            "are exchanged in the labels, or the axes mirrored"
        )
    rightward = across / np.linalg.norm(right - left, axis=1)[together, None]
    _check_legs(means, rightward, width, together)
    _check_knees(means, times)
    _check_heels(means)
    _check_medial(means, rightward, together)


def _rightward(
    means: dict[str, FloatArray], forward: FloatArray, together: BoolArray
) -> FloatArray:
    """Where right is (k, 3), at most of length 1, by the pelvis' ``forward`` (k, 3) and the
    direction from ankles to pelvis, so that it holds for somebody who lies; by the vertical where
    that direction is missing or is the pelvis' own.
    """
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    by_vertical = np.cross(forward, [0.0, 1.0, 0.0])
    ankles = [
        means[role] for role in ("malleolus_lateral_r", "malleolus_lateral_l") if role in means
    ]
    if not ankles:
        return by_vertical
    body = (means["asis_r"] + means["asis_l"])[together] / 2 - np.mean(ankles, axis=0)[together]
    by_body = np.cross(forward, body / np.linalg.norm(body, axis=1, keepdims=True))
    plain = np.linalg.norm(by_body, axis=1, keepdims=True) > 0.5
    return np.where(plain, by_body, by_vertical)


def _check_legs(
    means: dict[str, FloatArray], rightward: FloatArray, width: float, together: BoolArray
) -> None:
    """Refuses legs whose labels are exchanged under a pelvis that is right; crossed for a while
    they may be.
    """
    for role in [name[:-2] for name in means if name.endswith("_r") and name != "asis_r"]:
        if f"{role}_l" not in means:
            continue
        apart = ((means[f"{role}_r"] - means[f"{role}_l"])[together] * rightward).sum(1)
        part, limit = ("pelvis", _AGAINST) if role in _OF_PELVIS else ("legs", _CROSSED)
        if np.isfinite(apart).any() and np.nanmedian(apart) < -limit * width:
            raise LegsimError(
                f"{role}_r lies {-1e3 * np.nanmedian(apart):.0f} mm left of {role}_l, by the "
                f"sides of the pelvis: the labels of the {part} "
                "are exchanged; exchange them in the recording or in its marker map"
            )


def _check_knees(means: dict[str, FloatArray], times: FloatArray) -> None:
    """Refuses an ankle that lies between the pelvis and its knee: a leg whose labels of knee and
    ankle are exchanged, while it is not bent by more than some 70 degrees.

    The way over a true ankle is far longer, also for who sits on the heels.
    """
    pelvis = (means["asis_r"] + means["asis_l"]) / 2
    for side, word in (("r", "right"), ("l", "left")):
        knee, ankle = (means.get(f"{role}_{side}") for role in _LEG)
        if knee is None or ankle is None:
            continue
        near, far, shank = (
            np.linalg.norm(path, axis=1) for path in (ankle - pelvis, knee - pelvis, knee - ankle)
        )
        between = far > _BETWEEN * (near + shank)
        if between.sum() > _OFTEN * np.isfinite(far + near).sum():
            first = times[np.flatnonzero(between)[0]]
            raise LegsimError(
                f"malleolus_lateral_{side} lies between the pelvis and epicondyle_lateral_{side}, "
                f"first at {first:.4g} s: the labels of the {word} knee and ankle are exchanged; "
                "exchange them in the recording or in its marker map"
            )


def _check_heels(means: dict[str, FloatArray]) -> None:
    """Refuses a heel that lies nearer to the knee than the ankle does."""
    for side, word in (("r", "right"), ("l", "left")):
        knee, ankle, heel = (means.get(f"{role}_{side}") for role in (*_LEG, "heel"))
        if knee is None or ankle is None or heel is None:
            continue
        farther = np.linalg.norm(heel - knee, axis=1) - np.linalg.norm(ankle - knee, axis=1)
        if np.isfinite(farther).any() and np.nanmedian(farther) < -_HEEL:
            raise LegsimError(
                f"heel_{side} lies {-1e3 * np.nanmedian(farther):.0f} mm nearer to "
                f"epicondyle_lateral_{side} than malleolus_lateral_{side} does: the labels of the "
                f"{word} heel and ankle are exchanged; exchange them in the recording or in its "
                "marker map"
            )


def _check_medial(means: dict[str, FloatArray], rightward: FloatArray, together: BoolArray) -> None:
    """Refuses lateral markers that lie inside of the medial ones."""
    for part, joint in (("epicondyle", "knee"), ("malleolus", "ankle")):
        for side, word, sign in (("r", "right", 1), ("l", "left", -1)):
            lateral, medial = (means.get(f"{part}_{end}_{side}") for end in ("lateral", "medial"))
            if lateral is None or medial is None:
                continue
            apart = (lateral - medial)[together]
            width = np.linalg.norm(apart, axis=1)
            outward = sign * (apart * rightward).sum(1) / np.maximum(width, 1e-9)
            if not np.isfinite(outward).any() or np.nanmedian(width) < _APART:
                continue
            if np.nanmedian(outward) < _INWARD:
                raise LegsimError(
                    f"{part}_lateral_{side} lies inside of {part}_medial_{side}: the labels of the "
                    f"two sides of the {word} {joint} are exchanged; exchange them in the "
                    "recording or in its marker map"
                )
