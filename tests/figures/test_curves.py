"""Curves over time show what they are named after."""

import numpy as np
import pytest

from legsim import figures
from legsim.core import transforms
from legsim.deformation.models import RigidMotion
from legsim.imu.comparison import compare
from tests.examples import scene as example_scene
from tests.examples.sensors import swaying


@pytest.fixture(scope="module")
def scan():
    return example_scene.scan_scene()


@pytest.fixture(scope="module")
def replay(scan):
    return scan.replay


def test_motion_errors_are_distances_of_the_point(replay):
    times = replay.poses.times
    truth = RigidMotion.identity(times)
    turned = transforms.rigid(transforms.axis_rotation([0, 1, 0], np.deg2rad(2)), [0.0, 0.003, 0.0])
    estimate = RigidMotion(times, np.broadcast_to(turned, (len(times), 4, 4)))
    figure = figures.motion_errors(truth, [("turned", estimate)], np.zeros(3))
    distance, angle = (np.asarray(ax.lines[0].get_ydata()) for ax in figure.axes)
    np.testing.assert_allclose(distance, 3.0)
    np.testing.assert_allclose(angle, 2.0)


def test_angles_are_in_degrees_under_opensims_names(replay):
    figure = figures.joint_angles(replay.trajectories, ["knee_angle_r", "knee_angle_l"])
    line = figure.axes[0].lines[0]
    assert line.get_label() == "knee_angle_r"
    np.testing.assert_allclose(
        np.asarray(line.get_ydata()), np.rad2deg(replay.trajectories.coordinate("knee_angle_r"))
    )


def test_a_path_of_motion_is_in_mm_from_the_first_view():
    times = np.arange(3.0)
    moved = transforms.translation([[0, 0, 0], [1e-3, 0, 0], [0, 2e-3, 0]])
    figure = figures.motion_paths([("own", RigidMotion(times, moved))], np.array([0.1, 0.2, 0.3]))
    drawn = [np.asarray(ax.lines[0].get_ydata()) for ax in figure.axes[:3]]
    np.testing.assert_allclose(drawn, [[0, 1, 0], [0, 0, 2], [0, 0, 0]], atol=1e-12)


def test_measured_and_predicted_rates_lie_in_one_plot():
    compared = compare(swaying(), swaying().named("own"))
    figure = figures.imu_comparison([compared])
    lines = figure.axes[0].lines
    assert [str(line.get_label()) for line in lines] == ["measured", "predicted from the markers"]
    np.testing.assert_allclose(
        np.asarray(lines[0].get_ydata()), np.asarray(lines[1].get_ydata()), atol=1e-4
    )
