"""The detector by its laws: perfect changes nothing, Poisson moments, an edge, a step, the stated
scatter, streams of views.
"""

import numpy as np
import pytest
from scipy.special import erf

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.scan import detector
from legsim.scan.detector import Detector

PITCH, RATE = 0.5e-3, 30.0


def projections(images: np.ndarray) -> Projections:
    images = np.asarray(images, np.float32)
    geometry = ConeBeamGeometry.circular(
        times=np.arange(len(images)) / RATE,
        angles=0.1 * np.arange(len(images)),
        source_isocenter=0.78,
        source_detector=1.2,
        shape_vu=images.shape[1:],
        pixel_pitch=PITCH,
    )
    return Projections(geometry, images)


def detected(images: np.ndarray, what: Detector, seed: int = 5) -> np.ndarray:
    return detector.detect(projections(images), what, np.random.default_rng(seed)).line_integrals


def intensity(images: np.ndarray, what: Detector, seed: int = 5) -> np.ndarray:
    return np.exp(-detected(images, what, seed).astype(float))


def lump(rows: int = 60, columns: int = 80, height: float = 2.0) -> np.ndarray:
    v, u = np.mgrid[:rows, :columns]
    return height * np.sqrt(np.maximum(1 - ((u - 35) / 25) ** 2 - ((v - 28) / 20) ** 2, 0))


def test_a_perfect_detector_hands_back_the_same_projections_and_draws_nothing():
    given, rng = projections(lump()[None]), np.random.default_rng(3)
    assert detector.detect(given, Detector(lag=((0.0, 1.0),), scatter_fwhm=0.3), rng) is given
    assert rng.bit_generator.state == np.random.default_rng(3).bit_generator.state


@pytest.mark.parametrize("height", [0.0, 1.5, 4.0])
def test_noise_has_the_mean_and_variance_of_poisson_and_readout(height):
    photons, electronic = 2e4, 30.0
    counts = photons * intensity(np.full((4, 200, 200), height), Detector(photons, electronic))
    expected = photons * np.exp(-height)
    spread = np.sqrt(expected + electronic**2)
    assert counts.mean() == pytest.approx(expected, abs=4 * spread / np.sqrt(counts.size))
    assert counts.var() == pytest.approx(spread**2, rel=4 * np.sqrt(2 / counts.size) + 2e-3)


def test_few_photons_are_poisson_and_starved_pixels_have_the_stated_floor():
    found = detected(np.full((2, 200, 200), 3.0), Detector(photons=20.0))
    none = found == np.float32(np.log(20.0 / 0.5))
    mean = 20.0 * np.exp(-3.0)
    assert none.mean() == pytest.approx(np.exp(-mean), abs=4 * np.sqrt(np.exp(-mean) / none.size))
    assert np.isfinite(found).all()
    assert np.isfinite(detected(np.full((1, 20, 20), 3000.0), Detector(blur_fwhm=1e-3))).all()
    assert np.isfinite(detected(np.full((1, 50, 50), 30.0), Detector(5.0, 4.0))).all()


def test_the_most_photons_are_still_counted_and_leave_no_noise():
    images = np.linspace(0, 5, 12).reshape(1, 3, 4)
    noisy, exact = (
        detected(images, Detector(photons=photons, scatter_to_primary=10.0))
        for photons in (detector.MOST_PHOTONS, 0.0)
    )
    np.testing.assert_allclose(noisy, exact, atol=1e-4)


def test_views_of_one_scan_are_independent_and_their_noise_hangs_on_seed_and_number_alone():
    images = np.stack([lump(height=h) for h in (1.0, 2.0, 2.0, 0.5)])
    noisy = Detector(photons=1e4, electronic_noise=5.0)
    whole = detected(images, noisy)
    np.testing.assert_array_equal(whole, detected(images, noisy))
    np.testing.assert_array_equal(whole[:2], detected(images[:2], noisy))
    changed = images.copy()
    changed[0] += 1
    np.testing.assert_array_equal(whole[1:], detected(changed, noisy)[1:])
    assert (whole != detected(images, noisy, seed=6)).mean() > 0.9
    residue = (whole - images)[1:3].reshape(2, -1)
    assert abs(np.corrcoef(residue)[0, 1]) < 4 / np.sqrt(images[0].size)


def test_blur_keeps_the_total_and_draws_an_edge_as_the_error_function():
    what = Detector(blur_fwhm=3e-3)
    lumps = lump()[None]
    assert intensity(lumps, what).sum() == pytest.approx(np.exp(-lumps).sum(), rel=1e-6)
    edge = np.where(np.arange(100) < 50, 1.0, 0.2)
    found = intensity(np.tile(-np.log(edge), (1, 8, 1)), what)[0, 4]
    sigma = 3e-3 / PITCH / (2 * np.sqrt(2 * np.log(2)))
    expected = 0.6 - 0.4 * erf((np.arange(100) - 49.5) / sigma / np.sqrt(2))
    np.testing.assert_allclose(found, expected, atol=1.5e-3)
    middle = np.flatnonzero(found < 0.6)[0]
    assert found[middle - 1] - found[middle] == pytest.approx(
        0.8 / sigma / np.sqrt(2 * np.pi), rel=0.02
    )


