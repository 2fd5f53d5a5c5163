import re

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import fiducials, initialization
from legsim.correction.fiducials import Fiducials
from legsim.correction.initialization import FiducialOptions, FiducialScan
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu import strapdown
from legsim.imu.sensors import Sensor
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.opencl import device
from legsim.phantom import leg_phantom
from tests.references.sway import Sway

VIEWS = np.arange(4) / 31
SAMPLES = np.arange(60) / 120


def signals(count: int = 60) -> ImuSignals:
    rate, force = Sway.standing(0).signals(np.arange(count) / 120)
    return ImuSignals(np.arange(count) / 120, ("shank_l",), rate[:, None], force[:, None])


def c_arm() -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=VIEWS,
        angles=np.radians(0.8) * np.arange(4),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(240, 310),
        pixel_pitch=1.232e-3,
        isocenter=leg_phantom.load_leg_phantom().reference_world_from_segment[
            SEGMENTS.index("tibia_l")
        ][:3, 3],
    )


def resting_leg(sensor: Sensor) -> tuple[ImuSignals, FiducialScan, SegmentPoses]:
    """The straight leg, at rest: sensors read gravity alone."""
    phantom = leg_phantom.load_leg_phantom()
    poses = SegmentPoses(
        VIEWS, SEGMENTS, np.broadcast_to(phantom.reference_world_from_segment, (4, 13, 4, 4))
    )
    seen = poses.of(sensor.segment) @ sensor.segment_from_sensor
    force = np.broadcast_to([0, 9.80665, 0], (60, 1, 3))
    read = ImuSignals(SAMPLES, (sensor.name,), np.zeros((60, 1, 3)), force)
    return (
        read,
        FiducialScan(c_arm(), poses, phantom, device.open_device()),
        SegmentPoses(VIEWS, (sensor.name,), seen[:, None]),
    )


NEAR = Sensor.placed("shank_l", "tibia_l", 0.06, (0.02, 0, 0))
FAR = Sensor.placed("shank_l", "tibia_l", 0.14, (0.02, 0, 0))


def found(sensor: Sensor, **settings) -> initialization.Starts:
    read, scan, poses = resting_leg(sensor)
    options = FiducialOptions(**settings)
    return initialization.from_fiducials(
        read, [sensor], scan, poses, options, scheme="accurate", rng=np.random.default_rng(0)
    )


def test_exact_fiducials_give_the_true_start():
    starts = found(NEAR)
    truth = resting_leg(NEAR)[2].of("shank_l")[0]
    np.testing.assert_allclose(starts.starts[0].world_from_sensor, truth, atol=1e-8)
    np.testing.assert_allclose(starts.starts[0].velocity, 0, atol=1e-6)
    assert "projected with 0 px of error" in starts.notes[0]
    assert starts.notes[1] == "Sensor shank_l: fiducials off the real detector: none."


def test_what_a_pixel_costs_is_said_as_it_is_found():
    """A small detection error in many draws against the sentence's numbers; longer axes and more
    views cost less.
    """
    numbers = [float(n) for n in re.findall(r"[\d.e+-]+(?= deg| mm| m/s)", found(NEAR).notes[2])]
    read, scan, poses = resting_leg(NEAR)
    truth, spread = poses.of("shank_l")[0], []
    for seed in range(100):
        drawn = initialization.from_fiducials(
            read,
            [NEAR],
            scan,
            poses,
            FiducialOptions(error_px=0.01),
            scheme="accurate",
            rng=np.random.default_rng(seed),
        ).starts[0]
        up = drawn.world_from_sensor[:3, :3] @ truth[:3, :3].T @ [0, 1.0, 0]
        place = np.linalg.norm(drawn.world_from_sensor[:3, 3] - truth[:3, 3])
        spread.append(
            (np.degrees(np.hypot(up[0], up[2])), 1e3 * place, np.sqrt((drawn.velocity**2).sum()))
        )
    np.testing.assert_allclose(100 * np.sqrt(np.mean(np.square(spread), 0)), numbers, rtol=0.25)
    better = [
        float(n)
        for n in re.findall(
            r"[\d.e+-]+(?= deg| mm| m/s)", found(NEAR, fiducials=Fiducials(0.02), views=4).notes[2]
        )
    ]
    assert all(b < 0.6 * n for b, n in zip(better, numbers, strict=True))


def test_fiducials_found_in_images_give_the_start_to_their_error():
    """0.05 px on 10 mm seen at 1.2 px a mm: half a degree, and the depth to some mm; a mean over
    views helps.
    """
    starts = found(NEAR, found="images", views=3)
    truth = resting_leg(NEAR)[2].of("shank_l")[0]
    seen = c_arm().project(np.stack([starts.starts[0].world_from_sensor[:3, 3], truth[:3, 3]]))[0][
        0
    ]
    assert np.linalg.norm(seen[0] - seen[1]) < 0.3
    assert np.abs(starts.starts[0].world_from_sensor[:3, :3] - truth[:3, :3]).max() < 0.05


