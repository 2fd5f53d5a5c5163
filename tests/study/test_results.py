"""Results of a study on disk: what is saved is what is loaded."""

import json
from dataclasses import replace

import pytest

from legsim.core.errors import LegsimError
from legsim.evaluation.registration import Registration, RegistrationError
from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.similarity import RegionScores, Scores
from legsim.study import results as study_results
from legsim.study.results import LadderScore, NoiseLevel, ScanScore, SensorScore, StudyResults

REGISTRATION = Registration(0.5, 0.1, True, 0.9, 0.95, "converged")


def results() -> StudyResults:
    metrics = Scores((RegionScores("leg", 0.9, 0.02, 9.5, 1000),), REGISTRATION)
    noise = NoiseLevel("per-sample", 5.0, None)
    score = ScanScore(
        "subject01",
        "squat_30",
        "rigid",
        noise,
        2,
        metrics,
        (Residual("skin", None, None, 0.1),),
        1.5,
        "runs/x",
    )
    ladder = (LadderScore("subject01", "squat_30", noise, 0, 1.0, 0.1),)
    errors = (RegistrationError(0.02, 0.01),)
    return StudyResults(
        "s",
        "A study",
        (score,),
        ladder,
        (("device", "cpu"),),
        ("lost",),
        registration_errors=errors,
        sensors=(SensorScore("subject01", "squat_30", "bmi160", "rest", 1, 2.5, 0.3),),
    )


def test_saved_results_load_equal(tmp_path):
    study_results.save(tmp_path / "results.json", results())
    assert study_results.load(tmp_path / "results.json") == results()


def test_clean_scores_load_without_noise(tmp_path):
    clean = ScanScore("a", "b", "c", None, 0, Scores((), None), (), 0.0, "d")
    study_results.save(tmp_path / "r.json", StudyResults("s", "t", (clean,), (), ()))
    assert study_results.load(tmp_path / "r.json").scores == (clean,)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"name": "a"}'])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(LegsimError, match="is not a study's results"):
        study_results.load(path)


@pytest.mark.parametrize("number", ["1e400", "Infinity", "-Infinity"])
def test_infinite_numbers_are_refused(tmp_path, number):
    path = tmp_path / "results.json"
    costs = (study_results.StageCost("projecting", 3, 12.5, 300.0),)
    study_results.save(path, replace(results(), costs=costs))
    path.write_text(path.read_text().replace("12.5", number))
    with pytest.raises(LegsimError, match="is infinite"):
        study_results.load(path)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(LegsimError, match="no such file"):
        study_results.load(tmp_path / "results.json")


def test_labels_say_the_convention():
    assert NoiseLevel("SI", 4.0, None).label == "f_a = 4, f_g = no noise (SI)"
    assert NoiseLevel("SI", 4.0, None).stem == "SI-fa4-fgnonoise"


@pytest.mark.parametrize(
    ("posture", "block"),
    [("squat_30", "30"), ("squat_60", "60"), ("squats", "squats"), ("walk_60", "walk_60")],
)
def test_condition_is_the_published_block(posture, block):
    assert study_results.condition(posture) == block


def test_results_of_before_there_were_sensors_still_load(tmp_path):
    path = tmp_path / "results.json"
    study_results.save(path, results())
    content = json.loads(path.read_text("utf-8"))
    del content["sensors"]
    path.write_text(json.dumps(content), "utf-8")
    assert study_results.load(path).sensors == ()
