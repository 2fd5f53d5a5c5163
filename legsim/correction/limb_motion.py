"""How a leg moves whose thigh and shank are known: three rigid bones and the tissue between them.

Femur and tibia move as two estimates say, whichever they are. So does the patella where it has an
estimate of its own; else it follows the knee's flexion by the relation that Rajagopal et al. 2016
published. Tissue takes shares of the motions of thigh and shank that fall with the distance from
their axes. Where bones were seen, what lies at a bone moves with it, and the patella carries the
tissue around it as far as it is long.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, frozen_owned
from legsim.correction.bone_regions import FEMUR, PATELLA, TIBIA, BoneRegions, axis_distances
from legsim.deformation.polyrigid import PolyrigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.kinematics import patella

_FALLS_BY = 6
"""power of the distance by which a share falls"""

_NEAREST = 1e-4
"""m: a smaller distance counts as this"""

_PATELLA_CARRIES = 3.0
"""radii of a ball of the patella's volume, at which it carries no tissue any more: its length"""

_SOFTENS = 0.004
"""m beyond a bone's rigid margin, over which tissue goes over to its own shares"""

_BETWEEN = 0.002
"""m by which one bone must be nearer than another to lead alone"""

_UNSEEN = 1e3
"""m to a bone that was not seen"""

_UPPER_SHANK = 0.2
"""share of the way from knee to ankle"""

_BENT, _HELD_BENT = 0.1, 0.3
"""sine of a change of a bend that tells forward, 6 degrees, and of a bend that is held: 17 degrees,
which no knee bends sideways"""

_SHORTEST = 0.05
"""m of a thigh or shank"""


