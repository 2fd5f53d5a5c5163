"""All joint torques of a person: planned, elastic, reflexive and noisy."""

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from tools.virtual_subjects.body import Body
from tools.virtual_subjects.controller import (
    ControllerParams,
    DelayedFeedback,
    band_noise,
    filtered_noise,
    rest_stiffness,
)
from tools.virtual_subjects.plan import STEP, Plan


class Muscles:
    """What acts on the joints at every step of a plan."""

    def __init__(
        self, body: Body, plan: Plan, params: ControllerParams, rng: np.random.Generator
    ) -> None:
        self._body, self._plan = body, plan
        self.stiffness, self.damping = _impedance(plan, body, params)
        """(n, c) intrinsic, N m/rad and N m s/rad"""
        self.sole_stiffness = params.sole_stiffness * body.subject.mass / 75.0
        """N m/rad of each foot about the vertical"""
        self.sole_damping = params.damping_time * self.sole_stiffness
        """N m s/rad"""
        self._noise = _motor_noise(plan, body, params, rng)
        self._felt = _sensory_noise(plan, body, params, rng)
        self._noise += _restlessness(plan, body, params, rng)
        self._felt_rate = np.gradient(self._felt, STEP, axis=0)
        self._channels = [DelayedFeedback(params, STEP) for _ in range(2)]
        self._level = body.heading()[:, [0, 2]].T

    def torques(self, k: int, q: FloatArray, v: FloatArray) -> FloatArray:
        """(c,) at step k, after :meth:`Body.dynamics`; without the damping of ``v``, which the
        integrator takes at the step's end.
        """
        plan = self._plan
        elastic = self.stiffness[k] * (plan.q[k] - q) + self.damping[k] * plan.v[k]
        return plan.torques[k] + elastic + plan.push[k] @ self._push(k, v) + self._noise[k]

    def _push(self, k: int, v: FloatArray) -> FloatArray:
        """(2,) N forwards and to the right: the feedback's answer to the sway of the mass center
        against the plan.
        """
        body, planned = self._body, self._plan.mass_center[k]
        height = planned[1]
        load = body.subject.mass * STANDARD_GRAVITY * height
        sway = self._level @ (body.mass_center() - planned) / height + self._felt[k]
        rate = (
            self._level @ body.mass_center_jacobian() @ (v - self._plan.v[k]) / height
            + self._felt_rate[k]
        )
        answers = [
            channel(sway[i], rate[i], load, body.subject.gain)
            for i, channel in enumerate(self._channels)
        ]
        return np.array(answers) / height


def _motor_noise(
    plan: Plan, body: Body, params: ControllerParams, rng: np.random.Generator
) -> FloatArray:
    """Torques (n, c) that nobody planned, N m."""
    noise = _growing(plan, body, params.motor_floor, params.motor_variation)
    for joint in body.muscle_joints:
        halves = [filtered_noise(rng, len(noise), STEP, time) for time in params.motor_times]
        noise[:, joint] *= (halves[0] + halves[1]) / np.sqrt(2)
    return noise


def _restlessness(
    plan: Plan, body: Body, params: ControllerParams, rng: np.random.Generator
) -> FloatArray:
    """Torques (n, c) of twitching and trembling muscles, N m; each muscle for itself."""
    noise = _growing(plan, body, params.unrest_floor, params.unrest_variation)
    for joint in body.muscle_joints:
        unrest = filtered_noise(rng, len(noise), STEP, params.unrest_time)
        tremor = band_noise(rng, len(noise), STEP, params.tremor_band)
        noise[:, joint] *= unrest + params.tremor * tremor
    return noise


def _growing(plan: Plan, body: Body, floor: float, variation: float) -> FloatArray:
    """Standard deviation (n, c) of a noise, N m: ``floor`` at 75 kg plus ``variation`` of the
    torque, by this person's unsteadiness; 0 where no muscle acts.
    """
    size = np.zeros_like(plan.q)
    torques = np.abs(plan.torques[:, body.muscle_joints])
    size[:, body.muscle_joints] = floor * body.subject.mass / 75.0 + variation * torques
    return body.subject.noise * size


def _sensory_noise(
    plan: Plan, body: Body, params: ControllerParams, rng: np.random.Generator
) -> FloatArray:
    """Errors (n, 2) of the felt sway forwards and to the right, rad."""
    knees = np.abs(plan.torques[:, [body.index["knee_angle_r"], body.index["knee_angle_l"]]]).mean(
        1
    )
    effort = knees / (body.subject.mass * STANDARD_GRAVITY * 0.1)
    size = (
        np.radians(params.sensory_deg) * body.subject.noise * (1 + params.sensory_effort * effort)
    )
    return np.stack(
        [size * filtered_noise(rng, len(size), STEP, params.sensory_time) for _ in range(2)], -1
    )


def _impedance(plan: Plan, body: Body, params: ControllerParams) -> tuple[FloatArray, FloatArray]:
    """Intrinsic stiffness and damping (n, c) of the joints: at rest, and with the torque they
    carry.
    """
    stiffness = params.joint_stiffness * np.abs(plan.torques)
    damping = np.zeros_like(stiffness)
    load = body.subject.mass * STANDARD_GRAVITY * plan.mass_center[:, 1]
    for i in body.muscle_joints:
        stiffness[:, i] += rest_stiffness(body.names[i], body.subject.mass)
        damping[:, i] = params.damping_time * stiffness[:, i]
        if body.names[i].startswith("ankle"):
            stiffness[:, i], damping[:, i] = (
                0.5 * params.ankle_stiffness * load,
                0.5 * params.ankle_damping * load,
            )
    return stiffness, damping
