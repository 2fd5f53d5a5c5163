"""Hundreds of tiny scans on a local Dask cluster whose workers are killed: nothing lost, no leak.

Each scan is a person in the C-arm, projected and reconstructed on a coarse grid; it leaves a file
with a hash of its volume. While they run, workers are killed at random, and half way through one is
taken away and replaced. At the end every scan must be there, some are compared with the same scan
made here, and the memory of the processes is reported over time.

    python -m tools.experiments.soak --scans 500 --workers 2
"""

import functools
import hashlib
import os
import signal
import tempfile
import threading
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import legsim as ls
from legsim.study import engine


@functools.cache
def person(number: int) -> Any:
    """One of the seven people that come with legsim, in a held squat."""
    return ls.solve_kinematics(f"subject{number:02d}/squat_30.trc")


def scan(folder: Path, number: int) -> str:
    """Makes scan ``number``; leaves its hash, its process and that one's memory in a file."""
    angles = np.radians(np.arange(0, 200, 25.0) + number % 7)
    carm = ls.CArm.half(angles=angles, shape_vu=(12, 16), pixel_pitch=24e-3)
    made = ls.simulate_scan(person(1 + number % 2), carm)
    volume = ls.fdk(made.seen.projections, made.grid(12, 16e-3))
    digest = hashlib.sha256(volume.attenuation.tobytes()).hexdigest()
    (folder / f"{number:05d}").write_text(f"{digest} {os.getpid()} {resident(os.getpid()):.0f}\n")
    return digest


def resident(process: int) -> float:
    """MiB that a process holds; 0 when it is gone."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def disturb(
    cluster: Any, client: Any, kills: int, total: int, folder: Path, rng: np.random.Generator
) -> None:
    """Kills workers when random numbers of scans have ended; replaces one half way."""
    at = sorted(rng.integers(total // 20 + 1, max(total - 5, total // 20 + 2), kills).tolist())
    replaced = False
    while at or not replaced:
        time.sleep(0.2)
        done = len(list(folder.iterdir()))
        if at and done >= at[0]:
            at.pop(0)
            workers = sorted(client.run(os.getpid).values())
            if workers:
                os.kill(workers[rng.integers(len(workers))], signal.SIGKILL)
        if not replaced and done >= total // 2:
            replaced = True
            size = len(cluster.workers)
            cluster.scale(size - 1)
            time.sleep(2)
            cluster.scale(size)
        if done >= total:
            return


def watch(client: Any, ended: threading.Event, seen: list[tuple[float, float, float]]) -> None:
    """Notes (scans' seconds, MiB here, MiB of the largest worker) until the scans have ended."""
    begun = time.monotonic()
    while not ended.wait(5.0):
        try:
            workers = client.run(os.getpid).values()
        except Exception:  # a worker is being killed
            continue
        largest = max((resident(process) for process in workers), default=0.0)
        seen.append((time.monotonic() - begun, resident(os.getpid()), largest))


def growth(folder: Path) -> list[str]:
    """A line for each process that made four scans or more: its memory after some of them."""
    of_process: dict[str, list[float]] = {}
    for path in sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns):
        _, process, mebibytes = path.read_text().split()
        of_process.setdefault(process, []).append(float(mebibytes))
    lines = []
    for process, held in of_process.items():
        if len(held) >= 4:
            after = sorted({1, 2, 4, 8, 16, 32, 64, len(held)} & set(range(1, len(held) + 1)))
            shown = ", ".join(f"{held[k - 1]:.0f} ({k})" for k in after)
            lines.append(f"worker {process}: MiB after so many scans: {shown}")
    return lines


def _cluster(workers: int) -> Any:
    import distributed

    return distributed.LocalCluster(
        n_workers=workers, threads_per_worker=1, memory_limit=0, dashboard_address=":0"
    )


def main(
    scans: Annotated[int, typer.Option(help="How many.", min=4)] = 500,
    workers: Annotated[int, typer.Option(help="Processes.", min=2)] = 2,
    kills: Annotated[int, typer.Option(help="Workers that are killed.", min=0)] = 20,
    seed: Annotated[int, typer.Option(help="Of the moments.", min=0)] = 0,
) -> None:
    """Makes scans while workers are killed; fails where one is lost or another one than here."""
    import distributed

    from tools.experiments import soak  # by its name, which workers import

    rng = np.random.default_rng(seed)
    seen: list[tuple[float, float, float]] = []
    ended = threading.Event()
    with (
        tempfile.TemporaryDirectory() as place,
        _cluster(workers) as cluster,
        distributed.Client(cluster) as client,
    ):
        folder = Path(place, "scans")
        folder.mkdir()
        others = [
            threading.Thread(target=disturb, args=(cluster, client, kills, scans, folder, rng)),
            threading.Thread(target=watch, args=(client, ended, seen)),
        ]
        for other in others:
            other.daemon = True
            other.start()
        tasks = [engine.Task(f"scan-{k}", soak.scan, (folder, k)) for k in range(scans)]
        begun = time.monotonic()
        outcome = engine.run_on_cluster(
            tasks,
            lambda _: None,
            scheduler=cluster.scheduler_address,
            workers=workers,
            shared_folder=Path(place),
        )
        ended.set()
        took = time.monotonic() - begun
        lines = growth(folder)
        left = {path.name: path.read_text().split() for path in folder.iterdir()}
        sample = rng.choice(scans, min(5, scans), replace=False).tolist()
        other_here = [k for k in sample if scan(Path(place), k) != left[f"{k:05d}"][0]]
    processes = len({process for _, process, _ in left.values()})
    typer.echo(
        f"{len(outcome.results)} of {scans} scans in {took:.0f} s, {len(outcome.failures)} failed, "
        f"{processes} processes made them; {len(sample) - len(other_here)} of {len(sample)} are "
        "the same as here"
    )
    typer.echo("\n".join(lines))
    for name, column in (("this process", 1), ("the largest worker", 2)):
        values = np.array(seen)[:, column] if seen else np.zeros(4)
        first, last = values[: len(values) // 4 + 1], values[-len(values) // 4 :]
        typer.echo(
            f"memory of {name}: median {np.median(first):.0f} MiB in the first quarter, "
            f"{np.median(last):.0f} MiB in the last, {values.max():.0f} MiB at most"
        )
    if outcome.failures:
        typer.echo(next(iter(outcome.failures.values())))
    raise typer.Exit(0 if len(left) == scans and not outcome.failures and not other_here else 1)


if __name__ == "__main__":
    typer.run(main)
