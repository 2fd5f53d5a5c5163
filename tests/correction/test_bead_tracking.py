import numpy as np
import pytest
from scipy.optimize import least_squares

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import bead_tracking
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections

VIEWS = 120
TIMES = np.arange(VIEWS) / 15.5
KNEE = np.array([0.1, 0.5, -0.1])


def c_arm(views: int = VIEWS) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=TIMES[:views],
        angles=np.radians(1.65) * np.arange(views),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(240, 310),
        pixel_pitch=1.232e-3,
        isocenter=KNEE,
    )


def beads(count: int = 12) -> np.ndarray:
    turn = 2.4 * np.arange(count)
    return KNEE + np.stack(
        [0.06 * np.cos(turn), np.linspace(-0.06, 0.06, count), 0.06 * np.sin(turn)], -1
    )


def sway(seed: int, size: float = 1.0) -> RigidMotion:
    """Millimeters and a degree, at rest at the first view."""
    rng = np.random.default_rng(seed)
    phases, rates = rng.uniform(0, 2 * np.pi, (2, 3, 6)) * np.array([1, 0.3])[:, None, None]
    vectors = np.sin(phases[0][..., None] + 2 * np.pi * rates[..., None] * TIMES).sum(0).T * size
    poses = transforms.rigid(
        transforms.rotation_from_vector(np.radians(0.3) * vectors[:, :3]),
        KNEE + 1e-3 * vectors[:, 3:],
    )
    return RigidMotion.from_poses(TIMES, poses @ transforms.translation(-KNEE))


def seen(motion: RigidMotion, places: np.ndarray) -> np.ndarray:
    return c_arm().project(transforms.apply(motion.moved_from_reference, places))[0]


def worst(found: RigidMotion, true: RigidMotion) -> float:
    around = KNEE + 0.05 * np.vstack([np.zeros(3), np.eye(3)])
    a, b = (transforms.apply(m.moved_from_reference, around) for m in (found, true))
    return float(np.linalg.norm(a - b, axis=-1).max())


@pytest.mark.parametrize("seed", range(4))
def test_exact_shadows_of_known_beads_give_the_exact_motion(seed: int):
    motion = sway(seed)
    assert worst(bead_tracking.poses(c_arm(), seen(motion, beads()), beads()), motion) < 1e-11


def test_a_detection_error_costs_what_the_geometry_says(rng: np.random.Generator):
    """Half a dozen beads at 0.65 pixels a mm: 0.1 px is some hundredths of a mm across the ray, and
    many times that along it.
    """
    motion = sway(0)
    pixels = seen(motion, beads())
    found = bead_tracking.poses(c_arm(), pixels + rng.normal(0, 0.1, pixels.shape), beads())
    shown = c_arm().project(transforms.apply(found.moved_from_reference, beads()))[0] - pixels
    # six of the 24 numbers of a view go into its pose: the reprojected points carry that share of
    # the noise
    assert np.sqrt((shown**2).mean()) == pytest.approx(0.1 * np.sqrt(6 / 24), rel=0.1)
    assert worst(found, motion) < 5e-3


def test_beads_at_rest_are_placed_exactly():
    found = bead_tracking.estimate(c_arm(), seen(RigidMotion.identity(TIMES), beads()))
    np.testing.assert_allclose(found.positions, beads(), atol=1e-9)
    np.testing.assert_allclose(
        found.motion.moved_from_reference, np.broadcast_to(np.eye(4), (VIEWS, 4, 4)), atol=1e-9
    )


@pytest.mark.parametrize("seed", range(3))
def test_shadows_of_a_swaying_knee_are_explained_up_to_its_size(seed: int):
    """Free poses leave the size of the scene open (no camera tells it); all else is found."""
    motion = sway(seed)
    found = bead_tracking.estimate(c_arm(), seen(motion, beads()))
    assert found.residual_px < 2e-3
    assert found.used.all()
    spans = [np.linalg.norm(p - p.mean(0), axis=-1) for p in (found.positions, beads())]
    size = spans[0] / spans[1]
    assert np.ptp(size) < 1e-3
    assert np.abs(size - 1).max() < 0.01


def test_wrong_shadows_are_rejected(rng: np.random.Generator):
    motion = sway(1)
    clean = seen(motion, beads()) + rng.normal(0, 0.02, (VIEWS, 12, 2))
    spoilt = clean.copy()
    views, which = rng.integers(0, VIEWS, 60), rng.integers(0, 12, 60)
    spoilt[views, which] += rng.choice([-1, 1], (60, 2)) * rng.uniform(2, 5, (60, 2))
    spoilt[5, 3] = np.nan
    found, reference = (bead_tracking.estimate(c_arm(), pixels) for pixels in (spoilt, clean))
    assert not found.used[views, which].any()
    assert not found.used[5, 3]
    assert found.used.mean() > 0.9
    np.testing.assert_allclose(found.positions, reference.positions, atol=0.3e-3)
    assert found.residual_px < 0.04


