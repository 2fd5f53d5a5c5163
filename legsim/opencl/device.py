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
from legsim.opencl import runtimes, textures
from legsim.opencl.discovery import Candidate, build_program, candidates

if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = lazy_loader.load("pyopencl")

_GROUP = 256
"""work-items of a group where the device allows as many"""


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
    def described(self) -> str:
        """The label, and whether back-projection reads images through texture units."""
        return self.label + (", textures" if self.uses_textures else "")

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

    @property
    def image_limits(self) -> textures.ImageLimits:
        """The largest array of images for texture units."""
        return textures.limits(self.candidate)

    @property
    def texture_fault(self) -> str:
        """Why images must not be read through texture units, empty where they may."""
        return textures.check(self.candidate).fault

    @property
    def uses_textures(self) -> bool:
        """Whether back-projection reads images through texture units where it may choose.

        It does on GPUs that read known images right; LEGSIM_TEXTURES says "on" for any device, or
        "off".

        Raises:
            LegsimError: LEGSIM_TEXTURES has another value, or is "on" for a device that cannot.
        """
        wanted = os.environ.get("LEGSIM_TEXTURES", "")
        if wanted not in ("", "on", "off"):
            raise LegsimError(f"LEGSIM_TEXTURES is {wanted!r}; set it to on or off, or unset it")
        if wanted == "on" and self.texture_fault:
            raise LegsimError(
                f"LEGSIM_TEXTURES is on, but {self.label} cannot: {self.texture_fault}; unset it"
            )
        if wanted == "":
            return self.candidate.kind == "gpu" and not self.texture_fault
        return wanted == "on"

    @property
    def arithmetic(self) -> str:
        """What decides a kernel's numbers, beyond rounding, besides its code: for keys of results.

        The compiler; and on GPUs their kind, as they run other kernels than CPUs, and textures.
        """
        kind = "" if self.is_cpu else f", {self.candidate.kind}"
        return self.candidate.compiler + kind + (", textures" if self.uses_textures else "")

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

    def grouped(
        self, kernel: cl.Kernel, counts: tuple[int, int, int]
    ) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """Global and local size for at least ``counts`` work-items, the third axis as it is.

        A group is as long along the first axis as the device goes in step, and as many of these
        lines high as it may be.
        """
        handle, info = self.candidate.handle, cl.kernel_work_group_info
        most = min(kernel.get_work_group_info(info.WORK_GROUP_SIZE, handle), _GROUP)
        step = kernel.get_work_group_info(info.PREFERRED_WORK_GROUP_SIZE_MULTIPLE, handle)
        largest = handle.max_work_item_sizes
        along = min(step, most, largest[0])
        across = min(most // along, largest[1])
        rounded = (-(-counts[0] // along) * along, -(-counts[1] // across) * across, counts[2])
        return rounded, (along, across, 1)

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

    def image_array(self, shape: tuple[int, int, int]) -> cl.Image:
        """Images of zeros (layers, height, width) for texture units, float32."""
        array, (layers, height, width) = textures.image_array(self.context, shape), shape
        nothing = np.zeros(4, np.float32)
        cl.enqueue_fill_image(self.queue, array, nothing, (0, 0, 0), (width, height, layers))
        return array

    def write(self, target: cl.Buffer | cl.Image, array: np.ndarray, offset: int) -> None:
        """Copies a C-contiguous array into a buffer from element ``offset`` on, or layers (n,
        height, width) into an array of images from layer ``offset`` on, and waits.
        """
        array = np.ascontiguousarray(array)
        if isinstance(target, cl.Image):
            region = array.shape[::-1]
            cl.enqueue_copy(self.queue, target, array, origin=(0, 0, offset), region=region)
        else:
            cl.enqueue_copy(self.queue, target, array, dst_offset=offset * array.itemsize)

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
    return opened(matching[0])


@cache
def opened(candidate: Candidate) -> Device:
    """The device of a candidate, the same one each time."""
    context = cl.Context([candidate.handle])
    return Device(candidate, context, cl.CommandQueue(context))
