"""Numbers published in the study that the package rebuilds, for comparison with ours.

Maier et al., "Rigid and non-rigid motion compensation in weight-bearing cone-beam CT of the knee
using (noisy) inertial measurements", 2021. Table 1: image quality of volumes scaled from 0 to 1, on
the whole leg, shank and thigh. Table 2: how far noisy sensors move the rigid motion from the
noise-free one. Table 3: image quality from noisy sensors. Its closed phantom and its scans differ
from ours, and "all scans" is not always between its parts: the third digit has little meaning.
"""

from dataclasses import dataclass

REGIONS = ("leg", "shank", "thigh")

EXPONENTS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, None)
"""of Table 2, of accelerometer (f_a) and gyroscope (f_g); None is no noise

The sensor's noise is divided by ten to this power.
"""


@dataclass(frozen=True, slots=True)
class Score:
    """Mean and standard deviation over the scans of one condition."""

    mean: float
    deviation: float


# condition, method: (SSIM mean, sd) of leg, shank, thigh, then (RMSE mean, sd) of the same
_TABLE = {
    ("30", "uncorrected"): (
        (0.777, 0.089),
        (0.799, 0.093),
        (0.742, 0.084),
        (0.084, 0.029),
        (0.081, 0.030),
        (0.088, 0.029),
    ),
    ("30", "marker-based"): (
        (0.986, 0.002),
        (0.986, 0.002),
        (0.984, 0.003),
        (0.021, 0.006),
        (0.021, 0.006),
        (0.022, 0.005),
    ),
    ("30", "rigid"): (
        (0.993, 0.003),
        (0.993, 0.004),
        (0.992, 0.004),
        (0.015, 0.005),
        (0.015, 0.005),
        (0.015, 0.005),
    ),
    ("30", "nonrigid-2d"): (
        (0.991, 0.003),
        (0.991, 0.003),
        (0.992, 0.002),
        (0.017, 0.005),
        (0.018, 0.005),
        (0.016, 0.005),
    ),
    ("30", "nonrigid-3d"): (
        (0.994, 0.002),
        (0.994, 0.003),
        (0.994, 0.002),
        (0.014, 0.004),
        (0.014, 0.004),
        (0.013, 0.004),
    ),
    ("60", "uncorrected"): (
        (0.777, 0.111),
        (0.790, 0.090),
        (0.736, 0.118),
        (0.079, 0.022),
        (0.076, 0.020),
        (0.084, 0.025),
    ),
    ("60", "marker-based"): (
        (0.982, 0.009),
        (0.979, 0.012),
        (0.974, 0.013),
        (0.026, 0.009),
        (0.025, 0.009),
        (0.027, 0.009),
    ),
    ("60", "rigid"): (
        (0.991, 0.006),
        (0.990, 0.004),
        (0.987, 0.006),
        (0.018, 0.006),
        (0.018, 0.007),
        (0.019, 0.006),
    ),
    ("60", "nonrigid-2d"): (
        (0.989, 0.005),
        (0.989, 0.005),
        (0.989, 0.005),
        (0.018, 0.006),
        (0.018, 0.006),
        (0.018, 0.007),
    ),
    ("60", "nonrigid-3d"): (
        (0.994, 0.004),
        (0.991, 0.004),
        (0.991, 0.004),
        (0.016, 0.006),
        (0.017, 0.006),
        (0.016, 0.006),
    ),
    ("all", "uncorrected"): (
        (0.774, 0.092),
        (0.794, 0.090),
        (0.739, 0.098),
        (0.081, 0.025),
        (0.078, 0.025),
        (0.086, 0.026),
    ),
    ("all", "marker-based"): (
        (0.981, 0.009),
        (0.982, 0.009),
        (0.979, 0.011),
        (0.024, 0.007),
        (0.023, 0.007),
        (0.024, 0.008),
    ),
    ("all", "rigid"): (
        (0.991, 0.004),
        (0.991, 0.004),
        (0.990, 0.006),
        (0.017, 0.006),
        (0.016, 0.006),
        (0.017, 0.006),
    ),
    ("all", "nonrigid-2d"): (
        (0.990, 0.004),
        (0.990, 0.004),
        (0.990, 0.004),
        (0.017, 0.006),
        (0.018, 0.006),
        (0.017, 0.006),
    ),
    ("all", "nonrigid-3d"): (
        (0.993, 0.004),
        (0.992, 0.004),
        (0.993, 0.004),
        (0.015, 0.005),
        (0.015, 0.005),
        (0.014, 0.005),
    ),
}


