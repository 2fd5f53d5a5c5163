"""A study becomes runs: every shipped study plans, and what is missing is reported first."""

from pathlib import Path

import pytest

from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.study import config
from legsim.study import plan as study_plan

PLAIN = """
name = "mine"
title = "Mine"
preset = "demo"
subjects = ["subject01"]
postures = ["squat_30"]
methods = ["uncorrected", "rigid"]
"""


def load(tmp_path, text, **options):
    path = tmp_path / "STUDY.toml"
    path.write_text(text)
    return config.load(str(path), **options)


@pytest.mark.parametrize("name", config.shipped())
def test_every_shipped_study_plans(tmp_path, name):
    asked, base = config.load(name)
    planned = study_plan.plan(asked, base, tmp_path)
    assert planned.scans or planned.ladders
    assert asked.name == name


def test_a_recording_that_is_not_there_is_told_before_anything_runs(tmp_path):
    asked, base = load(tmp_path, PLAIN.replace("squat_30", "squat_45"))
    with pytest.raises(LegsimError, match="squat_45"):
        study_plan.plan(asked, base, tmp_path)


def test_the_example_plans_with_a_users_own_method_found_beside_it(tmp_path):
    example = Path(__file__).parents[2] / "docs/examples/own_study.toml"
    asked, base = config.load(str(example))
    clean, noisy = study_plan.plan(asked, base, tmp_path).scans
    own = f"{example.parent / 'own_method.py'}:without_drift"
    assert own in clean.settings.methods.run
    assert noisy.settings.methods.run == ("static", "rigid", own)
    assert noisy.settings.imu.noise.kind == "paper"


LADDER = '[ladder]\nsensors = ["bmi160", "own.toml"]\n'


def test_sensors_of_the_ladder_are_jobs_and_files_are_found_beside_the_study(tmp_path):
    shipped = resources.model_file("sensors/bmi160.toml")
    (tmp_path / "own.toml").write_bytes(shipped.read_bytes())
    asked, base = load(tmp_path, PLAIN + LADDER)
    planned = study_plan.plan(asked, base, tmp_path)
    assert [job.sensor for job in planned.sensors] == ["bmi160", str(tmp_path / "own.toml")]
    assert {job.name for job in planned.sensors} <= {task.name for task in planned.tasks()}


def test_an_unknown_sensor_is_refused_before_anything_runs(tmp_path):
    asked, base = load(tmp_path, PLAIN + LADDER.replace("own.toml", "bmi161"))
    with pytest.raises(LegsimError, match="unknown sensor 'bmi161'"):
        study_plan.plan(asked, base, tmp_path)
