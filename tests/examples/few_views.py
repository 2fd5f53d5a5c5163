"""Three ellipsoids in few views of a small detector."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from tests.references.backprojection import Ellipsoid, project

FEW = VolumeGrid((44, 30, 44), (0.0036,) * 3, (0.0, 0.0, 0.0))
SOLIDS = [
    Ellipsoid((0.0, 0.0, 0.0), (0.07, 0.04, 0.06), 20.0),
    Ellipsoid((0.03, 0.0, 0.01), (0.018, 0.02, 0.018), 15.0),
    Ellipsoid((-0.03, 0.0, -0.03), (0.015, 0.015, 0.02), -10.0),
]


def averaged_truth() -> FloatArray:
    """Attenuation of the ellipsoids on FEW, as a mean of 3 x 3 x 3 points of each voxel."""
    z, y, x = np.meshgrid(*FEW.axes()[::-1], indexing="ij")
    truth = np.zeros(FEW.shape_zyx)
    for shift in np.ndindex(3, 3, 3):
        points = np.stack([x, y, z], -1) + (np.array(shift) - 1) * 0.0012
        for e in SOLIDS:
            inside = (((points - e.center) / e.radii) ** 2).sum(-1) < 1
            truth += e.attenuation / 27 * inside
    return truth


def turn(views: int) -> ConeBeamGeometry:
    """A full turn about the ellipsoids."""
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(np.arange(views) * 360 / views),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(40, 52),
        pixel_pitch=6e-3,
    )


def noisy(views: int, sigma: float, rng: np.random.Generator) -> Projections:
    """Exact line integrals with normal noise."""
    geometry = turn(views)
    images = project(geometry, SOLIDS).line_integrals
    images = images + sigma * rng.normal(size=images.shape)
    return Projections(geometry, images.astype(np.float32))


def error(volume: Volume) -> float:
    """Root mean square (1/m) against the averaged truth."""
    return float(np.sqrt(np.mean((volume.attenuation - averaged_truth()) ** 2)))
