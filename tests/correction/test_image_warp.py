import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import image_warp
from legsim.deformation import models, moving_least_squares
from legsim.deformation.models import ControlPointMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.opencl.device import Device
from tests.references import mls as reference_mls
from tests.references.sway import Sway

KNEE = np.array([0.1, 0.5, -0.1])
JOINTS = KNEE + np.array([[-0.02, 0.08, 0.01], [0.0, 0.0, 0.0], [-0.03, -0.08, 0.0]])


def c_arm(views: int = 6, shape_vu: tuple[int, int] = (48, 62)) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31,
        angles=0.3 * np.arange(views),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=shape_vu,
        pixel_pitch=6e-3,
        isocenter=KNEE,
    )


def noise_images(geometry: ConeBeamGeometry) -> Projections:
    return Projections(
        geometry, np.random.default_rng(1).random((len(geometry), *geometry.shape_vu), np.float32)
    )


def motion_of(geometry: ConeBeamGeometry, seed: int = 0, size: float = 0.01) -> ControlPointMotion:
    shifts = np.random.default_rng(seed).normal(0, size, (len(geometry), 3, 3))
    return ControlPointMotion(geometry.times, JOINTS, JOINTS + shifts)


def test_no_motion_leaves_every_pixel(device: Device):
    given = noise_images(c_arm())
    still = ControlPointMotion(given.geometry.times, JOINTS, np.tile(JOINTS, (6, 1, 1)))
    np.testing.assert_array_equal(
        image_warp.warp_images(given, still, device).line_integrals, given.line_integrals
    )


def test_every_pixel_is_the_slow_references(device: Device):
    given = noise_images(c_arm())
    motion = motion_of(given.geometry)
    found = image_warp.warp_images(given, motion, device).line_integrals
    resting, moved = models.image_points(given.geometry, motion)
    for view in (0, 3, 5):
        for v in range(0, 48, 5):
            for u in range(0, 62, 5):
                at = reference_mls.displaced_in_image(
                    np.array([u, v], float), resting[view], moved[view]
                )
                assert found[view, v, u] == pytest.approx(
                    reference_mls.read_image(given.line_integrals[view], *at), abs=2e-4
                )


def test_more_control_points_follow_the_general_form(device: Device):
    """A plane wave reads off where each pixel came from."""
    geometry = c_arm(3)
    ramps = np.broadcast_to(np.arange(62, dtype=np.float32), (3, 48, 62))
    reference = KNEE + np.random.default_rng(0).uniform(-0.08, 0.08, (6, 3))
    motion = ControlPointMotion(
        geometry.times, reference, reference + np.random.default_rng(1).normal(0, 0.004, (3, 6, 3))
    )
    found = image_warp.warp_images(Projections(geometry, ramps), motion, device).line_integrals
    resting, moved = models.image_points(geometry, motion)
    u, v = np.meshgrid(np.arange(8, 54), np.arange(5, 43))
    pixels = np.stack([u.ravel(), v.ravel()], -1).astype(float)
    for view in range(3):
        expected = moving_least_squares.warp_points(pixels, resting[view], moved[view])[
            :, 0
        ].reshape(u.shape)
        np.testing.assert_allclose(found[view, 5:43, 8:54], expected, atol=2e-4)


def test_a_control_point_is_brought_back_where_it_was(device: Device):
    """A bright spot at each moved joint comes to lie where the joint was at rest."""
    geometry = c_arm(6, (240, 310))
    motion = motion_of(geometry, 3, 0.003)
    resting, moved = models.image_points(geometry, motion)
    scale = np.array([[155.0, 120.0]])
    assert (np.abs(resting - scale) < 110).all()
    v, u = np.mgrid[:240, :310]
    spots = np.zeros((6, 240, 310), np.float32)
    for view in range(6):
        for at in moved[view]:
            spots[view] += np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 8)
    found = image_warp.warp_images(Projections(geometry, spots), motion, device).line_integrals
    for view in range(6):
        for at in resting[view]:
            near = np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 50) * found[view]
            center = np.array([(near * u).sum(), (near * v).sum()]) / near.sum()
            np.testing.assert_allclose(center, at, atol=0.15)


def test_shift_of_the_detector_plane_shifts_the_image(device: Device):
    """A source far away and a move across the rays: the whole image moves by whole pixels, borders
    repeat.
    """
    geometry = ConeBeamGeometry.circular(
        times=[0.0],
        angles=[0.0],
        source_isocenter=1e5,
        source_detector=1e5,
        shape_vu=(48, 62),
        pixel_pitch=1e-3,
        isocenter=[0, 0, 0],
    )
    given = noise_images(geometry)
    reference = np.array([[0, 0.01, 0], [0.004, 0, 0], [0, -0.01, 0]])
    motion = ControlPointMotion([0.0], reference, (reference + np.array([3e-3, -2e-3, 0]))[None])
    found = image_warp.warp_images(given, motion, device).line_integrals[0]
    np.testing.assert_allclose(found[2:, :-3], given.line_integrals[0, :-2, 3:], atol=1e-3)
    np.testing.assert_allclose(
        found[:2, :-3], np.tile(given.line_integrals[0, :1, 3:], (2, 1)), atol=1e-3
    )


def test_rigid_motion_in_the_image_plane_is_undone(device: Device):
    """Joints in one plane across the rays, turned about the principal ray: what the image shows is
    turned back.
    """
    geometry = c_arm(1)
    turn = transforms.axis_rotation([0, 0, 1], 0.2)
    reference = KNEE + np.array([[0.02, 0.08, 0], [0, 0, 0], [0.03, -0.08, 0]])
    motion = ControlPointMotion(
        geometry.times, reference, (KNEE + (reference - KNEE) @ turn.T)[None]
    )
    resting, moved = models.image_points(geometry, motion)
    pixels = np.random.default_rng(0).uniform(0, 48, (30, 2))
    middle = np.array([30.5, 23.5])
    np.testing.assert_allclose(
        moving_least_squares.warp_points(pixels, resting[0], moved[0]),
        middle + (pixels - middle) @ turn[:2, :2].T,
        atol=1e-9,
    )


def test_sway_moves_little_and_values_stay_in_range(device: Device):
    given = noise_images(c_arm())
    poses = Sway.standing(1).poses(given.geometry.times)
    moved = transforms.apply(poses @ transforms.inverse(poses[0]), JOINTS)
    seen = []
    found = image_warp.warp_images(
        given,
        ControlPointMotion(given.geometry.times, JOINTS, moved),
        device,
        progress=lambda done, total: seen.append((done, total)),
    )
    np.testing.assert_array_equal(found.line_integrals[0], given.line_integrals[0])
    assert np.isfinite(found.line_integrals).all()
    assert (
        np.abs(found.line_integrals).max() < 1.6
    )  # cubic convolution overshoots by a quarter at most in each direction
    assert seen == [(6, 6)]


def test_refusals(device: Device):
    given = noise_images(c_arm())
    with pytest.raises(LegsimError, match="5 times for 6 views"):
        image_warp.warp_images(given, motion_of(c_arm(5)), device)
    far = ControlPointMotion(
        given.geometry.times, JOINTS + np.array([0, 0, 5.0]), np.tile(JOINTS, (6, 1, 1))
    )
    with pytest.raises(LegsimError, match="behind the source in view 0"):
        image_warp.warp_images(given, far, device)
