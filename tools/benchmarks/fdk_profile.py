"""Where the time of the whole FDK goes, stage by stage, and how far back-projection is from what
the device can do (a roofline).

A machine's cores may be shared: rates of a CPU are therefore per second of CPU time, times its
cores; a GPU's are by the clock.
"""

import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
import pyopencl as cl

from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import _backprojection_plan, backprojection, fdk, filtering
from legsim.reconstruction._backprojection_plan import BackprojectionPlan
from legsim.reconstruction.weights import ShortScanWarning
from tools.benchmarks import fdk as bench_fdk

STAGES = {
    "planning": (_backprojection_plan, "plan", "weights"),
    "weights of the geometry": (filtering, "plan_filter", "weights"),
    "continuing rows": (filtering, "extended_rows", "filter"),
    "FFT": (filtering.fft, "rfft", "filter"),
    "inverse FFT": (filtering.fft, "irfft", "filter"),
    "filtering, all of it": (filtering, "filter_batch", "filter"),
    "images as the kernels read them": (backprojection, "arranged", "filter"),
    "upload": (Device, "write", "device"),
    "back-projection": (backprojection.VolumeSlab, "add", "device"),
    "download": (backprojection.VolumeSlab, "result", "device"),
}
"""stage: where its function is, the function's name, and who works: the calling thread, or for
"device" the whole process
"""
COUNTED = {
    0: ((3, 25, 32), (2, 12, 17)),
    1: ((20, 32, 39), (11, 14, 19)),
    2: ((20, 32, 39), (11, 14, 19)),
}
"""curve: vector instructions, and arithmetic ones among them, of the inner loops as
docs/reconstruction.md has them: a block of 8 rows blended, a block of 8 voxels sampled at up to 4/3
rows a voxel, and beyond (beyond 5/3 there are more: the ceiling stays one)"""

PEAKS = """
#define EACH(x) x(0) x(1) x(2) x(3) x(4) x(5) x(6) x(7) x(8) x(9) x(10) x(11)
#define START(k) float8 s##k = (float8)(k + get_global_id(0));
#define MAD(k) s##k = fma(s##k, p, q);
#define MIXED(k) s##k = k % 2 ? fma(s##k, p, q) : s##k + q;
#define TOTAL(k) + s##k
#define PEAK(name, STEP) __attribute__((intel_vec_len_hint(1))) \\
__kernel void name(const float8 p, const float8 q, const int steps, __global float8 *out) \\
{
    EACH(START)
    for (int i = 0; i < steps; ++i) { EACH(STEP) }
    out[get_global_id(0)] = (float8)(0) EACH(TOTAL);
}
PEAK(multiply_add, MAD)
PEAK(mixed, MIXED)
/* each work-item goes over its own `count` vectors `repeats` times */
__attribute__((intel_vec_len_hint(1)))
__kernel void triad(__global float8 *a, __global const float8 *b, __global const float8 *c,
                    const int count, const int repeats)
{
    const size_t first = (size_t)get_global_id(0) * count;
    for (int k = 0; k < repeats; ++k)
        for (int i = 0; i < count; ++i) a[first + i] = b[first + i] + (float)k * c[first + i];
}
"""


@dataclass(slots=True)
class Spent:
    """Seconds of the calls of one stage."""

    cpu: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)


def profiled(work: Callable[[], object]) -> tuple[dict[str, Spent], Spent]:
    """Seconds per stage while ``work`` runs, and of all of it."""
    found, whole = {name: Spent() for name in STAGES}, Spent()

    def watched(
        call: Callable[..., Any], spent: Spent, cpu: Callable[[], float]
    ) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            begin, used = time.perf_counter(), cpu()
            result = call(*arguments, **named)
            # lists, for appending to one is safe between threads
            spent.cpu.append(cpu() - used)
            spent.clock.append(time.perf_counter() - begin)
            return result

        return run

    with ExitStack() as patched:
        for name, (owner, function, who) in STAGES.items():
            clock = time.process_time if who == "device" else time.thread_time
            patched.enter_context(
                mock.patch.object(
                    owner, function, watched(getattr(owner, function), found[name], clock)
                )
            )
        watched(work, whole, time.process_time)()
    return found, whole


def rate(device: Device, run: Callable[[], object], amount: float) -> float:
    """``amount`` per second of the device: the best of five."""
    run()
    seconds = []
    for _ in range(5):
        begin, used = time.perf_counter(), time.process_time()
        run()
        device.queue.finish()
        clock, cpu = time.perf_counter() - begin, time.process_time() - used
        seconds.append(cpu / device.candidate.compute_units if device.is_cpu else clock)
    return amount / min(seconds)


