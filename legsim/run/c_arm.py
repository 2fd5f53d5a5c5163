"""The scan settings in SI units: C-arm, volume grid, beam and detector."""

import numpy as np

from legsim.config import GridConfig, PhantomConfig, ScanConfig, SpectrumConfig
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.geometry.volume import VolumeGrid
from legsim.scan import spectrum
from legsim.scan.acquisition import Imaging
from legsim.scan.c_arm import CArm
from legsim.scan.detector import Detector
from legsim.scan.spectrum import Spectrum


def c_arm(scan: ScanConfig) -> CArm:
    """Builds the configured C-arm.

    Raises:
        LegsimError: unknown spectrum, or an impossible detector.
    """
    return CArm(
        angles=np.radians(scan.first_angle_deg + scan.increment_deg * np.arange(scan.views)),
        rate_hz=scan.rate_hz,
        source_isocenter=1e-3 * scan.source_isocenter_mm,
        source_detector=1e-3 * scan.source_detector_mm,
        shape_vu=(scan.rows, scan.columns),
        pixel_pitch=1e-3 * scan.pixel_mm,
        start=scan.start_s,
        rays_per_pixel=scan.rays_per_pixel,
        imaging=imaging(scan),
    )


def volume_grid(grid: GridConfig, isocenter: FloatArray) -> VolumeGrid:
    """Builds the cube to reconstruct, around ``isocenter`` (3,) m."""
    return VolumeGrid.cubic(grid.voxels, 1e-3 * grid.voxel_mm, [float(c) for c in isocenter])


def imaging(scan: ScanConfig) -> Imaging:
    """Builds the configured beam and detector.

    Raises:
        LegsimError: unknown spectrum, or an impossible detector.
    """
    read = scan.detector
    if len(read.lag_fractions) != len(read.lag_times_s):
        counts = f"{len(read.lag_fractions)} lag_fractions and {len(read.lag_times_s)} lag_times_s"
        raise LegsimError(f"scan.detector: {counts}; give one time for each fraction")
    try:
        made = Detector(
            photons=read.photons,
            electronic_noise=read.electronic_noise_photons,
            blur_fwhm=1e-3 * read.blur_fwhm_mm,
            lag=tuple(zip(read.lag_fractions, read.lag_times_s, strict=True)),
            scatter_to_primary=read.scatter_to_primary,
            scatter_fwhm=1e-3 * read.scatter_fwhm_mm,
        )
    except LegsimError as error:
        raise LegsimError(f"scan.detector: {error}") from error
    beam = scan.spectrum
    _check_read(beam)
    if beam.water_precorrection and beam.kind == "none":
        raise LegsimError(
            "scan.spectrum.water_precorrection has nothing to correct at one energy; set "
            "scan.spectrum.kind or leave it out"
        )
    return Imaging(_spectrum(beam), beam.water_precorrection, made)


def sentence(scan: ScanConfig, phantom: PhantomConfig) -> str:
    """Describes the projections in a sentence for a report."""
    beam, read = scan.spectrum, scan.detector
    energies = {
        "none": f"one energy, {phantom.energy_kev:g} keV",
        "tube": (
            f"a tube of {beam.kvp:g} kV behind {beam.aluminum_mm:g} mm Al and "
            f"{beam.copper_mm:g} mm Cu"
        ),
        "file": f"the spectrum of {beam.file}",
    }[beam.kind] + (", water-precorrected" if beam.water_precorrection else "")
    effects = (
        (read.scatter_to_primary, f"scatter of {read.scatter_to_primary:g} of the primary"),
        (
            read.photons,
            f"{read.photons:g} photons per pixel of the open beam, with "
            f"{read.electronic_noise_photons:g} of readout noise",
        ),
        (read.blur_fwhm_mm, f"a blur of {read.blur_fwhm_mm:g} mm"),
        (sum(read.lag_fractions), f"lag of {100 * sum(read.lag_fractions):.3g} %"),
    )
    present = ", ".join(text for value, text in effects if value > 0)
    swings = (
        f" Soft tissue swings at {phantom.tissue_swing.frequency_hz:g} Hz on the bones."
        if phantom.tissue_swing.amplitude > 0
        else ""
    )
    rays = (
        "a single ray through its center"
        if scan.rays_per_pixel == 1
        else f"the mean of {scan.rays_per_pixel}x{scan.rays_per_pixel} rays"
    )
    return (
        f"Projections are of {energies}; a pixel is {rays}; the detector "
        f"{f'has {present}' if present else 'is perfect'}.{swings}"
    )


_TUBE = ("kvp", "anode_deg", "aluminum_mm", "copper_mm", "response")
_READ: dict[str, tuple[str, ...]] = {"none": (), "tube": _TUBE, "file": ("file",)}
"""keys of scan.spectrum that each kind reads"""


def _check_read(beam: SpectrumConfig) -> None:
    """Refuses a key that the kind of spectrum does not read."""
    default = SpectrumConfig()
    for reader, keys in _READ.items():
        for key in keys:
            changed = getattr(beam, key) != getattr(default, key)
            if key not in _READ[beam.kind] and changed:
                raise LegsimError(
                    f"scan.spectrum.{key} has no effect with scan.spectrum.kind = {beam.kind!r}; "
                    f"leave it out, or set the kind to {reader}"
                )


def _spectrum(beam: SpectrumConfig) -> Spectrum | None:
    if beam.kind == "none":
        return None
    if beam.kind == "file":
        if not beam.file:
            raise LegsimError(
                'scan.spectrum.kind is "file", but no file is named: set scan.spectrum.file to a '
                "CSV of energy_kev,weight"
            )
        return spectrum.load(beam.file)
    return spectrum.tube(
        kvp=beam.kvp,
        anode_deg=beam.anode_deg,
        aluminum_mm=beam.aluminum_mm,
        copper_mm=beam.copper_mm,
        response=beam.response,
    )


def fingerprint(scan: ScanConfig, seed: int) -> tuple[object, ...]:
    """Parts of the projections' key besides the settings.

    They are a spectrum's file, and the seed where there is noise.
    """
    table = _spectrum(scan.spectrum) if scan.spectrum.kind == "file" else None
    return (
        None if table is None else [table.energies_kev.tolist(), table.weights.tolist()],
        seed if scan.detector.photons else None,
    )
