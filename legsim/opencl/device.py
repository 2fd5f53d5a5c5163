"""The OpenCL device in use: context, queue, compiled kernels, buffers."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from legsim.core.errors import LegsimError
from legsim.opencl import runtimes
from legsim.opencl.discovery import Candidate, build_program, candidates

if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = lazy_loader.load("pyopencl")


@dataclass(frozen=True, eq=False)
class Device:
    """A device in use: context, queue and compiled kernels; :func:`open_device` makes it."""

    candidate: Candidate
    context: cl.Context
    queue: cl.CommandQueue
    _programs: dict[str, cl.Program] = field(default_factory=dict, repr=False)
    _kernels: dict[tuple[int, str], cl.Kernel] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        memory = self.candidate.memory_bytes / 2**30
        return (
            f"Device({self.label}, {self.candidate.kind}, {self.candidate.compute_units} units, "
            f"{memory:.3g} GiB)"
        )

    @property
    def label(self) -> str:
        return self.candidate.label

    @property
    def is_cpu(self) -> bool:
        return self.candidate.kind == "cpu"

    @property
    def group_size(self) -> int:
        """Work-items that a work-group can have."""
        return self.candidate.handle.max_work_group_size

    @property
    def local_bytes(self) -> int:
        """Local memory of a work-group."""
        return self.candidate.handle.local_mem_size

    def program(self, *kernel_files: str, **defines: int | str) -> cl.Program:
        """Builds files of ``opencl/kernels`` as one program, once per set of ``defines``."""
        source = "\n".join(
            resources.files("legsim.opencl").joinpath("kernels", name).read_text("utf-8")
            for name in kernel_files
        )
        options = [f"-D{key}={value}" for key, value in sorted(defines.items())]
        key = hashlib.sha256("\0".join([source, *options]).encode()).hexdigest()
        if key not in self._programs:
            self._programs[key] = build_program(self.context, source, options)
        return self._programs[key]

    def kernel(self, name: str, *kernel_files: str, **defines: int | str) -> cl.Kernel:
        """The kernel ``name`` of that program, retrieved once: again would make a new one."""
        program = self.program(*kernel_files, **defines)
        if (id(program), name) not in self._kernels:
            self._kernels[id(program), name] = cl.Kernel(program, name)
        return self._kernels[id(program), name]

    def upload(self, array: np.ndarray) -> cl.Buffer:
        """A read-only device copy of a C-contiguous array."""
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(array))

    def zeros(self, count: int, dtype: type = np.float32) -> cl.Buffer:
        """A read-write buffer of ``count`` zeros."""
        buffer = cl.Buffer(
            self.context, cl.mem_flags.READ_WRITE, int(count) * np.dtype(dtype).itemsize
        )
        cl.enqueue_fill_buffer(
            self.queue, buffer, np.zeros(1, dtype), 0, int(count) * np.dtype(dtype).itemsize
        )
        return buffer

    def write(self, buffer: cl.Buffer, array: np.ndarray, offset: int) -> None:
        """Copies a C-contiguous array into ``buffer`` from element ``offset`` on, and waits."""
        cl.enqueue_copy(
            self.queue, buffer, np.ascontiguousarray(array), dst_offset=offset * array.itemsize
        )

    def download(self, buffer: cl.Buffer, array: np.ndarray) -> np.ndarray:
        """Fills ``array`` from ``buffer``, waiting for all that was queued before."""
        cl.enqueue_copy(self.queue, array, buffer)
        return array


def open_device(wanted: str | None = None) -> Device:
    """Opens the fastest device that works, or the one that ``wanted`` or LEGSIM_DEVICE names.

    ``wanted`` is part of a label, whatever its case, or "gpu" or "cpu".

    Raises:
        LegsimError: no device works, or none matches; the line lists what there is.

    >>> volume = fdk(projections, grid, device=open_device("cpu"))
    """
    wanted = wanted if wanted is not None else os.environ.get("LEGSIM_DEVICE", "")
    everything = candidates()
    working = [c for c in everything if c.seconds is not None]
    if not working:
        seen = (
            "; ".join(f"{c.label}: {c.failure}" for c in everything)
            or "the OpenCL loader lists no device"
        )
        fix = runtimes.fault() or (
            f"get one by `{runtimes.installation(platform.machine(), sys.platform)}`"
        )
        raise LegsimError(f"no OpenCL device works ({seen}); {fix}, then see `legsim doctor`")
    matching = [
        c for c in working if wanted.lower() in (c.kind, "") or wanted.lower() in c.label.lower()
    ]
    if not matching:
        raise LegsimError(
            f"no working OpenCL device matches {wanted!r} (LEGSIM_DEVICE or --device); there are: "
            f"{', '.join(c.label for c in working)}"
        )
    return _opened(matching[0])


@cache
def _opened(candidate: Candidate) -> Device:
    context = cl.Context([candidate.handle])
    return Device(candidate, context, cl.CommandQueue(context))
