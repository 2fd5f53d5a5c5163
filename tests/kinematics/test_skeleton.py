"""Values about one person's legs refuse what cannot be, and scale as they say."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, JointCenters, SegmentScales, segment_index

SITES = MarkerSites(
    ("a", "b"), ("femur_r", "pelvis"), [[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]], [1.0, 2.0]
)


def test_sites_scale_with_their_segment():
    factors = np.ones((len(SEGMENTS), 3))
    factors[segment_index("femur_r")] = 2, 3, 4
    scaled = SITES.scaled(SegmentScales(factors))
    np.testing.assert_allclose(scaled.position("a"), (0.2, 0.6, 1.2))
    np.testing.assert_allclose(scaled.position("b"), (1, 2, 3))


def test_sites_can_be_picked_in_any_order():
    picked = SITES.only(["b", "a"])
    assert picked.names == ("b", "a")
    assert picked.segments == ("pelvis", "femur_r")
    np.testing.assert_array_equal(picked.weights, (2, 1))


def test_joint_centers_are_found_by_name():
    positions = np.arange(36.0).reshape(2, 6, 3)
    np.testing.assert_array_equal(JointCenters([0, 1], positions).of("knee_l"), positions[:, 1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SegmentScales.uniform(0.0), "scale factors must be positive"),
        (lambda: SegmentScales.uniform(1.0, mass=-3.0), "body mass must be positive"),
        (
            lambda: MarkerSites(("a", "a"), ("pelvis", "pelvis"), np.zeros((2, 3)), np.ones(2)),
            "names of marker sites must differ",
        ),
        (
            lambda: MarkerSites(("a",), ("thigh",), np.zeros((1, 3)), np.ones(1)),
            "no segment named 'thigh'; there are: pelvis, femur_r",
        ),
        (
            lambda: MarkerSites(("a",), ("pelvis",), np.zeros((1, 3)), -np.ones(1)),
            "weights must not be negative",
        ),
        (lambda: MarkerSites(("a",), (), np.zeros((1, 3)), np.ones(1)), "need as many segments"),
        (lambda: SITES.index("c"), "no marker site named 'c'; there are: a, b"),
        (
            lambda: JointCenters([0.0], np.zeros((1, 6, 3))).of("hip"),
            "no joint center named 'hip'; there are: hip_l",
        ),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()
