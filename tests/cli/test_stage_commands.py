"""`legsim convert`, `project`, `reconstruct` and `evaluate` hand their options on and print the
result.
"""

import numpy as np
import pytest

from legsim.cli import main as cli_main
from legsim.geometry import image_files
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """What a command prints that succeeds."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(argument) for argument in arguments])
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_convert_prints_a_path_with_brackets_whole(tmp_path, capsys):
    times = np.arange(3.0)
    first, second = tmp_path / "a.mot", tmp_path / "trial [2].sto"
    opensim.save(first, JointTrajectories(times, ("knee_angle_r",), np.zeros((3, 1))))
    assert "trial [2].sto" in printed(capsys, "convert", first, "--out", second, "--degrees")
    assert "inDegrees=yes" in second.read_text()


def test_evaluate_prints_a_row_for_each_region(tmp_path, capsys):
    grid = VolumeGrid.cubic(12, 0.002, (0.0, 0.0, 0.0))
    values = np.random.default_rng(0).random(grid.shape_zyx, np.float32)
    image_files.save_volume(tmp_path / "v.mha", Volume(grid, values))
    files = (tmp_path / "v.mha", tmp_path / "v.mha")
    shown = printed(capsys, "evaluate", *files, "--no-register", "--out", tmp_path / "m.json")
    assert "cylinder" in shown
    assert "1.0000" in shown
    assert (tmp_path / "m.json").is_file()
