import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.fiducials import (
    Fiducials,
    _reprojected,
    on_detector,
    pose_from_fiducials,
    project_fiducials,
    velocity_from_views,
)
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu import strapdown
from legsim.imu.signals import SensorStart
from legsim.imu.strapdown import Scheme
from tests.references.sway import Sway

ISOCENTER = np.array([0.05, 0.45, -0.1])
VIEWS = np.arange(248) / 31


def c_arm(times: np.ndarray = VIEWS) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=times,
        angles=np.radians(-8.8 + 0.8 * np.arange(len(times))),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
        isocenter=ISOCENTER,
    )


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    return Rotation.from_quat(rng.normal(size=4), scalar_first=True).as_matrix()


def random_pose(rng: np.random.Generator, reach: float = 0.08) -> np.ndarray:
    rotation = random_rotation(rng)
    return transforms.rigid(rotation, ISOCENTER + rng.uniform(-reach, reach, 3))


def errors(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """(m, rad)"""
    return float(np.linalg.norm((found - truth)[:3, 3])), float(
        transforms.rotation_angle(truth[:3, :3].T @ found[:3, :3])
    )


@pytest.mark.parametrize(
    ("axis_length", "count"),
    [(0.01, 200), (0.05, 200), pytest.param(0.01, 5000, marks=pytest.mark.slow)],
)
def test_exact_points_give_the_pose_back_for_any_pose(
    rng: np.random.Generator, axis_length: float, count: int
):
    geometry, fiducials = c_arm(), Fiducials(axis_length)
    for trial in range(count):
        pose, view = random_pose(rng, 0.04), trial % 248
        fit = pose_from_fiducials(
            geometry, view, project_fiducials(geometry, view, pose, fiducials), fiducials
        )
        away, turned = errors(fit.world_from_sensor, pose)
        assert away < 1e-8
        assert turned < 1e-8
        assert fit.residual_px < 1e-7


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), axis_length=st.floats(0.003, 0.15), distance=st.floats(0.4, 3.0))
def test_any_scanner_and_any_size(seed: int, axis_length: float, distance: float):
    rng = np.random.default_rng(seed)
    geometry = ConeBeamGeometry.circular(
        times=[0.0],
        angles=[rng.uniform(0, 6)],
        source_isocenter=distance,
        source_detector=1.5 * distance,
        shape_vu=(100, 100),
        pixel_pitch=1e-3,
    ).moved(transforms.rigid(random_rotation(rng), rng.uniform(-0.1, 0.1, 3)))
    pose, fiducials = (
        transforms.rigid(random_rotation(rng), rng.uniform(-0.05, 0.05, 3)),
        Fiducials(axis_length),
    )
    pixels = project_fiducials(geometry, 0, pose, fiducials)
    fit = pose_from_fiducials(geometry, 0, pixels, fiducials, detector="unbounded")
    away, turned = errors(fit.world_from_sensor, pose)
    assert away < 1e-6
    assert turned < 1e-6


def test_there_is_no_other_root(rng: np.random.Generator):
    """Least squares from rotations all over the group ends at the same pose, at one that reprojects
    pixels off, or behind the source.
    """
    geometry, fiducials = c_arm(), Fiducials()
    for _ in range(12):
        pose = random_pose(rng)
        pixels = project_fiducials(geometry, 0, pose, fiducials)
        for _ in range(8):
            start = transforms.rigid(random_rotation(rng), pose[:3, 3])
            found, residual = _reprojected(
                geometry.matrices[0], pixels, start, fiducials.points_sensor
            )
            behind = geometry.matrices[0, 2] @ found[:, 3] < 0
            assert errors(found, pose)[1] < 1e-2 or residual > 5 or behind


