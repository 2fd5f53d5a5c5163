"""Where the patella sits on the femur: the published table, any size, either side."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.kinematics import patella
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.skeleton import segment_index


def bent(degrees) -> np.ndarray:
    """femur_from_tibia (n, 3, 3) of knees bent by so much: turned by -flexion about z."""
    return transforms.axis_rotation((0, 0, 1), -np.radians(np.atleast_1d(degrees)))


@pytest.mark.parametrize("side", ["l", "r"])
def test_it_is_where_the_leg_model_has_it(side):
    """The model's knee slides as well; the relation is of the angle alone."""
    leg, angles = LegModel.load(), np.array([0.0, 10, 33, 60, 100])
    values = np.tile(leg.default_coordinates, (5, 1))
    values[:, leg.coordinate_names.index(f"knee_angle_{side}")] = -np.radians(angles)
    poses = leg.kinematics(values)
    f, p = (segment_index(f"{bone}_{side}") for bone in ("femur", "patella"))
    femur, own = (transforms.rigid(poses.rotations[:, k], poses.origins[:, k]) for k in (f, p))
    np.testing.assert_allclose(
        patella.in_femur(bent(angles), np.ones(3), side),
        transforms.inverse(femur) @ own,
        atol=1e-9,
    )


def test_its_turn_is_that_of_the_published_table():
    """At 60 degrees of flexion, Rajagopal et al. 2016 turn it by 0.747 rad."""
    (at_60,) = patella.in_femur(bent(60.0), np.ones(3), "r")
    vector = transforms.vector_from_rotation(at_60[:3, :3])
    np.testing.assert_allclose(vector, [0, 0, -0.747244], atol=1e-5)


def test_it_scales_with_the_femur():
    one, two = (patella.in_femur(bent(40.0), np.full(3, s), "l") for s in (1.0, 2.0))
    np.testing.assert_allclose(two[:, :3, 3], 2 * one[:, :3, 3], atol=1e-12)
    np.testing.assert_array_equal(two[:, :3, :3], one[:, :3, :3])


def test_the_knees_center_is_the_origin_of_the_tibia():
    """2 mm behind the straight leg's line at 3 degrees, and 14 mm lower at 75."""
    straight, deep = (patella.knee_in_femur(np.radians(d)) for d in (3.0, 75.0))
    np.testing.assert_allclose(straight, [-0.0042, -0.396, 0], atol=1e-4)
    np.testing.assert_allclose(deep - straight, [0.0085, -0.0136, 0], atol=1e-4)
