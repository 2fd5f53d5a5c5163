"""The scan configuration in SI units: view times, C-arm geometry, volume grid, beam and
detector.
"""

import numpy as np
from numpy.typing import NDArray

from legsim.config import GridConfig, PhantomConfig, ScanConfig, SpectrumConfig
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.scan import spectrum
from legsim.scan.acquisition import Imaging
from legsim.scan.detector import Detector
from legsim.scan.spectrum import Spectrum


def view_times(scan: ScanConfig, recorded: FloatArray) -> FloatArray:
    """Times (v,) s of the views: from ``scan.start_s``, or so that the scan sits in the middle of
    the recording.

    Raises:
        LegsimError: the recording is shorter than the scan, or the scan runs over one of its ends.
    """
    first, last = float(recorded[0]), float(recorded[-1])
    length = (scan.views - 1) / scan.rate_hz
    if length > last - first:
        raise LegsimError(
            f"the recording lasts {last - first:.2f} s, the scan {length:.2f} s ({scan.views} "
            f"views at {scan.rate_hz:g} Hz); "
            "use a longer recording, or fewer views (--set scan.views=...) or a higher rate "
            "(--set scan.rate_hz=...)"
        )
    start = first + 0.5 * (last - first - length) if scan.start_s is None else scan.start_s
    if start < first or start + length > last:
        raise LegsimError(
            f"the scan would run from {start:.2f} to {start + length:.2f} s, the recording from "
            f"{first:.2f} to {last:.2f} s; "
            f"set scan.start_s between {first:.2f} and {last - length:.2f}"
        )
    return start + np.arange(scan.views) / scan.rate_hz


def c_arm(scan: ScanConfig, times: FloatArray, isocenter: FloatArray) -> ConeBeamGeometry:
    """The circular scan of the configuration about the vertical through ``isocenter`` (3,) m."""
    return ConeBeamGeometry.circular(
        times=times,
        angles=np.radians(scan.first_angle_deg + scan.increment_deg * np.arange(scan.views)),
        source_isocenter=1e-3 * scan.source_isocenter_mm,
        source_detector=1e-3 * scan.source_detector_mm,
        shape_vu=(scan.rows, scan.columns),
        pixel_pitch=1e-3 * scan.pixel_mm,
        isocenter=isocenter,
    )


def volume_grid(grid: GridConfig, isocenter: FloatArray) -> VolumeGrid:
    """The cube to reconstruct, around ``isocenter`` (3,) m."""
    return VolumeGrid.cubic(grid.voxels, 1e-3 * grid.voxel_mm, [float(c) for c in isocenter])


def field_of_view(scan: ScanConfig) -> float:
    """Radius (m) of the cylinder about the axis that every view sees whole."""
    half_fan = np.arctan(0.5 * scan.columns * scan.pixel_mm / scan.source_detector_mm)
    return float(1e-3 * scan.source_isocenter_mm * np.sin(half_fan))


def seen_by_every_view(
    scan: ScanConfig, grid: VolumeGrid, *, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Voxels (z, y, x) of a grid around the isocenter that lie on the detector from every source of
    a whole turn.

    In the cylinder of :func:`field_of_view`, and between the cones from the sources to the
    detector's upper and lower edge, there by more than ``margin`` (m) for what moves up and down.
    """
    x, y, z = (axis - middle for axis, middle in zip(grid.axes(), grid.center, strict=True))
    away = np.hypot(x[None, :], z[:, None])
    # the nearest source has the voxel at a depth of source_isocenter - away
    slope = 0.5 * scan.rows * scan.pixel_mm / scan.source_detector_mm
    reach = np.where(
        away <= field_of_view(scan), slope * (1e-3 * scan.source_isocenter_mm - away), -1.0
    )
    return np.abs(y)[None, :, None] <= reach[:, None, :] - margin


def imaging(scan: ScanConfig) -> Imaging:
    """The configured beam and detector.

    Raises:
        LegsimError: no such spectrum, or a detector that cannot be.
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
    if beam.water_precorrection and beam.kind == "none":
        raise LegsimError(
            "scan.spectrum.water_precorrection has nothing to correct at one energy; set "
            "scan.spectrum.kind or leave it out"
        )
    return Imaging(_spectrum(beam), beam.water_precorrection, made)


def sentence(scan: ScanConfig, phantom: PhantomConfig) -> str:
    """What the projections are of, for a report."""
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
            f"{read.photons:g} photons a pixel of the open beam, with "
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
        "a single ray through its middle"
        if scan.rays_per_pixel == 1
        else f"the mean of {scan.rays_per_pixel}x{scan.rays_per_pixel} rays"
    )
    return (
        f"Projections are of {energies}; a pixel is {rays}; the detector "
        f"{f'has {present}' if present else 'is perfect'}.{swings}"
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
    """What decides the projections beside the settings themselves: a spectrum's file, and the seed
    where there is noise.
    """
    table = _spectrum(scan.spectrum) if scan.spectrum.kind == "file" else None
    return (
        None if table is None else [table.energies_kev.tolist(), table.weights.tolist()],
        seed if scan.detector.photons else None,
    )
