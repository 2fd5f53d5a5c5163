"""Twenty seconds of a person holding a squat, or squatting, under gravity and under control."""

from dataclasses import dataclass

import numpy as np
from posture_body import Body
from posture_controller import GRAVITY, ControllerParams, DelayedFeedback, filtered_noise, rest_stiffness
from scipy.interpolate import CubicSpline

from legsim.arrays import FloatArray

RATE = 120
SUBSTEPS = 8
STEP = 1.0 / (RATE * SUBSTEPS)
DURATION = 20.0
WARM_UP = 6.0


@dataclass(frozen=True, slots=True)
class Plan:
    """What the person means to do, at every step of the simulation."""

    q: FloatArray
    """(n, c) coordinates"""
    v: FloatArray
    """(n, c) their rates"""
    a: FloatArray
    """(n, c) their accelerations"""
    torques: FloatArray
    """(n, c) muscle torques that would do it without noise"""
    mass_center: FloatArray
    """(n, 3) world"""
    push: FloatArray
    """(n, c, 2) muscle torques that push the mass center forwards, and to the right, by 1 N"""


@dataclass(frozen=True, slots=True)
class Performance:
    """What happened, at the recording rate."""

    times: FloatArray
    q: FloatArray
    """(n, c)"""
    mass_center: FloatArray
    """(n, 3) world"""
    foot_force: FloatArray
    """(n, 2, 6) force and moment of the floor on each foot, right and left, world axes, about the calcn origin"""


def simulate(body: Body, plan: Plan, params: ControllerParams, rng: np.random.Generator) -> Performance:
    """Integrates the closed chain with semi-implicit steps that obey the constraints on velocity (Moreau's scheme)."""
    steps, n = plan.q.shape
    muscles = body.muscle_joints
    mass = body.subject.mass
    noise = _motor_noise(plan, body, params, rng)
    felt = np.stack([filtered_noise(rng, steps, STEP, params.sensory_time) for _ in range(2)], -1)
    felt *= np.radians(params.sensory_deg) * body.subject.noise
    felt_rate = np.gradient(felt, STEP, axis=0)
    channels = [DelayedFeedback(params, STEP) for _ in range(2)]
    level = body.heading()[:, [0, 2]].T
    q, v = plan.q[0].copy(), plan.v[0].copy()
    kept_q, kept_center, kept_force = [], [], []
    for k in range(steps):
        inertia, bias = body.dynamics(q, v)
        error, jacobian = body.constraints()
        center, center_jacobian = body.mass_center(), level @ body.mass_center_jacobian()
        height = plan.mass_center[k, 1]
        load = mass * GRAVITY * height
        sway = level @ (center - plan.mass_center[k]) / height + felt[k]
        planned_rate = plan.v[k]
        rate = center_jacobian @ (v - planned_rate) / height + felt_rate[k]
        push = [channel(*pair, load, body.subject.gain) / height for channel, *pair in zip(channels, sway, rate, strict=True)]
        stiffness, damping = _impedance(body, plan.torques[k], load, params)
        torque = plan.torques[k] + noise[k] - stiffness * (q - plan.q[k]) - damping * (v - planned_rate)
        torque += plan.push[k] @ push
        implicit = inertia + np.diag(STEP * damping + STEP**2 * stiffness)
        torque -= STEP * stiffness * v
        torque[np.setdiff1d(np.arange(n), muscles)] = 0.0
        system = np.block([[implicit, jacobian.T], [jacobian, np.zeros((16, 16))]])
        right = np.concatenate([implicit @ v + STEP * (torque - bias), -0.2 * error / STEP])
        solution = np.linalg.solve(system, right)
        if k % SUBSTEPS == 0:
            kept_q.append(q.copy())
            kept_center.append(center)
            kept_force.append(-solution[n + 4 :].reshape(2, 6) / STEP)
        v = solution[:n]
        q = q + STEP * v
    start = round(WARM_UP * RATE)
    times = np.arange(len(kept_q) - start) / RATE
    exact = np.array([body.settle(row) for row in kept_q[start:]])
    return Performance(times, exact, np.array(kept_center[start:]), np.array(kept_force[start:]))


def _motor_noise(plan: Plan, body: Body, params: ControllerParams, rng: np.random.Generator) -> FloatArray:
    steps = len(plan.q)
    noise = np.zeros_like(plan.q)
    for joint in body.muscle_joints:
        halves = [filtered_noise(rng, steps, STEP, time) for time in params.motor_times]
        size = params.motor_floor * body.subject.mass / 75.0 + params.motor_variation * np.abs(plan.torques[:, joint])
        noise[:, joint] = body.subject.noise * size * (halves[0] + halves[1]) / np.sqrt(2)
    return noise


def _impedance(body: Body, torques: FloatArray, load: float, params: ControllerParams) -> tuple[FloatArray, FloatArray]:
    stiffness, damping = np.zeros(body.size), np.zeros(body.size)
    for i in body.muscle_joints:
        stiffness[i] = rest_stiffness(body.names[i], body.subject.mass) + params.joint_stiffness * abs(torques[i])
        damping[i] = params.damping_time * stiffness[i]
        if body.names[i].startswith("ankle"):
            stiffness[i], damping[i] = 0.5 * params.ankle_stiffness * load, 0.5 * params.ankle_damping * load
    return stiffness, damping


def hold(body: Body, flexion_deg: float) -> Plan:
    """Stand still with the knees bent."""
    steps = round((DURATION + WARM_UP) / STEP)
    q = body.posture(np.radians(flexion_deg))
    still = np.zeros_like(q)
    torques = body.muscle_torques(q, still, still)
    body.kinematics(q)
    push = body.share((body.heading()[:, [0, 2]].T @ body.mass_center_jacobian()).T)
    one = (q, still, still, torques, body.mass_center(), push)
    return Plan(*(np.broadcast_to(row, (steps, *row.shape)) for row in one))
