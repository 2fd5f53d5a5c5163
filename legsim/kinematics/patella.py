"""Where the patella sits on the femur, from the knee's flexion: Rajagopal2016's splines, for models
that have none or another.
"""

import tomllib
from functools import cache

import numpy as np

from legsim.core import resources, transforms
from legsim.core.values import FloatArray
from legsim.kinematics._simm_spline import SimmSpline
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.skeleton import segment_index

MIDDLE = np.array([0.0018, 0.0264, 0.0])
"""m, the bone's center of mass in its frame, which begins at its lower end (the same model)"""


@cache
def _splines() -> tuple[SimmSpline, SimmSpline, SimmSpline]:
    tables = tomllib.loads(resources.model_file("lower_body/couplings.toml").read_text("utf-8"))
    by_joint = {t["joint"]: SimmSpline(t["x"], t["y"]) for t in tables["coupling"]}
    return by_joint["patella_tx"], by_joint["patella_ty"], by_joint["patella_angle"]


@cache
def _splines_at_straight() -> tuple[FloatArray, FloatArray]:
    forward, up, _ = _splines()
    return forward(0.0), up(0.0)


@cache
def _straight() -> FloatArray:
    """(3,) m, origin of the right patella in the generic femur, knee straight."""
    leg = LegModel.load()
    origins = leg.kinematics(leg.default_coordinates[None]).origins[0]
    return origins[segment_index("patella_r")] - origins[segment_index("femur_r")]


def in_femur(femur_from_tibia: FloatArray, factors: FloatArray, side: str) -> FloatArray:
    """femur_from_patella (n, 4, 4), from rotations femur_from_tibia (n, 3, 3) and the femur's scale
    factors (3,).
    """
    flexion = -np.arctan2(femur_from_tibia[:, 1, 0], femur_from_tibia[:, 0, 0])
    forward, up, angle = _splines()
    straight = _splines_at_straight()
    place = np.tile(_straight() * (1.0, 1.0, 1.0 if side == "r" else -1.0), (len(flexion), 1))
    place[:, 0] += forward(flexion) - straight[0]
    place[:, 1] += up(flexion) - straight[1]
    return transforms.rigid(transforms.axis_rotation((0, 0, 1), angle(flexion)), place * factors)


def knee_in_femur(flexion: float) -> FloatArray:
    """(3,) m, the knee's center in the generic right femur, the knee bent by ``flexion`` (rad)."""
    leg = LegModel.load()
    values = leg.default_coordinates.copy()
    values[leg.coordinate_names.index("knee_angle_r")] = -flexion
    found = leg.kinematics(values[None])
    femur, tibia = segment_index("femur_r"), segment_index("tibia_r")
    return found.rotations[0, femur].T @ (found.origins[0, tibia] - found.origins[0, femur])
