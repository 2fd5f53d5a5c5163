"""The shipped marker table: gait2392's places, mirrored sides, known segments."""

import numpy as np

from legsim.kinematics import marker_sites


def test_the_seven_of_the_study_are_there():
    sites = marker_sites.load()
    np.testing.assert_array_equal(sites.position("sacrum"), (-0.16, 0.04, 0))
    np.testing.assert_array_equal(sites.position("asis_l"), (0.02, 0.03, -0.128))
    np.testing.assert_array_equal(sites.position("epicondyle_lateral_r"), (0, -0.404, 0.05))
    np.testing.assert_array_equal(sites.position("malleolus_lateral_l"), (-0.005, -0.41, -0.053))


def test_left_mirrors_right():
    sites = marker_sites.load()
    for name in sites.names:
        if name.endswith("_r"):
            left = sites.index(f"{name[:-2]}_l")
            np.testing.assert_array_equal(sites.positions[left], sites.position(name) * (1, 1, -1))
            assert sites.weights[left] == sites.weights[sites.index(name)]
            assert sites.segments[left][:-2] == sites.segments[sites.index(name)][:-2]


def test_calibrated_roles_are_sites_and_never_the_landmarks_that_scale():
    calibrated = marker_sites.calibrated_roles()
    assert calibrated <= set(marker_sites.load().names)
    assert "thigh_front_l" in calibrated
    assert not calibrated & {
        "sacrum",
        "asis_r",
        "psis_l",
        "epicondyle_lateral_r",
        "malleolus_lateral_l",
    }
