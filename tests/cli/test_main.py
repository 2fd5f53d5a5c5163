import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import typer

from legsim import config
from legsim.cli import main as cli_main
from legsim.cli.main import _warn
from legsim.run import pipeline


def legsim(*arguments: str, **changes: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "legsim", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | changes
    )


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that a bad command prints."""
    with pytest.raises(SystemExit) as caught:
        cli_main.main(list(arguments))
    assert caught.value.code not in (0, None)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    "command",
    [
        "run",
        "replay",
        "convert",
        "project",
        "reconstruct",
        "evaluate",
        "study",
        "geometry",
        "view",
        "doctor",
        "sensors",
    ],
)
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as caught:
        cli_main.main([command, "--help"])
    assert caught.value.code == 0
    assert "Usage" in capsys.readouterr().out


def test_version(capsys):
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith("legsim ")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("run", "nowhere.toml"), "nowhere.toml: no such file"),
        (("run", "scan [2].toml"), "scan [2].toml: no such file"),
        (
            ("run", "--set", "scan.detector.photons=-1"),
            "scan.detector.photons): Input should be greater than or equal to 0",
        ),
        (
            (
                "run",
                "--set",
                "scan.spectrum.kind=file",
                "--set",
                "scan.spectrum.file=no.csv",
                "--out",
                "{tmp}",
            ),
            "no.csv: cannot be read",
        ),
        (
            ("project", "nowhere.toml", "--geometry", "nowhere.json", "--set", "grid.voxels=9"),
            "uses scan.spectrum.<key>",
        ),
        (("run", "--set", "scan.speed=3"), "scan.speed): unknown key"),
        (
            ("run", "--set", "motion.file=nowhere.trc", "--out", "{tmp}"),
            "nowhere.trc: no such motion file",
        ),
        (("run", "--set", "scan.views=9000", "--out", "{tmp}"), "the recording lasts"),
        (
            ("run", "--set", 'methods.run=["magic"]', "--out", "{tmp}"),
            "unknown correction method 'magic'",
        ),
        (
            ("run", "--device", "abacus", "--out", "{tmp}"),
            "no working OpenCL device matches 'abacus'",
        ),
        (("run", "--out", "/proc/nothing"), "/proc/nothing: cannot be written to"),
        (("replay", "nowhere.c3d", "--out", "{tmp}"), "nowhere.c3d: no such motion file"),
        (("convert", "nowhere.c3d", "--out", "{tmp}/a.trc"), "nowhere.c3d: cannot be read"),
        (("project", "nowhere.toml", "--geometry", "nowhere.json"), "nowhere.json"),
        (("reconstruct", "nowhere.mha", "--geometry", "nowhere.xml"), "nowhere.mha: no such file"),
        (
            ("reconstruct", "p.mha", "--geometry", "g.xml", "--nonnegative"),
            "--nonnegative: fdk has no such option; leave it out, or choose --algorithm cgls",
        ),
        (
            ("reconstruct", "p.mha", "--geometry=g.xml", "--algorithm=cgls", "--window=hann"),
            "--window: cgls has no such option; leave it out, or choose --algorithm fdk",
        ),
        (
            ("run", "--set", "reconstruction.iterations=30", "--out", "{tmp}"),
            "reconstruction.iterations: fdk has no such option; leave it out, or choose "
            "reconstruction.algorithm = cgls",
        ),
        (("evaluate", "nowhere.mha", "nowhere.mha"), "nowhere.mha: no such file"),
        (("geometry", "show", "nowhere.json"), "nowhere.json"),
        (("view", "{tmp}"), "no such recording"),
        (("run", "--speed"), "No such option"),
        (("dance",), "No such command"),
    ],
)
def test_a_bad_command_prints_one_line_with_the_cure(arguments, expected, capsys, tmp_path):
    assert expected in failure(capsys, *(a.format(tmp=tmp_path) for a in arguments))


def test_a_full_disk_is_one_line(capsys, monkeypatch, tmp_path):
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", str(tmp_path / "projections.mha"))

    monkeypatch.setattr(pipeline, "run_scan", full)
    assert "projections.mha: the disk is full" in failure(capsys, "run", "--out", str(tmp_path))


def test_an_error_of_ours_keeps_its_traceback(monkeypatch, tmp_path):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(pipeline, "run_scan", broken)
    with pytest.raises(ZeroDivisionError):
        cli_main.main(["run", "--out", str(tmp_path)])


@pytest.mark.end_to_end
def test_no_opencl_runtime_is_one_line(tmp_path):
    (tmp_path / "none.icd").write_text("/nowhere/libnone.so\n")
    result = legsim(
        "run",
        "--out",
        str(tmp_path / "o"),
        OCL_ICD_VENDORS=str(tmp_path / "none.icd"),
        OPENCL_VENDOR_PATH=str(tmp_path),
    )
    assert result.returncode == 1
    assert result.stderr.startswith("error: no OpenCL device works")
    assert "Traceback" not in result.stderr


@pytest.mark.end_to_end
def test_debug_shows_where_an_error_came_from(tmp_path):
    assert "Traceback" in legsim("run", "nowhere.toml", "--debug").stderr


@pytest.mark.end_to_end
def test_ctrl_c_ends_with_a_word_of_comfort(tmp_path):
    command = [
        sys.executable,
        "-c",
        "from legsim.cli.main import main; main()",
        "run",
        "--out",
        str(tmp_path),
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (tmp_path / "config.toml").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; finished stages are kept" in errors


_WRITING = """
import sys, time, types
from legsim.cli.main import main
from legsim.core.files import whole