@dataclass(frozen=True, slots=True, eq=False)
class Limb:
    """A leg whose thigh and shank move as two estimates say."""

    joints: FloatArray
    """(3, 3) m, hip, knee and ankle in world at the first time"""
    thigh: FloatArray
    """(v, 4, 4) poses in world of anything that is fixed to the femur"""
    shank: FloatArray
    """(v, 4, 4) poses in world of anything that is fixed to the tibia"""
    bones: BoneRegions | None = None
    """where its bones were seen at the first time; None where they were not"""
    kneecap: FloatArray | None = None
    """(v, 4, 4) poses in world of anything fixed to the patella; None: it follows the bend"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", frozen("Limb.joints", self.joints, (3, 3)))
        object.__setattr__(self, "thigh", frozen("Limb.thigh", self.thigh, (None, 4, 4)))
        shape = (len(self.thigh), 4, 4)
        object.__setattr__(self, "shank", frozen("Limb.shank", self.shank, shape))
        if self.kneecap is not None:
            object.__setattr__(self, "kneecap", frozen("Limb.kneecap", self.kneecap, shape))
        thigh, shank = np.linalg.norm(np.diff(self.joints, axis=0), axis=-1)
        if not min(thigh, shank) > _SHORTEST:
            raise LegsimError(
                f"hip and knee are {1e3 * thigh:.0f} mm apart, knee and ankle "
                f"{1e3 * shank:.0f} mm, which is no leg; check their places on the sensors"
            )

    @property
    def patella(self) -> FloatArray | None:
        """(3,) m in world, the middle of the patella at the first time; None if it was not seen."""
        return None if self.bones is None else self.bones.middle(PATELLA)

    def motions(self) -> FloatArray:
        """(v, k, 4, 4) moved_from_reference of thigh, shank, and the patella if it was seen."""
        thigh, shank = (poses @ transforms.inverse(poses[0]) for poses in (self.thigh, self.shank))
        if self.patella is None:
            return np.stack([thigh, shank], 1)
        if self.kneecap is not None:
            own = self.kneecap @ transforms.inverse(self.kneecap[0])
            return np.stack([thigh, shank, own], 1)
        follows = patella_motion(thigh, shank, self.joints, self.patella)
        return np.stack([thigh, shank, follows], 1)

    def carried_by_patella(self, points: FloatArray) -> FloatArray:
        """(p,) share of the patella in the motion of tissue at points (p, 3).

        It falls from 1 at the bone to 0 where it reaches no more. Were it felt farther up the
        thigh, skin there would slide with it as the knee is straightened, which it does not.
        """
        if self.bones is None or self.patella is None:
            return np.zeros(len(points))
        radius = np.cbrt(self.bones.volume(PATELLA) * 3 / (4 * np.pi))
        away = KDTree(self.bones.points(PATELLA)).query(points)[0] / (_PATELLA_CARRIES * radius)
        return _smooth_step(1 - away)

    def bone_distances(self, points: FloatArray) -> FloatArray:
        """(p, k) m of points (p, 3) from the bodies' bones; a kilometer where none was seen.

        The greatest of the distances along the axes of world: a node no farther than a cell is a
        corner of one that holds some bone.
        """
        found = np.full((len(points), 2 if self.patella is None else 3), _UNSEEN)
        if self.bones is not None:
            for k, label in enumerate((FEMUR, TIBIA, PATELLA)[: found.shape[1]]):
                found[:, k] = KDTree(self.bones.points(label)).query(points, p=np.inf)[0]
        return found


def articulated_motion(
    times: FloatArray, limbs: Sequence[Limb], nodes: VolumeGrid
) -> PolyrigidMotion:
    """Motion of all limbs together, its shares given at ``nodes``."""
    bodies = np.concatenate([limb.motions() for limb in limbs], 1)
    # all corners of a cell that holds some bone: linear between them, bone stays rigid
    margin = float(max(nodes.spacing_xyz))
    shares = shares_at(nodes.positions(), limbs, margin)
    per_body = np.moveaxis(shares.reshape(*nodes.shape_zyx, -1), -1, 0).astype(np.float32)
    return PolyrigidMotion(times, bodies, nodes, frozen_owned(np.ascontiguousarray(per_body)))


def shares_at(points: FloatArray, limbs: Sequence[Limb], margin: float) -> FloatArray:
    """Shares (p, k) of the bodies' motions at points (p, 3); each row sums to 1.

    Nearer to a bone than ``margin`` (m, along the axes of world) all is its own. Shares are
    continuous.
    """
    tissue = _tissue_shares(points, limbs)
    from_bones = np.concatenate([limb.bone_distances(points) for limb in limbs], -1)
    nearest = from_bones.min(-1, keepdims=True)
    bony = np.maximum(1 - (from_bones - nearest) / _BETWEEN, 0)
    soft = _smooth_step((nearest - margin) / _SOFTENS)
    return soft * tissue + (1 - soft) * bony / bony.sum(-1, keepdims=True)


def _tissue_shares(points: FloatArray, limbs: Sequence[Limb]) -> FloatArray:
    """Shares (p, k) of tissue that lies at no bone."""
    distance = np.concatenate([axis_distances(points, limb.joints) for limb in limbs], -1)
    falling = np.maximum(distance, _NEAREST) ** -_FALLS_BY
    of_axes = np.split(falling / falling.sum(-1, keepdims=True), len(limbs), -1)
    carried = np.stack([limb.carried_by_patella(points) for limb in limbs], -1)
    carried = carried / np.maximum(carried.sum(-1, keepdims=True), 1)
    rest = 1 - carried.sum(-1, keepdims=True)
    columns = []
    for limb, shares, own in zip(limbs, of_axes, carried.T, strict=True):
        columns += [rest * shares] if limb.patella is None else [rest * shares, own[:, None]]
    return np.concatenate(columns, -1)


def _smooth_step(t: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, without a bend at either."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def patella_motion(
    thigh: FloatArray, shank: FloatArray, joints: FloatArray, middle: FloatArray
) -> FloatArray:
    """Motion (v, 4, 4) of a patella, from those of thigh and shank (v, 4, 4).

    Its place on the femur is that of Rajagopal's model at the knee's flexion, scaled to the thigh's
    length; ``middle`` (3,) m is where the bone was seen. Flexion is about the axis to the right.
    """
    femur, factors, bent = _scaled_femur(joints, middle)
    turned = np.swapaxes(thigh[:, :3, :3] @ femur[:3, :3], 1, 2) @ shank[:, :3, :3] @ femur[:3, :3]
    on_femur = patella.in_femur(turned @ bent, factors, "r")
    return thigh @ femur @ on_femur @ transforms.inverse(femur @ on_femur[0])


def expected_patella(limb: Limb) -> FloatArray | None:
    """world_from_patella (4, 4) at the first time as Rajagopal's model has it: from its middle, x
    forward.

    A knee bends backward: forward is away from where the shank goes as it bends. None where it
    hardly bends, so that nothing tells forward. Whether the leg is a left or a right one is
    unknown: the patella lies in the middle between both, 3 mm beside its place in either.
    """
    backward, shaft = _backward(limb), limb.joints[2] - limb.joints[1]
    if backward is None:
        return None
    ahead = limb.joints[1] + _UPPER_SHANK * shaft - backward
    femur, factors, bent = _scaled_femur(limb.joints, ahead)
    on_femur = patella.in_femur(bent[None], factors, "r")[0]
    on_femur[2, 3] = 0.0
    return femur @ on_femur @ transforms.translation(factors * patella.MIDDLE)


def _backward(limb: Limb) -> FloatArray | None:
    """(3,) in world, where the shank goes at the first time as the knee bends; None if unknown."""
    thigh, shank = np.moveaxis(limb.motions()[:, :2, :3, :3], 1, 0)
    up = (limb.joints[0] - limb.joints[1]) / np.linalg.norm(limb.joints[0] - limb.joints[1])
    shaft = limb.joints[2] - limb.joints[1]
    against_thigh = np.swapaxes(thigh, 1, 2) @ shank @ shaft
    off = (against_thigh - (against_thigh @ up)[:, None] * up) / np.linalg.norm(shaft)
    # a leg in varus or valgus is off sideways, too, but by the same in all views
    along = np.linalg.svd(off - off.mean(0), full_matrices=False)[2][0]
    bends = off @ along
    if np.ptp(bends) >= _BENT:
        return along * np.sign(bends[np.argmax(np.abs(bends))])
    most = off[np.argmax(np.linalg.norm(off, axis=-1))]
    return most if np.linalg.norm(most) >= _HELD_BENT else None


def _scaled_femur(
    joints: FloatArray, middle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """world_from_femur (4, 4) of Rajagopal's femur, its scale (3,), and the rotation (3, 3) of a
    tibia that is bent as the leg is.
    """
    length = float(np.linalg.norm(joints[0] - joints[1]))
    femur = _femur_frame(joints, middle)
    knee = patella.knee_in_femur(_bend(femur, joints))
    # the thigh's axis goes through the knee's center, which is not quite below the hip
    tilted = transforms.axis_rotation((0, 0, 1), np.arctan2(-knee[0], -knee[1]))
    femur = femur @ transforms.rigid(tilted, np.zeros(3))
    bent = transforms.axis_rotation((0, 0, 1), -_bend(femur, joints))
    return femur, np.full(3, length / float(np.linalg.norm(knee))), bent


def _bend(femur: FloatArray, joints: FloatArray) -> float:
    """Flexion in rad of a knee whose femur lies as ``femur`` (4, 4) says."""
    down = femur[:3, :3].T @ (joints[2] - joints[1])
    return float(np.arctan2(-down[0], -down[1]))


def _femur_frame(joints: FloatArray, middle: FloatArray) -> FloatArray:
    """world_from_femur (4, 4): from the hip, y up along the thigh, x forward.

    Forward is from the upper shank to the patella: a straight leg's patella lies in front of its
    axis, and a bent knee's shank points backward.
    """
    up = (joints[0] - joints[1]) / np.linalg.norm(joints[0] - joints[1])
    forward = middle - (joints[1] + _UPPER_SHANK * (joints[2] - joints[1]))
    forward = forward - (forward @ up) * up
    forward = forward / np.linalg.norm(forward)
    return transforms.rigid(np.stack([forward, up, np.cross(forward, up)], -1), joints[0])
