import numpy as np
import pytest
from scipy.optimize import least_squares

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import blob_detection
from legsim.correction.fiducials import Fiducials, pose_from_fiducials, project_fiducials
from legsim.geometry.cone_beam import ConeBeamGeometry

FINE = (np.arange(7) - 3) / 7


def shadow(
    shape: tuple[int, int],
    centers: np.ndarray,
    radius: float,
    height: float = 1.0,
    row_ratio: float = 1.0,
) -> np.ndarray:
    """Chords through spheres, averaged over each pixel, which is ``row_ratio`` widths high."""
    v, u = np.indices(shape, float)
    image = np.zeros(shape)
    for center in centers:
        for du in FINE:
            for dv in FINE:
                square = (u + du - center[0]) ** 2 + (row_ratio * (v + dv - center[1])) ** 2
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


@pytest.mark.parametrize("row_ratio", [0.6, 1.5, 2.0])
def test_pixels_may_be_higher_than_wide(rng: np.random.Generator, row_ratio: float):
    """Bead by bead, on a tilted background, and as many widths off as may be."""
    v, u = np.indices((90, 95))
    background = (3 + 0.05 * u - 0.03 * v).astype(np.float32)
    for center in np.array([[20.0, 20.0], [60.3, 22.4], [30.7, 60.2], [70.1, 69.6]]):
        image = background + shadow((90, 95), center[None], 4.0, row_ratio=row_ratio)
        angle = rng.uniform(0, 2 * np.pi)
        off = 3.9 * np.array([np.cos(angle), np.sin(angle) / row_ratio])
        sizes = {"radius_px": 4.0, "search_px": 4.0, "least_contrast": 0.2}
        found = blob_detection.locate(image, center + off, row_ratio=row_ratio, **sizes)
        np.testing.assert_allclose(found[0], center, atol=0.03)


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


def by_scipy(image: np.ndarray, start: np.ndarray, radius: float) -> np.ndarray:
    """Center (2,) of a Gaussian on a plane, by a general optimizer with derivatives by differences.

    Widths end at 0.31 pixel, as in the package.
    """
    v, u = np.indices(image.shape)
    inside = (u - start[0]) ** 2 + (v - start[1]) ** 2 <= (2.5 * radius + 1) ** 2
    du, dv, values = u[inside] - start[0], v[inside] - start[1], image[inside].astype(float)

    def miss(x: np.ndarray) -> np.ndarray:
        height, cu, cv, width, offset, slope_u, slope_v = x
        bump = height * np.exp(-((du - cu) ** 2 + (dv - cv) ** 2) / (2 * width**2))
        return bump + offset + slope_u * du + slope_v * dv - values

    first = [values.max(), 0, 0, 0.5 * radius + 0.3, values.min(), 0, 0]
    free = np.full(7, np.inf)
    low = np.where(np.arange(7) == 3, blob_detection._NARROWEST, -free)
    fit = least_squares(
        miss, first, bounds=(low, free), x_scale="jac", xtol=1e-12, ftol=1e-12, max_nfev=5000
    )
    return start + fit.x[1:3]


@pytest.mark.parametrize("radius", [1.2, 2.0, 3.5])
def test_all_at_once_agrees_with_a_general_optimizer_for_each(
    rng: np.random.Generator, radius: float
):
    centers = np.stack(np.meshgrid([20, 45, 70], [20, 45, 70]), -1).reshape(-1, 2) + rng.uniform(
        -0.5, 0.5, (9, 2)
    )
    image = shadow((90, 90), centers, radius, height=4.0)
    image += rng.normal(0, 0.02, image.shape).astype(np.float32)
    sizes = {"radius_px": radius, "search_px": 4.0, "least_contrast": 0.2}
    found = blob_detection.locate(image, centers, **sizes)
    alone = np.concatenate([blob_detection.locate(image, [c], **sizes) for c in centers])
    np.testing.assert_allclose(found, alone, atol=1e-9)
    # both start from the same pixel: that of the strongest response, next to the center
    slow = np.array([by_scipy(image, np.round(c), radius) for c in found])
    np.testing.assert_allclose(found, slow, atol=2e-3)


def test_a_small_shadow_between_four_pixels_has_one_center():
    """Point samples of a sphere of 1.2 pixels: pixels tell its width no more, only its middle."""
    v, u = np.indices((40, 40), float)

    def sampled(cu: float, cv: float) -> np.ndarray:
        square = ((u - cu) ** 2 + (v - cv) ** 2) / 1.2**2
        return (5 * np.sqrt(np.maximum(1 - square, 0))).astype(np.float32)

    sizes = {"radius_px": 1.2, "search_px": 4.0, "least_contrast": 0.2}
    middle = blob_detection.locate(sampled(20.5, 19.5), [[20, 20]], **sizes)
    np.testing.assert_allclose(middle, [[20.5, 19.5]], atol=1e-6)
    left, right = (
        blob_detection.locate(sampled(20.5 + shift, 19.5), [[20, 20]], **sizes)[0]
        for shift in (-0.1, 0.1)
    )
    assert left[0] < 20.5 < right[0]
    np.testing.assert_allclose((left + right) / 2, [20.5, 19.5], atol=1e-3)


@pytest.mark.parametrize("size", [(2, 2), (1, 40), (40, 3)])
def test_images_smaller_than_a_shadow_show_none(size: tuple[int, int]):
    image = np.ones(size, np.float32)
    at = [[1.0, 1.0], [0.0, 0.0]]
    found = blob_detection.locate(image, at, radius_px=2, search_px=4, least_contrast=0.2)
    assert np.isnan(found).all()


def test_no_shadow_is_found_in_an_image_without_contrast():
    image = np.zeros((40, 40), np.float32)
    found = blob_detection.locate(image, [[20, 20]], radius_px=2, search_px=4, least_contrast=0.2)
    assert np.isnan(found).all()
    assert blob_detection.locate(
        image, np.empty((0, 2)), radius_px=2, search_px=4, least_contrast=0.2
    ).shape == (0, 2)


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
