"""Settings of the reconstructed volumes and of their comparison."""

from typing import Literal

from pydantic import Field

from legsim.config.tree import ConfigSection


class GridConfig(ConfigSection):
    """The reconstructed cube around the isocenter."""

    voxels: int = Field(default=512, ge=16)
    voxel_mm: float = Field(default=0.5, gt=0)


class ReconstructionConfig(ConfigSection):
    """How every volume is reconstructed from its projections."""

    algorithm: Literal["fdk", "cgls", "tv"] = "fdk"
    """filtered back-projection, or conjugate gradients for few views, gaps and wide cones, or few
    views with total variation
    """
    window: Literal["ram-lak", "shepp-logan", "hann"] = "shepp-logan"
    """fdk: the ramp filter, from sharp to smooth; the paper's is shepp-logan"""
    water_attenuation_per_mm: float = Field(default=0.02, ge=0)
    """fdk: width of the cylinder that continues a truncated object; 0 leaves rows truncated"""
    redundancy: Literal["parker", "none"] = "parker"
    """fdk: weights of lines measured more than once; "none" counts every view half"""
    iterations: int | None = Field(default=None, ge=1)
    """cgls, tv: iterations; fewer are smoother; none: until a step gains little"""
    noise: float | None = Field(default=None, gt=0)
    """standard deviation of the line integrals: cgls ends its steps at it, tv weighs by it"""
    nonnegative: bool = False
    """cgls: whether attenuation is kept at 0 or above; tv always keeps it"""
    tv_weight_mm: float | None = Field(default=None, ge=0)
    """tv: a ball of radius r loses 2 x weight / r^2 of its contrast; none: by the noise"""


class EvaluationConfig(ConfigSection):
    """How volumes are compared."""

    scaling: Literal["reference", "reference-leg", "percentiles", "extremes"] = "reference"
    """which attenuations become 0 and 1

    "reference": the motion-free volume's minimum and maximum over the grid, for every volume;
    "reference-leg": those inside the regions; "percentiles": 0.5 and 99.5 % of each volume inside
    the regions; "extremes": each volume's own minimum and maximum over the grid.
    """
    window: Literal["uniform", "gaussian"] = "uniform"
    """of SSIM: a cube of 7 voxels, or a Gaussian of 1.5 voxels as in Wang et al. 2004"""
    registered: Literal["reconstructed", "resampled", "none"] = "reconstructed"
    """how a volume that lies elsewhere than the motion-free one is brought to it

    "reconstructed": once more (for fdk the leg alone), with every voxel where the registration
    found it, so that noise and streaks stay as they are; "resampled": by cubic B-splines, as volumes of other programs have to
    be, which costs a right volume up to 0.02 of SSIM; "none": not.
    """
    air_margin_mm: float = Field(default=5.0, ge=0)
