"""Two legs behind one interface: legsim's own, moved by MuJoCo, and the same written as an OpenSim
model and read back, moved by numpy.
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.kinematics import osim_export, osim_file
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import SEGMENTS
from tests.examples import osim

PATELLAE = [k for k, name in enumerate(SEGMENTS) if name.startswith("patella")]


@pytest.fixture(scope="module")
def own() -> LegModel:
    return LegModel.load()


@pytest.fixture
def read(tmp_path, own) -> OsimLeg:
    return OsimLeg(
        osim_file.read(osim.saved(tmp_path, osim_export.text(own, None, name="generic")))
    )


def random_values(leg: Leg, rng: np.random.Generator, n: int = 20) -> np.ndarray:
    low, high = leg.coordinate_ranges.T
    return low + (high - low) * rng.random((n, len(low)))


def test_both_have_all_of_it(own, read):
    members = [name for name in dir(Leg) if not name.startswith("_")]
    assert len(members) > 15
    for leg in (own, read):
        assert all(hasattr(leg, name) for name in members)
    for name in ("coordinate_names", "shifts", "pelvis_coordinates", "heading"):
        assert getattr(own, name) == getattr(read, name)
    np.testing.assert_array_equal(own.moves, read.moves)
    np.testing.assert_allclose(read.scales.factors, 1.0, atol=1e-12)


def test_screws_and_poses_are_the_same_patellae_among_them(own, read, rng):
    values = random_values(own, rng)
    for ours, theirs in zip(own.kinematics(values), read.kinematics(values), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_sensors_feel_the_same(own, read, rng):
    values, rates, bends = (random_values(own, rng) for _ in range(3))
    place = transforms.rigid(transforms.rotation_from_vector((0.3, 0.2, 0.1)), (0.1, -0.2, 0.05))
    for segment in ("pelvis", "femur_l", "tibia_r", "toes_l"):
        ours, theirs = (
            leg.attached_motion(values, rates, bends, segment=segment, segment_from_sensor=place)
            for leg in (own, read)
        )
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-7)


def test_postures_and_pelvis_coordinates_are_the_same(own, read, rng):
    values = random_values(own, rng)
    values[:, 1] = np.clip(values[:, 1], -1.2, 1.2)
    pose = own.kinematics(values)
    world = transforms.rigid(pose.rotations[:, 0], pose.origins[:, 0])
    np.testing.assert_allclose(own.pelvis_values(world), values[:, :6], atol=1e-9)
    np.testing.assert_allclose(read.pelvis_values(world), values[:, :6], atol=1e-9)
    bent = [leg.posture(0.8, -1.0, 0.3) for leg in (own, read)]
    # by the turn of the joint's axis: that of the ankle is oblique
    np.testing.assert_allclose(bent[0][6:], bent[1][6:], atol=0.01)
