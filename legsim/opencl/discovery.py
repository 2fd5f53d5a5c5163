"""OpenCL devices of all runtimes, probed by running kernels whose numbers are checked."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from legsim.opencl import caches, runtimes

if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = lazy_loader.load("pyopencl")


_PROBE = """
__kernel void probe(__global const float *table, __global float *out, const int steps)
{
    const int i = get_global_id(0);
    float position = (float)(i & 1023), sum = 0.0f;
    for (int k = 0; k < steps; ++k) {
        const int j = (int)position & 4095;
        sum += table[j] + (position - floor(position)) * (table[j + 1] - table[j]);
        position = fmod(position * 1.0001f + 7.25f, 4096.0f);
    }
    out[i] = sum;
}

__kernel void groups(__global int *sums, __global volatile int *counts, __local int *shared)
{
    const int i = get_global_id(0), own = get_local_id(0), value = i % 1009;
    shared[own] = value;
    atomic_inc(&counts[value & 7]);
    for (int reach = get_local_size(0) / 2; reach > 0; reach /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (own < reach)
            shared[own] += shared[own + reach];
    }
    if (own == 0)
        sums[get_group_id(0)] = shared[0];
}
"""

_COUNT, _STEPS = 1 << 16, 64
"""work-items of the probe and steps of each"""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One OpenCL device and what the probe found."""

    platform: str
    name: str
    kind: str
    """"gpu", "cpu" or "other" """
    memory_bytes: int
    compute_units: int
    seconds: float | None
    """time of the probe kernel, None where it failed"""
    failure: str
    """first line of why the probe failed, empty where it passed"""
    driver: str
    """the driver's version"""
    handle: Any = field(repr=False, compare=False)

    @property
    def label(self) -> str:
        """What a user sees and may name in LEGSIM_DEVICE."""
        return f"{self.name.strip()} [{self.platform.strip()}]"

    @property
    def compiler(self) -> str:
        """What turns kernels into numbers: the platform and its driver's version."""
        return f"{self.platform.strip()} {self.driver.strip()}"


def build_program(context: cl.Context, source: str, options: list[str]) -> cl.Program:
    with warnings.catch_warnings():
        # Intel's compiler reports vectorization remarks as output, which pyopencl turns into this
        # warning
        warnings.simplefilter("ignore", cl.CompilerWarning)
        # the program is then built without its cache
        warnings.filterwarnings("ignore", "PyOpenCL compiler caching failed")
        return cl.Program(context, source).build(options=options)


@cache
def candidates() -> tuple[Candidate, ...]:
    """Every OpenCL device that the loader lists, probed by running a kernel; fastest first."""
    caches.prepare()
    runtimes.register()
    try:
        platforms = cl.get_platforms()
    except cl.Error:
        return ()
    found = []
    for platform in platforms:
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue
        found += [_candidate(platform, device) for device in devices]
    return tuple(sorted(found, key=lambda c: (c.seconds is None, c.seconds or 0.0)))


def _candidate(platform: cl.Platform, device: cl.Device) -> Candidate:
    seconds, failure = None, ""
    try:
        seconds = _probe(device)
    except (cl.Error, RuntimeError, OSError) as error:
        failure = reason(error)
    return Candidate(
        platform.name,
        device.name,
        _kind(device),
        device.global_mem_size,
        device.max_compute_units,
        seconds,
        failure,
        device.driver_version,
        device,
    )


def reason(error: Exception) -> str:
    """First line of an error, and the compiler's first complaint where there is one."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    complaint = [line for line in lines[1:] if "error:" in line][:1]
    return "; ".join([*lines[:1], *complaint]) or type(error).__name__


def _kind(device: cl.Device) -> str:
    for kind in ("GPU", "CPU"):
        if device.type & getattr(cl.device_type, kind):
            return kind.lower()
    return "other"


def _probe(device: cl.Device) -> float:
    """Seconds of the probe kernels on the device, the best of three.

    Raises:
        RuntimeError: numbers that are wrong.
        pyopencl.Error: it cannot build or run them.
    """
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    program = build_program(context, _PROBE, [])
    table = np.arange(4097, dtype=np.float32)
    source = cl.Buffer(context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=table)
    target = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * _COUNT)
    out, laps = np.empty(_COUNT, np.float32), []
    kernel = program.probe
    for _ in range(3):
        start = time.perf_counter()
        kernel(queue, (_COUNT,), None, source, target, np.int32(_STEPS))
        cl.enqueue_copy(queue, out, target)
        laps.append(time.perf_counter() - start)
    expected = _probe_reference(table, _STEPS)
    if not np.allclose(out.reshape(-1, 1024), expected, rtol=1e-3):
        raise RuntimeError("the probe kernel returned wrong numbers")
    _check_groups(context, queue, program.groups, device.max_work_group_size)
    return min(laps)


def _check_groups(context: cl.Context, queue: cl.CommandQueue, kernel: Any, largest: int) -> None:
    """Checks what the kernels need besides arithmetic: local memory, barriers, atomic counts.

    Raises:
        RuntimeError: numbers that are wrong.
    """
    size = min(64, largest)
    size = 1 << (size.bit_length() - 1)
    groups = 256
    sums, counts = np.empty(groups, np.int32), np.zeros(8, np.int32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    target, counters = (cl.Buffer(context, flags, hostbuf=array) for array in (sums, counts))
    kernel(queue, (groups * size,), (size,), target, counters, cl.LocalMemory(4 * size))
    cl.enqueue_copy(queue, sums, target)
    cl.enqueue_copy(queue, counts, counters)
    values = np.arange(groups * size, dtype=np.int64) % 1009
    right = values.reshape(groups, size).sum(1)
    if not np.array_equal(sums, right):
        raise RuntimeError("the probe kernel returned wrong sums of a work-group")
    if not np.array_equal(counts, np.bincount(values % 8, minlength=8)):
        raise RuntimeError("the probe kernel returned wrong atomic counts")


def _probe_reference(table: np.ndarray, steps: int) -> np.ndarray:
    position, total = np.arange(1024, dtype=np.float32), np.zeros(1024, np.float32)
    for _ in range(steps):
        j = position.astype(np.int32) & 4095
        total += table[j] + (position - np.floor(position)) * (table[j + 1] - table[j])
        position = np.fmod(position * np.float32(1.0001) + np.float32(7.25), np.float32(4096))
    return total
