"""Damages files towards code that no file reached before, by Atheris and libFuzzer.

``python -m tools.fuzz.guided READER FOLDER INPUTS UNTIL SEED`` is a process of its own, which
:func:`tools.fuzz.engine.guided` starts: code is instrumented as it is imported, and libFuzzer ends
the process. FOLDER/corpus holds inputs to start from, and then those that reached new code;
FOLDER/log gets a line for each input, FOLDER/firsts the first of every kind that must not be; the
last input is the reader's file in FOLDER/seed-SEED. UNTIL is by the monotonic clock.
"""

import sys
import time
from pathlib import Path

import atheris  # pyright: ignore[reportMissingImports]
import numpy as np
from atheris.import_hook import instrument_imports  # pyright: ignore[reportMissingImports]

with instrument_imports(include=["legsim"]):
    from tools.fuzz import engine, law
    from tools.fuzz.readers import READERS

from legsim.core import files
from tools.fuzz.damage import damaged

LONGEST = 4
"""of an input, in lengths of the longest one to start from"""

_LIBFUZZER = 0.3
"""share of inputs that libFuzzer damages, which knows what the code compares bytes with"""

_ANEW = 0.5
"""share of the others that begin with a first file: damage upon damage is refused early"""


def main(name: str, folder: Path, inputs: int, until: float, seed: int) -> None:
    """Reads damaged files until there were enough, and ends the process."""
    reader, corpus = READERS[name], folder / "corpus"
    path = engine.file_of(reader, folder / f"seed-{seed}")
    path.parent.mkdir()
    with instrument_imports(include=["legsim"]):  # what is imported when it is used
        engine.samples(reader, path)
    first = tuple(file.read_bytes() for file in sorted(corpus.iterdir()))

    def changed(data: bytes, most: int, number: int) -> bytes:
        rng = np.random.default_rng(number)
        if rng.random() < _LIBFUZZER:
            return atheris.Mutate(data, most)
        begin = first[rng.integers(len(first))] if rng.random() < _ANEW else data
        return damaged(begin, rng, first)[:most]

    def read(data: bytes) -> None:
        path.write_bytes(data)
        became = law.outcome(reader, path)
        stream.write(became + "\n")
        place = folder / "firsts" / files.key_of(became)
        if became not in (law.READ, law.REFUSED) and not place.exists():
            place.write_bytes(data)

    seconds = max(1, round(until - time.monotonic()))
    options = (
        *(f"-runs={inputs}", f"-max_total_time={seconds}", f"-seed={seed + 1}"),  # 0: by the clock
        *("-timeout=0", "-rss_limit_mb=0", "-verbosity=0"),  # the law's own limits hold
        "-use_counters=0",  # how often code runs is nothing new
        f"-max_len={LONGEST * max(map(len, first))}",
        str(corpus),
    )
    with (
        engine.limited_memory(),
        (folder / "log").open("a", encoding="utf-8", buffering=1) as stream,
        law.libraries_quiet(),
        law.watched(),
    ):
        atheris.Setup(["guided", *options], read, custom_mutator=changed)
        atheris.Fuzz()


if __name__ == "__main__":
    _, which, where, how_many, how_long, by = sys.argv
    main(which, Path(where), int(how_many), float(how_long), int(by))
