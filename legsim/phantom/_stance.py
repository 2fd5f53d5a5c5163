"""Whether labeled bones stand as in a person: shins below thighs, kneecaps in front."""

from collections.abc import Mapping

import numpy as np

from legsim.core.values import FloatArray

_CLEARLY = 0.01
"""m by which one bone's middle must be on the wrong side of another's"""

_KNEE = 0.06
"""m of a femur's lower end"""

_X, _Y, _Z = np.eye(3)


def objections(bones: Mapping[str, FloatArray]) -> list[str]:
    """Lines on bones that lie where no person has them.

    Args:
        bones: points (p, 3) m in world of the surfaces of bones by name and side, as femur_l; x is
            in front, y up, z to the right.
    """
    found = []
    middles = {name: points.mean(axis=0) for name, points in bones.items()}
    for side in ("l", "r"):
        if f"femur_{side}" in bones:
            femur = bones[f"femur_{side}"]
            middles[f"knee_{side}"] = femur[femur[:, 1] < femur[:, 1].min() + _KNEE].mean(axis=0)
    for side, lateral in (("l", -_Z), ("r", _Z)):
        rules = (
            ("femur", "tibia", _Y, "above", "the image is upside down"),
            ("tibia", "talus", _Y, "above", "the image is upside down"),
            ("patella", "knee", _X, "in front of", "the image's front and back are exchanged"),
            ("fibula", "tibia", lateral, "outside of", "left and right are exchanged"),
        )
        for bone, other, direction, where, why in rules:
            a, b = middles.get(f"{bone}_{side}"), middles.get(f"{other}_{side}")
            if a is not None and b is not None and (a - b) @ direction < -_CLEARLY:
                found.append(f"In doubt: {bone}_{side} is not {where} {other}_{side}: {why}")
    for bone in ("femur", "tibia"):
        left, right = middles.get(f"{bone}_l"), middles.get(f"{bone}_r")
        if left is not None and right is not None and (right - left) @ _Z < -_CLEARLY:
            found.append(
                f"In doubt: {bone}_r is to the left of {bone}_l: left and right are exchanged"
            )
    cure = "; check the map's sides, the axes of the image (--axes) and its directions"
    return [line + cure for line in found]
