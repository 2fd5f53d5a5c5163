"""A flat-panel detector: scatter, photon noise, blur, lag and electronic noise.

Intensities are shares of the unattenuated beam. A view passes, in this order,

1. scatter, added to the primary exp(-p),
2. Poisson noise of the photons that are absorbed,
3. blur by the light's spread in the scintillator: it follows the absorption, so it smooths the
   quantum noise too,
4. lag: a part of the charge is held in traps and read in later views (the exponential model of
   Hsieh, Gurmen and King, Proc. SPIE 3977 (2000), by fraction and time instead of per frame);
   before the first view the detector was in the dark,
5. electronic noise of the readout, white,

and the logarithm. A reading below half a photon counts as half a photon; without photon noise the
floor is the smallest float.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import Projections

_FWHM = 2 * np.sqrt(2 * np.log(2))
"""FWHM of a Gaussian of unit standard deviation"""

LEAST_PHOTONS = 0.5

MOST_PHOTONS = 1e12
"""more are free of noise in float32, and soon overflow an integer"""

_DARKEST = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True)
class Detector:
    """Imperfections of a detector; the default is a perfect one."""

    photons: float = 0.0
    """per pixel and view of the unattenuated beam; 0: unlimited, no noise"""
    electronic_noise: float = 0.0
    """photons, RMS of one readout"""
    blur_fwhm: float = 0.0
    """m on the detector, of a Gaussian"""
    lag: tuple[tuple[float, float], ...] = ()
    """(fraction of the signal that is held back, s to 1/e of it), one pair per exponential"""
    scatter_to_primary: float = 0.0
    """in every view: mean scatter over mean primary within the shadow"""
    scatter_fwhm: float = 0.1
    """m on the detector, of the Gaussian that smooths the scatter"""

    def __post_init__(self) -> None:
        named = (
            ("photons", self.photons),
            ("electronic_noise", self.electronic_noise),
            ("blur_fwhm", self.blur_fwhm),
        )
        for name, value in (
            *named,
            ("scatter_to_primary", self.scatter_to_primary),
            ("scatter_fwhm", self.scatter_fwhm),
        ):
            if not (np.isfinite(value) and value >= 0):
                raise LegsimError(
                    f"the detector's {name} must be a number, at least 0; got {value}"
                )
        if self.photons > MOST_PHOTONS:
            raise LegsimError(
                f"{self.photons:g} photons per pixel are noise-free (at most {MOST_PHOTONS:g} are "
                "counted): set 0 for no noise"
            )
        if self.electronic_noise > 0 and self.photons == 0:
            raise LegsimError(
                "electronic noise is counted in photons: set the detector's photons too"
            )
        if (
            not all(
                0 <= fraction <= 1 and np.isfinite(time) and time > 0 for fraction, time in self.lag
            )
            or sum(f for f, _ in self.lag) > 1
        ):
            raise LegsimError(
                "lag needs fractions of at most 1 in all, each with a time above 0 s; got "
                f"{self.lag}"
            )

    @property
    def perfect(self) -> bool:
        """Whether line integrals pass unchanged."""
        return not (
            self.photons
            or self.blur_fwhm
            or self.scatter_to_primary
            or any(fraction for fraction, _ in self.lag)
        )


def detect(projections: Projections, detector: Detector, rng: np.random.Generator) -> Projections:
    """Applies the detector to the projections; a perfect one returns them unchanged.

    Every view draws from a stream of its own, so its noise depends on the generator's seed and the
    view's number alone.
    """
    if detector.perfect:
        return projections
    times = projections.geometry.times
    pitch_vu = (projections.geometry.row_pitch(), projections.geometry.pixel_pitch)
    intervals = np.diff(
        times, append=2 * times[-1] - times[-2] if len(times) > 1 else times[-1] + 1.0
    )
    held = np.zeros((len(detector.lag), *projections.geometry.shape_vu))
    readings = np.empty_like(projections.line_integrals)
    for view, stream in enumerate(rng.spawn(len(projections.geometry))):
        intensity = np.exp(-projections.line_integrals[view].astype(float))
        if detector.scatter_to_primary:
            intensity += _scatter(intensity, detector, pitch_vu)
        if detector.photons:
            intensity = stream.poisson(detector.photons * intensity) / detector.photons
        if detector.blur_fwhm:
            # the edges are mirrored, so that the total stays
            intensity = gaussian_filter(
                intensity, [detector.blur_fwhm / _FWHM / p for p in pitch_vu], mode="reflect"
            )
        intensity = _lagging(intensity, held, detector, float(intervals[view]))
        if detector.electronic_noise:
            intensity += stream.normal(
                0.0, detector.electronic_noise / detector.photons, intensity.shape
            )
        readings[view] = -np.log(
            np.maximum(
                intensity, LEAST_PHOTONS / detector.photons if detector.photons else _DARKEST
            )
        )
    return replace(projections, line_integrals=readings)


def _scatter(primary: FloatArray, detector: Detector, pitch_vu: tuple[float, float]) -> FloatArray:
    """Scatter of a view, I ln(1 / I) smoothed and scaled to the stated ratio.

    It comes from where photons are both transmitted and attenuated: the form of Ohnesorge, Flohr
    and Klingenbeck-Regn, Eur. Radiol. 9 (1999) 563.
    """
    shadow = primary < 1
    source = np.where(shadow, -primary * np.log(np.maximum(primary, _DARKEST)), 0.0)
    sigma_v, sigma_u = (detector.scatter_fwhm / _FWHM / pitch for pitch in pitch_vu)
    smooth = _widely_smoothed(source, sigma_v, sigma_u)
    within = smooth[shadow].sum()
    return (
        smooth * (detector.scatter_to_primary * primary[shadow].sum() / within)
        if within > 0
        else smooth
    )


def _widely_smoothed(image: FloatArray, sigma_v: float, sigma_u: float) -> FloatArray:
    """Smooths by a Gaussian of many pixels, mirrored at the edges.

    It is fast as a product of cosine transforms.
    """
    rows, columns = (
        np.exp(-0.5 * (sigma * np.pi * np.arange(n) / n) ** 2)
        for sigma, n in zip((sigma_v, sigma_u), image.shape, strict=True)
    )
    return np.asarray(idctn(dctn(image) * rows[:, None] * columns), float)


def _lagging(
    arriving: FloatArray, held: FloatArray, detector: Detector, interval: float
) -> FloatArray:
    """Readout of an exposure and of the charge ``held`` from earlier views.

    ``held`` (exponentials, rows, columns) is updated.
    """
    reading = arriving
    for charge, (fraction, time) in zip(held, detector.lag, strict=True):
        charge += fraction * arriving
        released = -np.expm1(-interval / time) * charge
        charge -= released
        reading = reading - fraction * arriving + released
    return reading
