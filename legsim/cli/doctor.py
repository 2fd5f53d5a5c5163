"""What works on this machine: OpenCL devices, memory, disk, rerun, file formats."""

import importlib.metadata
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement

from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.core.memory import in_words
from legsim.opencl import discovery, runtimes
from legsim.opencl.device import opened

_NEEDED_MEMORY = 8 * 2**30

_NEEDED_DISK = 4 * 2**30


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    topic: str
    good: bool
    detail: str
    cure: str = ""
    """what to do where it is not good"""


def examine(folder: Path) -> tuple[Finding, ...]:
    """Everything a run needs; ``folder`` is where results would go."""
    return (_python(), *_packages(), *_devices(), _memory(), _disk(folder), _models(), _viewer())


def _python() -> Finding:
    return Finding(
        "python",
        sys.version_info >= (3, 11),
        f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        "use Python 3.11 or newer",
    )


def _packages() -> list[Finding]:
    """Legsim and what its installation asks for on this machine, extras left out."""
    needed = [
        Requirement(text) for text in ("legsim", *(importlib.metadata.requires("legsim") or ()))
    ]
    return [
        _package(one) for one in needed if one.marker is None or one.marker.evaluate({"extra": ""})
    ]


def _package(needed: Requirement) -> Finding:
    topic, cure = f"package {needed.name}", f"pip install '{needed.name}{needed.specifier}'"
    try:
        version = importlib.metadata.version(needed.name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(topic, False, "not installed", cure)
    fits = needed.specifier.contains(version, prereleases=True)
    return Finding(
        topic, fits, version if fits else f"{version}, but {needed.specifier} is needed", cure
    )


def _devices() -> list[Finding]:
    chosen = next((c for c in discovery.candidates() if c.seconds is not None), None)
    findings = []
    for candidate in discovery.candidates():
        size = (
            f"{candidate.kind}, {candidate.compute_units} compute units, "
            f"{candidate.memory_bytes / 2**30:.0f} GiB"
        )
        if candidate.seconds is None:
            findings.append(
                Finding(
                    f"opencl {candidate.label}",
                    chosen is not None,
                    f"{size}; probe failed: {candidate.failure}",
                    "another device is needed",
                )
            )
        else:
            taken = "; taken by default" if candidate is chosen else ""
            good, images = _images_read(candidate)
            findings.append(
                Finding(
                    f"opencl {candidate.label}",
                    good,
                    f"{size}; probe kernel {1e3 * candidate.seconds:.1f} ms{images}{taken}",
                    "" if good else "unset LEGSIM_TEXTURES",
                )
            )
    if chosen is None:
        findings.append(
            Finding(
                "opencl",
                False,
                "no device works",
                runtimes.fault() or runtimes.installation(platform.machine(), sys.platform),
            )
        )
    return findings


def _images_read(candidate: discovery.Candidate) -> tuple[bool, str]:
    """Whether LEGSIM_TEXTURES suits a device, and how a GPU's back-projection reads images."""
    device = opened(candidate)
    try:
        through = device.uses_textures
    except LegsimError as error:
        return False, f"; {error}"
    if device.is_cpu and not through:
        return True, ""
    if through:
        return True, "; images through texture units"
    return True, f"; images from buffers, as {device.texture_fault or 'LEGSIM_TEXTURES is off'}"


def _memory() -> Finding:
    total = (
        os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0
    )
    detail = (
        f"{total / 2**30:.1f} GiB; the paper preset wants {_NEEDED_MEMORY / 2**30:.0f} GiB"
        if total
        else "unknown here"
    )
    return Finding(
        "memory", not total or total >= _NEEDED_MEMORY, detail, "use --preset demo or half"
    )


def _disk(folder: Path) -> Finding:
    place = folder.resolve()
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    writable = os.access(place, os.W_OK)
    access = "" if writable else ", not writable"
    detail = (
        f"{in_words(free)} free at {place}{access}; a run at paper size writes "
        f"{_NEEDED_DISK / 2**30:.0f} GiB"
    )
    return Finding(
        "disk",
        writable and free >= _NEEDED_DISK,
        detail,
        "choose another folder with --out, or a smaller preset",
    )


def _models() -> Finding:
    try:
        found = [resources.model_file("lower_body"), resources.motion_file("README.md").parent]
    except LegsimError as error:
        return Finding("models and motions", False, str(error), "install legsim again")
    return Finding("models and motions", True, ", ".join(map(str, found)))


def _viewer() -> Finding:
    found = shutil.which("rerun") or shutil.which("rerun", path=str(Path(sys.executable).parent))
    shown = bool(
        os.environ.get("DISPLAY")
        or os.environ.get("WAYLAND_DISPLAY")
        or sys.platform in ("darwin", "win32")
    )
    where = (
        "a display is there"
        if shown
        else "no display: recordings can be written and checked, but `legsim view` needs a screen"
    )
    return Finding(
        "rerun viewer",
        found is not None,
        f"{found or 'not found'}; {where}",
        "pip install rerun-sdk",
    )
