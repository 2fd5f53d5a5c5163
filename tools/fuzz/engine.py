"""Reads damaged files by the thousand, in children that may die, and counts what became of them."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from legsim.core import files
from tools.fuzz import corpus, law
from tools.fuzz.damage import damaged
from tools.fuzz.readers import READERS, Reader

MEMORY_BYTES = 2 << 30
"""that one file may ask for"""

SHARE = 20_000
"""inputs of one child"""


def fuzz(
    name: str, inputs: int, seed: int, *, seconds: float = float("inf")
) -> tuple[Counter[str], dict[str, bytes]]:
    """Counts what a reader did, and the first input of everything that it must not do.

    Files are read by a child, so that one that ends the process is counted as well.

    Args:
        name: of the reader.
        inputs: how many.
        seed: of the damage.
        seconds: after which no more are read.
    """
    reader, found, firsts = READERS[name], Counter[str](), dict[str, bytes]()
    until = time.monotonic() + seconds
    with in_memory() as folder:
        path, log = file_of(reader, folder), folder / "log"
        valid = (*samples(reader, path), *corpus.load(name))
        done = 0
        while done < inputs and time.monotonic() < until:
            child = os.fork()
            if child == 0:
                numbers = range(done, min(inputs, done + SHARE))
                _read_all(reader, path, log, valid, numbers, seed, until)
            _, status = os.waitpid(child, 0)
            lines = log.read_text("utf-8").splitlines()
            log.unlink()
            ended = [line.split(" ", 1) for line in lines]
            if os.WIFSIGNALED(status):
                ended.append([str(done + len(lines)), f"ended by signal {os.WTERMSIG(status)}"])
            for number, what in ended:
                found[what] += 1
                if what not in (law.READ, law.REFUSED) and what not in firsts:
                    firsts[what] = _input(valid, seed, int(number))
            done += len(ended)
    return found, firsts


def guided(
    name: str, inputs: int, seed: int, *, seconds: float, kept: Path | None = None
) -> tuple[Counter[str], dict[str, bytes]]:
    """Like :func:`fuzz`, guided by the code that inputs reach; see :mod:`tools.fuzz.guided`.

    Args:
        name: of the reader.
        inputs: how many.
        seed: of the damage.
        seconds: after which no more are read.
        kept: folder where the inputs that reach code which valid files do not reach take the
            place of those kept for the reader.

    Raises:
        RuntimeError: the process that reads them failed by itself.
    """
    reader, found, firsts = READERS[name], Counter[str](), dict[str, bytes]()
    until = time.monotonic() + seconds
    with in_memory() as folder:
        log = folder / "log"
        for place in ("valid", "corpus", "firsts"):
            (folder / place).mkdir()
        valid = samples(reader, file_of(reader, folder / "valid"))
        for k, data in enumerate((*valid, *corpus.load(name))):
            (folder / "corpus" / f"{k:03d}").write_bytes(data)
        while found.total() < inputs and time.monotonic() < until:
            limits = (str(inputs - found.total()), str(until), str(seed))
            command = [sys.executable, "-m", "tools.fuzz.guided", name, str(folder), *limits]
            child = subprocess.run(command, check=False, capture_output=True, text=True)
            lines = log.read_text("utf-8").splitlines() if log.exists() else []
            log.unlink(missing_ok=True)
            found.update(lines)
            if child.returncode < 0:
                what = f"ended by signal {-child.returncode}"
                found[what] += 1
                last = file_of(reader, folder / f"seed-{seed}")
                firsts.setdefault(what, last.read_bytes())
            elif child.returncode or not lines:
                raise RuntimeError(child.stderr)
            seed += 1
        for what in found.keys() - {law.READ, law.REFUSED} - firsts.keys():
            firsts[what] = (folder / "firsts" / files.key_of(what)).read_bytes()
        reached = {file.read_bytes() for file in (folder / "corpus").iterdir()}
        if kept is not None:
            corpus.save(name, tuple(reached - set(valid)), kept)
    return found, firsts


@contextmanager
def in_memory() -> Iterator[Path]:
    """A folder for files that need no disk."""
    place = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        yield Path(folder)


def file_of(reader: Reader, folder: Path) -> Path:
    """Where a reader's file lies."""
    return folder / f"{reader.name}{reader.suffix}"


def samples(reader: Reader, path: Path) -> tuple[bytes, ...]:
    """The valid files of a reader, of which each must be read.

    Raises:
        AssertionError: one is not.
    """
    made = []
    for maker in reader.makers:
        maker(path)
        with law.watched():
            became = law.outcome(reader, path)
        assert became == law.READ, f"a valid {path.suffix} is not read: {became}"
        made.append(path.read_bytes())
    return tuple(made)


def _input(valid: Sequence[bytes], seed: int, number: int) -> bytes:
    rng = np.random.default_rng([seed, number])
    return damaged(valid[int(rng.integers(len(valid)))], rng, valid[1:] and valid)


def _read_all(
    reader: Reader,
    path: Path,
    log: Path,
    valid: Sequence[bytes],
    numbers: range,
    seed: int,
    until: float,
) -> None:
    """Reads damaged files and logs a line for each; ends the process."""
    with (
        limited_memory(),
        log.open("w", encoding="utf-8", buffering=1) as stream,
        law.libraries_quiet(),
        law.watched(),
    ):
        for number in numbers:
            path.write_bytes(_input(valid, seed, number))
            stream.write(f"{number} {law.outcome(reader, path)}\n")
            if time.monotonic() > until:
                break
    os._exit(0)


@contextmanager
def limited_memory() -> Iterator[None]:
    """What a header asks for by mistake must not fill the machine."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def keep(folder: Path, name: str, firsts: dict[str, bytes]) -> None:
    """Writes the inputs that must not be, under names that hold for equal ones."""
    folder.mkdir(parents=True, exist_ok=True)
    for what, data in firsts.items():
        place = f"{name}-{files.key_of(what)[:8]}"
        (folder / f"{place}{READERS[name].suffix}").write_bytes(data)
        (folder / f"{place}.what").write_text(f"{name}: {what}\n")
