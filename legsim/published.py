"""Numbers printed in the study that the package rebuilds, to be shown beside ours.

Maier et al., "Rigid and non-rigid motion compensation in weight-bearing cone-beam CT of the knee using (noisy) inertial
measurements", 2021, Table 1: image quality of volumes scaled from 0 to 1, on the whole leg, shank and thigh. Its closed
phantom and its scans differ from ours, and "all scans" is not always between its parts: the third digit means little.
"""

from dataclasses import dataclass

CONDITIONS = ("30", "60", "all")
"""degrees of the squat"""
METHODS = ("uncorrected", "marker-based", "rigid", "nonrigid-2d", "nonrigid-3d")
REGIONS = ("leg", "shank", "thigh")


@dataclass(frozen=True, slots=True)
class Score:
    """Mean and standard deviation over the scans of one condition."""

    mean: float
    deviation: float


# condition, method: (SSIM mean, sd) of leg, shank, thigh, then (RMSE mean, sd) of the same
_TABLE = {
    ("30", "uncorrected"): ((0.777, 0.089), (0.799, 0.093), (0.742, 0.084), (0.084, 0.029), (0.081, 0.030), (0.088, 0.029)),
    ("30", "marker-based"): ((0.986, 0.002), (0.986, 0.002), (0.984, 0.003), (0.021, 0.006), (0.021, 0.006), (0.022, 0.005)),
    ("30", "rigid"): ((0.993, 0.003), (0.993, 0.004), (0.992, 0.004), (0.015, 0.005), (0.015, 0.005), (0.015, 0.005)),
    ("30", "nonrigid-2d"): ((0.991, 0.003), (0.991, 0.003), (0.992, 0.002), (0.017, 0.005), (0.018, 0.005), (0.016, 0.005)),
    ("30", "nonrigid-3d"): ((0.994, 0.002), (0.994, 0.003), (0.994, 0.002), (0.014, 0.004), (0.014, 0.004), (0.013, 0.004)),
    ("60", "uncorrected"): ((0.777, 0.111), (0.790, 0.090), (0.736, 0.118), (0.079, 0.022), (0.076, 0.020), (0.084, 0.025)),
    ("60", "marker-based"): ((0.982, 0.009), (0.979, 0.012), (0.974, 0.013), (0.026, 0.009), (0.025, 0.009), (0.027, 0.009)),
    ("60", "rigid"): ((0.991, 0.006), (0.990, 0.004), (0.987, 0.006), (0.018, 0.006), (0.018, 0.007), (0.019, 0.006)),
    ("60", "nonrigid-2d"): ((0.989, 0.005), (0.989, 0.005), (0.989, 0.005), (0.018, 0.006), (0.018, 0.006), (0.018, 0.007)),
    ("60", "nonrigid-3d"): ((0.994, 0.004), (0.991, 0.004), (0.991, 0.004), (0.016, 0.006), (0.017, 0.006), (0.016, 0.006)),
    ("all", "uncorrected"): ((0.774, 0.092), (0.794, 0.090), (0.739, 0.098), (0.081, 0.025), (0.078, 0.025), (0.086, 0.026)),
    ("all", "marker-based"): ((0.981, 0.009), (0.982, 0.009), (0.979, 0.011), (0.024, 0.007), (0.023, 0.007), (0.024, 0.008)),
    ("all", "rigid"): ((0.991, 0.004), (0.991, 0.004), (0.990, 0.006), (0.017, 0.006), (0.016, 0.006), (0.017, 0.006)),
    ("all", "nonrigid-2d"): ((0.990, 0.004), (0.990, 0.004), (0.990, 0.004), (0.017, 0.006), (0.018, 0.006), (0.017, 0.006)),
    ("all", "nonrigid-3d"): ((0.993, 0.004), (0.992, 0.004), (0.993, 0.004), (0.015, 0.005), (0.015, 0.005), (0.014, 0.005)),
}


def ssim(method: str, region: str, condition: str = "all") -> Score | None:
    """Printed SSIM of a method in a region, or None where the study has no such method."""
    return _score(method, region, condition, 0)


def rmse(method: str, region: str, condition: str = "all") -> Score | None:
    """Printed RMSE (of volumes scaled from 0 to 1) of a method in a region, or None where the study has no such method."""
    return _score(method, region, condition, len(REGIONS))


def _score(method: str, region: str, condition: str, offset: int) -> Score | None:
    row = _TABLE.get((condition, method))
    return Score(*row[offset + REGIONS.index(region)]) if row is not None and region in REGIONS else None
