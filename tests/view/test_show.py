"""What is shown where: files, notebooks, windows, and what is refused."""

import sys
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap.trajectories import JointTrajectories
from legsim.view import show as view_show


@pytest.fixture(scope="module")
def person() -> MovingLeg:
    times = np.arange(60) / 60
    still = JointTrajectories(times, COORDINATES, np.zeros((60, len(COORDINATES))))
    return MovingLeg("rest", LegModel.load(), still, fit=None)


def test_a_path_gets_the_recording_and_nothing_opens(person, tmp_path, monkeypatch):
    monkeypatch.setattr(view_show.subprocess, "Popen", lambda *_: pytest.fail("a window opened"))
    assert view_show.show(person, path=tmp_path / "person.rrd") is None
    assert (tmp_path / "person.rrd").read_bytes()[:4] == b"RRF2"


def test_a_window_opens_the_recording_that_was_written(person, monkeypatch):
    opened = []
    monkeypatch.setattr(view_show.subprocess, "Popen", opened.append)
    view_show.show(person)
    assert Path(opened[0][-1]).is_file()
    assert opened[0][:3] == [sys.executable, "-m", "rerun"]


def test_a_notebook_shows_it_in_the_cell(person, monkeypatch):
    monkeypatch.setattr(view_show, "_in_notebook", lambda: True)
    monkeypatch.setattr(view_show, "_notebook_viewer", lambda scene: ("viewer", scene.name))
    assert view_show.show(person) == ("viewer", "rest")


def test_a_notebook_without_the_extra_is_refused_with_what_to_install(person, monkeypatch):
    monkeypatch.setattr(view_show, "_in_notebook", lambda: True)
    monkeypatch.setitem(sys.modules, "rerun.notebook", None)
    with pytest.raises(LegsimError, match=r"pip install 'legsim\[notebook\]'"):
        view_show.show(person)


def test_python_outside_a_notebook_is_none():
    assert not view_show._in_notebook()


def test_volumes_of_somebody_who_was_not_scanned_are_refused(person):
    grid = VolumeGrid.cubic(8, 0.01, (0, 0, 0))
    volume = Volume(grid, np.zeros(grid.shape_zyx, np.float32))
    with pytest.raises(LegsimError, match="the scan that they come from"):
        view_show.show(person, volume)
    with pytest.raises(LegsimError, match="not Volume"):
        view_show.show(volume)  # type: ignore[arg-type]


def test_volumes_without_a_name_are_numbered():
    grid = VolumeGrid.cubic(8, 0.01, (0, 0, 0))
    volume = Volume(grid, np.zeros(grid.shape_zyx, np.float32))
    named = view_show._named((volume, volume), {"rigid": volume})
    assert [n.name for n in named] == ["volume", "volume 2", "rigid"]
