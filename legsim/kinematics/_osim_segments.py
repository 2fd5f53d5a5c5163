"""Legsim's segment frames on the bodies of an OpenSim model, and the sizes of its segments.

The phantom, the sensors and the joint centers expect gait2392's frames: a femur's origin in the hip
center with the knee center in one direction of it, a tibia's in the knee center with the ankle
center straight below. Other models put their bodies' frames elsewhere, by up to a centimeter and
two degrees. So each segment gets a frame of its own, fixed in the body: its origin in the center of
the joint that carries it, turned against the body by the least that brings the next center where
gait2392 has it. On gait2392 that is the body's frame itself.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics._osim_chain import Chain
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales, segment_index

_LARGEST_TURN_DEG = 30.0
"""of a segment's frame against its body's: beyond it the model's axes are not OpenSim's usual"""


@dataclass(frozen=True, slots=True, eq=False)
class SegmentFrames:
    """Where each segment sits; the patella's is computed from femur and tibia."""

    bodies: tuple[int, ...]
    """(13,) index in the chain of the body that carries each segment"""
    body_from_segment: FloatArray
    """(13, 4, 4)"""
    scales: SegmentScales
    """of the phantom: the lengths of this model's segments over the generic leg's"""
    thigh: dict[str, float]
    """m, hip to knee center with the knee straight, by side"""
    shank: dict[str, float]
    """m, knee to ankle center, by side"""
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Generic:
    """Legsim's generic leg, straight: offsets between the origins of its segments, right side."""

    hip: FloatArray
    knee: FloatArray
    ankle: FloatArray
    heel: FloatArray
    toes: FloatArray


@cache
def _generic() -> _Generic:
    leg = LegModel.load()
    origins = leg.kinematics(leg.default_coordinates[None]).origins[0]
    at = {name: origins[segment_index(name)] for name in SEGMENTS}
    steps = ("pelvis", "femur_r", "tibia_r", "talus_r", "calcn_r", "toes_r")
    return _Generic(*(at[b] - at[a] for a, b in pairwise(steps)))


def place(chain: Chain, roles: dict[str, str], neutral: FloatArray) -> SegmentFrames:
    """Frames and sizes of the segments, from the model standing straight at values (c,).

    Raises:
        LegsimError: the model's axes are not x forward, y up, z to the right, or its legs are
            crossed or folded.
    """
    rotations, origins = (part[0] for part in chain.poses(neutral[None]))
    centers = chain.centers(neutral[None])[0]
    body = {s: chain.bodies.index(b) for s, b in roles.items() if not s.startswith("patella")}
    pelvis = transforms.rigid(rotations[body["pelvis"]], origins[body["pelvis"]])
    world = {"pelvis": pelvis}
    carrier = {"pelvis": body["pelvis"]}
    factors = np.ones((len(SEGMENTS), 3))
    thigh, shank, notes = {}, {}, []
    hips = {side: _center(chain, body["pelvis"], body[f"femur_{side}"], centers) for side in "rl"}
    _check_axes(pelvis, hips, rotations, roles, body)
    for side in "rl":
        leg = _Leg(chain, body, side, rotations, centers)
        placed, sizes, said = leg.segments(hips[side])
        world |= {name: pose for name, (pose, _) in placed.items()}
        carrier |= {name: b for name, (_, b) in placed.items()}
        thigh[side], shank[side] = leg.thigh, leg.shank
        for name, factor in sizes.items():
            factors[segment_index(name)] = factor
        notes += said
    across = np.linalg.norm(hips["r"] - hips["l"]) / 2 / _generic().hip[2]
    factors[segment_index("pelvis")] = across
    local = [
        transforms.inverse(transforms.rigid(rotations[carrier[s]], origins[carrier[s]])) @ world[s]
        for s in SEGMENTS
    ]
    return SegmentFrames(
        tuple(carrier[s] for s in SEGMENTS),
        np.stack(local),
        SegmentScales(factors),
        thigh,
        shank,
        tuple(notes),
    )


