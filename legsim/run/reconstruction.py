"""The reconstruction settings applied: an algorithm with its options."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from legsim.config import ReconstructionConfig, of_options
from legsim.core.errors import LegsimError
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk, total_variation
from legsim.reconstruction.corrected_scan import CorrectedScan
from legsim.reconstruction.fdk import FdkOptions
from legsim.reconstruction.source_path import source_arc
from legsim.scan.c_arm import CArm

_OPTIONS = {
    "fdk": ("window", "water_attenuation_per_mm", "redundancy"),
    "cgls": ("iterations", "noise", "nonnegative"),
    "tv": ("iterations", "noise", "tv_weight_mm"),
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
            raise _refusal(name, f"reconstruction.{name}", "reconstruction.algorithm = ", settings)
    _check_weight(settings, "reconstruction.tv_weight_mm and reconstruction.noise")


def check_views(settings: ReconstructionConfig, arm: CArm) -> None:
    """Refuses, before anything is projected, views that filtered back-projection cannot use.

    Raises:
        LegsimError: fewer than three, or views from places on one line.
    """
    if settings.algorithm != "fdk":
        return
    times = np.arange(len(arm.angles)) / arm.rate_hz
    try:
        source_arc(arm.geometry(times, np.zeros(3)))
    except LegsimError as error:
        raise LegsimError(
            f"scan.views, scan.increment_deg: {error}; or choose reconstruction.algorithm = cgls"
        ) from error


def from_options(given: Mapping[str, Any]) -> ReconstructionConfig:
    """Builds the settings of a command line that names only these.

    Raises:
        LegsimError: an option that the chosen algorithm does not read, whatever its value, or a
            value that is not allowed.
    """
    settings = of_options(ReconstructionConfig, given)
    for name in _foreign(settings.algorithm):
        if name in given:
            raise _refusal(name, f"--{name.replace('_', '-')}", "--algorithm ", settings)
    _check_weight(settings, "--tv-weight-mm and --noise")
    return settings


def _foreign(algorithm: str) -> tuple[str, ...]:
    """Options that others read and ``algorithm`` does not."""
    every = dict.fromkeys(name for names in _OPTIONS.values() for name in names)
    return tuple(name for name in every if name not in _OPTIONS[algorithm])


def _refusal(name: str, option: str, chooser: str, settings: ReconstructionConfig) -> LegsimError:
    readers = " or ".join(other for other, names in _OPTIONS.items() if name in names)
    return LegsimError(
        f"{option}: {settings.algorithm} has no such option; leave it out, or choose "
        f"{chooser}{readers}"
    )


def _check_weight(settings: ReconstructionConfig, both: str) -> None:
    if settings.tv_weight_mm is not None and settings.noise is not None:
        raise LegsimError(f"{both} both say how smooth the volume is; give one")


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
    if settings.algorithm == "tv":
        return total_variation.tv(
            scan,
            grid,
            motion=motion,
            weight=_weight(settings),
            noise=settings.noise,
            iterations=settings.iterations,
            device=device,
            progress=progress,
        )
    options = fdk_options(settings)
    return fdk.fdk(scan, grid, motion=motion, options=options, device=device, progress=progress)


def _weight(settings: ReconstructionConfig) -> float | None:
    """That of total variation in m."""
    return None if settings.tv_weight_mm is None else 1e-3 * settings.tv_weight_mm


def remarks(settings: ReconstructionConfig, projections: Projections) -> list[str]:
    """Lines on what an algorithm decides from the projections."""
    if settings.algorithm != "tv" or settings.tv_weight_mm is not None:
        return []
    noise, said = settings.noise, "as given"
    if noise is None:
        noise, said = total_variation.noise_of(projections), "from the images"
    weight = total_variation.default_weight(projections, noise)
    return [f"total variation: weight {1e3 * weight:.4g} mm, by noise of {noise:.3g} ({said})"]


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
    if settings.algorithm == "tv":
        return total_variation.needed_bytes(geometry, grid, motion=motion, device=device)
    return fdk.plan(geometry, grid, motion=motion, device=device).device_bytes
