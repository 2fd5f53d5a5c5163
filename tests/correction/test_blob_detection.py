import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import blob_detection
from legsim.correction.fiducials import Fiducials, pose_from_fiducials, project_fiducials
from legsim.geometry.cone_beam import ConeBeamGeometry

FINE = (np.arange(7) - 3) / 7


def shadow(
    shape: tuple[int, int], centers: np.ndarray, radius: float, height: float = 1.0
) -> np.ndarray:
    """Chords through spheres, averaged over each pixel."""
    v, u = np.indices(shape, float)
    image = np.zeros(shape)
    for center in centers:
        for du in FINE:
            for dv in FINE:
                square = (u + du - center[0]) ** 2 + (v + dv - center[1]) ** 2
                image += height * np.sqrt(np.maximum(1 - square / radius**2, 0)) / FINE.size**2
    return image.astype(np.float32)


@pytest.mark.parametrize(("radius", "tolerance"), [(1.2, 0.06), (2.0, 0.02), (4.0, 0.02)])
def test_centers_are_found_to_hundredths_of_a_pixel(
    rng: np.random.Generator, radius: float, tolerance: float
):
    centers = np.array([[20.0, 20.0], [60.0, 22.0], [30.0, 60.0], [70.0, 70.0]]) + rng.uniform(
        -0.5, 0.5, (4, 2)
    )
    image = shadow((90, 95), centers, radius)
    found = blob_detection.locate(
        image,
        centers + rng.uniform(-2, 2, (4, 2)),
        radius_px=radius,
        search_px=4,
        least_contrast=0.2,
    )
    np.testing.assert_allclose(found, centers, atol=tolerance)


def test_slope_of_the_background_does_not_pull(rng: np.random.Generator):
    center = np.array([[24.3, 25.8]])
    v, u = np.indices((50, 50))
    image = shadow((50, 50), center, 2.0) + (3 + 0.05 * u - 0.03 * v).astype(np.float32)
    found = blob_detection.locate(image, [[25, 25]], radius_px=2, search_px=4, least_contrast=0.2)
    np.testing.assert_allclose(found, center, atol=0.02)


def test_noise_costs_as_much_as_it_must(rng: np.random.Generator):
    center = np.array([[24.3, 25.8]])
    clean = shadow((50, 50), center, 2.5)
    noisy = [clean + rng.normal(0, 0.05, clean.shape).astype(np.float32) for _ in range(60)]
    found = np.concatenate(
        [
            blob_detection.locate(image, [[25, 25]], radius_px=2.5, search_px=4, least_contrast=0.3)
            for image in noisy
        ]
    )
    assert np.isfinite(found).all()
    # Cramer and Rao: sigma / (height sqrt(pi)) for a Gaussian of any width, pixels of size 1
    assert 0.02 < (found - center).std() < 0.06
    assert np.abs((found - center).mean(0)).max() < 0.02


def test_missing_and_lost_beads_are_nan(rng: np.random.Generator):
    center = np.array([[24.3, 25.8]])
    image = shadow((50, 50), center, 2.0) + rng.normal(0, 0.02, (50, 50)).astype(np.float32)
    expected = [[25, 25], [40, 10], [-30, 20], [np.nan, np.nan], [200, 200]]
    found = blob_detection.locate(image, expected, radius_px=2, search_px=4, least_contrast=0.3)
    assert np.isfinite(found).all(-1).tolist() == [True, False, False, False, False]


def test_the_nearest_place_decides_between_beads():
    centers = np.array([[20.0, 20.0], [27.0, 20.0]])
    image = shadow((40, 50), centers, 1.5)
    found = blob_detection.locate(
        image, centers + np.array([[-1, 0], [1, 0]]), radius_px=1.5, search_px=3, least_contrast=0.2
    )
    np.testing.assert_allclose(found, centers, atol=0.05)


def test_fiducials_seen_in_an_image_give_the_sensors_pose():
    """From the picture to the pose: what the detection leaves is within what the covariance
    promises.
    """
    geometry = ConeBeamGeometry.circular(
        times=[0.0],
        angles=[0.4],
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(200, 240),
        pixel_pitch=0.616e-3,
        isocenter=[0, 0, 0],
    )
    fiducials = Fiducials(0.02)
    pose = transforms.rigid(transforms.rotation_from_vector([0.5, 0.3, -0.2]), [0.005, 0.01, -0.01])
    pixels = project_fiducials(geometry, 0, pose, fiducials)
    found = blob_detection.locate(
        shadow((200, 240), pixels, 1.6),
        np.round(pixels),
        radius_px=1.6,
        search_px=4,
        least_contrast=0.2,
    )
    fit = pose_from_fiducials(geometry, 0, found, fiducials)
    deviation = np.sqrt(np.diag(fit.covariance(0.02)))
    assert np.abs(fit.world_from_sensor[:3, 3] - pose[:3, 3]).max() < 3 * deviation[3:].max()
    assert (
        transforms.rotation_angle(fit.world_from_sensor[:3, :3].T @ pose[:3, :3])
        < 3 * deviation[:3].max()
    )


def test_refuses_sizes_that_are_none():
    with pytest.raises(LegsimError, match="positive radius"):
        blob_detection.locate(
            np.zeros((9, 9), np.float32), [[4, 4]], radius_px=0, search_px=3, least_contrast=1
        )
