"""The reconstruction settings applied: an algorithm with its options."""

from collections.abc import Callable, Mapping
from typing import Any

from legsim.config import ReconstructionConfig
from legsim.core.errors import LegsimError
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk
from legsim.reconstruction.corrected_scan import CorrectedScan
from legsim.reconstruction.fdk import FdkOptions

_OPTIONS = {
    "fdk": ("window", "water_attenuation_per_mm", "redundancy"),
    "cgls": ("iterations", "noise", "nonnegative"),
}
"""options that each algorithm reads"""


def check(settings: ReconstructionConfig) -> None:
    """Refuses a changed option that the chosen algorithm does not read.

    Raises:
        LegsimError: such an option; the line names its key.
    """
    defaults = ReconstructionConfig()
    for name in _foreign(settings.algorithm):
        if getattr(settings, name) != getattr(defaults, name):
            raise _refusal(f"reconstruction.{name}", "reconstruction.algorithm = ", settings)


def from_options(given: Mapping[str, Any]) -> ReconstructionConfig:
    """Builds the settings of a command line that names only these.

    Raises:
        LegsimError: an option that the chosen algorithm does not read, whatever its value.
    """
    settings = ReconstructionConfig(**given)
    for name in _foreign(settings.algorithm):
        if name in given:
            raise _refusal(f"--{name.replace('_', '-')}", "--algorithm ", settings)
    return settings


def _foreign(algorithm: str) -> tuple[str, ...]:
    return _OPTIONS["cgls" if algorithm == "fdk" else "fdk"]


def _refusal(option: str, chooser: str, settings: ReconstructionConfig) -> LegsimError:
    other = "cgls" if settings.algorithm == "fdk" else "fdk"
    return LegsimError(
        f"{option}: {settings.algorithm} has no such option; leave it out, or choose "
        f"{chooser}{other}"
    )


def fdk_options(settings: ReconstructionConfig) -> FdkOptions:
    """Converts the options of filtered back-projection to SI units."""
    water = 1e3 * settings.water_attenuation_per_mm
    return FdkOptions(
        window=settings.window,
        water_attenuation=water if water > 0 else None,
        redundancy=settings.redundancy,
    )


def reconstruct(
    settings: ReconstructionConfig,
    scan: Projections | CorrectedScan,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    device: Device,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Reconstructs the volume (1/m) by the chosen algorithm; arguments as in :func:`fdk.fdk`."""
    if settings.algorithm == "cgls":
        return cgls.cgls(
            scan,
            grid,
            motion=motion,
            iterations=settings.iterations,
            noise=settings.noise,
            nonnegative=settings.nonnegative,
            device=device,
            progress=progress,
        )
    options = fdk_options(settings)
    return fdk.fdk(scan, grid, motion=motion, options=options, device=device, progress=progress)


def needed_bytes(
    settings: ReconstructionConfig,
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    device: Device,
) -> int:
    """Memory of :func:`reconstruct` besides projections and volume, including the device's.

    Raises:
        LegsimError: the device has too little memory.
    """
    if settings.algorithm == "cgls":
        return cgls.needed_bytes(geometry, grid, motion=motion, device=device)
    return fdk.plan(geometry, grid, motion=motion, device=device).device_bytes
