"""The body that stands: legsim's MJCF leg model with a movable trunk, as a closed chain on two feet
that do not leave the floor.

MuJoCo gives mass matrix, bias forces and Jacobians. The knees' translations (exact splines) and the
two feet are constraints on velocity, so that no contact or spring softens them: a foot stays where
it is and stays flat to the rounding of the solver. It turns on its sole about the vertical alone,
against a spring and a damper: the skin below a foot shears, so a leg can turn about its long axis
while the pelvis rests.
"""

# mujoco is compiled and ships no type stubs
# pyright: reportAttributeAccessIssue=false
import tomllib
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.kinematics._simm_spline import SimmSpline
from tools.virtual_subjects.subjects import Subject

MODEL = Path(__file__).parents[2] / "models" / "lower_body"
GENERIC_MASS = 75.1646
SIDES = ("r", "l")
LUMBAR = (
    ("lumbar_extension", (0, 0, 1)),
    ("lumbar_bending", (1, 0, 0)),
    ("lumbar_rotation", (0, 1, 0)),
)
SOLE_BELOW_CALCN = 0.0161293
"""m; height of the generic calcn above the ground in gait2392's default posture (pelvis_ty 0.95),
taken as the thickness of the sole
"""


_HELD, _TWIST = [0, 1, 2, 3, 5], 4
"""of a foot's three shifts and three turns"""


@dataclass(frozen=True, slots=True)
class Foothold:
    """Where one foot is fixed: world_from_calcn (4, 4)."""

    body: int
    world_from_calcn: FloatArray


