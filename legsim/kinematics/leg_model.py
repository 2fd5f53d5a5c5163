"""The leg model: OpenSim gait2392's pelvis, legs and feet with patellae, moved by MuJoCo.

MuJoCo knows every joint as a hinge or slide; the knee's and patella's dependent ones are set here
from exact splines with their first and second derivatives, because MuJoCo applies equality
constraints only in simulations, not in kinematics. Derivation of the model:
models/lower_body/README.md.
"""


# mujoco is compiled and ships no type stubs
# pyright: reportAttributeAccessIssue=false

import tomllib
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from legsim.core import resources
from legsim.core.constants import GRAVITY_WORLD
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.kinematics._leg_scaling import scale_masses, scale_offsets
from legsim.kinematics._simm_spline import SimmSpline
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import (
    SEGMENTS,
    JointCenters,
    SegmentPoses,
    SegmentScales,
    segment_index,
)
from legsim.mocap.trajectories import JointTrajectories

_SIDE = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "ankle_angle",
    "subtalar_angle",
    "mtp_angle",
)

_SHIFTS = ("pelvis_tx", "pelvis_ty", "pelvis_tz")

COORDINATES = (
    *("pelvis_tilt", "pelvis_list", "pelvis_rotation", *_SHIFTS),
    *(f"{name}_{side}" for side in "rl" for name in _SIDE),
)
"""The 20 independent coordinates in the order of every (n, 20) array, under OpenSim's names."""


class SensorMotion(NamedTuple):
    """What a frame fixed in a segment goes through, n samples."""

    world_from_sensor: FloatArray
    """(n, 4, 4)"""
    angular_velocity: FloatArray
    """(n, 3) rad/s in the sensor frame"""
    specific_force: FloatArray
    """(n, 3) m/s^2 in the sensor frame: acceleration minus gravity"""


class Kinematics(NamedTuple):
    """Poses of all segments and how each coordinate moves them, n samples."""

    rotations: FloatArray
    """(n, 13, 3, 3) world_from_segment"""
    origins: FloatArray
    """(n, 13, 3) m, segment origins in world"""
    angular: FloatArray
    """(n, 20, 3) turn per unit of each coordinate, in world"""
    linear: FloatArray
    """(n, 20, 3) shift per unit of each coordinate of the point at the world's origin: dp/dq =
    linear + angular x p
    """


class LegJoint(NamedTuple):
    """One degree of freedom of a body on its parent."""

    name: str
    """the coordinate's, or that of a joint which follows the knee angle"""
    axis: FloatArray
    """(3,)"""
    slides: bool
    """along the axis; else it turns about it"""
    low: float
    high: float
    default: float
    spline: SimmSpline | None
    """of the same side's knee angle, where it follows that; None for a free coordinate"""


class LegBody(NamedTuple):
    """One body: its inertia, and how it sits on its parent."""

    name: str
    parent: str
    """``world`` for the pelvis"""
    offset: FloatArray
    """(3,) m, its origin in the parent with all slides at zero"""
    mass: float
    mass_center: FloatArray
    inertia: FloatArray
    """(3,) kg m^2 about the mass center"""
    joints: tuple[LegJoint, ...]
    """slides first"""


@dataclass(frozen=True, slots=True, eq=False)
class _Coupling:
    """A dependent joint of both legs, right and left: each value is ``size * spline(sign * knee
    angle)``.
    """

    joints: np.ndarray
    """(2,)"""
    sign: float
    sizes: FloatArray
    """(2,)"""
    spline: SimmSpline
    moves_shank: bool
    """a knee's, not a patella's"""


_KNEES = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]