def reconstruct(projections, geometry, out, **_):
    with whole(out) as partial:
        partial.write_text("half")
        print("writing", flush=True)
        time.sleep(60)

def options(*_, **__):
    pass

sys.modules["legsim.cli.file_stages"] = types.SimpleNamespace(
    reconstruct=reconstruct, ImageOptions=options, GeometryOptions=options
)
main(["reconstruct", "p.mha", "--geometry", "g.json", "--out", sys.argv[1]])
"""
"""a reconstruction that writes its volume for a minute"""


@pytest.mark.parametrize(
    ("sent", "code", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
def test_a_stopped_command_leaves_no_half_file_and_says_what_is_kept(sent, code, word, tmp_path):
    command = [sys.executable, "-c", _WRITING, str(tmp_path / "volume.mha")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "writing\n"
    assert len(list(tmp_path.iterdir())) == 1
    process.send_signal(sent)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == code
    assert list(tmp_path.iterdir()) == []
    assert (
        errors.splitlines()[-1]
        == f"{word}; half-written files are removed, the same command starts again"
    )


def test_a_warning_is_reported_once_whatever_its_numbers(capsys, monkeypatch):
    monkeypatch.setattr(cli_main, "_warned", set())
    for text in ("short scan: 197.6 deg", "short scan: 197.9 deg", "full disk"):
        _warn(text)
    written = capsys.readouterr().err
    assert written.count("short scan") == 1
    assert "197.6" in written
    assert "full disk" in written


@pytest.mark.parametrize("folder", ["x[/b]", "[red]", ":warning:", "end\\\\"])
def test_paths_are_printed_as_they_are(folder, tmp_path, capsys):
    (tmp_path / folder).mkdir(parents=True)
    source = tmp_path / folder / "a.csv"
    source.write_text("time_s,knee_angle_r_rad\n0,0.1\n0.1,0.2\n")
    out = tmp_path / folder / "b.csv"
    with pytest.raises(SystemExit) as caught:
        cli_main.main(["convert", str(source), "--out", str(out)])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"2 samples of 1 joint coordinates: {out}\n"


def test_a_name_that_is_no_utf8_is_read_written_and_printed(tmp_path):
    source, out = (
        os.fsdecode(os.fsencode(tmp_path) + name) for name in (b"/\xff.csv", b"/\xfe.mot")
    )
    with open(source, "w") as stream:
        stream.write("time_s,knee_angle_r_rad\n0,0.1\n0.1,0.2\n")
    done = subprocess.run(
        [sys.executable, "-m", "legsim", "convert", source, "--out", out],
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"2 samples of 1 joint coordinates: ")
    assert os.path.exists(out)


def commands_in_the_documents() -> list[str]:
    """Lines of blocks of code and of the examples' docstrings that are commands of legsim."""
    root = Path(__file__).parents[2]
    pages = [root / "README.md", *sorted((root / "docs").glob("*.md"))]
    blocks = [b for page in pages for b in re.findall(r"```\w*\n(.*?)```", page.read_text(), re.S)]
    blocks += [example.read_text() for example in sorted((root / "docs/examples").glob("*.py"))]
    lines = [line for b in blocks for line in re.sub(r"\\\n\s*", " ", b).splitlines()]
    found = [line.partition("  #")[0].strip() for line in lines]
    return sorted({line for line in found if line.startswith("legsim ")})


@pytest.mark.parametrize("line", commands_in_the_documents())
def test_commands_in_the_documents_have_options_and_settings_that_exist(line):
    _, *words = shlex.split(line)
    command: Any = typer.main.get_command(cli_main.app)
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    given = command.make_context("legsim", words).params
    config.load_settings(overrides=tuple(given.get("settings") or ()))


def test_a_choice_that_does_not_exist_is_refused_in_plain_words(capsys):
    said = " ".join(failure(capsys, "run", "--preset", "tiny").split())
    assert said.startswith("error: Invalid value for '--preset': 'tiny' is not one of 'demo'"), said
