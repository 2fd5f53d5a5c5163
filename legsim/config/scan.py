"""Settings of the C-arm: phantom, beam and detector."""

from typing import Literal

from pydantic import Field

from legsim.config.imu import SoftTissueConfig
from legsim.config.tree import ConfigSection


class PhantomConfig(ConfigSection):
    """The scanned legs."""

    legs: Literal["both", "scanned"] = "both"
    """scanned: the scanned leg alone

    The other leg's edges leave streaks wherever the views are few.
    """
    file: str = ""
    """a PHANTOM.toml of imaged legs, as of `legsim phantom from-labels`; none: legsim's own"""
    detail: Literal["coarse", "fine"] = "coarse"
    """of legsim's own legs"""
    energy_kev: float = Field(default=60.0, gt=10, le=500)
    tissue_swing: SoftTissueConfig = SoftTissueConfig()
    """how its soft tissue swings on its bones; the sensors have imu.soft_tissue

    Images and truth both show it.
    """


class SpectrumConfig(ConfigSection):
    """The beam's photon energies; "none" is one energy, phantom.energy_kev."""

    kind: Literal["none", "tube", "file"] = "none"
    kvp: float = Field(default=90.0, ge=30, le=300)
    """tube"""
    anode_deg: float = Field(default=12.0, gt=0, lt=90)
    """tube: slope of the anode"""
    aluminum_mm: float = Field(default=3.0, ge=0)
    """tube: filter, including the tube's own"""
    copper_mm: float = Field(default=0.1, ge=0)
    """tube: additional filter"""
    response: Literal["energy", "count"] = "energy"
    """tube: whether the detector weighs a photon by its energy, as flat panels do"""
    file: str = ""
    """file: a CSV of energy_kev,weight, photons as the detector weighs them"""
    water_precorrection: bool = False
    """whether line integrals are linearized as if all were water; bones still harden the beam"""


class DetectorConfig(ConfigSection):
    """What the detector adds to the projections; the defaults add nothing."""

    photons: float = Field(default=0.0, ge=0)
    """per pixel and view of the unattenuated beam; 0: no noise"""
    electronic_noise_photons: float = Field(default=0.0, ge=0)
    """RMS of one reading; needs photons"""
    blur_fwhm_mm: float = Field(default=0.0, ge=0)
    """on the detector"""
    lag_fractions: tuple[float, ...] = ()
    """parts of the signal that traps hold back, one exponential each"""
    lag_times_s: tuple[float, ...] = ()
    """time in which each falls to 1/e"""
    scatter_to_primary: float = Field(default=0.0, ge=0)
    """mean scatter over mean primary within the shadow, the same in every view"""
    scatter_fwhm_mm: float = Field(default=100.0, gt=0)
    """on the detector: how smooth the scatter is"""


class ScanConfig(ConfigSection):
    """The C-arm; defaults are the paper's."""

    side: Literal["left", "right"] = "left"
    """side of the leg in the isocenter; regions, markers, beads and default sensors follow it"""
    center: Literal["knee"] | tuple[float, float, float] = "knee"
    """center of the rotation: the scanned knee at the first view, or a world point in mm"""
    start_s: float | None = None
    """time of the first view in the recording; none: the scan is in the recording's middle"""
    views: int = Field(default=248, ge=2)
    increment_deg: float = 0.8
    rate_hz: float = Field(default=31.0, gt=0)
    first_angle_deg: float = -8.8
    """angle of the source about the vertical; 0 is the subject's right (+z), 90 the front (+x)"""
    source_detector_mm: float = Field(default=1198.0, gt=0)
    source_isocenter_mm: float = Field(default=780.0, gt=0)
    columns: int = Field(default=620, ge=8)
    rows: int = Field(default=480, ge=8)
    pixel_mm: float = Field(default=0.616, gt=0)
    rays_per_pixel: int = Field(default=2, ge=1, le=8)
    """rays along each axis of a pixel

    A pixel is the mean of this number squared; 1 is a single ray through its center.
    """
    spectrum: SpectrumConfig = SpectrumConfig()
    detector: DetectorConfig = DetectorConfig()
