import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction import fiducials, initialization
from legsim.correction.fiducials import Fiducials
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu import strapdown
from legsim.imu.signals import ImuSignals
from tests.references.sway import Sway

TIMES = np.arange(990) / 120
VIEWS = np.arange(248) / 31
FIDUCIALS = Fiducials()


def c_arm() -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=VIEWS,
        angles=np.radians(0.8) * np.arange(248),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
        isocenter=Sway.standing(0).center,
    )


def recorded(seed: int) -> tuple[Sway, ImuSignals]:
    sway = Sway.standing(seed)
    rate, force = sway.signals(TIMES)
    return sway, ImuSignals(TIMES, ("shank_l",), rate[:, None], force[:, None])


def seen(sway: Sway, views: int) -> np.ndarray:
    geometry, poses = c_arm(), sway.poses(VIEWS[:views])
    return np.stack(
        [fiducials.project_fiducials(geometry, k, poses[k], FIDUCIALS) for k in range(views)]
    )


@pytest.mark.parametrize("views", [2, 3, 8])
def test_exact_points_give_the_start_and_the_whole_scan(views: int):
    """From fiducials in the first views to every pose of the scan: 0.05 mm and 0.001 deg are the
    bound, this is far below.
    """
    for seed in range(4):
        sway, signals = recorded(seed)
        found = initialization.start_from_fiducials(
            signals, "shank_l", c_arm(), seen(sway, views), FIDUCIALS
        )
        np.testing.assert_allclose(found.start.velocity, sway.velocities(VIEWS[:1])[0], atol=2e-7)
        np.testing.assert_allclose(
            found.start.world_from_sensor, sway.poses(VIEWS[:1])[0], atol=1e-7
        )
        poses = strapdown.integrate(TIMES, *signals.sensor("shank_l"), found.start, VIEWS)
        assert np.linalg.norm((poses - sway.poses(VIEWS))[:, :3, 3], axis=-1).max() < 5e-6


def test_detection_errors_cost_less_with_more_views(rng: np.random.Generator):
    sway, signals = recorded(1)
    truth = sway.poses(VIEWS[:1])[0][:3, 3]
    velocity_spread, position_errors = [], []
    for views in (2, 10):
        pixels = seen(sway, views)
        found = [
            initialization.start_from_fiducials(
                signals, "shank_l", c_arm(), pixels + rng.normal(0, 0.05, pixels.shape), FIDUCIALS
            )
            for _ in range(40)
        ]
        velocity_spread.append(
            (np.array([f.start.velocity for f in found]) - sway.velocities(VIEWS[:1])[0]).std()
        )
        position_errors.append(
            [np.linalg.norm(f.start.world_from_sensor[:3, 3] - truth) for f in found]
        )
    assert velocity_spread[1] < 0.25 * velocity_spread[0]
    assert np.mean(position_errors[1]) < 0.75 * np.mean(position_errors[0])


def test_lost_fiducials_are_said_so():
    sway, signals = recorded(1)
    pixels = seen(sway, 3)
    pixels[1, 2] = np.nan
    with pytest.raises(LegsimError, match="view 1: fiducial y is hidden"):
        initialization.start_from_fiducials(signals, "shank_l", c_arm(), pixels, FIDUCIALS)
    with pytest.raises(LegsimError, match="of 2 to 248 views; got 1"):
        initialization.start_from_fiducials(signals, "shank_l", c_arm(), pixels[:1], FIDUCIALS)
    below = pixels - np.array([0, 400])
    with pytest.raises(LegsimError, match="off the detector"):
        initialization.start_from_fiducials(signals, "shank_l", c_arm(), below, FIDUCIALS)