def test_skin_that_bends_with_the_knee_loses_no_bead():
    """Exact shadows, the lower half of the beads turned by up to 0.3 deg: nothing rigid fits, and
    no shadow is wrong.
    """
    motion, places = sway(0), beads()
    bend = np.radians(0.3) * np.sin(2 * np.pi * 0.3 * TIMES) * (TIMES > 4)
    bent = (
        transforms.apply(
            transforms.rigid(transforms.axis_rotation([0, 0, 1], bend), np.zeros(3)), places - KNEE
        )
        + KNEE
    )
    at_views = np.where((places[:, 1] < KNEE[1])[None, :, None], bent, places)
    pixels = np.stack(
        [
            c_arm().project(transforms.apply(m, p))[0][v]
            for v, (m, p) in enumerate(zip(motion.moved_from_reference, at_views, strict=True))
        ]
    )
    found = bead_tracking.estimate(c_arm(), pixels)
    assert found.used.all()
    assert 0.02 < found.residual_px < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_the_mean_reference_is_where_the_rays_of_all_views_pass_nearest(seed: int):
    """Places by a general least squares of distances to rays; then each view's pose of these."""
    pixels = seen(sway(seed, 0.5), beads())
    found = bead_tracking.estimate(c_arm(), pixels, reference="mean")
    assert found.used.all()
    sources, rays = c_arm().sources(), np.empty((VIEWS, 12, 3))
    for bead in range(12):
        homogeneous = np.concatenate([pixels[:, bead], np.ones((VIEWS, 1))], -1)
        rays[:, bead] = np.linalg.solve(c_arm().matrices[:, :, :3], homogeneous[..., None])[..., 0]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)

    def off(place: np.ndarray, bead: int) -> np.ndarray:
        return np.cross(place - sources, rays[:, bead]).ravel()

    places = np.stack([least_squares(off, KNEE, args=(k,), xtol=1e-15).x for k in range(12)])
    given = bead_tracking.poses(c_arm(), pixels, places).moved_from_reference
    relative = given @ transforms.inverse(given[0])
    np.testing.assert_allclose(found.motion.moved_from_reference, relative, atol=1e-7)
    np.testing.assert_allclose(found.positions, transforms.apply(given[0], places), atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_no_reference_explains_the_shadows_better_than_the_bundle(seed: int):
    pixels = seen(sway(seed), beads())
    mean, bundle = (
        bead_tracking.estimate(c_arm(), pixels, reference=name) for name in ("mean", "bundle")
    )
    assert bundle.residual_px < mean.residual_px < 0.5


def test_beads_at_rest_are_placed_exactly_by_their_mean():
    pixels = seen(RigidMotion.identity(TIMES), beads())
    found = bead_tracking.estimate(c_arm(), pixels, reference="mean")
    np.testing.assert_allclose(found.positions, beads(), atol=1e-9)
    assert worst(found.motion, RigidMotion.identity(TIMES)) < 1e-9


def test_wrong_shadows_are_rejected_with_the_mean_too(rng: np.random.Generator):
    pixels = seen(sway(1, 0.3), beads()) + rng.normal(0, 0.02, (VIEWS, 12, 2))
    views, which = rng.integers(0, VIEWS, 40), rng.integers(0, 12, 40)
    pixels[views, which] += rng.choice([-1, 1], (40, 2)) * rng.uniform(2, 5, (40, 2))
    found = bead_tracking.estimate(c_arm(), pixels, reference="mean")
    assert not found.used[views, which].any()
    assert found.used.mean() > 0.9


def test_an_unknown_reference_is_refused():
    with pytest.raises(LegsimError, match="the reference is 'first'; give mean or bundle"):
        bead_tracking.estimate(c_arm(), seen(sway(0), beads()), reference="first")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("reference", ["mean", "bundle"])
def test_a_bead_seen_too_seldom_is_left_out(reference: bead_tracking.Reference):
    pixels = seen(sway(0), beads())
    pixels[5:, 4] = np.nan
    found = bead_tracking.estimate(c_arm(), pixels, reference=reference)
    assert np.isnan(found.positions[4]).all()
    assert np.isfinite(np.delete(found.positions, 4, 0)).all()


def test_too_few_beads_are_refused():
    pixels = seen(sway(0), beads())
    pixels[17, 3:] = np.nan
    with pytest.raises(LegsimError, match="view 17 shows 3 beads"):
        bead_tracking.estimate(c_arm(), pixels)
    with pytest.raises(LegsimError, match="view 17 shows 3 beads"):
        bead_tracking.poses(c_arm(), pixels, beads())


def shadows(centers: np.ndarray, radius: float) -> Projections:
    """Images of spheres of contrast on a slope, in the exact shape of a chord smeared over a
    pixel.
    """
    geometry = c_arm(len(centers))
    v, u = np.mgrid[:240, :310].astype(float)
    images = np.broadcast_to(1.0 + 0.002 * u + 0.001 * v, (len(centers), 240, 310)).copy()
    for image, points in zip(images, centers, strict=True):
        for cu, cv in points:
            box = (slice(max(0, int(cv) - 8), int(cv) + 9), slice(max(0, int(cu) - 8), int(cu) + 9))
            image[box] += 3 * np.exp(
                -((u[box] - cu) ** 2 + (v[box] - cv) ** 2) / (2 * (0.6 * radius) ** 2)
            )
    return Projections(geometry, images.astype(np.float32))


def test_beads_are_followed_through_overlaps_and_from_rough_guesses(rng: np.random.Generator):
    motion = sway(2)
    # a thirteenth bead lies before another one in the tenth view, and passes it
    toward = c_arm().sources()[10] - beads()[6]
    places = np.vstack([beads(), beads()[6] + 0.05 * toward / np.linalg.norm(toward)])
    truth = seen(motion, places)[:20]
    found = bead_tracking.track(
        shadows(truth, 1.3), places + rng.normal(0, 1e-3, places.shape), radius=1e-3
    )
    has = np.isfinite(found).all(-1)
    assert np.linalg.norm(found - truth, axis=-1)[has].max() < 0.15
    assert not has[10, [6, 12]].any()
    assert has[[0, 0, -1, -1], [6, 12, 6, 12]].all()
    assert has[:, :6].all()


def test_a_bead_whose_guess_is_too_far_off_is_followed_back_from_where_it_is_met():
    """Its guess is off along the first ray's side by 7 mm, and right along that of a later view."""
    truth = seen(sway(2), beads(2))[:60]
    toward = c_arm().sources()[50] - beads(2)[0]
    off = np.array([7e-3 * toward / np.linalg.norm(toward), np.zeros(3)])
    found = bead_tracking.track(shadows(truth, 1.3), beads(2) + off, radius=1e-3)
    away = c_arm().project(beads(2) + off)[0][0, 0] - truth[0, 0]
    assert np.linalg.norm(away) > 6
    assert np.linalg.norm(found - truth, axis=-1).max() < 0.15


def test_a_bead_is_met_where_most_views_show_it_not_at_the_first_shadow_taken_for_it():
    """As above, with another shadow where the guess is seen, in a few of the views before."""
    truth = seen(sway(2), beads(2))[:60]
    toward = c_arm().sources()[50] - beads(2)[0]
    guess = beads(2) + np.array([7e-3 * toward / np.linalg.norm(toward), np.zeros(3)])
    decoy = c_arm().project(guess)[0][:60, :1] + [0.0, 1.0]
    decoy[[0, 1, 2, 3, *range(7, 60)]] = [20.0, 20.0]
    assert np.linalg.norm(decoy[:, 0] - truth[:, 0], axis=-1).min() > 3
    images = shadows(np.concatenate([truth, decoy], 1), 1.3)
    found = bead_tracking.track(images, guess, radius=1e-3)
    assert np.linalg.norm(found - truth, axis=-1).max() < 0.15


def test_a_bead_whose_guess_is_too_far_off_in_all_views_is_sought_farther():
    """Its guess is 7 mm too low, 9 pixels in every view; the other one's is right."""
    truth = seen(sway(2), beads(2))[:20]
    off = np.array([[0.0, -7e-3, 0.0], [0.0, 0.0, 0.0]])
    away = c_arm().project(beads(2) + off)[0][:20] - truth
    assert np.linalg.norm(away[:, 0], axis=-1).min() > 5
    found = bead_tracking.track(shadows(truth, 1.3), beads(2) + off, radius=1e-3)
    assert np.linalg.norm(found - truth, axis=-1).max() < 0.15


def test_no_other_shadow_is_taken_for_a_bead_that_is_not_there():
    truth = seen(sway(2), beads(2))[:20]
    truth[:, 0] = np.nan
    images = shadows(truth[:, 1:], 1.3)
    found = bead_tracking.track(images, beads(2), radius=1e-3)
    assert np.isnan(found[:, 0]).all()
    assert np.linalg.norm(found[:, 1] - truth[:, 1], axis=-1).max() < 0.15