def test_blur_follows_the_absorption_so_it_smooths_the_quantum_noise():
    flat = np.zeros((1, 300, 300))
    sharp, soft = (intensity(flat, Detector(photons=1e4, blur_fwhm=f)).std() for f in (0.0, 2e-3))
    sigma = 2e-3 / PITCH / (2 * np.sqrt(2 * np.log(2)))
    assert soft / sharp == pytest.approx(1 / (2 * np.sqrt(np.pi) * sigma), rel=0.05)


def test_lag_of_a_step_rises_and_falls_by_its_exponentials():
    lag = ((0.03, 0.05), (0.01, 2.0))
    bright = (np.arange(60) >= 10) & (np.arange(60) < 40)
    found = intensity(
        np.where(bright, 0.0, 50.0)[:, None, None] * np.ones((1, 8, 9)), Detector(lag=lag)
    )[:, 3, 4]
    k = np.arange(60)
    rise = 1 - sum(f * np.exp(-(k - 9) / RATE / t) for f, t in lag)
    fall = sum(f * (np.exp(-(k - 39) / RATE / t) - np.exp(-(k - 9) / RATE / t)) for f, t in lag)
    expected = np.where(k < 10, 0, np.where(k < 40, rise, fall))
    np.testing.assert_allclose(found, expected, atol=2e-7)


def test_lag_loses_nothing_and_a_constant_exposure_is_read_as_it_is_in_the_end():
    lag = ((0.2, 0.1), (0.1, 0.02))
    flash = np.where(np.arange(80) == 3, 0.0, 60.0)[:, None, None] * np.ones((1, 8, 8))
    assert intensity(flash, Detector(lag=lag))[:, 2, 2].sum() == pytest.approx(1, abs=1e-6)
    assert intensity(np.full((80, 8, 8), 0.7), Detector(lag=lag))[-1, 0, 0] == pytest.approx(
        np.exp(-0.7), rel=1e-6
    )


def test_scatter_is_the_stated_part_of_the_primary_within_the_shadow_and_smooth():
    images = np.stack([lump(height=h) for h in (0.5, 3.0)])
    primary = np.exp(-images)
    added = intensity(images, Detector(scatter_to_primary=0.4, scatter_fwhm=0.02)) - primary
    for image, more, before in zip(images, added, primary, strict=True):
        shadow = image > 0
        assert more[shadow].mean() == pytest.approx(0.4 * before[shadow].mean(), rel=1e-5)
        assert more.min() > -1e-7
        assert np.abs(np.diff(more, axis=1)).max() < 0.1 * more.max()
    more = intensity(images, Detector(scatter_to_primary=0.8, scatter_fwhm=0.02)) - primary
    np.testing.assert_allclose(more, 2 * added, atol=1e-6)
    np.testing.assert_allclose(
        detected(np.zeros((1, 9, 9)), Detector(scatter_to_primary=0.4)), 0, atol=1e-7
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"photons": -1.0}, "photons must be a number, at least 0"),
        ({"photons": 1e19}, "1e\\+19 photons per pixel are noise-free .*: set 0 for no noise"),
        ({"blur_fwhm": np.nan}, "blur_fwhm must be a number"),
        ({"electronic_noise": 3.0}, "set the detector's photons too"),
        ({"lag": ((0.7, 1.0), (0.5, 1.0))}, "fractions of at most 1 in all"),
        ({"lag": ((0.1, 0.0),)}, "a time above 0 s"),
    ],
)
def test_refusals(values, message):
    with pytest.raises(LegsimError, match=message):
        Detector(**values)


def test_blur_and_scatter_are_in_mm_whatever_the_shape_of_pixels():
    """Pixels of half the height: blur and scatter reach over twice as many rows as columns."""
    square = projections(np.zeros((1, 81, 81), np.float32))
    geometry = square.geometry
    middle = np.array([[1, 0, 0], [0, 2, -40], [0, 0, 1.0]])
    flat = ConeBeamGeometry(
        geometry.times, middle @ geometry.matrices, geometry.shape_vu, geometry.pixel_pitch
    )
    images = np.zeros((1, 81, 81), np.float32)
    images[0, 40, 40] = 3.0
    pitch = flat.pixel_pitch
    for what in (
        Detector(blur_fwhm=4 * pitch),
        Detector(scatter_to_primary=0.5, scatter_fwhm=6 * pitch),
    ):
        read = detector.detect(Projections(flat, images), what, np.random.default_rng(0))
        change = np.exp(-read.line_integrals[0].astype(float)) - np.exp(-images[0])
        change[40, 40] = 0
        steps = np.arange(81) - 40.0
        spread_v, spread_u = (
            np.sqrt((np.abs(change).sum(axis) * steps**2).sum() / np.abs(change).sum())
            for axis in (1, 0)
        )
        assert spread_v == pytest.approx(2 * spread_u, rel=0.05)