def test_mirrored_root_nearly_fits_and_is_rejected(rng: np.random.Generator):
    """Turned inside out along the ray the four points project almost alike: what the cross
    product's sign is there for.
    """
    geometry, fiducials = c_arm(), Fiducials()
    for _ in range(50):
        pose = random_pose(rng)
        ray = pose[:3, 3] - geometry.sources()[0]
        normal = ray / np.linalg.norm(ray)
        mirrored = pose.copy()
        mirrored[:3, :3] = (np.eye(3) - 2 * np.outer(normal, normal)) @ pose[:3, :3]
        pixels = project_fiducials(geometry, 0, mirrored, fiducials)
        true_pixels = project_fiducials(geometry, 0, pose, fiducials)
        assert np.abs(pixels - true_pixels).max() < 1.0
        fit = pose_from_fiducials(geometry, 0, true_pixels, fiducials, detector="unbounded")
        assert np.linalg.det(fit.world_from_sensor[:3, :3]) == pytest.approx(1)
        assert errors(fit.world_from_sensor, pose)[1] < 1e-7


def test_covariance_is_that_of_many_noisy_detections(rng: np.random.Generator):
    geometry, fiducials, pose, sigma = c_arm(), Fiducials(), random_pose(rng), 0.1
    pixels = project_fiducials(geometry, 3, pose, fiducials)
    expected = pose_from_fiducials(geometry, 3, pixels, fiducials).covariance(sigma)
    deviations = []
    for _ in range(500):
        fit = pose_from_fiducials(geometry, 3, pixels + rng.normal(0, sigma, (4, 2)), fiducials)
        turn = transforms.vector_from_rotation(fit.world_from_sensor[:3, :3] @ pose[:3, :3].T)
        deviations.append(np.concatenate([turn, fit.world_from_sensor[:3, 3] - pose[:3, 3]]))
    whitened = np.linalg.solve(np.linalg.cholesky(expected), np.array(deviations).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.2)


@pytest.mark.parametrize("count", [300, pytest.param(5000, marks=pytest.mark.slow)])
def test_noise_never_flips_the_pose(rng: np.random.Generator, count: int):
    geometry, fiducials = c_arm(), Fiducials()
    for trial in range(count):
        pose, view = random_pose(rng, 0.07), trial % 248
        pixels = project_fiducials(geometry, view, pose, fiducials) + rng.normal(0, 0.3, (4, 2))
        fit = pose_from_fiducials(geometry, view, pixels, fiducials)
        deviation = np.concatenate(
            [
                transforms.vector_from_rotation(fit.world_from_sensor[:3, :3] @ pose[:3, :3].T),
                (fit.world_from_sensor - pose)[:3, 3],
            ]
        )
        # squared Mahalanobis distance of six numbers: 45 is past one in ten million
        assert deviation @ np.linalg.solve(fit.covariance(0.3), deviation) < 50
        assert fit.residual_px < 2


def test_longer_axes_know_the_pose_better():
    geometry, pose = (
        c_arm(),
        transforms.rigid(transforms.rotation_from_vector([0.4, 0.8, -0.3]), ISOCENTER),
    )
    tilts = []
    for axis_length in (0.01, 0.02, 0.04):
        fiducials = Fiducials(axis_length)
        fit = pose_from_fiducials(
            geometry, 0, project_fiducials(geometry, 0, pose, fiducials), fiducials
        )
        tilts.append(fit.tilt_error(0.1))
    assert tilts[0] / tilts[1] == pytest.approx(2, rel=0.1)
    assert tilts[1] / tilts[2] == pytest.approx(2, rel=0.1)
    assert np.degrees(tilts[0]) == pytest.approx(0.23, abs=0.15)


def test_hidden_and_lost_fiducials_are_named():
    geometry, fiducials = c_arm(), Fiducials()
    below = transforms.rigid(np.eye(3), ISOCENTER - [0, 0.14, 0])
    pixels = project_fiducials(geometry, 0, below, fiducials)
    with pytest.raises(
        LegsimError, match="view 0: fiducial origin, x, y, z is off the detector of 620 x 480"
    ):
        pose_from_fiducials(geometry, 0, pixels, fiducials)
    found = pose_from_fiducials(geometry, 0, pixels, fiducials, detector="unbounded")
    assert errors(found.world_from_sensor, below)[0] < 1e-8
    pixels = np.array([0.0, 300.0]) + pixels
    pixels[2] = np.nan
    with pytest.raises(LegsimError, match="fiducial y is hidden"):
        pose_from_fiducials(geometry, 0, pixels, fiducials)
    with pytest.raises(LegsimError, match="unknown view 248"):
        pose_from_fiducials(geometry, 248, pixels, fiducials)
    with pytest.raises(LegsimError, match="one line"):
        pose_from_fiducials(geometry, 0, np.full((4, 2), 50.0), fiducials)