class LegModel:
    """One person's leg model; unchangeable, safe to use from several threads.

    Arrays named ``values`` hold the 20 coordinates in the order of ``coordinate_names``: radians,
    and meters for pelvis_tx, _ty, _tz.
    """

    __slots__ = (
        "_address",
        "_couplings",
        "_model",
        "coordinate_ranges",
        "default_coordinates",
        "moves",
        "scales",
    )

    coordinate_names = COORDINATES
    shifts = _SHIFTS
    pelvis_coordinates = 6
    heading = COORDINATES.index("pelvis_rotation")

    def __init__(
        self, model: mujoco.MjModel, couplings: list[_Coupling], scales: SegmentScales
    ) -> None:
        self._model, self._couplings, self.scales = model, couplings, scales
        joints = [model.joint(name).id for name in COORDINATES]
        self._address = np.array(joints)
        self.coordinate_ranges = frozen("coordinate_ranges", model.jnt_range[joints], (20, 2))
        """(20, 2) lowest and highest value of each coordinate: gait2392's, or people's"""
        self.default_coordinates = frozen("default_coordinates", model.qpos0[joints], (20,))
        """(20,) the standing pose: zero but for pelvis_ty"""
        self.moves = _moves(model, joints)
        """(20, 13) whether a coordinate moves a segment by its :class:`Kinematics`; False for knee
        and patella, which glides on its own
        """

    def __repr__(self) -> str:
        thigh, shank = (1e3 * f("r") for f in (self.thigh_length, self.shank_length))
        return f"LegModel(thigh {thigh:.0f} mm, shank {shank:.0f} mm)"

    @classmethod
    def load(cls, scales: SegmentScales | None = None) -> "LegModel":
        """The generic model, or one scaled by OpenSim's rules.

        Offsets of joints scale with the parent segment, mass centers with their own, knee and
        patella splines with the femur; masses and inertias as :class:`SegmentScales` says.

        Raises:
            LegsimError: the model's files are missing from this installation.
        """
        scales = SegmentScales.uniform() if scales is None else scales
        model = mujoco.MjModel.from_xml_path(str(resources.model_file("lower_body/lower_body.xml")))
        # a constraint would not change kinematics, only cost time
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        model.opt.gravity[:] = GRAVITY_WORLD
        couplings = _load_couplings(model, scales)
        scale_offsets(model, scales)
        scale_masses(model, scales)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return cls(model, couplings, scales)

    def values_of(self, trajectories: JointTrajectories) -> FloatArray:
        """Values (n, 20) in the model's order; coordinates of other names (lumbar, arms) are left
        out.

        Raises:
            LegsimError: a coordinate of the leg is missing or not a number.
        """
        missing = [name for name in COORDINATES if name not in trajectories.coordinate_names]
        if missing:
            raise LegsimError(
                f"the motion has no coordinate {', '.join(missing)}; the leg needs "
                f"{', '.join(COORDINATES)}"
            )
        values = trajectories.values[
            :, [trajectories.coordinate_names.index(name) for name in COORDINATES]
        ]
        return self._checked(values)

    def segment_poses(self, trajectories: JointTrajectories) -> SegmentPoses:
        """Pose of every segment at every time of ``trajectories`` (any order of coordinates, extra
        ones ignored).

        Raises:
            LegsimError: a coordinate of the leg is missing or not a number.
        """
        positions, _, _ = self._dependent(self.values_of(trajectories))
        rotations, origins, _, _ = self._poses(positions)
        matrices = np.zeros((len(positions), len(SEGMENTS), 4, 4))
        matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = rotations, origins, 1.0
        return SegmentPoses(trajectories.times, SEGMENTS, matrices)

    def joint_centers(self, poses: SegmentPoses) -> JointCenters:
        """Hip, knee and ankle centers: the origins of femur, tibia and talus."""
        return JointCenters.of_segments(poses)

    def thigh_length(self, side: str) -> float:
        """m, from hip center to knee center with the knee straight; ``side`` is "r" or "l"."""
        return float(np.linalg.norm(self._model.body(f"tibia_{side}").pos))

    def shank_length(self, side: str) -> float:
        """m, from knee center to ankle center; ``side`` is "r" or "l"."""
        return float(np.linalg.norm(self._model.body(f"talus_{side}").pos))

    def mass_of(self, segment: str) -> float:
        """kg of one segment."""
        return float(self._model.body(SEGMENTS[segment_index(segment)]).mass[0])

    def mass_center_of(self, segment: str) -> FloatArray:
        """Mass center (3,) of one segment, m in its frame."""
        return frozen("mass center", self._model.body(SEGMENTS[segment_index(segment)]).ipos, (3,))

    def inertia_of(self, segment: str) -> FloatArray:
        """Moments of inertia (3,) kg m^2 of one segment about its mass center, along its axes."""
        return frozen("inertia", self._model.body(SEGMENTS[segment_index(segment)]).inertia, (3,))

    def posture(self, hip: float, knee: float, ankle: float) -> FloatArray:
        """Coordinates (20,) with both legs bent: turns (rad) of each joint about the axis to the
        right.
        """
        values = np.zeros(len(COORDINATES))
        for name, angle in (("hip_flexion", hip), ("knee_angle", knee), ("ankle_angle", ankle)):
            for side in "rl":
                values[COORDINATES.index(f"{name}_{side}")] = angle
        return values

    def pelvis_values(self, world_from_pelvis: FloatArray) -> FloatArray:
        """The pelvis' coordinates (n, 6) at poses (n, 4, 4), whose rotations are Rz Rx Ry."""
        r = np.asarray(world_from_pelvis, float)
        tilt = np.arctan2(-r[:, 0, 1], r[:, 1, 1])
        lean = np.arcsin(np.clip(r[:, 2, 1], -1, 1))
        turn = np.arctan2(-r[:, 2, 0], r[:, 2, 2])
        return np.column_stack([tilt, lean, turn, r[:, :3, 3]])

    def complete(self, trajectories: JointTrajectories) -> JointTrajectories:
        """The motion itself: gait2392 has no coordinate beside the 20."""
        return trajectories

    def bodies(self) -> tuple[LegBody, ...]:
        """All bodies, parents first; the torso, which does not move on the pelvis, among them."""
        return tuple(self._body(k) for k in range(1, self._model.nbody))

    def kinematics(self, values: ArrayLike) -> Kinematics:
        """Poses and coordinate screws for values (n, 20)."""
        positions, slopes, _ = self._dependent(self._checked(values))
        rotations, origins, anchors, axes = self._poses(positions)
        slide = (self._model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)[:, None]
        angular = np.where(slide, 0.0, axes)
        linear = np.where(slide, axes, np.cross(anchors, axes))
        screws = Kinematics(rotations, origins, angular[:, self._address], linear[:, self._address])
        for k, coupling in enumerate(self._couplings):
            if coupling.moves_shank:
                screws.linear[:, _KNEES] += slopes[:, k, :, None] * linear[:, coupling.joints]
        return screws

    def marker_positions(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Where the markers are in world, (n, m, 3), for values (n, 20)."""
        positions, _, _ = self._dependent(self._checked(values))
        rotations, origins, _, _ = self._poses(positions)
        rows = [segment_index(s) for s in sites.segments]
        return origins[:, rows] + np.einsum("nmij,mj->nmi", rotations[:, rows], sites.positions)

    def marker_jacobians(self, values: ArrayLike, sites: MarkerSites) -> FloatArray:
        """Derivatives (n, m, 3, 20) of the marker positions by the coordinates.

        Raises:
            LegsimError: a marker sits on a patella, whose glide on the femur is not among the
                screws.
        """
        rows = marker_rows(sites)
        pose = self.kinematics(values)
        points = pose.origins[:, rows] + np.einsum(
            "nmij,mj->nmi", pose.rotations[:, rows], sites.positions
        )
        columns = pose.linear[:, None] + np.cross(pose.angular[:, None], points[:, :, None])
        jacobians: FloatArray = np.where(self.moves.T[rows][None, :, :, None], columns, 0.0)
        return np.swapaxes(jacobians, -1, -2)

    def attached_motion(
        self,
        values: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        *,
        segment: str,
        segment_from_sensor: ArrayLike,
    ) -> SensorMotion:
        """What a sensor fixed to ``segment`` feels, exactly, from the coordinates and their first
        and second time derivatives.

        Args:
            values: (n, 20) rad and m, in the order of ``coordinate_names``.
            rates: (n, 20) first time derivatives.
            accelerations: (n, 20) second time derivatives.
            segment: name of the segment that carries the sensor.
            segment_from_sensor: (4, 4) where the sensor sits.

        Raises:
            LegsimError: an unknown segment, or a value that is not a number.
        """
        positions, velocities, accelerations = self._with_time_derivatives(
            values, rates, accelerations
        )
        segment_from_sensor = np.asarray(segment_from_sensor, float)
        body = self._model.body(SEGMENTS[segment_index(segment)]).id
        poses, twists, forces = self._body_motion(positions, velocities, accelerations, body)
        omega, alpha = twists[:, :3], forces[:, :3]
        lever, turn = segment_from_sensor[:3, 3], segment_from_sensor[:3, :3]
        force = forces[:, 3:] + np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))
        return SensorMotion(poses @ segment_from_sensor, omega @ turn, force @ turn)

    def _body(self, index: int) -> LegBody:
        model, body = self._model, self._model.body(index)
        joints = [self._joint(body.jntadr[0] + k) for k in range(body.jntnum[0])]
        offset = body.pos.copy()
        for k, joint in enumerate(joints):
            if joint.slides:
                offset -= joint.axis * model.qpos0[body.jntadr[0] + k]
        parent = model.body(body.parentid[0]).name
        held = (float(body.mass[0]), body.ipos.copy(), body.inertia.copy())
        return LegBody(body.name, parent, offset, *held, tuple(joints))

    def _joint(self, index: int) -> LegJoint:
        joint = self._model.joint(index)
        spline = None
        for c in self._couplings:
            if index in c.joints:
                y = c.sizes[list(c.joints).index(index)] * c.spline.y
                order = slice(None, None, int(c.sign))
                spline = SimmSpline(c.sign * c.spline.x[order], y[order])
        slides = self._model.jnt_type[index] == mujoco.mjtJoint.mjJNT_SLIDE
        low, high = map(float, joint.range)
        start = float(self._model.qpos0[index])
        return LegJoint(joint.name, joint.axis.copy(), bool(slides), low, high, start, spline)

    def _checked(self, values: ArrayLike) -> FloatArray:
        array = np.ascontiguousarray(values, float)
        if array.ndim != 2 or array.shape[1] != len(COORDINATES):
            raise LegsimError(
                f"coordinates have shape {array.shape}; expected (n, {len(COORDINATES)})"
            )
        if not np.isfinite(array).all():
            row, column = np.argwhere(~np.isfinite(array))[0]
            raise LegsimError(f"coordinate {COORDINATES[column]} is not a number at sample {row}")
        return array

    def _dependent(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions (n, joints) of all joints; first and second derivative (n, couplings, 2) of the
        dependent ones by the knee angles.
        """
        positions = np.empty((len(values), self._model.nq))
        positions[:, self._address] = values
        slopes, bends = np.empty((2, len(values), len(self._couplings), 2))
        for k, c in enumerate(self._couplings):
            value, first, second = c.spline.with_derivatives(c.sign * values[:, _KNEES])
            positions[:, c.joints] = c.sizes * value
            slopes[:, k], bends[:, k] = c.sizes * c.sign * first, c.sizes * second
        return positions, slopes, bends

    def _with_time_derivatives(
        self, values: ArrayLike, rates: ArrayLike, accelerations: ArrayLike
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations (n, joints) of all joints, dependent ones by the
        chain rule.
        """
        rates, accelerations = self._checked(rates), self._checked(accelerations)
        positions, slopes, bends = self._dependent(self._checked(values))
        velocities, second = np.empty_like(positions), np.empty_like(positions)
        velocities[:, self._address], second[:, self._address] = rates, accelerations
        for k, c in enumerate(self._couplings):
            rate = rates[:, _KNEES]
            velocities[:, c.joints] = slopes[:, k] * rate
            second[:, c.joints] = slopes[:, k] * accelerations[:, _KNEES] + bends[:, k] * rate**2
        return positions, velocities, second

    def _poses(
        self, positions: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rotations (n, 13, 3, 3) and origins (n, 13, 3) of the segments, anchors and axes (n,
        joints, 3) of the joints, in world.
        """
        model, data = self._model, mujoco.MjData(self._model)
        n = len(positions)
        rotations, origins = np.empty((n, model.nbody, 9)), np.empty((n, model.nbody, 3))
        anchors, axes = np.empty((n, model.njnt, 3)), np.empty((n, model.njnt, 3))
        qpos, xmat, xpos, xanchor, xaxis = data.qpos, data.xmat, data.xpos, data.xanchor, data.xaxis
        for i in range(n):
            qpos[:] = positions[i]
            mujoco.mj_kinematics(model, data)
            rotations[i], origins[i], anchors[i], axes[i] = xmat, xpos, xanchor, xaxis
        rows = [model.body(name).id for name in SEGMENTS]
        return rotations[:, rows].reshape(n, len(rows), 3, 3), origins[:, rows], anchors, axes

    def _body_motion(
        self, positions: FloatArray, velocities: FloatArray, accelerations: FloatArray, body: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At a body's origin: pose (n, 4, 4); in its frame (angular, linear) velocity, (angular
        acceleration, specific force) (n, 6).
        """
        model, data = self._model, mujoco.MjData(self._model)
        n, kind = len(positions), mujoco.mjtObj.mjOBJ_XBODY
        poses, twists, forces = np.zeros((n, 4, 4)), np.empty((n, 6)), np.empty((n, 6))
        poses[:, 3, 3] = 1.0
        for i in range(n):
            data.qpos[:], data.qvel[:], data.qacc[:] = positions[i], velocities[i], accelerations[i]
            # inverse, not forward dynamics: the latter would overwrite qacc by a free fall
            mujoco.mj_inverse(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            poses[i, :3, :3], poses[i, :3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
            mujoco.mj_objectVelocity(model, data, kind, body, twists[i], 1)
            mujoco.mj_objectAcceleration(model, data, kind, body, forces[i], 1)
        return poses, twists, forces


def marker_rows(sites: MarkerSites) -> list[int]:
    """Segment index of each marker.

    Raises:
        LegsimError: a marker sits on a patella.
    """
    on_patella = [
        name
        for name, segment in zip(sites.names, sites.segments, strict=True)
        if segment.startswith("patella")
    ]
    if on_patella:
        raise LegsimError(
            f"marker {', '.join(on_patella)} sits on a patella, which follows the knee; attach it "
            "to the femur or tibia"
        )
    return [segment_index(s) for s in sites.segments]


def _moves(model: mujoco.MjModel, joints: list[int]) -> np.ndarray:
    """(20, 13) whether a joint lies between the world and a segment."""
    moves = np.zeros((len(joints), len(SEGMENTS)), bool)
    for s, name in enumerate(SEGMENTS):
        body = model.body(name).id
        while body:
            moves[:, s] |= model.jnt_bodyid[joints] == body
            body = model.body_parentid[body]
    moves.flags.writeable = False
    return moves


def _load_couplings(model: mujoco.MjModel, scales: SegmentScales) -> list[_Coupling]:
    """Reads couplings.toml; slides are scaled by the femur's factor along their axis (OpenSim:
    |axis| . factors of the parent).
    """
    tables = tomllib.loads(resources.model_file("lower_body/couplings.toml").read_text("utf-8"))[
        "coupling"
    ]
    couplings = []
    for t in tables:
        joints = [model.joint(f"{t['joint']}_{side}") for side in "rl"]
        sizes = [
            float(np.abs(joint.axis) @ scales.of(f"femur_{side}"))
            if model.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_SLIDE
            else 1.0
            for joint, side in zip(joints, "rl", strict=True)
        ]
        ids, spline = np.array([joint.id for joint in joints]), SimmSpline(t["x"], t["y"])
        couplings.append(
            _Coupling(ids, t["sign"], np.array(sizes), spline, t["joint"].startswith("knee"))
        )
    return couplings
