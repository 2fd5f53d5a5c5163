"""Carries a plan out: the body under gravity, held by muscles with stiffness, late feedback and
noise.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core.values import FloatArray
from tools.virtual_subjects.body import Body
from tools.virtual_subjects.controller import ControllerParams
from tools.virtual_subjects.muscles import Muscles
from tools.virtual_subjects.plan import RATE, STEP, SUBSTEPS, WARM_UP, Plan

SOLE = (-0.03, 0.23, -0.04, 0.045)
"""m in the axes of the generic calcn: heel, toes, inner and outer edge"""


@dataclass(frozen=True, slots=True)
class Performance:
    """What happened, at the recording rate."""

    times: FloatArray
    q: FloatArray
    """(n, c)"""
    mass_center: FloatArray
    """(n, 3) world"""
    foot_force: FloatArray
    """(n, 2, 6) force and moment of the floor on each foot, right and left, world axes, about the
    calcn origin
    """


@dataclass(frozen=True, slots=True)
class Footing:
    """How the floor carried both feet; whether fixing them to the floor was fair."""

    pressure_range: FloatArray
    """(2, 4) of right and left foot: hindmost, foremost, innermost, outermost center of pressure, m
    in the axes of the generic calcn
    """
    friction: float
    """largest horizontal over vertical force"""

    def check(self) -> None:
        """Raises where a real foot would have tipped or slid: the sole reaches from heel to toes,
        the floor's friction to 0.5.
        """
        inside = (self.pressure_range[:, [0, 2]] > [SOLE[0], SOLE[2]]).all() and (
            self.pressure_range[:, [1, 3]] < [SOLE[1], SOLE[3]]
        ).all()
        if not inside or self.friction > 0.5:
            raise RuntimeError(
                f"a foot would not stay: pressure {self.pressure_range.round(3).tolist()} m, "
                f"friction {self.friction:.2f}"
            )


def footing(body: Body, performance: Performance) -> Footing:
    """Center of pressure under each foot, from the constraint forces."""
    ranges, slides = [], []
    for k, foot in enumerate(body.feet):
        force, moment = performance.foot_force[:, k, :3], performance.foot_force[:, k, 3:]
        height = foot.world_from_calcn[1, 3]
        forward = (moment[:, 2] - height * force[:, 0]) / force[:, 1]
        right = -(moment[:, 0] + height * force[:, 2]) / force[:, 1]
        local = (
            np.stack([forward, 0 * forward, right], -1)
            @ foot.world_from_calcn[:3, :3]
            / body.subject.foot
        )
        outwards = local[:, 2] * (1, -1)[k]
        ranges.append([local[:, 0].min(), local[:, 0].max(), outwards.min(), outwards.max()])
        slides.append(np.linalg.norm(force[:, [0, 2]], axis=-1) / force[:, 1])
        if (force[:, 1] <= 0).any():
            raise RuntimeError(f"{body.subject.name}: a foot leaves the floor")
    return Footing(np.array(ranges), float(np.max(slides)))


def simulate(
    body: Body, plan: Plan, params: ControllerParams, rng: np.random.Generator
) -> Performance:
    """Carries out the plan and records it after the warm-up, every coordinate put exactly onto the
    constraints.
    """
    muscles = Muscles(body, plan, params, rng)
    q, v = plan.q[0].copy(), plan.v[0].copy()
    kept = []
    for k in range(len(plan.q)):
        before, (v, forces) = q, _step(body, muscles, k, q, v)
        if k % SUBSTEPS == 0:
            kept.append((before, body.mass_center(), forces))
        q = q + STEP * v
    coordinates, centers, forces = (
        np.array(values) for values in zip(*kept[round(WARM_UP * RATE) :], strict=True)
    )
    exact = np.array([body.settle(row) for row in coordinates])
    return Performance(np.arange(len(exact)) / RATE, exact, centers, forces)


def _step(
    body: Body, muscles: Muscles, k: int, q: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Velocities (n,) after step k and the floor's force and moment (2, 6) on the feet.

    Semi-implicit, constraints obeyed by the new velocity (Moreau's time stepping); stiffness and
    damping act at the step's end.
    """
    n = body.size
    inertia, bias = body.dynamics(q, v)
    error, jacobian = body.constraints()
    twist, turning = body.twists()
    torques = muscles.torques(k, q, v) - muscles.sole_stiffness * turning.T @ twist
    system = np.zeros((n + len(error), n + len(error)))
    system[:n, :n] = inertia + np.diag(STEP * (muscles.damping[k] + STEP * muscles.stiffness[k]))
    soles = muscles.sole_damping + STEP * muscles.sole_stiffness
    system[:n, :n] += STEP * soles * turning.T @ turning
    system[:n, n:], system[n:, :n] = jacobian.T, jacobian
    # what rounding leaves of position errors is taken out by and by
    right = np.concatenate([inertia @ v + STEP * (torques - bias), -0.2 * error / STEP])
    solution = np.asarray(np.linalg.solve(system, right), float)
    floor = np.zeros((2, 6))
    floor[:, [0, 1, 2, 3, 5]] = -solution[n + 4 :].reshape(2, 5) / STEP
    floor[:, 4] = -muscles.sole_stiffness * twist - soles * turning @ solution[:n]
    return solution[:n], floor
