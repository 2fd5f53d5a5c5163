"""What a person is asked to do: hold a squat, or squat five times; with the torques that would do
it if nothing were noisy.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from legsim.core.values import FloatArray
from tools.virtual_subjects.body import Body
from tools.virtual_subjects.controller import smooth_noise

RATE = 120
"""Hz of the recording"""
SUBSTEPS = 5
STEP = 1.0 / (RATE * SUBSTEPS)
"""s of the simulation"""
DURATION = 20.0
WARM_UP = 6.0
"""s before the recording starts, for the sway to become stationary"""
STANDING_DEG = 5.0
"""knee flexion of upright stance"""
POSITION_SENSE = (0.0028, 0.003)
"""rad, and per flexion: standard deviation of the flexion meant; set so that the pelvis rises and
falls as in the measured sway
"""
POSITION_SENSE_TIME = 1.5
"""s"""


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


def hold(body: Body, flexion_deg: float, rng: np.random.Generator) -> Plan:
    """Stand still with the knees bent, as well as a person knows how much they are: the flexion
    meant drifts a little.
    """
    n = round((DURATION + WARM_UP) * RATE)
    spread = body.subject.noise * (POSITION_SENSE[0] + POSITION_SENSE[1] * np.radians(flexion_deg))
    flexion = (
        np.radians(flexion_deg)
        + spread * smooth_noise(rng, n, 1, 1 / RATE, POSITION_SENSE_TIME)[:, 0]
    )
    rate = np.gradient(flexion, 1 / RATE)
    return _along_path(body, flexion, rate, np.gradient(rate, 1 / RATE))


def squats(body: Body, rng: np.random.Generator) -> Plan:
    """Five squats from upright stance, each half a minimum-jerk movement (Flash and Hogan 1985, J
    Neurosci 5:1688-1703).
    """
    standing, n = np.radians(STANDING_DEG), round((DURATION + WARM_UP) * RATE)
    flexion, rate, acceleration = np.full(n, standing), np.zeros(n), np.zeros(n)
    start = WARM_UP + rng.uniform(0.9, 1.3)
    for _ in range(5):
        depth = np.radians(body.subject.squat_depth_deg + rng.normal(0.0, 2.0)) - standing
        down, bottom, up, rest = (
            rng.uniform(1.35, 1.6),
            rng.uniform(0.05, 0.25),
            rng.uniform(1.25, 1.5),
            rng.uniform(0.25, 0.5),
        )
        for begin, time, way in ((start, down, depth), (start + down + bottom, up, -depth)):
            t = np.clip((np.arange(n) / RATE - begin) / time, 0.0, 1.0)
            flexion += way * t**3 * (10 - 15 * t + 6 * t**2)
            rate += way / time * 30 * t**2 * (1 - t) ** 2
            acceleration += way / time**2 * 60 * t * (1 - t) * (1 - 2 * t)
        start += down + bottom + up + rest
    return _along_path(body, flexion, rate, acceleration)


def _along_path(
    body: Body, flexion: FloatArray, rate: FloatArray, acceleration: FloatArray
) -> Plan:
    """The plan for knee flexion (n,) rad and its derivatives at RATE, through this person's
    postures.
    """
    knots = np.radians(
        np.arange(STANDING_DEG - 1, max(np.degrees(flexion.max()), STANDING_DEG + 6) + 3, 2.5)
    )
    postures = [body.posture(np.radians(30.0))]
    for knot in knots:
        postures.append(body.posture(knot, postures[-1]))
    path = CubicSpline(knots, postures[1:])
    first, second = path(flexion, 1), path(flexion, 2)
    q, v = path(flexion), first * rate[:, None]
    a = first * acceleration[:, None] + second * rate[:, None] ** 2
    level = body.heading()[:, [0, 2]]
    torques, centers, push = [], [], []
    for row in zip(q, v, a, strict=True):
        torques.append(body.muscle_torques(*row))
        centers.append(body.mass_center())
        push.append(body.share(body.mass_center_jacobian().T @ level))
    return Plan(*(_refined(np.array(values)) for values in (q, v, a, torques, centers, push)))


def _refined(values: FloatArray) -> FloatArray:
    """From RATE to the simulation's steps, linearly."""
    n = len(values)
    fine = np.minimum(np.arange(n * SUBSTEPS) / SUBSTEPS, n - 1)
    low = np.minimum(fine.astype(int), n - 2)
    share = (fine - low).reshape(-1, *[1] * (values.ndim - 1))
    return (1 - share) * values[low] + share * values[low + 1]