class _Leg:
    """One leg of a model that stands straight."""

    def __init__(
        self,
        chain: Chain,
        body: dict[str, int],
        side: str,
        rotations: FloatArray,
        centers: FloatArray,
    ) -> None:
        self._chain, self._centers, self._rotations = chain, centers, rotations
        self._side, self._mirror = side, np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
        self._body = {
            name.removesuffix(f"_{side}"): b
            for name, b in body.items()
            if name.endswith(f"_{side}")
        }
        self.thigh = self.shank = 0.0

    def segments(
        self, hip: FloatArray
    ) -> tuple[dict[str, tuple[FloatArray, int]], dict[str, float], list[str]]:
        """(world pose and carrier of each segment, its size, notes)."""
        body, generic, notes = self._body, _generic(), []
        foot = "talus" if "talus" in body else "calcn"
        knee = self._between("femur", "tibia")
        ankle = self._between("tibia", foot)
        self.thigh = float(np.linalg.norm(knee - hip))
        self.shank = float(np.linalg.norm(ankle - knee))
        femur_size = self.thigh / float(np.linalg.norm(generic.knee))
        tibia_size = self.shank / float(np.linalg.norm(generic.ankle))
        poses = {
            "femur": self._aimed("femur", hip, generic.knee * self._mirror, knee),
            "tibia": self._aimed("tibia", knee, generic.ankle * self._mirror, ankle),
            "talus": transforms.rigid(self._turn(self._level(foot)), ankle),
        }
        foot_size = tibia_size
        if {"calcn", "toes"} <= body.keys():
            length = np.linalg.norm(self._between("calcn", "toes") - self._heel(ankle, 1.0))
            foot_size = float(length / np.linalg.norm(generic.toes))
        hind = "calcn" if "calcn" in body else "talus"
        poses["calcn"] = transforms.rigid(self._turn(hind), self._heel(ankle, foot_size))
        fore = "toes" if "toes" in body else hind
        tip = (
            self._between("calcn", "toes")
            if {"calcn", "toes"} <= body.keys()
            else transforms.apply(poses["calcn"], (generic.toes * self._mirror * foot_size)[None])[
                0
            ]
        )
        poses["toes"] = transforms.rigid(self._turn(fore), tip)
        # a stand-in, never read: the leg computes it from femur and tibia
        poses["patella"] = poses["femur"]
        carriers = {"femur": "femur", "tibia": "tibia", "talus": foot, "calcn": hind, "toes": fore}
        carriers["patella"] = "femur"
        for part, by in carriers.items():
            if part not in body and part != "patella":
                notes.append(f"{part}_{self._side} is taken to be fixed in the model's {by} body")
        sizes = {"femur": femur_size, "patella": femur_size, "tibia": tibia_size}
        sizes |= dict.fromkeys(("talus", "calcn", "toes"), foot_size)
        return (
            {f"{n}_{self._side}": (pose, body[carriers[n]]) for n, pose in poses.items()},
            {f"{name}_{self._side}": size for name, size in sizes.items()},
            notes,
        )

    def _turn(self, part: str) -> FloatArray:
        return self._rotations[self._body[part]]

    def _level(self, foot: str) -> str:
        """The body whose axes the talus takes: its own, unless these are turned to the ankle's
        axis.
        """
        if foot != "talus" or "calcn" not in self._body:
            return foot
        turn = self._turn("calcn").T @ self._turn("talus")
        far = np.degrees(transforms.rotation_angle(turn)) > _LARGEST_TURN_DEG
        return "calcn" if far else foot

    def _between(self, upper: str, lower: str) -> FloatArray:
        return _center(self._chain, self._body[upper], self._body[lower], self._centers)

    def _heel(self, ankle: FloatArray, size: float) -> FloatArray:
        """Origin of the calcaneus: its joint's center, or below the ankle as in the generic
        leg.
        """
        if {"talus", "calcn"} <= self._body.keys():
            return self._between("talus", "calcn")
        part = "calcn" if "calcn" in self._body else "talus"
        return ankle + self._turn(part) @ (_generic().heel * self._mirror * size)

    def _aimed(
        self, part: str, origin: FloatArray, local: FloatArray, end: FloatArray
    ) -> FloatArray:
        """The body's axes turned by the least that brings ``local`` onto the way to ``end``."""
        turn, along = self._turn(part), end - origin
        length = np.linalg.norm(along)
        if length == 0:
            raise LegsimError(
                f"the joints at both ends of the {part}_{self._side} lie at one point; check the "
                "frames of the model's joints"
            )
        a, b = turn @ (local / np.linalg.norm(local)), along / length
        axis, cosine = np.cross(a, b), float(np.clip(a @ b, -1, 1))
        angle = float(np.arctan2(np.linalg.norm(axis), cosine))
        if np.degrees(angle) > _LARGEST_TURN_DEG:
            raise LegsimError(
                f"with all joints at zero the {part}_{self._side}'s y axis lies "
                f"{np.degrees(angle):.0f} degrees off the line of its joints; legsim needs bodies "
                "with x forward, y up, z to the right, and a straight leg at zero"
            )
        if angle < 1e-12:
            return transforms.rigid(turn, origin)
        return transforms.rigid(
            transforms.rotation_from_vector(axis / np.linalg.norm(axis) * angle) @ turn, origin
        )


def _center(chain: Chain, upper: int, lower: int, centers: FloatArray) -> FloatArray:
    """(3,) center of the joint between two bodies: of several on the way, the first that turns.

    Raises:
        LegsimError: ``lower`` does not hang on ``upper``.
    """
    path, at = [], lower
    while at != upper:
        if at < 0:
            raise LegsimError(
                f"the body {chain.bodies[lower]} does not hang on {chain.bodies[upper]}"
            )
        path.append(at)
        at = chain.parent_of(at)
    path.reverse()
    turning = [b for b in path if chain.joint_of(b).rotations]
    return centers[(turning or path)[0]]


def _check_axes(
    pelvis: FloatArray,
    hips: dict[str, FloatArray],
    rotations: FloatArray,
    roles: dict[str, str],
    body: dict[str, int],
) -> None:
    """Refuses a model whose axes are not OpenSim's usual."""
    across = pelvis[:3, :3].T @ (hips["r"] - hips["l"])
    if not across[2] > 0.7 * np.linalg.norm(across):
        raise LegsimError(
            "the right hip does not lie to the right (+z) of the left one in the pelvis; legsim "
            "needs bodies with x forward, y up, z to the right"
        )
    for segment in body:
        if segment.startswith("talus") and segment.replace("talus", "calcn") in body:
            continue  # some follow the ankle's axis; the calcaneus says how the foot lies
        turn = pelvis[:3, :3].T @ rotations[body[segment]]
        angle = float(np.degrees(transforms.rotation_angle(turn)))
        if angle > _LARGEST_TURN_DEG:
            raise LegsimError(
                f"with all joints at zero the body {roles[segment]} is turned by {angle:.0f} "
                "degrees against the pelvis; legsim needs bodies whose axes (x forward, y up, z "
                "to the right) are then parallel"
            )