def peaks(device: Device) -> dict[str, float]:
    """Measured: vectors of eight a second (multiply-adds; half of them sums), bytes a second (in
    L2, in memory).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        program = cl.Program(device.context, PEAKS).build()
    units, steps = (
        device.candidate.compute_units * (1 if device.is_cpu else 2048),
        1 << (22 if device.is_cpu else 14),
    )
    out = device.zeros(8 * units)
    vectors = (np.full(8, 0.999, np.float32), np.full(8, 1e-3, np.float32))
    found = {}
    for name in ("multiply_add", "mixed"):
        call = partial(
            getattr(program, name), device.queue, (units,), (1,), *vectors, np.int32(steps), out
        )
        found[name] = rate(device, call, 12 * steps * units)
    kernel = program.triad
    for name, count, repeats in (("L2", 2048, 4000), ("memory", (1 << 23) // units, 1)):
        arrays = [device.zeros(8 * count * units) for _ in range(3)]
        call = partial(
            kernel, device.queue, (units,), (1,), *arrays, np.int32(count), np.int32(repeats)
        )
        found[name] = rate(device, call, 96 * count * units * repeats)
    return found


def seen(geometry: ConeBeamGeometry, grid: VolumeGrid, axis: int) -> tuple[float, float, float]:
    """Over a lattice: share of the updates that a detector sees; of these the mean rows between
    neighboring voxels, share beyond 4/3.
    """
    lattice = np.stack(np.meshgrid(*(a[:: max(1, len(a) // 24)] for a in grid.axes())), -1).reshape(
        -1, 3
    )
    step = np.eye(3)[axis] * grid.spacing_xyz[axis]
    views = geometry[:: max(1, len(geometry) // 32)]
    at, beyond = views.project(lattice)[0], views.project(lattice + step)[0]
    inside = ((at > -1) & (at < geometry.shape_vu[::-1])).all(-1)
    rows = np.abs(beyond - at)[inside, 1]
    return float(inside.mean()), float(rows.mean()), float((rows > 4 / 3).mean())


def ceilings(
    decided: BackprojectionPlan,
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    limits: dict[str, float],
) -> list[float]:
    """Giga updates a second that the device could do at most: by arithmetic, by vector
    instructions, by loads from L2, by memory.
    """
    share, rows, wide = seen(geometry, grid, decided.column_axis)
    vectors, arithmetic = (
        (1 - wide) * near + wide * far + rows * blend for blend, near, far in COUNTED[decided.curve]
    )
    # two detector columns of 4 bytes a row; a sum is read and written once a batch of views
    by_l2, by_memory = limits["L2"] / (share * 8 * rows), limits["memory"] * decided.batch / 8
    by_arithmetic, by_vectors = (
        8 * limits["mixed"] / (share * count) for count in (arithmetic, vectors)
    )
    return [1e-9 * value for value in (by_arithmetic, by_vectors, by_l2, by_memory)]


def run(views: int, count: int, binning: int, wanted: str | None) -> str:
    """Markdown: seconds per stage, and the roofline."""
    device, geometry = open_device(wanted), bench_fdk.scan(views, binning)
    projections, grid = (
        bench_fdk.projected(geometry),
        VolumeGrid.cubic(count, bench_fdk.SIDE / count, (0.0, 0.0, 0.0)),
    )
    ways: dict[str, Motion | None] = {
        "circular": None,
        "any matrices": bench_fdk.sway(views),
        "moving least squares": bench_fdk.bending(views),
    }
    limits = peaks(device)
    spent, limited, measured = {}, {}, {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortScanWarning)
        for name, motion in ways.items():
            fdk.fdk(projections, bench_fdk.warm_up(count), device=device, motion=motion)
            spent[name] = profiled(
                lambda motion=motion: fdk.fdk(projections, grid, device=device, motion=motion)
            )
            adding = spent[name][0]["back-projection"]
            seconds = (
                sum(adding.cpu) / device.candidate.compute_units
                if device.is_cpu
                else sum(adding.clock)
            )
            measured[name] = (
                1e-9 * views * count**3 / seconds,
                1e-9 * views * count**3 / sum(adding.clock),
            )
            decided = fdk.plan(geometry, grid, device=device, motion=motion)
            if decided.kernel == "columns":
                limited[name] = ceilings(decided, geometry, grid, limits)
    rows, columns = geometry.shape_vu
    lines = [
        f"{device.label}, {device.candidate.compute_units} compute units; {views} views of "
        f"{columns} x {rows} to {count}^3.",
        "",
        "| CPU s (s by the clock) | " + " | ".join(ways) + " |",
        "|---|" + "---|" * len(ways),
    ]
    for stage in STAGES:
        cells = [spent[name][0][stage] for name in ways]
        # filtering runs on all cores at once: only its CPU seconds add up
        pooled = STAGES[stage][2] == "filter"
        lines.append(
            f"| {stage} | "
            + " | ".join(
                f"{sum(c.cpu):.2f}" + ("" if pooled else f" ({sum(c.clock):.2f})") for c in cells
            )
            + " |"
        )
    lines.append(
        "| the whole | "
        + " | ".join(f"{spent[n][1].cpu[0]:.2f} ({spent[n][1].clock[0]:.2f})" for n in ways)
        + " |"
    )
    lines += [
        "",
        f"Peaks: {8e-9 * limits['multiply_add']:.1f} G multiply-adds a second (float8), "
        f"{1e-9 * limits['mixed']:.1f} G vector instructions "
        f"a second (half multiply-adds, half sums), {1e-9 * limits['L2']:.0f} GB/s in L2, "
        f"{1e-9 * limits['memory']:.0f} GB/s in memory (triads).",
    ]
    if limited:
        lines += [
            "",
            "| back-projection, GUPS | measured | ceiling by arithmetic | by vector instructions "
            "| by L2 | by memory | by the clock |",
            "|---|---|---|---|---|---|---|",
        ]
        for name, most in limited.items():
            of_most = " | ".join(
                f"{value:.1f} ({100 * measured[name][0] / value:.0f} %)" for value in most
            )
            lines.append(
                f"| {name} | {measured[name][0]:.2f} | {of_most} | {measured[name][1]:.2f} |"
            )
    return "\n".join(lines)
