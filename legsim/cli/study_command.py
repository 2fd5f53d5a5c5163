"""`legsim study`: many scans."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from legsim.cli import console, progress
from legsim.cli.console import print_lines
from legsim.cli.options import DeviceOption, OutFolder, Preset
from legsim.core.errors import LegsimError


def study(
    study_file: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A STUDY.toml, or a study that comes with legsim: "
            "paper_order, paper_scheme, quick, sensors, table1, "
            "table1_one_leg, table1_paper, table2, table3.",
        ),
    ],
    out: OutFolder = Path("study"),
    preset: Annotated[
        Preset | None, typer.Option(help="Size of the scans, instead of the study's own.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="a.b=c", help="Change one setting of every run, as in `legsim run`."
        ),
    ] = None,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            "--recording",
            metavar="FILE",
            help="A further recording, one scan more, named after its folder and file.",
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes on this machine; each does one run at a time.")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://...",
            help="A Dask scheduler; its workers must see --out. Default: this machine.",
        ),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            help=(
                "Folder of finished stages to share with other studies, as OTHER/store; on "
                "the file system of --out. Default: OUT/store."
            )
        ),
    ] = None,
    device: DeviceOption = None,
) -> None:
    """Run many scans: subjects x postures x methods x noise levels, beside the published values."""
    from legsim.run.store import check_shared
    from legsim.study import config, plan
    from legsim.study import run as study_run

    if scheduler is not None and workers > 1:
        raise LegsimError(
            "--workers are of this machine, --scheduler has its own: give one of the two"
        )
    overrides = tuple(settings or ())
    asked, base = config.load(
        study_file,
        preset=None if preset is None else preset.value,
        overrides=overrides,
        recordings=tuple(map(str, recordings or ())),
    )
    if store is not None:
        check_shared(store.resolve(), out.resolve())
    planned = plan.plan(asked, base, out.resolve(), device=device, store=store and store.resolve())
    console.err.print(plan.needs(planned, out.resolve(), 0 if scheduler else workers))
    options = ([] if preset is None else ["--preset", preset.value]) + [
        word for setting in overrides for word in ("--set", setting)
    ]
    options += [word for file in recordings or () for word in ("--recording", str(file))]
    options += [] if store is None else ["--store", str(store)]
    command = shlex.join(["legsim", "study", study_file, *options, "--out", str(out)])
    with progress.of_study(console.err) as (runs, stages):
        results = study_run.run(
            asked,
            planned,
            out.resolve(),
            command=command,
            workers=workers,
            scheduler=scheduler,
            on_step=runs,
            on_progress=stages,
        )
    print_lines(study_run.lines(results, out))
    if results.failures:
        for failure in results.failures:
            console.err.print(f"failed: {failure}", style="red")
        raise typer.Exit(1)