def test_sensors_off_the_detector_need_the_papers_virtual_one():
    with pytest.raises(
        LegsimError,
        match="start of sensor shank_l: view 0: fiducial origin, x, y, z is off the detector",
    ):
        found(FAR)
    starts = found(FAR, detector="unbounded")
    assert starts.notes[1] == "Sensor shank_l: fiducials off the real detector: origin, x, y, z."
    in_images = found(FAR, detector="unbounded", found="images")
    # depth is known to some mm, the direction to the error of detection
    places = np.stack([starts.starts[0].world_from_sensor[:3, 3] for starts in (in_images, starts)])
    seen = c_arm().project(places)[0][0]
    assert np.linalg.norm(seen[0] - seen[1]) < 0.3


def test_more_views_than_there_are_are_refused():
    with pytest.raises(LegsimError, match=r"views is 9, but the scan has 4 views"):
        found(NEAR, views=9)


SCAN_SAMPLES = np.arange(990) / 120
SCAN_VIEWS = np.arange(248) / 31
FIDUCIALS = Fiducials()


def short_scan_c_arm() -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=SCAN_VIEWS,
        angles=np.radians(0.8) * np.arange(248),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
        isocenter=Sway.standing(0).center,
    )


def recorded(seed: int) -> tuple[Sway, ImuSignals]:
    sway = Sway.standing(seed)
    rate, force = sway.signals(SCAN_SAMPLES)
    return sway, ImuSignals(SCAN_SAMPLES, ("shank_l",), rate[:, None], force[:, None])


def seen(sway: Sway, views: int) -> np.ndarray:
    geometry, poses = short_scan_c_arm(), sway.poses(SCAN_VIEWS[:views])
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
            signals, "shank_l", short_scan_c_arm(), seen(sway, views), FIDUCIALS
        )
        np.testing.assert_allclose(
            found.start.velocity, sway.velocities(SCAN_VIEWS[:1])[0], atol=2e-7
        )
        np.testing.assert_allclose(
            found.start.world_from_sensor, sway.poses(SCAN_VIEWS[:1])[0], atol=1e-7
        )
        poses = strapdown.integrate(
            SCAN_SAMPLES, *signals.sensor("shank_l"), found.start, SCAN_VIEWS
        )
        assert np.linalg.norm((poses - sway.poses(SCAN_VIEWS))[:, :3, 3], axis=-1).max() < 5e-6


def test_detection_errors_cost_less_with_more_views(rng: np.random.Generator):
    sway, signals = recorded(1)
    truth = sway.poses(SCAN_VIEWS[:1])[0][:3, 3]
    velocity_spread, position_errors = [], []
    for views in (2, 10):
        pixels = seen(sway, views)
        found = [
            initialization.start_from_fiducials(
                signals,
                "shank_l",
                short_scan_c_arm(),
                pixels + rng.normal(0, 0.05, pixels.shape),
                FIDUCIALS,
            )
            for _ in range(40)
        ]
        velocity_spread.append(
            (np.array([f.start.velocity for f in found]) - sway.velocities(SCAN_VIEWS[:1])[0]).std()
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
        initialization.start_from_fiducials(
            signals, "shank_l", short_scan_c_arm(), pixels, FIDUCIALS
        )
    with pytest.raises(LegsimError, match="of 2 to 248 views; got 1"):
        initialization.start_from_fiducials(
            signals, "shank_l", short_scan_c_arm(), pixels[:1], FIDUCIALS
        )
    below = pixels - np.array([0, 400])
    with pytest.raises(LegsimError, match="off the detector"):
        initialization.start_from_fiducials(
            signals, "shank_l", short_scan_c_arm(), below, FIDUCIALS
        )


def test_starts_are_leveled_by_the_rest_of_their_own_sensor():
    tilted = transforms.rotation_from_vector([0.02, 0.0, 0.01])
    start = SensorStart(transforms.rigid(tilted, np.zeros(3)), np.zeros(3))
    given = initialization.Starts((start, start), ("known",))
    rest = np.array([[0.0, 9.8, 0.0], [0.0, 9.8 * np.cos(0.1), 9.8 * np.sin(0.1)]])
    shape = (2, 2, 3)
    read = ImuSignals(SAMPLES[:2], ("a", "b"), np.zeros(shape), np.zeros(shape), rest_force=rest)
    found = initialization.leveled(given, read)
    for level, force in zip(found.starts, rest, strict=True):
        up = level.world_from_sensor[:3, :3] @ force
        np.testing.assert_allclose(up, [0, 9.8, 0], atol=1e-12)
    assert found.notes[0] == "known"
    assert "rest before the scan" in found.notes[1]
    assert initialization.leveled(given, signals()) is given
    broken = ImuSignals(SAMPLES[:2], ("a", "b"), np.zeros(shape), np.zeros(shape), rest_force=-rest)
    with pytest.raises(LegsimError, match=r"start of sensor a: .*cannot be leveled"):
        initialization.leveled(given, broken)
