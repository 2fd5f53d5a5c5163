"""OpenCL devices found inside the environment and probed by running a kernel.

Runtimes from PyPI register themselves badly: Intel's ``.icd`` files hold a dummy path and nothing
points the loader at the environment's folder. ``_register_runtimes`` therefore writes a folder of
correct ``.icd`` files (the environment's runtimes and the system's) and names it in
``OCL_ICD_VENDORS`` before the loader reads it, once, at the first platform query.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np

from legsim.core import files

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
"""


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
    handle: Any = field(repr=False, compare=False)

    @property
    def label(self) -> str:
        """What a user sees and may name in LEGSIM_DEVICE."""
        return f"{self.name.strip()} [{self.platform.strip()}]"


def installation(machine: str, system: str) -> str:
    """How to get an OpenCL runtime for a machine's CPU, as platform.machine() and sys.platform name
    it; PyPI has one for x86-64 alone.
    """
    if machine in ("x86_64", "AMD64") and system != "darwin":
        return "pip install intel-opencl-rt intel-cmplr-lib-rt"
    if system == "linux":
        return "apt install pocl-opencl-icd, or conda install -c conda-forge pocl"
    return "conda install -c conda-forge pocl"


def build_program(context: cl.Context, source: str, options: list[str]) -> cl.Program:
    with warnings.catch_warnings():
        # Intel's compiler reports vectorization remarks as output, which pyopencl turns into this
        # warning
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return cl.Program(context, source).build(options=options)


@cache
def _register_runtimes() -> str:
    """Points the ICD loader at the environment's and the system's runtimes; returns the setting.

    A user's own setting stays.
    """
    if "OCL_ICD_VENDORS" in os.environ:
        return os.environ["OCL_ICD_VENDORS"]
    libraries = [
        p
        for p in (
            Path(sys.prefix, "lib", "libintelocl.so"),
            Path(sys.prefix, "Library", "bin", "intelocl64.dll"),
        )
        if p.exists()
    ]
    system = sorted(Path("/etc/OpenCL/vendors").glob("*.icd"))
    if not libraries:
        return ""
    # on Windows the folder of temporary files is the user's own
    owner = os.getuid() if hasattr(os, "getuid") else "own"
    folder = Path(
        tempfile.gettempdir(),
        f"legsim-icd-{owner}-{hashlib.sha256(str(libraries).encode()).hexdigest()[:12]}",
    )
    folder.mkdir(mode=0o700, exist_ok=True)
    entries = {f"env-{k}.icd": f"{library}\n" for k, library in enumerate(libraries)}
    entries |= {path.name: path.read_text() for path in system}
    for name, content in entries.items():
        if not (folder / name).exists() or (folder / name).read_text() != content:
            files.write_text(folder / name, content)
    for stale in {p.name for p in folder.glob("*.icd")} - set(entries):
        (folder / stale).unlink(missing_ok=True)
    os.environ["OCL_ICD_VENDORS"] = str(folder)
    return str(folder)


@cache
def candidates() -> tuple[Candidate, ...]:
    """Every OpenCL device that the loader lists, probed by running a kernel; fastest first."""
    _register_runtimes()
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
        found += [_probe(platform, device) for device in devices]
    return tuple(sorted(found, key=lambda c: (c.seconds is None, c.seconds or 0.0)))


def _probe(platform: cl.Platform, device: cl.Device) -> Candidate:
    kind = (
        "gpu"
        if device.type & cl.device_type.GPU
        else "cpu"
        if device.type & cl.device_type.CPU
        else "other"
    )
    seconds, failure = None, ""
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context)
        kernel = build_program(context, _PROBE, []).probe
        count, table = 1 << 16, np.arange(4097, dtype=np.float32)
        source = cl.Buffer(
            context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=table
        )
        target = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, 4 * count)
        out = np.empty(count, np.float32)
        for _ in range(3):
            start = time.perf_counter()
            kernel(queue, (count,), None, source, target, np.int32(64))
            cl.enqueue_copy(queue, out, target)
            lap = time.perf_counter() - start
            seconds = lap if seconds is None else min(seconds, lap)
        expected = _probe_reference(table, 64)
        if not np.allclose(out[:1024], expected, rtol=1e-3):
            seconds, failure = None, "the probe kernel returned wrong numbers"
    except (cl.Error, RuntimeError) as error:
        seconds, failure = None, (str(error).strip().splitlines() or [type(error).__name__])[0]
    return Candidate(
        platform.name,
        device.name,
        kind,
        device.global_mem_size,
        device.max_compute_units,
        seconds,
        failure,
        device,
    )


def _probe_reference(table: np.ndarray, steps: int) -> np.ndarray:
    position, total = np.arange(1024, dtype=np.float32), np.zeros(1024, np.float32)
    for _ in range(steps):
        j = position.astype(np.int32) & 4095
        total += table[j] + (position - np.floor(position)) * (table[j + 1] - table[j])
        position = np.fmod(position * np.float32(1.0001) + np.float32(7.25), np.float32(4096))
    return total
