"""Hip, knee and ankle that follow a motion, and points around the knee warped by the device."""

from importlib import resources

import numpy as np
import pyopencl as cl

from legsim.deformation import three_points
from legsim.deformation.models import ControlPointMotion
from legsim.opencl import discovery
from legsim.opencl.device import Device

# hip, knee and ankle of a leg bent by 30 degrees, m
LEG = np.array([[0.05, 0.85, -0.09], [0.15, 0.47, -0.1], [0.02, 0.08, -0.11]])
STRAIGHT = np.array([[0.0, 0.9, 0.0], [0.0, 0.5, 0.0], [0.0, 0.1, 0.0]])


def random_motion(
    rng: np.random.Generator, views: int = 5, size: float = 0.01, reference: np.ndarray = LEG
) -> ControlPointMotion:
    return ControlPointMotion(
        np.arange(views) / 31, reference, reference + rng.normal(0, size, (views, 3, 3))
    )


def around_the_knee(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    return LEG[1] + rng.uniform(-0.13, 0.13, (count, 3))


def on_device(
    device: Device,
    motion: ControlPointMotion,
    points: np.ndarray,
    maps: np.ndarray | None = None,
    **options: float,
) -> np.ndarray:
    """H f(v) (v, n, 3) of every point by kernels/moving_least_squares.cl."""
    maps = np.tile(np.eye(3, 4), (len(motion.times), 1, 1)) if maps is None else maps
    numbers = three_points.three_points(motion, maps, anchor=LEG[1], **options)
    source = (
        resources.files("legsim.opencl").joinpath("kernels", "moving_least_squares.cl").read_text()
        + """
    __kernel void map_points(__global const float *positions, __constant float *rest, __constant float *views, __global float *out)
    {
        const int i = get_global_id(0), view = get_global_id(1), n = get_global_size(0);
        vstore3(mls_moved(mls_prepare(vload3(i, positions), rest), views + 24 * view), view * n + i, out);
    }"""
    )
    program = discovery.build_program(device.context, source, [])
    out = np.empty((len(motion.times), len(points), 3), np.float32)
    target = device.zeros(out.size)
    positions = device.upload((points - LEG[1]).astype(np.float32))
    cl.Kernel(program, "map_points")(
        device.queue,
        (len(points), len(motion.times)),
        None,
        positions,
        device.upload(numbers.rest),
        device.upload(numbers.views),
        target,
    )
    return device.download(target, out).astype(float)
