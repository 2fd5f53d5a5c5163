import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.evaluation import image_gauge, residual_motion
from legsim.evaluation.residual_motion import Residual, Structure
from tests.correction.test_bead_tracking import KNEE, TIMES, VIEWS, c_arm, sway

POINTS = KNEE + 0.04 * np.random.default_rng(3).uniform(-1, 1, (20, 3))
TRUE = sway(0)


def bones(motion: RigidMotion = TRUE) -> tuple[Structure, ...]:
    paths = motion.carry(POINTS)
    return Structure("femur", True, paths[:, :10]), Structure("tibia", True, paths[:, 10:])


def left(motion: RigidMotion | None) -> tuple[Residual, ...]:
    return residual_motion.of_motion(motion, bones(), c_arm())


def after(residuals: tuple[Residual, ...]) -> float:
    values = [r.pixels_after_similarity for r in residuals]
    assert None not in values
    return float(np.sqrt(np.mean(np.square(np.array(values, float)))))


def sized(motion: RigidMotion, scale: float) -> RigidMotion:
    """The rigid motion by which a scene scaled about the knee looks like this one, in every view.

    Scaled about the source, a scene looks the same; that is the scale about the knee, then a shift
    along the source's path.
    """
    at_knee = motion.moved_from_reference @ transforms.translation(KNEE)
    shift = (1 - scale) * (c_arm().sources() - at_knee[:, :3, 3])
    moved = at_knee.copy()
    moved[:, :3, 3] += shift
    return RigidMotion(TIMES, moved @ transforms.translation(-KNEE))


def test_the_true_motion_after_any_constant_shift_and_turn_leaves_nothing():
    constant = transforms.rigid(
        transforms.rotation_from_vector([0.02, -0.05, 0.03]), [0.004, -0.002, 0.006]
    )
    found = left(RigidMotion(TIMES, TRUE.moved_from_reference @ constant))
    assert found[0].pixels > 1
    assert found[0].mm is not None
    assert found[0].mm > 1
    assert after(found) < 1e-5


@pytest.mark.parametrize("scale", [0.99, 0.999, 1.02])
def test_a_scene_of_another_size_leaves_nothing_though_a_thousandth_is_most_of_a_millimeter(
    scale: float,
):
    found = left(sized(TRUE, scale))
    assert [r.mm for r in found] == pytest.approx([780 * abs(1 - scale)] * 2, rel=0.03)
    assert after(found) < 1e-5


def noisy(seed: int, size: float) -> RigidMotion:
    rng = np.random.default_rng(seed)
    shifts = transforms.translation(size * rng.standard_normal((VIEWS, 3)))
    return RigidMotion(TIMES, shifts @ TRUE.moved_from_reference)


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_noise_of_each_view_is_counted_in_full(size: float):
    """Seven numbers cannot follow 120 views: they take 7 of 720 shares of a shift by view."""
    found = left(noisy(1, size))
    assert after(found) == pytest.approx(found[0].pixels, rel=0.05)


def test_a_constant_similarity_besides_changes_nothing():
    turned = transforms.rigid(transforms.rotation_from_vector([0, 0.03, 0.01]), [0.003, 0.002, 0])
    noise = noisy(2, 5e-4)
    moved = RigidMotion(TIMES, sized(noise, 1.004).moved_from_reference @ turned)
    assert after(left(moved)) == pytest.approx(after(left(noise)), rel=1e-3)


def test_it_is_never_more_than_without():
    for motion in (None, sway(1), noisy(3, 0.02)):
        found = left(motion)
        pixels = np.sqrt(np.mean(np.square([r.pixels for r in found])))
        assert after(found) <= pixels


def test_the_similarity_is_found_of_which_the_best_is_known():
    true = transforms.rigid(transforms.rotation_from_vector([0.01, 0.02, -0.01]), [0.001, 0.002, 0])
    true[:3, :3] *= 1.01

    def seen(points: FloatArray) -> FloatArray:
        return c_arm().project(points)[0]

    found = image_gauge.best_similarity(seen, POINTS, seen(transforms.apply(true, POINTS)))
    np.testing.assert_allclose(found, true, atol=1e-8)


def test_the_skin_is_read_after_the_bones_similarity():
    constant = transforms.translation([0.003, 0, 0.001])
    motion = RigidMotion(TIMES, TRUE.moved_from_reference @ constant)
    skin = Structure("skin", False, sway(1).carry(POINTS))
    found = residual_motion.of_motion(motion, (*bones(), skin), c_arm())
    truly = residual_motion.of_motion(TRUE, (*bones(), skin), c_arm())
    assert found[2].pixels_after_similarity == pytest.approx(truly[2].pixels, abs=1e-4)
    alone = residual_motion.of_motion(motion, (skin,), c_arm())
    assert alone[0].pixels_after_similarity is None


def test_deformed_images_are_read_after_a_similarity_too():
    exact = ControlPointMotion(TIMES, POINTS, TRUE.carry(POINTS))
    left_of = residual_motion.of_warp(exact, bones(), c_arm())
    assert after(left_of) < 1e-5
    still = ControlPointMotion(TIMES, POINTS, np.broadcast_to(POINTS, (VIEWS, *POINTS.shape)))
    warped = residual_motion.of_warp(still, bones(), c_arm())
    assert after(warped) == pytest.approx(after(left(None)), rel=1e-3)
