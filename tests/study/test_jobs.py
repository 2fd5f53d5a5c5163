"""Jobs of a study: their names and seeds, and that what was scored once is not computed again."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from legsim import config
from legsim.run import motion as run_motion
from legsim.run import pipeline
from legsim.run.folder import RunFolder
from legsim.run.pipeline import RunResult
from legsim.study import jobs as study_jobs
from legsim.study.config import Aiding, Ladder
from legsim.study.jobs import AidedJob, LadderJob, ScanJob, SensorJob, seed_of
from legsim.study.results import NoiseLevel

LADDER = Ladder(f_a=(0.0, "none"), f_g=(1.0,), conventions=("SI",), repetitions=2)


def job(tmp_path, **changes) -> LadderJob:
    settings = config.load_settings(
        preset="demo", overrides=("motion.file=subject01/squat_30.trc",)
    )
    return LadderJob(
        tmp_path,
        "subject01",
        "squat_30",
        changes.get("convention", "SI"),
        changes.get("ladder", LADDER),
        settings,
    )


@pytest.mark.end_to_end
def test_a_ladder_is_scored_once(tmp_path, monkeypatch):
    first = study_jobs.ladder(job(tmp_path))
    assert [(s.noise.f_a, s.noise.f_g, s.repetition) for s in first] == [
        (0, 1, 0),
        (0, 1, 1),
        (None, 1, 0),
        (None, 1, 1),
    ]
    assert first[0].translation_mm > first[2].translation_mm > 0

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(run_motion, "solve", refuse)
    assert study_jobs.ladder(job(tmp_path)) == first
    with pytest.raises(AssertionError, match="computed again"):
        study_jobs.ladder(job(tmp_path, ladder=LADDER.model_copy(update={"repetitions": 3})))


def test_a_scan_is_scored_again_only_where_its_folder_was_deleted(tmp_path, monkeypatch):
    runs = []

    def fake(_: object, out: Path, **__: object) -> RunResult:
        runs.append(out)
        RunFolder(out, {}).write_manifest()
        return RunResult(out, ())

    monkeypatch.setattr(pipeline, "run_scan", fake)
    settings = config.load_settings(
        preset="demo", overrides=("motion.file=subject01/squat_30.trc",)
    )
    one = ScanJob(tmp_path, "subject01", "squat_30", None, 0, settings, None, tmp_path / "store")
    study_jobs.scan(one)
    study_jobs.scan(one)
    assert len(runs) == 1
    shutil.rmtree(one.folder)
    study_jobs.scan(one)
    assert len(runs) == 2


def test_a_scan_is_scored_again_where_a_file_that_its_settings_name_is_another(
    tmp_path, monkeypatch
):
    runs = []

    def fake(_: object, out: Path, **__: object) -> RunResult:
        runs.append(out)
        RunFolder(out, {}).write_manifest()
        return RunResult(out, ())

    monkeypatch.setattr(pipeline, "run_scan", fake)
    beam = tmp_path / "beam.csv"
    settings = config.load_settings(
        preset="demo",
        overrides=(
            "motion.file=subject01/squat_30.trc",
            "scan.spectrum.kind=file",
            f"scan.spectrum.file={beam}",
        ),
    )
    one = ScanJob(tmp_path, "subject01", "squat_30", None, 0, settings, None, tmp_path / "store")
    for weight, count in ((1, 1), (1, 1), (2, 2)):
        beam.write_text(f"energy_kev,weight\n40,1\n80,{weight}\n")
        study_jobs.scan(one)
        assert len(runs) == count


@pytest.mark.parametrize("kind", ["ladder", "sensor", "aided"])
def test_scores_without_images_are_of_the_code_that_is_there(tmp_path, monkeypatch, kind):
    settings = config.load_settings(
        preset="demo", overrides=("motion.file=subject01/squat_30.trc",)
    )
    keys = []

    def noted(_: Path, key: str, __: object) -> list[dict[str, Any]]:
        keys.append(key)
        return []

    monkeypatch.setattr(study_jobs.kept, "entries", noted)
    who = (tmp_path, "subject01", "squat_30")
    for code in ("one", "one", "another"):
        monkeypatch.setattr(study_jobs.code, "fingerprint", lambda *_, now=code: now)
        if kind == "ladder":
            study_jobs.ladder(LadderJob(*who, "SI", LADDER, settings))
        elif kind == "sensor":
            study_jobs.sensor(SensorJob(*who, "mti300", SENSORS, settings))
        else:
            study_jobs.aided(AidedJob(*who, "none", Aiding(), settings))
    assert keys[0] == keys[1] != keys[2]


def test_every_job_has_a_folder_of_its_own(tmp_path):
    settings = config.load_settings(preset="demo")
    levels = [
        None,
        NoiseLevel("SI", 1.0, 1.0),
        NoiseLevel("per-sample", 1.0, 1.0),
        NoiseLevel("SI", None, 1.0),
    ]
    jobs = [
        ScanJob(tmp_path, s, p, n, r, settings, None, tmp_path / "store")
        for s in ("a", "b")
        for p in ("30", "60")
        for n in levels
        for r in (0, 1)
    ]
    folders = {j.folder for j in jobs if j.noise is not None or j.repetition == 0}
    assert len(folders) == 2 * 2 * (1 + 3 * 2)
    assert all(folder.parent == tmp_path / "runs" for folder in folders)


def test_seeds_differ_between_scans_and_repetitions_and_never_change():
    seeds = {
        seed_of(s, p, r)
        for s in ("subject01", "subject02")
        for p in ("squat_30", "squat_60")
        for r in range(5)
    }
    assert len(seeds) == 20
    assert seed_of("subject01", "squat_30", 0) == 523417868


SENSORS = Ladder(sensors=("mti300",), calibrations=("none", "six-positions"), repetitions=2)


@pytest.mark.end_to_end
def test_a_sensor_is_scored_once_under_every_calibration(tmp_path, monkeypatch):
    settings = config.load_settings(
        preset="demo", overrides=("motion.file=subject01/squat_30.trc",)
    )
    given = SensorJob(tmp_path, "subject01", "squat_30", "mti300", SENSORS, settings)
    first = study_jobs.sensor(given)
    assert [(s.calibration, s.repetition) for s in first] == [
        ("none", 0),
        ("none", 1),
        ("six-positions", 0),
        ("six-positions", 1),
    ]
    assert first[0].translation_mm > 10 * first[2].translation_mm > 0
    assert first[0].rotation_deg > 10 * first[2].rotation_deg > 0

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(run_motion, "solve", refuse)
    assert study_jobs.sensor(given) == first
    more = SENSORS.model_copy(update={"sensors": ("mti300", "bmi160")})
    assert study_jobs.sensor(replace(given, ladder=more)) == first


def test_sensors_from_files_have_names_that_a_file_may_have(tmp_path):
    settings = config.load_settings(preset="demo")
    given = SensorJob(tmp_path, "a/b", "30", "/far/away/my sensor.toml", SENSORS, settings)
    assert given.name == "sensor-a_b-30-my sensor"
    assert given.under("rest").noise.kind == "/far/away/my sensor.toml"
    assert [s.name for s in given.under("rest").sensors] == ["shank_l"]


@pytest.mark.end_to_end
def test_an_aided_sensor_is_measured_once(tmp_path, monkeypatch):
    settings = config.load_settings(
        preset="demo",
        overrides=(
            "motion.file=subject01/squat_30.trc",
            "methods.start=rough",
            "imu.noise.kind=bmi160",
        ),
    )
    asked = Aiding(sensors=("bmi160",), aids=("uncorrected", "beads-2"), repetitions=2)
    given = AidedJob(tmp_path, "subject01", "squat_30", "bmi160", asked, settings)
    first = study_jobs.aided(given)
    assert [(s.aid, s.repetition, s.followed) for s in first] == [
        ("uncorrected", 0, False),
        ("beads-2", 0, True),
        ("uncorrected", 1, False),
        ("beads-2", 1, True),
    ]
    assert first[1].px_after_similarity != first[3].px_after_similarity

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(run_motion, "solve", refuse)
    assert study_jobs.aided(given) == first
    with pytest.raises(AssertionError, match="computed again"):
        more = asked.model_copy(update={"repetitions": 3})
        study_jobs.aided(replace(given, aiding=more))