# one row per f_a and one column per f_g, both in the order of EXPONENTS
_LADDER_MM = (
    (9461, 8866, 6329, 6762, 8518, 10389, 9390),
    (1899, 883, 663, 754, 883, 666, 940),
    (1104, 158, 133, 73, 61, 77, 81),
    (1173, 125, 20, 7, 9, 9, 9),
    (1622, 190, 10, 1, 0.943, 0.985, 0.672),
    (108, 146, 10, 1, 0.167, 0.078, 0.077),
    (148, 80, 12, 1, 0.077, 0.021, 0),
)

# the first three columns, which differ from row to row; the others are published as powers of ten
_LADDER_DEG = (
    (1.453, 0.146, 0.016),
    (1.404, 0.128, 0.012),
    (1.357, 0.128, 0.016),
    (1.270, 0.122, 0.015),
    (1.645, 0.190, 0.014),
    (1.193, 0.178, 0.013),
    (1.285, 0.129, 0.014),
)

_POWERS_DEG = (1e-3, 1e-4, 2e-5, 1e-5)

# (f_a, f_g) of rigid: as in _TABLE
_NOISY = {
    (None, None): (
        (0.991, 0.004),
        (0.991, 0.004),
        (0.990, 0.006),
        (0.017, 0.006),
        (0.016, 0.006),
        (0.017, 0.006),
    ),
    (5.0, 5.0): (
        (0.989, 0.005),
        (0.990, 0.005),
        (0.987, 0.004),
        (0.018, 0.006),
        (0.018, 0.006),
        (0.019, 0.006),
    ),
    (5.0, 4.0): (
        (0.987, 0.004),
        (0.988, 0.004),
        (0.985, 0.004),
        (0.020, 0.006),
        (0.020, 0.006),
        (0.021, 0.007),
    ),
    (4.0, 5.0): (
        (0.926, 0.049),
        (0.929, 0.046),
        (0.919, 0.054),
        (0.047, 0.022),
        (0.046, 0.022),
        (0.048, 0.023),
    ),
    (4.0, 4.0): (
        (0.927, 0.043),
        (0.929, 0.040),
        (0.923, 0.052),
        (0.048, 0.021),
        (0.048, 0.021),
        (0.047, 0.021),
    ),
}


def ssim(method: str, region: str, condition: str = "all") -> Score | None:
    """Published SSIM of a method in a region, or None where the study has no such method."""
    return _score(method, region, condition, 0)


def rmse(method: str, region: str, condition: str = "all") -> Score | None:
    """Published RMSE of a method in a region, or None where the study has no such method.

    Volumes are scaled from 0 to 1.
    """
    return _score(method, region, condition, len(REGIONS))


@dataclass(frozen=True, slots=True)
class PublishedDrift:
    """RMSE over the views from the noise-free estimate.

    It is the mean of three axes and of five repetitions on one scan.
    """

    translation_mm: float
    rotation_deg: float


def deviation(f_a: float | None, f_g: float | None) -> PublishedDrift | None:
    """A cell of Table 2, or None where it has no such exponents."""
    if f_a not in EXPONENTS or f_g not in EXPONENTS:
        return None
    row, column = EXPONENTS.index(f_a), EXPONENTS.index(f_g)
    if f_a is None and f_g is None:
        return PublishedDrift(0.0, 0.0)
    degrees = (*_LADDER_DEG[row], *_POWERS_DEG)[column]
    return PublishedDrift(float(_LADDER_MM[row][column]), degrees)


def noisy_ssim(f_a: float | None, f_g: float | None, region: str) -> Score | None:
    """SSIM of rigid from noisy sensors over all scans (Table 3).

    None where it has no such exponents.
    """
    return _in_region(_NOISY.get((f_a, f_g)), region, 0)


def noisy_rmse(f_a: float | None, f_g: float | None, region: str) -> Score | None:
    """RMSE of rigid from noisy sensors over all scans (Table 3)."""
    return _in_region(_NOISY.get((f_a, f_g)), region, len(REGIONS))


def _score(method: str, region: str, condition: str, offset: int) -> Score | None:
    return _in_region(_TABLE.get((condition, method)), region, offset)


def _in_region(
    row: tuple[tuple[float, float], ...] | None, region: str, offset: int
) -> Score | None:
    return (
        Score(*row[offset + REGIONS.index(region)])
        if row is not None and region in REGIONS
        else None
    )
