"""Runs that are killed at random moments, or whose files may not grow, end in the same table.

A small run is started again and again in one folder, and each time killed (SIGKILL) after a random
time, or given a random largest file size (RLIMIT_FSIZE, as a disk that is full). Then it is let
finish, and its table is compared with that of a run that nobody disturbed.

    python -m tools.experiments.kills --kills 20 --full 10
"""

import json
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

SETTINGS = (
    *("scan.views=13", "scan.increment_deg=17", "scan.rate_hz=1.53", "scan.columns=60"),
    *("scan.rows=44", "scan.pixel_mm=6.4", "scan.rays_per_pixel=1", "scan.detector.photons=1000"),
    *("grid.voxels=24", "grid.voxel_mm=8", "evaluation.register_volumes=false"),
    'methods.run=["static", "uncorrected", "rigid", "nonrigid-3d"]',
)


def command(out: Path) -> list[str]:
    """The command of the run."""
    options = [word for setting in SETTINGS for word in ("--set", setting)]
    return [sys.executable, "-m", "legsim", "run", *options, "--out", str(out)]


def table(out: Path) -> list[dict[str, Any]]:
    """Scores of every method, without the seconds that it took."""
    methods = json.loads((out / "metrics.json").read_text("utf-8"))["methods"]
    return [{k: v for k, v in method.items() if k != "seconds"} for method in methods]


def finished(out: Path) -> float:
    """Seconds of a run that ends; a failure ends this program."""
    begun = time.monotonic()
    ended = subprocess.run(command(out), capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        raise SystemExit(f"the run failed: {ended.stderr}")
    return time.monotonic() - begun


def killed(out: Path, after: float) -> bool:
    """Whether the run was still going when it was killed."""
    process = subprocess.Popen(
        command(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True
    return False


def out_of_room(out: Path, largest: int) -> str:
    """How a run ends whose files may have that many bytes: "whole", "one line", or what it says."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    ended = subprocess.run(
        command(out), capture_output=True, text=True, check=False, preexec_fn=limit
    )
    if ended.returncode == 0:
        return "whole"
    errors = [line for line in ended.stderr.splitlines() if line.startswith("error: ")]
    if ended.returncode == 1 and len(errors) == 1 and "Traceback" not in ended.stderr:
        return "one line"
    return f"exit code {ended.returncode}: {ended.stderr[-300:]}"


def main(
    kills: Annotated[int, typer.Option(help="Times that the run is killed.", min=0)] = 20,
    full: Annotated[int, typer.Option(help="Times that its files may not grow.", min=0)] = 10,
    seed: Annotated[int, typer.Option(help="Of the moments and sizes.", min=0)] = 0,
) -> None:
    """Kills a run, fills its disk, lets it finish, and compares its table."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        calm, troubled, cramped = (Path(folder, name) for name in ("calm", "troubled", "cramped"))
        seconds = finished(calm)
        typer.echo(f"undisturbed: {seconds:.1f} s")
        struck = 0
        for _ in range(kills):
            if killed(troubled, rng.uniform(0, seconds)):
                struck += 1
            else:
                shutil.rmtree(troubled)
        finished(troubled)
        same = table(troubled) == table(calm)
        typer.echo(
            f"killed {struck} times of {kills}: the table is {'the same' if same else 'OTHER'}"
        )
        ends = [out_of_room(cramped, int(10 ** rng.uniform(2, 7))) for _ in range(full)]
        for end in sorted(set(ends)):
            typer.echo(f"files too small to grow: {ends.count(end)} x {end}")
        finished(cramped)
        fits = table(cramped) == table(calm)
        typer.echo(f"then let grow: the table is {'the same' if fits else 'OTHER'}")
    if not (same and fits and set(ends) <= {"whole", "one line"}):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
