"""Femur, tibia and patella are told apart in a volume by where the joints are."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.bone_regions import (
    FEMUR,
    PATELLA,
    TIBIA,
    BoneRegions,
    axis_distances,
    find_bones,
)
from legsim.geometry.volume import Volume, VolumeGrid
from tests.examples import knee


def overlap(found: np.ndarray, true: np.ndarray) -> list[float]:
    """Dice of each bone: twice the common volume over the sum of both."""
    return [
        2 * ((found == k) & (true == k)).sum() / ((found == k).sum() + (true == k).sum())
        for k in (FEMUR, TIBIA, PATELLA)
    ]


def test_the_bones_of_a_knee_are_found_and_parted(rng):
    found = find_bones(knee.volume(rng), knee.JOINTS)
    assert min(overlap(found.labels, knee.truth())) > 0.9
    middle = found.middle(PATELLA)
    assert middle is not None
    np.testing.assert_allclose(middle, knee.PATELLA, atol=1e-3)


def test_bones_that_touch_in_the_image_are_parted_in_the_gap(rng):
    """Cartilage as dense as the least of bone joins all three; few voxels change sides."""
    joined = knee.volume(rng, gap=26.0)
    found = find_bones(joined, knee.JOINTS).labels
    true = knee.truth()
    wrong = ((found == FEMUR) & (true == TIBIA)) | ((found == TIBIA) & (true == FEMUR))
    assert wrong.sum() < 0.002 * (true > 0).sum()
    assert min(overlap(found, true)) > 0.8


def test_an_expected_patella_is_a_ball_that_takes_no_bone_from_behind_its_back():
    """x is forward: the plane of its back cuts the femur, and the femur behind it stays whole."""
    true = BoneRegions(knee.GRID, knee.truth().astype(np.uint8))
    at, radius = np.array([0.022, 0.005, 0.0]), 0.015
    found = true.with_patella(transforms.translation(at), radius)
    arms = knee.GRID.positions().reshape(*found.labels.shape, 3) - at
    behind, away = arms[..., 0] < -0.5 * radius, np.linalg.norm(arms, axis=-1)
    femur, patella = true.labels == FEMUR, found.labels == PATELLA
    assert (femur & behind & (away < radius)).any()
    assert not (patella & femur & behind).any()
    assert patella[(away < radius) & ~behind].all()
    assert patella[(away < radius) & (true.labels == 0)].all()
    assert not patella[away >= 2 * radius].any()
    middle = found.middle(PATELLA)
    assert middle is not None
    np.testing.assert_allclose(middle[1:], at[1:], atol=0.25 * radius)


def test_bone_is_bone_in_any_unit(rng):
    """Only ratios of attenuations count: another spectrum, or a file in other units."""
    one = knee.volume(rng)
    other = Volume(one.grid, 1e-3 * one.attenuation)
    np.testing.assert_array_equal(
        find_bones(one, knee.JOINTS).labels, find_bones(other, knee.JOINTS).labels
    )


def test_the_leg_may_stand_anywhere(rng):
    one = knee.volume(rng)
    shift = np.array([0.3, 0.5, -0.2])
    x, y, z = (np.array(one.grid.center) + shift).tolist()
    moved = Volume(VolumeGrid(one.grid.shape_zyx, one.grid.spacing_xyz, (x, y, z)), one.attenuation)
    found = find_bones(moved, knee.JOINTS + shift)
    np.testing.assert_array_equal(found.labels, find_bones(one, knee.JOINTS).labels)
    np.testing.assert_allclose(found.points(FEMUR).mean(0)[1], shift[1] + 0.03, atol=0.02)


def test_a_knee_without_a_patella_has_two_bones(rng):
    seen = knee.volume(rng)
    attenuation = seen.attenuation.copy()
    attenuation[knee.truth() == PATELLA] = knee.SOFT
    found = find_bones(Volume(seen.grid, attenuation), knee.JOINTS)
    assert found.middle(PATELLA) is None
    assert found.volume(PATELLA) == 0
    assert found.volume(FEMUR) > 50e-6


def test_specks_of_noise_are_no_bone(rng):
    seen = knee.volume(rng)
    attenuation = seen.attenuation.copy()
    specks = rng.random(attenuation.shape) < 0.002
    specks &= (
        axis_distances(seen.grid.positions(), knee.JOINTS).min(-1).reshape(specks.shape) > 0.04
    )
    attenuation[specks & (knee.truth() == 0)] = 60
    labels = find_bones(Volume(seen.grid, attenuation), knee.JOINTS).labels
    alone = specks & (knee.truth() == 0)
    assert (labels[alone] == 0).mean() > 0.9


@pytest.mark.parametrize(
    ("attenuation", "message"),
    [
        (np.zeros(knee.GRID.shape_zyx), "nothing but air"),
        (np.full(knee.GRID.shape_zyx, knee.SOFT), "no bone is seen"),
        (np.where(knee.truth() == FEMUR, 45.0, 20.0), "not seen as two bones"),
    ],
)
def test_what_shows_no_knee_is_refused(attenuation, message):
    seen = Volume(knee.GRID, attenuation)
    with pytest.raises(LegsimError, match=message):
        find_bones(seen, knee.JOINTS)


def test_a_volume_beside_the_leg_shows_nothing():
    far = transforms.apply(transforms.translation([3.0, 0, 0]), knee.JOINTS)
    with pytest.raises(LegsimError, match="nothing but air"):
        find_bones(Volume(knee.GRID, np.full(knee.GRID.shape_zyx, 20.0)), far)


def test_distances_are_from_the_segments_of_the_axes():
    points = np.array([[0.03, 0.2, 0.04], [0.0, 0.5, 0.0], *knee.JOINTS])
    to_thigh, to_shank = axis_distances(points, knee.JOINTS).T
    np.testing.assert_allclose(to_thigh[:2], [0.05, 0.1], atol=1e-12)
    np.testing.assert_allclose([to_thigh[3], to_shank[3], to_shank[4]], 0, atol=1e-12)
