"""Jobs of a study: their names and seeds, and that what was scored once is not computed again."""

import json
import shutil
from pathlib import Path

import pytest

from legsim import artifacts, config, pipeline, recovery, study_tasks
from legsim.pipeline import RunResult
from legsim.study_config import Ladder
from legsim.study_results import NoiseLevel
from legsim.study_tasks import LadderJob, ScanJob

LADDER = Ladder(f_a=(0.0, "none"), f_g=(1.0,), conventions=("SI",), repetitions=2)


def job(tmp_path, **changes) -> LadderJob:
    settings = config.load(preset="demo", overrides=("motion.file=subject01/squat_30.trc",))
    return LadderJob(tmp_path, "subject01", "squat_30", changes.get("convention", "SI"), changes.get("ladder", LADDER), settings)


def test_a_ladder_is_scored_once(tmp_path, monkeypatch):
    first = study_tasks.ladder(job(tmp_path))
    assert [(s.noise.f_a, s.noise.f_g, s.repetition) for s in first] == [(0, 1, 0), (0, 1, 1), (None, 1, 0), (None, 1, 1)]
    assert first[0].translation_mm > first[2].translation_mm > 0

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(recovery, "recover", refuse)
    assert study_tasks.ladder(job(tmp_path)) == first
    with pytest.raises(AssertionError, match="computed again"):
        study_tasks.ladder(job(tmp_path, ladder=LADDER.model_copy(update={"repetitions": 3})))


def test_scores_of_other_settings_are_not_taken(tmp_path):
    kept = tmp_path / "scores" / "x.json"
    assert study_tasks._kept(kept, "key", lambda: [{"a": 1.5}]) == [{"a": 1.5}]
    assert study_tasks._kept(kept, "key", lambda: [{"a": 2.5}]) == [{"a": 1.5}]
    assert study_tasks._kept(kept, "other", lambda: [{"a": 2.5}]) == [{"a": 2.5}]
    assert json.loads(kept.read_text())["key"] == "other"


def test_a_scan_is_scored_again_only_where_its_folder_was_deleted(tmp_path, monkeypatch):
    runs = []

    def fake(_: object, out: Path, **__: object) -> RunResult:
        runs.append(out)
        artifacts.RunFolder(out, {}).write_manifest()
        return RunResult(out, ())

    monkeypatch.setattr(pipeline, "run", fake)
    settings = config.load(preset="demo", overrides=("motion.file=subject01/squat_30.trc",))
    one = ScanJob(tmp_path, "subject01", "squat_30", None, 0, settings, None, tmp_path / "store")
    study_tasks.scan(one)
    study_tasks.scan(one)
    assert len(runs) == 1
    shutil.rmtree(one.folder)
    study_tasks.scan(one)
    assert len(runs) == 2


def test_every_job_has_a_folder_of_its_own(tmp_path):
    settings = config.load(preset="demo")
    levels = [None, NoiseLevel("SI", 1.0, 1.0), NoiseLevel("per-sample", 1.0, 1.0), NoiseLevel("SI", None, 1.0)]
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
    seeds = {study_tasks.seed_of(s, p, r) for s in ("subject01", "subject02") for p in ("squat_30", "squat_60") for r in range(5)}
    assert len(seeds) == 20
    assert study_tasks.seed_of("subject01", "squat_30", 0) == 523417868
