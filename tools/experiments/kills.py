"""Studies that are killed at random moments, or whose disk is full, end in the same table.

A small study is started again and again in one folder. After a random time it is killed (SIGKILL),
or something else takes all the room of its disk, a tmpfs of its own. Then it is let finish, and its
scores are compared with those of a study that nobody disturbed. One that is done begins again in an
empty folder. Times are seconds of a processor, so that other jobs of the machine do not count, and
short ones are drawn more often: a study that goes on where it was is killed there again.

Disks need the right to mount (root, in a container as well); without it only kills are tried.

    python -m tools.experiments.kills --kills 100 --full 100
"""

import contextlib
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

STUDY = """name = "small"
title = "small"
preset = "demo"
subjects = ["subject01"]
postures = ["squat_30"]
methods = ["static", "uncorrected", "rigid"]
[settings.scan]
views = 13
increment_deg = 17.0
rate_hz = 1.53
columns = 60
rows = 44
pixel_mm = 6.4
rays_per_pixel = 1
detector = { photons = 1000 }
[settings.grid]
voxels = 24
voxel_mm = 8.0
[settings.evaluation]
registered = "none"
"""

BEFORE = ("legsim.cli.study_command", "legsim.study.run", "legsim.run.pipeline")
BEFORE += ("matplotlib.pyplot", "mujoco", "rerun", "SimpleITK", "trimesh", "skimage.metrics")
"""what is imported once, before the forks"""

_DISK_MIB = 400

FIT = ("whole", "refused: the disk is full", "refused before it began")
"""how a study may end whose disk is full"""

_KEPT = "filler"
"""what takes the room of the disk"""


