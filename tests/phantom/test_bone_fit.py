"""Bones of the model's shape are found where they are; bones of another shape are not taken for it."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.phantom import _bone_fit, leg_phantom
from legsim.phantom.landmarks import BoneSurface

LEGS = leg_phantom.load_leg_phantom()
KNEE = LEGS._reference("tibia_r")[:3, 3]
FLEXION = 0.3


def model() -> dict[str, BoneSurface]:
    found = {}
    for name in ("femur", "tibia"):
        part = LEGS.phantom.parts[LEGS.part_index(f"{name}_cortex_r")]
        found[name] = BoneSurface(part.vertices, part.triangles)
    return found


def moved(flexion: float) -> dict[str, np.ndarray]:
    turn = transforms.rigid(transforms.axis_rotation((0, 0, 1), -flexion), (0, 0, 0))
    about = transforms.translation(KNEE) @ turn @ transforms.translation(-KNEE)
    return {"femur": np.eye(4), "tibia": about}


PLACED = transforms.rigid(
    transforms.rotation_from_vector(np.array([0.1, -0.2, 0.05])), (0.2, 0.1, 0)
)
GUESS = PLACED @ transforms.rigid(
    transforms.rotation_from_vector(np.array([0.02, 0.03, -0.02])), (0.003, -0.004, 0.002)
)


def imaged(shape=lambda points: points) -> dict[str, BoneSurface]:
    """The model's bones with a bent knee, elsewhere, on other triangles than the model's."""
    found = {}
    for name, bone in model().items():
        points = transforms.apply(PLACED @ moved(FLEXION)[name], shape(bone.vertices))
        found[name] = BoneSurface(points, bone.triangles).divided()
    return found


def fitted(bones: dict[str, BoneSurface]) -> _bone_fit.BoneFit:
    return _bone_fit.fit(bones, model(), moved, GUESS, FLEXION - 0.05)


def farthest(found: _bone_fit.BoneFit) -> float:
    """m by which a vertex of the model is off."""
    return max(
        np.linalg.norm(
            transforms.apply(found.placed @ moved(found.flexion)[name], bone.vertices)
            - transforms.apply(PLACED @ moved(FLEXION)[name], bone.vertices),
            axis=1,
        ).max()
        for name, bone in model().items()
    )


def test_the_models_own_bones_are_found_exactly():
    found = fitted(imaged())
    assert found.same_shape
    assert farthest(found) < 1e-5
    assert found.flexion == pytest.approx(FLEXION, abs=1e-5)


def test_cut_and_noisy_bones_are_found_to_a_fraction_of_their_noise(rng):
    bones = {}
    for name, bone in imaged().items():
        near = np.abs(bone.corners().mean(1)[:, 1] - transforms.apply(PLACED, KNEE[None])[0, 1])
        noisy = bone.vertices + rng.normal(0, 0.0001, bone.vertices.shape)
        bones[name] = BoneSurface(noisy, bone.triangles[near < 0.12])
    found = fitted(bones)
    assert found.same_shape
    # thousands of samples; the axis of the short shaft is the weakest direction, 40 cm away at most
    assert farthest(found) < 0.0001


@pytest.mark.parametrize(
    "shape",
    [
        lambda points: KNEE + (points - KNEE) * 1.04,
        lambda points: KNEE + (points - KNEE) * [1.15, 1, 1.0],
        lambda points: points + 0.004 * np.sin(points[:, ::-1] / 0.012),
    ],
    ids=["larger", "deeper", "knobbly"],
)
def test_bones_of_another_shape_are_left_to_the_landmarks(shape):
    assert not fitted(imaged(shape)).same_shape


def test_bones_far_from_the_guess_are_left_to_the_landmarks():
    away = {
        name: BoneSurface(bone.vertices + 0.5, bone.triangles) for name, bone in imaged().items()
    }
    found = fitted(away)
    assert not found.same_shape
    np.testing.assert_array_equal(found.placed, GUESS)
