"""Damages valid files at random and reads them; see :mod:`tools.fuzz`."""

import sys
import time
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from tools.fuzz import engine, law
from tools.fuzz.readers import READERS


def main(
    reader: Annotated[str, typer.Argument(help=f"One of {', '.join(READERS)}; or all.")],
    inputs: Annotated[float, typer.Option(help="Damaged files for each reader.")] = 1e4,
    seed: Annotated[int, typer.Option(help="Of the damage.", min=0)] = 0,
    seconds: Annotated[float, typer.Option(help="For each reader, at most.")] = 1e6,
    keep: Annotated[Path | None, typer.Option(help="Folder for inputs that must not be.")] = None,
    guided: Annotated[
        bool, typer.Option("--guided", help="By the code that is reached; needs atheris.")
    ] = False,
    corpus: Annotated[
        Path | None, typer.Option(help="Folder for inputs that reach new code, with --guided.")
    ] = None,
) -> None:
    """Damages valid files at random and reads them."""
    failed = False
    for name in READERS if reader == "all" else (reader,):
        begun = time.monotonic()
        if guided:
            found, firsts = engine.guided(name, int(inputs), seed, seconds=seconds, kept=corpus)
        else:
            found, firsts = engine.fuzz(name, int(inputs), seed, seconds=seconds)
        typer.echo(report(name, found, time.monotonic() - begun))
        failed |= bool(firsts)
        if keep is not None:
            engine.keep(keep, name, firsts)
        sys.stdout.flush()
    raise typer.Exit(1 if failed else 0)


def report(name: str, found: Counter[str], seconds: float) -> str:
    """A line of counts, and one for everything that must not be."""
    lines = [
        f"{name}: {found.total()} inputs in {seconds:.0f} s, {found[law.READ]} read, "
        f"{found[law.REFUSED]} refused"
    ]
    for what, count in found.most_common():
        if what not in (law.READ, law.REFUSED):
            lines.append(f"  {count} x {what}")
    return "\n".join(lines)


if __name__ == "__main__":
    typer.run(main)