def child(study: Path, out: Path, said: Path) -> int:
    """Starts the study in a fork of this process, which has imported all; its id."""
    process = os.fork()
    if process:
        return process
    os.setsid()
    taken = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(taken, 1)
    os.dup2(taken, 2)
    from legsim.cli import main

    code = 70
    try:
        sys.argv = ["legsim", "study", str(study), "--out", str(out)]
        main.main()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException as error:
        print(f"Traceback: {error!r}", file=sys.stderr)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def waited(process: int, seconds: float = float("inf")) -> int | None:
    """The exit code (negative: the signal); None once it has used that much of a processor."""
    while True:
        ended, status = os.waitpid(process, 0 if seconds == float("inf") else os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if used(process) > seconds:
            return None
        time.sleep(0.005)


def used(process: int) -> float:
    """Seconds of a processor that a child has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def moment(rng: np.random.Generator, seconds: float) -> float:
    """A time within ``seconds``, a quarter of it on average."""
    return seconds * rng.uniform() ** 3


def table(out: Path) -> list[dict[str, Any]]:
    """All scores, without the seconds that they took."""
    scores = json.loads((out / "results.json").read_text("utf-8"))["scores"]
    return [{k: v for k, v in score.items() if k != "seconds"} for score in scores]


def finished(study: Path, out: Path, said: Path) -> float:
    """Seconds of a processor of a study that ends; a failure ends this program."""
    before = os.times()
    code = waited(child(study, out, said))
    if code != 0:
        raise SystemExit(f"the study failed ({code}): {said.read_text()}")
    after = os.times()
    return after.children_user + after.children_system - before[2] - before[3]


def killed(study: Path, out: Path, said: Path, after: float) -> bool:
    """Whether the study was still going when it was killed, with all its processes."""
    process = child(study, out, said)
    if waited(process, after) is not None:
        return False
    os.killpg(process, signal.SIGKILL)
    waited(process)
    return True


def ending(code: int | None, said: str) -> str:
    """How a study ends whose disk is full: one of :data:`FIT`, or what it says."""
    if code == 0:
        return "whole"
    if code == 1 and "are free there; choose another folder" in said and "Traceback" not in said:
        return "refused before it began"
    lines = [line for line in said.splitlines() if "the disk is full" in line]
    if code == 1 and lines and "Traceback" not in said:
        return "refused: the disk is full"
    return f"exit code {code}: {said[-400:]}"


@contextlib.contextmanager
def disk(place: Path) -> Iterator[bool]:
    """Mounts a tmpfs at ``place``; False where that is not allowed."""
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={_DISK_MIB}m", "none", str(place)]
    mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(place)], check=True)


def filled(place: Path, left: int = 0) -> None:
    """Takes the room of a disk, but for ``left`` bytes in which small files still fit."""
    with (place / _KEPT).open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while True:
            stream.write(bytes(1 << 20))
    with (place / _KEPT).open("ab", buffering=0) as stream, contextlib.suppress(OSError):
        while True:
            stream.write(bytes(1 << 9))
    os.truncate(place / _KEPT, max(0, (place / _KEPT).stat().st_size - left))


def emptied(folder: Path) -> None:
    """Removes what a finished study left, so that it begins again."""
    shutil.rmtree(folder, ignore_errors=True)


def main(
    kills: Annotated[int, typer.Option(help="Times that the study is killed.", min=0)] = 20,
    full: Annotated[int, typer.Option(help="Times that its disk is full.", min=0)] = 20,
    seed: Annotated[int, typer.Option(help="Of the moments and sizes.", min=0)] = 0,
    minutes: Annotated[float, typer.Option(help="For each of the two, at most.")] = 60.0,
) -> None:
    """Kills a study, fills its disk, lets it finish, and compares its scores."""
    for module in BEFORE:
        importlib.import_module(module)
    rng = np.random.default_rng(seed)
    wrong = 0
    with tempfile.TemporaryDirectory() as folder, disk(Path(folder, "disk")) as mounted:
        place = Path(folder)
        study, said = place / "small.toml", place / "said.txt"
        study.write_text(STUDY)
        seconds = finished(study, place / "calm", said)
        calm = table(place / "calm")
        typer.echo(f"undisturbed: {seconds:.1f} s")
        wrong += _kill(study, place / "killed", said, kills, seconds, rng, calm, 60 * minutes)
        if full and not mounted:
            typer.echo("disks cannot be mounted here: none was filled")
        elif full:
            wrong += _fill(study, place / "disk", said, full, seconds, rng, calm, 60 * minutes)
    raise typer.Exit(1 if wrong else 0)


def _kill(
    study: Path,
    out: Path,
    said: Path,
    times: int,
    seconds: float,
    rng: np.random.Generator,
    calm: list,
    limit: float,
) -> int:
    """How many resumed studies end otherwise."""
    struck = rounds = wrong = tried = 0
    until = time.monotonic() + limit
    while tried < times and time.monotonic() < until:
        tried += 1
        if killed(study, out, said, moment(rng, seconds)):
            struck += 1
            if rng.random() > 0.1:
                continue
        finished(study, out, said)
        rounds, wrong = rounds + 1, wrong + (table(out) != calm)
        emptied(out)
        typer.echo(f"{struck} kills of {tried}, {rounds} studies ended, {wrong} wrong", err=True)
    if out.exists():
        finished(study, out, said)
        rounds, wrong = rounds + 1, wrong + (table(out) != calm)
    typer.echo(f"killed {struck} times of {tried}; {rounds} studies ended, {wrong} in other scores")
    return wrong


def _fill(
    study: Path,
    place: Path,
    said: Path,
    times: int,
    seconds: float,
    rng: np.random.Generator,
    calm: list,
    limit: float,
) -> int:
    """How many studies end otherwise, or not in a line where the disk is full."""
    ends, rounds, wrong = Counter[str](), 0, 0
    out, until = place / "study", time.monotonic() + limit
    while ends.total() < times and time.monotonic() < until:
        process = child(study, out, said)
        code = waited(process, moment(rng, seconds))
        if code is None:
            # on a busy machine the study may be faster than what fills its disk
            os.killpg(process, signal.SIGSTOP)
            filled(place, int(rng.integers(64) * rng.integers(2)) << 12)
            os.killpg(process, signal.SIGCONT)
            code = waited(process)
        (place / _KEPT).unlink(missing_ok=True)
        ends[ending(code, said.read_text())] += 1
        typer.echo(f"{ends.total()} disks filled, {rounds} studies ended", err=True)
        if code == 0 or rng.random() < 0.1:
            finished(study, out, said)
            rounds, wrong = rounds + 1, wrong + (table(out) != calm)
            emptied(out)
    finished(study, out, said)
    rounds, wrong = rounds + 1, wrong + (table(out) != calm)
    for end, count in ends.most_common():
        typer.echo(f"disk filled at a random moment: {count} x {end}")
        wrong += 0 if end in FIT else count
    typer.echo(f"{rounds} studies ended with room, {wrong} in other scores or not in a line")
    return wrong


if __name__ == "__main__":
    typer.run(main)
