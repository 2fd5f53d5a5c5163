"""`legsim study` runs the study that is asked for, and ends with an error where a run failed."""

import pytest

from legsim.cli import main as cli_main
from legsim.study import run as study_run
from legsim.study.results import StudyResults


def asked(monkeypatch: pytest.MonkeyPatch, *arguments: str, failures: tuple[str, ...] = ()):
    """(exit code, keyword arguments of the study's run) of a command whose runs are left out."""
    passed: dict = {}

    def run(*_: object, **options: object) -> StudyResults:
        passed.update(options)
        return StudyResults("s", "Study", (), (), (), failures)

    monkeypatch.setattr(study_run, "run", run)
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["study", *arguments])
    return caught.value.code, passed


def test_the_report_names_the_command_that_repeats_it(tmp_path, monkeypatch):
    options = ("quick", "--preset", "demo", "--set", "scan.views=62", "--out", str(tmp_path / "o"))
    code, passed = asked(monkeypatch, *options, "--workers", "2")
    assert code == 0
    assert passed["workers"] == 2
    assert passed["command"] == " ".join(("legsim study", *options))


def test_a_failed_run_is_an_error_and_named(tmp_path, monkeypatch, capsys):
    code, _ = asked(monkeypatch, "quick", "--out", str(tmp_path), failures=("ben: no file",))
    assert code == 1
    assert "failed: ben: no file" in capsys.readouterr().err


def test_workers_and_scheduler_exclude_each_other(tmp_path, monkeypatch, capsys):
    options = ("quick", "--workers", "2", "--scheduler", "tcp://there:1", "--out", str(tmp_path))
    code, passed = asked(monkeypatch, *options)
    assert (code, passed) == (1, {})
    assert "--scheduler" in capsys.readouterr().err
