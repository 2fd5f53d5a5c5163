"""A lower leg of ellipsoids in a small C-arm, that moves as a whole: images are exact."""

from dataclasses import replace

import numpy as np

from legsim.core import transforms
from legsim.deformation.models import RigidMotion
from legsim.evaluation import image_gauge
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from tests.references.backprojection import Ellipsoid, project
from tests.references.sway import Sway

STILL = Sway.standing(4, position_mm=0.0, angle_deg=0.0)
KNEE = STILL.center + np.array([0.0, 0.14, 0.0])
VIEWS = np.arange(80) / 10
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(2.5) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(100, 120),
    pixel_pitch=2.464e-3,
    isocenter=KNEE,
)


def solid(place: tuple[float, ...], radii: tuple[float, float, float], value: float) -> Ellipsoid:
    x, y, z = KNEE + 1e-3 * np.array(place)
    a, b, c = (1e-3 * r for r in radii)
    return Ellipsoid((float(x), float(y), float(z)), (a, b, c), value)


SOLIDS = [
    solid((0, -30, 0), (50, 65, 46), 20.0),
    solid((8, -35, 4), (19, 55, 17), 25.0),
    solid((7, -40, 3), (11, 40, 10), -20.0),
    solid((-14, -45, -14), (7, 40, 6), 28.0),
    solid((10, -8, 5), (25, 9, 22), 18.0),
    solid((20, -60, -12), (5, 8, 6), 15.0),
]


BONE = KNEE + 1e-3 * np.array([[0.0, 0, 0], [30, -60, 0], [-30, -60, 10], [0, -30, -30]])


def motion_of(sway: Sway) -> RigidMotion:
    """The leg's, with the sensor 14 cm below the knee."""
    return RigidMotion.from_poses(VIEWS, sway.poses(VIEWS))


def left_px(found: RigidMotion, true: RigidMotion) -> float:
    """RMS distance of the bone's projections after the similarity that fits best."""
    target = GEOMETRY.project(true.carry(BONE))[0]

    def seen(at: np.ndarray) -> np.ndarray:
        return GEOMETRY.project(found.carry(at))[0]

    best = image_gauge.best_similarity(seen, BONE, target)
    off = seen(transforms.apply(best, BONE)) - target
    return float(np.sqrt((off**2).sum(-1).mean()))


def scanned(motion: RigidMotion, noise: float = 0.0, seed: int = 0) -> Projections:
    """The leg's images as it moves, with white noise of that standard deviation."""
    seen = project(GEOMETRY.moved(motion.moved_from_reference), SOLIDS)
    drawn = np.random.default_rng(seed).standard_normal(seen.line_integrals.shape)
    images = seen.line_integrals + noise * drawn.astype(np.float32)
    return replace(seen, geometry=GEOMETRY, line_integrals=images)