@dataclass(frozen=True, slots=True)
class KneeSlides:
    """One translation of both knees: q[joints] = sizes * spline(q[knees])."""

    joints: np.ndarray
    knees: np.ndarray
    sizes: FloatArray
    knots: list[float]
    cubics: list[list[float]]
    """four coefficients from the third power down, an interval each, of the distance to its first
    knot
    """

    def at(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and slopes (2,) at both knee angles (2,); plain numbers, because arrays of two
        cost more than they save.
        """
        values, slopes = [], []
        for angle, size in zip(angles.tolist(), self.sizes.tolist(), strict=True):
            k = min(max(bisect_right(self.knots, angle) - 1, 0), len(self.cubics) - 1)
            c3, c2, c1, c0 = self.cubics[k]
            d = angle - self.knots[k]
            values.append(size * (((c3 * d + c2) * d + c1) * d + c0))
            slopes.append(size * ((3 * c3 * d + 2 * c2) * d + c1))
        return np.array(values), np.array(slopes)


def scale_of(subject: Subject, body: str) -> FloatArray:
    """Scale factors (3,) of an OpenSim body for this subject."""
    thigh, shank = np.array(subject.thigh), np.array(subject.shank)
    left_thigh, left_shank = (
        thigh * [1, 1 + subject.left_thigh_longer, 1],
        shank * [1, 1 + subject.left_shank_longer, 1],
    )
    named = {"pelvis": np.array(subject.pelvis), "torso": np.array(subject.torso)}
    named |= {"femur_r": thigh, "femur_l": left_thigh, "patella_r": thigh, "patella_l": left_thigh}
    named |= {"tibia_r": shank, "tibia_l": left_shank}
    return named.get(body, np.array(subject.foot))


class Body:
    """One subject's model, with its own MuJoCo state as scratch space."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.model = _scaled_model(subject)
        self.data = mujoco.MjData(self.model)
        self.names = tuple(self.model.joint(i).name for i in range(self.model.njnt))
        self.index = {name: i for i, name in enumerate(self.names)}
        self.size = len(self.names)
        self._knees = _knee_slides(subject, self.index)
        self.calcn = tuple(self.model.body(f"calcn_{side}").id for side in SIDES)
        self.feet = self._place_feet()
        unactuated = {i for slides in self._knees for i in slides.joints} | set(range(6))
        self.muscle_joints = np.array([i for i in range(self.size) if i not in unactuated])

    # ---- kinematics
    # ----------------------------------------------------------------------------------------------

    def kinematics(self, q: FloatArray) -> None:
        """Positions of all bodies for coordinates ``q`` (n,), left in ``data``."""
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def poses(self, q: FloatArray) -> dict[str, FloatArray]:
        """world_from_body (n, 4, 4) of every body for coordinates (n, c)."""
        names = [self.model.body(i).name for i in range(1, self.model.nbody)]
        matrices = np.zeros((len(names), len(q), 4, 4))
        matrices[..., 3, 3] = 1.0
        for k, row in enumerate(q):
            self.kinematics(row)
            matrices[:, k, :3, :3] = self.data.xmat[1:].reshape(-1, 3, 3)
            matrices[:, k, :3, 3] = self.data.xpos[1:]
        return dict(zip(names, matrices, strict=True))

    def mass_center(self) -> FloatArray:
        """(3,) of the whole body after :meth:`kinematics`."""
        return self.data.subtree_com[1].copy()

    def mass_center_jacobian(self) -> FloatArray:
        """(3, n) after :meth:`kinematics`."""
        jacobian = np.zeros((3, self.size))
        mujoco.mj_jacSubtreeCom(self.model, self.data, jacobian, 1)
        return jacobian

    def constraints(self) -> tuple[FloatArray, FloatArray]:
        """(errors (14,), Jacobian (14, n)) of knee couplings and feet after :meth:`kinematics`.

        The rows of a foot: its three shifts, its roll and its pitch.
        """
        error, jacobian = np.zeros(14), np.zeros((14, self.size))
        for row, slides in enumerate(self._knees):
            rows = [2 * row, 2 * row + 1]
            value, slope = slides.at(self.data.qpos[slides.knees])
            error[rows] = self.data.qpos[slides.joints] - value
            jacobian[rows, slides.joints], jacobian[rows, slides.knees] = 1.0, -slope
        for k, foot in enumerate(self.feet):
            rows = slice(4 + 5 * k, 9 + 5 * k)
            error[rows] = self._foot_error(foot)[_HELD]
            jacobian[rows] = self._foot_jacobian(foot)[_HELD]
        return error, jacobian

    def twists(self) -> tuple[FloatArray, FloatArray]:
        """(angles (2,) rad, Jacobian (2, n)) of both feet about the vertical, after
        :meth:`kinematics`.
        """
        angles = np.array([self._foot_error(foot)[_TWIST] for foot in self.feet])
        return angles, np.array([self._foot_jacobian(foot)[_TWIST] for foot in self.feet])

    def _foot_jacobian(self, foot: Foothold) -> FloatArray:
        jacobian = np.zeros((6, self.size))
        mujoco.mj_jacBody(self.model, self.data, jacobian[:3], jacobian[3:], foot.body)
        return jacobian

    def _foot_error(self, foot: Foothold) -> FloatArray:
        turned = self.data.xmat[foot.body].reshape(3, 3) @ foot.world_from_calcn[:3, :3].T
        skew = 0.5 * np.array(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        return np.concatenate([self.data.xpos[foot.body] - foot.world_from_calcn[:3, 3], skew])

    def settle(self, q: FloatArray) -> FloatArray:
        """The nearest coordinates that obey all constraints."""
        q = q.copy()
        for _ in range(6):
            self.kinematics(q)
            error, jacobian = self.constraints()
            q -= np.linalg.lstsq(jacobian, error, rcond=None)[0]
            if np.abs(error).max() < 1e-10:
                break
        return q

    # ---- dynamics
    # ----------------------------------------------------------------------------------------------

    def dynamics(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(mass matrix (n, n), forces (n,) that gravity and motion ask for)."""
        self.data.qvel[:] = v
        self.kinematics(q)
        mujoco.mj_crb(self.model, self.data)
        mujoco.mj_comVel(self.model, self.data)
        mass, bias = np.zeros((self.size, self.size)), np.zeros(self.size)
        mujoco.mj_fullM(self.model, self.data, mass)
        mujoco.mj_rne(self.model, self.data, 0, bias)
        return mass, bias

    def muscle_torques(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """(n,) least joint torques, weighted, that carry this motion; zero where no muscle acts."""
        mass, bias = self.dynamics(q, v)
        return self.share(mass @ a + bias)

    def share(self, forces: FloatArray) -> FloatArray:
        """(n, ...) least joint torques, weighted, that do what the generalized ``forces`` (n, ...)
        would do; after :meth:`kinematics`.
        """
        jacobian = self.constraints()[1]
        free = np.linalg.svd(jacobian)[2][len(jacobian) :]
        # the foot's small joints are the last to be loaded
        strength = np.array(
            [0.2 if self.names[i].startswith("subtalar") else 1.0 for i in self.muscle_joints]
        )
        torques = np.zeros_like(forces)
        least = np.linalg.lstsq(free[:, self.muscle_joints] * strength, free @ forces, rcond=None)[
            0
        ]
        torques[self.muscle_joints] = (strength * least.T).T
        return torques

    # ---- stance
    # ----------------------------------------------------------------------------------------------

    def _place_feet(self) -> tuple[Foothold, ...]:
        subject = self.subject
        heading = transforms.axis_rotation([0, 1, 0], np.radians(subject.heading_deg))
        middle = np.array([subject.place[0], 0.0, subject.place[1]])
        feet = []
        for body, sign, toe_out in zip(self.calcn, (1.0, -1.0), subject.toe_out_deg, strict=True):
            rotation = heading @ transforms.axis_rotation([0, 1, 0], np.radians(-sign * toe_out))
            ankle = middle + heading @ [0, 0, sign * subject.stance_width / 2]
            calcn = ankle + rotation @ (self.model.body_pos[body] * [1, 0, 1])
            calcn[1] = SOLE_BELOW_CALCN * subject.foot[1]
            feet.append(Foothold(body, transforms.rigid(rotation, calcn)))
        return tuple(feet)

    def posture(self, flexion: float, start: FloatArray | None = None) -> FloatArray:
        """Coordinates (n,) with both feet down, both knees flexed by ``flexion`` (rad) and this
        person's way to squat.
        """
        q = self._first_guess(flexion) if start is None else start.copy()
        for _ in range(60):
            self.kinematics(q)
            error, jacobian = self.constraints()
            goal, goal_jacobian = self._posture_goals(q, flexion)
            step = np.linalg.solve(
                np.vstack([jacobian, goal_jacobian]), np.concatenate([error, goal])
            )
            q -= step * min(1.0, 0.3 / np.abs(step).max())
            if np.abs(step).max() < 1e-11:
                return q
        raise RuntimeError(
            f"{self.subject.name}: no posture with {np.degrees(flexion):.0f} deg of knee flexion"
        )

    def _first_guess(self, flexion: float) -> FloatArray:
        q = np.zeros(self.size)
        for side in SIDES:
            q[self.index[f"knee_angle_{side}"]], q[self.index[f"hip_flexion_{side}"]] = (
                -flexion,
                flexion,
            )
            q[self.index[f"ankle_angle_{side}"]] = 0.5 * flexion
        for slides in self._knees:
            q[slides.joints] = slides.at(q[slides.knees])[0]
        q[0], q[2], q[5] = *self.subject.place, np.radians(self.subject.heading_deg)
        q[1] = 0.9 * self.subject.thigh[1]
        return q

    def _posture_goals(self, q: FloatArray, flexion: float) -> tuple[FloatArray, FloatArray]:
        subject, index, n = self.subject, self.index, self.size
        tilt = -subject.pelvis_tilt * flexion
        wanted = {
            "pelvis_tilt": tilt,
            "pelvis_rotation": np.radians(subject.heading_deg + subject.twist_deg),
        }
        wanted |= {
            "lumbar_extension": -subject.trunk_lean * flexion - tilt,
            "lumbar_bending": 0.0,
            "lumbar_rotation": 0.0,
        }
        goal, jacobian = np.zeros(11), np.zeros((11, n))
        for row, (name, value) in enumerate(wanted.items()):
            goal[row], jacobian[row, index[name]] = q[index[name]] - value, 1.0
        knees = [index["knee_angle_r"], index["knee_angle_l"]]
        goal[5:7], jacobian[5:7, knees] = q[knees] + flexion, np.eye(2)
        level = self.heading()[:, [0, 2]].T
        center = np.array([subject.place[0], 0.0, subject.place[1]])
        goal[7:9] = level @ (self.mass_center() - center) - [subject.com_forward, subject.com_right]
        jacobian[7:9] = level @ self.mass_center_jacobian()
        goal[9:], jacobian[9:] = self.twists()
        return goal, jacobian

    def heading(self) -> FloatArray:
        """(3, 3) world from the frame that faces where the subject does."""
        return transforms.axis_rotation([0, 1, 0], np.radians(self.subject.heading_deg))


def _knee_slides(subject: Subject, index: dict[str, int]) -> tuple[KneeSlides, ...]:
    """Forward and upward translation of both knees, scaled with the femurs."""
    couplings = {
        c["joint"]: c for c in tomllib.loads((MODEL / "couplings.toml").read_text())["coupling"]
    }
    found = []
    for axis, name in enumerate(("knee_tx", "knee_ty")):
        joints, knees = (
            [index[f"{joint}_{side}"] for side in SIDES] for joint in (name, "knee_angle")
        )
        sizes = np.array([scale_of(subject, f"femur_{side}")[axis] for side in SIDES])
        spline = SimmSpline(couplings[name]["x"], couplings[name]["y"])
        same = CubicHermiteSpline(spline.x, *spline.with_derivatives(spline.x)[:2])
        found.append(
            KneeSlides(
                np.array(joints), np.array(knees), sizes, spline.x.tolist(), same.c.T.tolist()
            )
        )
    return tuple(found)


def _scaled_model(subject: Subject) -> mujoco.MjModel:
    """The MJCF leg without patellae, toes fixed, back free; lengths, masses and inertias scaled
    after OpenSim's rules.
    """
    spec = mujoco.MjSpec.from_file(str(MODEL / "lower_body.xml"))
    for side in SIDES:
        spec.delete(spec.body(f"patella_{side}"))
        spec.delete(spec.joint(f"mtp_angle_{side}"))
    for name, axis in LUMBAR:
        spec.body("torso").add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    mass_factor = subject.mass / GENERIC_MASS
    for body in spec.bodies[1:]:
        scale = scale_of(subject, body.name)
        if body.parent.name != "world":
            body.pos = body.pos * scale_of(subject, body.parent.name)
        body.ipos, body.mass = body.ipos * scale, body.mass * mass_factor
        second_moments = 0.5 * body.inertia.sum() - body.inertia
        squares = np.maximum(second_moments, 0.0) * scale**2 * mass_factor
        body.inertia = squares.sum() - squares
        for joint in body.joints:
            if joint.name.startswith("knee_t"):
                joint.ref = (
                    joint.ref
                    * scale_of(subject, body.parent.name)[int(joint.name.startswith("knee_ty"))]
                )
    return spec.compile()