def test_which_fiducials_are_seen():
    geometry, poses = c_arm(), np.tile(np.eye(4), (248, 1, 1))
    poses[:, :3, 3] = np.array([0, 0.09, 0]) + ISOCENTER
    seen = on_detector(geometry, poses, Fiducials(0.01))
    assert seen[:, [0, 1, 3]].all()
    assert not seen[:, 2].any()  # the y tip is 100 mm up, half the detector is 96


@pytest.mark.parametrize(
    ("imu_rate_hz", "scheme"), [(120.0, "accurate"), (100.0, "accurate"), (31.0, "paper")]
)
def test_velocity_from_the_second_view_is_exact(imu_rate_hz: float, scheme: Scheme):
    """At any ratio of the two clocks (120/31 is no integer); the paper's recursion to its own
    velocity, which hits the second view.
    """
    sway, geometry = Sway.standing(1), c_arm()
    times = np.arange(int(8.1 * imu_rate_hz)) / imu_rate_hz
    start, at = SensorStart(sway.poses(VIEWS[:1])[0], np.zeros(3)), geometry.times[:2]
    free = strapdown.integrate(times, *sway.signals(times), start, at, scheme=scheme)
    seen = sway.poses(at)
    fit = velocity_from_views(at, seen[:, :3, 3], free[:, :3, 3])
    if scheme == "accurate":
        np.testing.assert_allclose(fit.velocity, sway.velocities(at[:1])[0], atol=1e-7)
    moved = strapdown.integrate(
        times,
        *sway.signals(times),
        SensorStart(start.world_from_sensor, fit.velocity),
        at,
        scheme=scheme,
    )
    np.testing.assert_allclose(moved[:, :3, 3], seen[:, :3, 3], atol=1e-12)


def test_more_views_average_the_errors_as_reported(rng: np.random.Generator):
    sway, sigma = Sway.standing(2), 1e-4
    times, start = np.arange(300) / 120, SensorStart(sway.poses(VIEWS[:1])[0], np.zeros(3))
    for views in (2, 6, 20):
        at = VIEWS[:views]
        seen = sway.poses(at)[:, :3, 3]
        free = strapdown.integrate(times, *sway.signals(times), start, at)[:, :3, 3]
        found = []
        for _ in range(300):
            noise = rng.normal(0, sigma, seen.shape)
            found.append(velocity_from_views(at, seen + noise, free + noise[0]))
        deviation = np.array([fit.velocity for fit in found]) - sway.velocities(at[:1])[0]
        assert deviation.std() == pytest.approx(found[0].error_per_position_error * sigma, rel=0.1)


def test_two_views_are_ill_conditioned_as_computed():
    # 0.1 mm over one view interval is 3.1 mm/s (times sqrt 2, both views being wrong)
    fit = velocity_from_views(VIEWS[:2], np.zeros((2, 3)), np.zeros((2, 3)))
    assert fit.error_per_position_error * 1e-4 == pytest.approx(np.sqrt(2) * 3.1e-3, rel=1e-6)


def test_start_shift_is_found_from_many_views():
    at, velocity, shift = VIEWS[:10], np.array([0.01, -0.02, 0.03]), np.array([1e-3, 0, -2e-3])
    fit = velocity_from_views(at, at[:, None] * velocity + shift, np.zeros((10, 3)))
    np.testing.assert_allclose(fit.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(fit.start_shift, shift, atol=1e-12)
    assert fit.residual < 1e-12


def test_refuses_one_view_and_bad_sizes():
    with pytest.raises(LegsimError, match="at least two views"):
        velocity_from_views(VIEWS[:1], np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(LegsimError, match="positive axis length"):
        Fiducials(0.0)
