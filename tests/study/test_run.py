"""A small study from its file to its report: killed and resumed on a cluster it ends in the same
numbers as one that ran through.
"""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from legsim.core import memory
from legsim.core.errors import LegsimError
from legsim.study import config
from legsim.study import plan as study_plan
from legsim.study import results as study_results
from legsim.study import run as study_run

pytestmark = pytest.mark.end_to_end
STUDY = """
name = "small"
title = "A small study"
preset = "demo"
subjects = ["subject06"]
postures = ["squat_60"]
methods = ["uncorrected", "rigid"]

[[noise]]
convention = "per-sample"
levels = [[4, 4]]

[ladder]
f_a = [4, "none"]
f_g = [4]
repetitions = 2

[settings.scan]
views = 62
increment_deg = 3.3
rate_hz = 7.75
columns = 62
rows = 48
pixel_mm = 6.16

[settings.grid]
voxels = 40
voxel_mm = 6.0
"""


def command(folder: Path, *options: str) -> list[str]:
    call = "from legsim.cli.main import main; main()"
    return [
        sys.executable,
        "-c",
        call,
        "study",
        str(folder / "STUDY.toml"),
        "--out",
        str(folder / "out"),
        *options,
    ]


@pytest.fixture(scope="module")
def through(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a study that ran through in this process."""
    folder = tmp_path_factory.mktemp("through")
    (folder / "STUDY.toml").write_text(STUDY)
    asked, base = config.load(str(folder / "STUDY.toml"))
    out = folder / "out"
    planned = study_plan.plan(asked, base, out)
    study_plan.needs(planned, out, 1)
    study_run.run(
        asked,
        planned,
        out,
        command="legsim study",
        on_step=lambda *_: None,
        on_progress=lambda *_: None,
    )
    return out


def numbers(out: Path) -> list[dict[str, str]]:
    """Every row of scores.csv and ladder.csv without what time says."""
    rows = []
    for name in ("scores.csv", "ladder.csv"):
        with (out / name).open(encoding="utf-8", newline="") as stream:
            rows += [
                {k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)
            ]
    return rows


def test_the_report_holds_all(through):
    results = study_results.load(through / "results.json")
    assert {(s.method, s.noise is None) for s in results.scores} == {
        *((m, True) for m in ("static", "uncorrected", "rigid")),
        *((m, False) for m in ("static", "rigid")),
    }
    assert len(results.ladder) == 2 * 2 * 2
    assert not results.failures
    by_method = {s.method: s.metrics.of("leg") for s in results.scores if s.noise is None}
    assert by_method["uncorrected"].ssim < by_method["rigid"].ssim < 1
    page = (through / "report.html").read_text()
    assert all(
        word in page for word in ("per-sample", "runs/subject06-squat_60", "Pictures of one scan")
    )
    assert (through / "pictures" / "noise-slices.png").exists()


def test_noisy_runs_share_the_clean_runs_projections(through):
    clean, noisy = (
        through / "runs" / name
        for name in ("subject06-squat_60", "subject06-squat_60-per-sample-fa4-fg4-0")
    )
    assert (clean / "projections.mha").stat().st_ino == (noisy / "projections.mha").stat().st_ino
    costs = {cost.stage: cost.runs for cost in study_results.load(through / "results.json").costs}
    assert costs["projections"] == 1
    assert costs["volume-rigid"] == 2


def test_killed_and_resumed_on_a_cluster_it_ends_in_the_same_numbers(through, tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "STUDY.toml").write_text(STUDY)
    process = subprocess.Popen(
        command(tmp_path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    manifest = tmp_path / "out" / "runs" / "subject06-squat_60" / "manifest.json"
    until = time.monotonic() + 300
    while time.monotonic() < until and not (
        manifest.exists() and '"projections"' in manifest.read_text()
    ):
        assert process.poll() is None, "ended before it could be killed"
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "out" / "results.json").exists()
    kept = (manifest.parent / "projections.mha").stat()
    subprocess.run(command(tmp_path, "--workers", "2"), check=True, capture_output=True)
    assert numbers(tmp_path / "out") == numbers(through)
    after = (manifest.parent / "projections.mha").stat()
    assert (kept.st_ino, kept.st_mtime_ns) == (after.st_ino, after.st_mtime_ns), (
        "was projected again"
    )


def test_a_second_run_computes_nothing(through):
    asked, base = config.load(str(through.parent / "STUDY.toml"))
    before = {p: p.stat().st_mtime_ns for p in through.glob("runs/*/*")}
    study_run.run(
        asked,
        study_plan.plan(asked, base, through),
        through,
        command="",
        on_step=lambda *_: None,
        on_progress=lambda *_: None,
    )
    assert {p: p.stat().st_mtime_ns for p in through.glob("runs/*/*")} == before


def test_a_disk_that_is_too_small_is_reported_before_anything_runs(through, monkeypatch):
    asked, base = config.load(
        str(through.parent / "STUDY.toml"), preset="paper", overrides=("grid.voxels=512",)
    )
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 10**6})())
    with pytest.raises(LegsimError, match=r"takes .* GiB, 1\.0 MiB are free there"):
        study_plan.needs(study_plan.plan(asked, base, through), through, 1)


def test_more_workers_than_the_memory_holds_are_refused(through, monkeypatch):
    asked, base = config.load(str(through.parent / "STUDY.toml"), overrides=("grid.voxels=512",))
    monkeypatch.setattr(memory, "available", lambda: 9 * 2**30)
    with pytest.raises(LegsimError, match=r"use --workers 2$"):
        study_plan.needs(study_plan.plan(asked, base, through), through, 4)
    monkeypatch.setattr(memory, "available", lambda: 2**30)
    with pytest.raises(LegsimError, match=r"use a smaller --preset$"):
        study_plan.needs(study_plan.plan(asked, base, through), through, 1)


def test_photons_of_each_run_and_a_true_field_take_disk(through):
    def needed(*overrides: str, methods: str = '"rigid"]') -> int:
        (through.parent / "other.toml").write_text(STUDY.replace('"rigid"]', methods, 1))
        asked, base = config.load(str(through.parent / "other.toml"), overrides=overrides)
        return study_plan.plan(asked, base, through).disk()

    exposures, volume, nodes = 2 * 4 * 62 * 62 * 48, 4 * 40**3, 31**3
    assert needed("scan.detector.photons=1e5") - needed() == exposures + volume
    assert needed(methods='"rigid", "oracle-nonrigid"]') - needed() == volume + 3 * 4 * 62 * nodes
