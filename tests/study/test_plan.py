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
    assert planned.scans or planned.ladders or planned.aided
    assert asked.name == name


def test_a_recording_that_is_not_there_is_reported_before_anything_runs(tmp_path):
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


def test_runs_of_sensors_have_their_own_noise_and_wait_for_the_first_of_their_scan(tmp_path):
    text = PLAIN.replace('methods = ["uncorrected", "rigid"]', "") + (
        '[aiding]\nsensors = ["bmi160"]\nvolume_sensors = ["none", "bmi160"]\n'
        'volume_methods = ["rigid"]\nvolume_repetitions = 2\n'
    )
    planned = study_plan.plan(*load(tmp_path, text), tmp_path)
    stem = "subject01-squat_30"
    names = [f"{stem}-none-0", f"{stem}-none-1", f"{stem}-bmi160-0", f"{stem}-bmi160-1"]
    assert [job.name for job in planned.scans] == names
    assert [job.settings.imu.noise.kind for job in planned.scans] == ["none"] * 2 + ["bmi160"] * 2
    assert planned.scans[0].settings.methods.run == ("static", "rigid")
    assert len({job.settings.seed for job in planned.scans}) == 2
    waits = {task.name: task.needs for task in planned.tasks()}
    assert waits == {
        f"aided-{stem}-bmi160": (),
        names[0]: (),
        **dict.fromkeys(names[1:], (names[0],)),
    }


def test_a_wrong_sensor_or_method_is_reported_before_anything_runs(tmp_path):
    for wrong, said in (
        ('sensors = ["bmi161"]', "unknown sensor 'bmi161'"),
        ('volume_sensors = ["none"]\nvolume_methods = ["rigidd"]', "unknown correction method"),
    ):
        asked, base = load(tmp_path, f"{PLAIN}[aiding]\n{wrong}\n")
        with pytest.raises(LegsimError, match=said):
            study_plan.plan(asked, base, tmp_path)


def test_drawn_sensors_and_starts_are_those_of_each_scan_alone(tmp_path):
    """Clean runs keep the seed of the settings, by which marker-based places its beads."""
    two = PLAIN.replace('["subject01"]', '["subject01", "subject02"]')
    drawn = (
        '[settings.imu.noise]\nkind = "bmi160"\n',
        '[settings.methods]\nstart = "rough"\n',
        "[settings.imu]\nlost_share = 0.1\n",
        "[settings.imu.vibration]\nacceleration_mg = 5\n",
    )
    for more, count in (("", 1), *((text, 2) for text in drawn)):
        scans = study_plan.plan(*load(tmp_path, two + more), tmp_path).scans
        assert len({job.settings.seed for job in scans}) == count
        again = study_plan.plan(*load(tmp_path, PLAIN + more), tmp_path).scans
        assert again[0].settings == scans[0].settings
        other = study_plan.plan(*load(tmp_path, f"{PLAIN}{more}[settings]\nseed = 1\n"), tmp_path)
        assert other.scans[0].settings.seed == scans[0].settings.seed + 1


def test_an_aided_sensor_that_nobody_wears_is_refused(tmp_path):
    text = f'{PLAIN}[aiding]\naids = ["standing"]\n[settings.methods]\nsensor = "typo"\n'
    with pytest.raises(LegsimError, match=r"methods\.sensor: unknown sensor 'typo'"):
        study_plan.plan(*load(tmp_path, text.replace('"rigid"', '"oracle"')), tmp_path)


def test_noisy_runs_take_no_settings_of_another_noise(tmp_path):
    text = f"""{PLAIN}[settings.imu.noise]
kind = "rms"
acceleration_mg = 5
acceleration_bias_mg = 2
[[noise]]
convention = "SI"
levels = [[1, 1]]
"""
    clean, noisy = (
        job.settings.imu.noise for job in study_plan.plan(*load(tmp_path, text), tmp_path).scans
    )
    assert (clean.kind, clean.acceleration_mg) == ("rms", 5)
    assert (noisy.kind, noisy.acceleration_mg, noisy.acceleration_bias_mg) == ("paper", 1.8, 2)
