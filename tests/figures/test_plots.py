"""Figures of single values are those of the report."""

import numpy as np
import pytest

from legsim import figures
from legsim.core.errors import LegsimError
from legsim.figures import plots
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from tests.examples import scene as example_scene


def test_slices_are_those_of_the_named_volumes():
    scan = example_scene.scan_scene()
    named = {one.name.replace("-", "_"): one.volume for one in scan.volumes}
    figure = plots.plot_slices(**named)
    titles = " ".join(ax.get_title() for ax in figure.axes)
    assert all(name in titles for name in named)
    with pytest.raises(LegsimError, match="needs volumes by name"):
        plots.plot_slices()


def test_angles_and_signals_are_drawn_as_in_a_report():
    replay = example_scene.replay_scene()
    person = MovingLeg("squat", LegModel.load(), replay.trajectories, fit=None)
    for drawn, expected in (
        (plots.plot_angles(person), figures.joint_angles(replay.trajectories)),
        (plots.plot_imu(replay.imu), figures.imu_curves(replay.imu)),
    ):
        assert figures.png(drawn) == figures.png(expected)
    few = plots.plot_angles(person, ["knee_angle_r", "knee_angle_l"])
    values = [np.asarray(line.get_ydata()) for ax in few.axes for line in ax.get_lines()]
    knee = np.degrees(replay.trajectories.coordinate("knee_angle_r"))
    assert len(values) == 2
    np.testing.assert_allclose(values[0], knee)
