"""OpenSim's rules of scaling, on the MuJoCo model of the leg."""

# mujoco is compiled and ships no type stubs
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales


def scale_offsets(model: mujoco.MjModel, scales: SegmentScales) -> None:
    """Body offsets (with the slides' reference values, which are part of them) by the parent's
    factors; mass centers by their own.
    """
    for name in SEGMENTS:
        body = model.body(name)
        parent = model.body(body.parentid[0]).name
        body.ipos[:] *= scales.of(name)
        if parent in SEGMENTS:
            body.pos[:] *= scales.of(parent)
            for j in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0]):
                if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
                    model.qpos0[j] *= np.abs(model.jnt_axis[j]) @ scales.of(parent)


def scale_masses(model: mujoco.MjModel, scales: SegmentScales) -> None:
    """Masses and inertias as OpenSim scales them, with or without a given mass of the whole
    body.
    """
    common = None if scales.mass is None else scales.mass / float(model.body_mass.sum())
    for name in SEGMENTS:
        body = model.body(name)
        factors = scales.of(name)
        body.inertia[:] = scaled_inertia(float(body.mass[0]), body.inertia.copy(), factors)
        by = float(np.prod(factors)) if common is None else common
        body.mass[:], body.inertia[:] = body.mass * by, body.inertia * by
    if common is not None:
        model.body("torso").mass[:] *= common
        model.body("torso").inertia[:] *= common


def scaled_inertia(mass: float, inertia: FloatArray, factors: FloatArray) -> FloatArray:
    """Moments of inertia (3,) of a segment of unchanged mass after its size changed.

    OpenSim's rule (checked against its Body.scaleInertialProperties): exact for equal factors;
    otherwise the segment becomes a solid cylinder along its axis of least inertia, with the radius
    of that inertia and the length of the next one.
    """
    if np.ptp(factors) == 0:
        return inertia * factors[0] ** 2
    axis = int(np.argmin(inertia))
    first, second = (k for k in range(3) if k != axis)
    radius2 = 2 * inertia[axis] / mass
    length2 = max(12 * (inertia[first] / mass - radius2 / 4), 0.0)
    radius2, length2 = radius2 * factors[first] * factors[second], length2 * factors[axis] ** 2
    scaled = np.full(3, mass * (length2 / 12 + radius2 / 4))
    scaled[axis] = mass * radius2 / 2
    return scaled
