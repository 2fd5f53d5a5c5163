"""The `legsim` command. The only module that prints or decides an exit code; `progress` draws on
its console.

A command imports what it runs, so that help and mistaken options are answered at once.
"""

import errno
import os
import re
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
import typer.exceptions
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from legsim import __version__
from legsim.cli import progress
from legsim.core.errors import LegsimError

app = typer.Typer(
    help=(
        "Simulate a weight-bearing knee CT from motion capture, correct its motion, and tell "
        "how well that worked."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

geometry_app = typer.Typer(
    help="Look at a scan geometry, or convert it between legsim JSON, RTK XML and plain matrices.",
    no_args_is_help=True,
)
app.add_typer(geometry_app, name="geometry")

ColumnsOption = Annotated[
    int | None,
    typer.Option("--columns", help="Detector columns, where the geometry file does not say."),
]

RowsOption = Annotated[
    int | None, typer.Option("--rows", help="Detector rows, where the geometry file does not say.")
]

PixelOption = Annotated[
    float | None,
    typer.Option("--pixel-mm", help="Pixel pitch, where the geometry file does not say."),
]

_INTERRUPTED = 130
"""exit code of a command that Ctrl-C ended, as shells have it and typer returns it"""

_RESUMED = ("run", "replay", "study")
"""commands whose folders keep each finished part"""

_warned: set[str] = set()
"""what was already told"""

_out = Console(highlight=False, soft_wrap=True)

_err = Console(stderr=True, highlight=False, soft_wrap=True)


class Preset(StrEnum):
    """Sizes of a run."""

    demo = "demo"
    half = "half"
    paper = "paper"


OutFolder = Annotated[
    Path,
    typer.Option(
        "--out",
        help=(
            "Folder for the results; made if it is not there. A second run there goes on "
            "where the first one stopped."
        ),
    ),
]

DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help=(
            "Part of an OpenCL device's name (see `legsim doctor`), or cpu or gpu. Default: "
            "LEGSIM_DEVICE, else the fastest."
        ),
    ),
]

GeometryOption = Annotated[
    Path,
    typer.Option(
        "--geometry",
        help="legsim .json, RTK .xml, or one 3x4 matrix per view as .txt or .npy "
        "(world mm to pixels).",
    ),
]


def _table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    table = Table(title=title, title_justify="left", box=box.SIMPLE)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # a line that the terminal wraps can still be read; a cell cut short cannot
    Console(highlight=False, width=max(_out.width, 240)).print(table)


@app.command()
def run(
    config_file: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG.toml", help="What to change against the preset."),
    ] = None,
    preset: Annotated[
        Preset,
        typer.Option(
            help="paper: 620x480 pixels, 512^3 voxels; half: half of both; "
            "demo: minutes on a laptop."
        ),
    ] = Preset.paper,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="a.b=c",
            help="Change one setting, as in --set motion.file=walk.trc. May be repeated.",
        ),
    ] = None,
    out: OutFolder = Path("run"),
    device: DeviceOption = None,
) -> None:
    """The whole chain for one scan: motion to corrected volumes, with table, recording and
    report.
    """
    from legsim import config
    from legsim.run import pipeline

    settings_tree = config.load(config_file, preset=preset.value, overrides=tuple(settings or ()))
    with progress.of_stages(_err) as on_progress:
        result = pipeline.run(settings_tree, out, device=device, on_progress=on_progress)
    _table(
        "Against the motion-free scan (volumes scaled 0 to 1, registered); residual motion; at "
        "the bones in the images",
        result.columns(),
        result.rows(),
    )
    for line in result.places():
        _out.print(line, markup=False)


@app.command()
def replay(
    motion: Annotated[
        Path,
        typer.Argument(
            metavar="MOTION",
            help=(
                "Markers (.trc, .c3d, .csv), solved for joint angles; or coordinates (.mot, "
                ".sto, .csv), taken as they are."
            ),
        ),
    ],
    out: OutFolder = Path("replay"),
    filter_hz: Annotated[
        float | None,
        typer.Option(
            help="Zero-phase low-pass; 0 for none. Default: 6 for markers, none for coordinates."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="a.b=c",
            help="As in `legsim run`: motion.unit=mm, motion.up=z, imu.rate_hz=100 ...",
        ),
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(help="Also draw a still picture (.png) of the middle of the recording."),
    ] = None,
) -> None:
    """Kinematics, IMU signals and a recording to look at, from one motion file."""
    from legsim import config
    from legsim.run.replay import replay as replay_recording

    overrides = [f"motion.file={motion}", *(settings or ())]
    if filter_hz is not None:
        overrides.append(f"motion.filter_hz={filter_hz}")
    with progress.of_stages(_err) as on_progress:
        result = replay_recording(
            config.load(overrides=tuple(overrides)),
            out,
            filtered=filter_hz is not None,
            image=image,
            on_progress=on_progress,
        )
    for line in result.lines():
        _out.print(line, markup=False)


class Unit(StrEnum):
    """Of length in a marker file."""

    m = "m"
    cm = "cm"
    mm = "mm"


class Axis(StrEnum):
    """Of the laboratory, upwards."""

    x = "x"
    y = "y"
    z = "z"


@app.command()
def convert(
    motion: Annotated[
        Path,
        typer.Argument(
            metavar="MOTION", help="Markers (.trc, .c3d, .csv) or coordinates (.mot, .sto, .csv)."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="The ending says the format: .trc or .csv of markers, "
            ".mot, .sto or .csv of coordinates.",
        ),
    ],
    unit: Annotated[
        Unit | None,
        typer.Option(help="Of the markers' lengths, where the file is wrong or silent."),
    ] = None,
    up: Annotated[
        Axis | None,
        typer.Option(help="Axis of the markers that points up, where it is not seen rightly."),
    ] = None,
    degrees: Annotated[
        bool, typer.Option("--degrees", help="Write coordinates in degrees.")
    ] = False,
) -> None:
    """Write the same recording in another format: markers in m with y up, coordinates in radians
    and m.
    """
    from legsim.cli import commands

    lines = commands.convert_motion(
        motion, out, unit=unit and unit.value, up=up and up.value, in_degrees=degrees
    )
    for line in lines:
        _out.print(line)


@app.command()
def project(
    phantom: Annotated[
        Path,
        typer.Argument(
            metavar="PHANTOM.toml", help="Closed meshes with a material each, outermost first."
        ),
    ],
    geometry: GeometryOption,
    out: Annotated[Path, typer.Option("--out", help="Projections, 32-bit .mha.")] = Path(
        "projections.mha"
    ),
    energy_kev: Annotated[
        float, typer.Option(help="Photon energy for parts given by material.")
    ] = 60.0,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="a.b=c",
            help="Beam and detector as in `legsim run`: "
            "scan.detector.photons=1e5, scan.spectrum.kind=tube.",
        ),
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
    device: DeviceOption = None,
) -> None:
    """Line integrals of any set of closed meshes."""
    from legsim.cli import commands

    with progress.of_stages(_err) as on_progress:
        detector = commands.DetectorSize(columns, rows, pixel_mm)
        lines = commands.project(
            phantom,
            geometry,
            out,
            detector=detector,
            energy_kev=energy_kev,
            settings=tuple(settings or ()),
            device=device,
            on_progress=on_progress,
        )
    for line in lines:
        _out.print(line, markup=False)


@app.command()
def reconstruct(
    projections: Annotated[
        Path, typer.Argument(metavar="PROJECTIONS.mha", help="Line integrals, one slice a view.")
    ],
    geometry: GeometryOption,
    motion: Annotated[
        Path | None, typer.Option(help="motion-<method>.npz of a run: the motion to compensate.")
    ] = None,
    like: Annotated[Path | None, typer.Option(help="A volume whose grid to use.")] = None,
    shape_zyx: Annotated[
        tuple[int, int, int] | None,
        typer.Option(help="Voxels along z, y, x; where there is no --like."),
    ] = None,
    spacing_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Voxel spacing along x, y, z; where there is no --like."),
    ] = None,
    center_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Middle of the grid. Default: the rotation center."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Volume, 1/mm.")] = Path("volume.mha"),
    device: DeviceOption = None,
) -> None:
    """FDK, static or motion-compensated."""
    from legsim.cli import commands

    with progress.of_stages(_err) as on_progress:
        lines = commands.reconstruct(
            projections,
            geometry,
            out,
            motion=motion,
            like=like,
            shape_zyx=shape_zyx,
            spacing_mm=spacing_mm,
            center_mm=center_mm,
            device=device,
            on_progress=on_progress,
        )
    for line in lines:
        _out.print(line, markup=False)


@app.command()
def evaluate(
    volume: Annotated[
        Path, typer.Argument(metavar="VOLUME", help="1/mm: .mha, .nii or whatever else ITK reads.")
    ],
    reference: Annotated[
        Path,
        typer.Argument(metavar="REFERENCE", help="The volume to compare with, on the same grid."),
    ],
    regions: Annotated[
        Path | None,
        typer.Option(
            help=(
                "Label volume on the same grid (each value above 0 a region). Default: the "
                "largest upright cylinder."
            )
        ),
    ] = None,
    register: Annotated[
        bool, typer.Option(help="Register the volume to the reference first.")
    ] = True,
    out: Annotated[Path, typer.Option("--out", help="The numbers as JSON.")] = Path("metrics.json"),
) -> None:
    """SSIM and RMSE of a volume against a reference, and its gradient entropy, by region."""
    from legsim.cli import commands

    rows = commands.evaluate(volume, reference, out, regions=regions, register=register)
    _table(
        f"{volume} against {reference}",
        ("region", "SSIM", "RMSE", "gradient entropy", "voxels"),
        rows,
    )
    _out.print(f"numbers: {out}", markup=False)


@app.command()
def study(
    study_file: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A STUDY.toml, or a study that comes with legsim: "
            "paper_order, paper_scheme, quick, table1, "
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
    workers: Annotated[
        int, typer.Option(min=1, help="Processes on this machine, each with a run of its own.")
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
    """Subjects x postures x methods x noise levels, with tables and figures beside the published
    ones.
    """
    from legsim.run.store import check_shared
    from legsim.study import config, plan
    from legsim.study import run as study_run

    if scheduler is not None and workers > 1:
        raise LegsimError(
            "--workers are of this machine, --scheduler has its own: give one of the two"
        )
    overrides = tuple(settings or ())
    asked, base = config.load(
        study_file, preset=None if preset is None else preset.value, overrides=overrides
    )
    if store is not None:
        check_shared(store.resolve(), out.resolve())
    planned = plan.plan(asked, base, out.resolve(), device=device, store=store and store.resolve())
    _err.print(plan.needs(planned, out.resolve(), 0 if scheduler else workers), markup=False)
    options = ([] if preset is None else ["--preset", preset.value]) + [
        word for setting in overrides for word in ("--set", setting)
    ]
    options += [] if store is None else ["--store", str(store)]
    command = shlex.join(["legsim", "study", study_file, *options, "--out", str(out)])
    with progress.of_study(_err) as (runs, stages):
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
    for line in study_run.lines(results, out):
        _out.print(line, markup=False)
    if results.failures:
        for failure in results.failures:
            _err.print(f"failed: {failure}", style="red", markup=False)
        raise typer.Exit(1)


@geometry_app.command("show")
def geometry_show(
    file: Annotated[Path, typer.Argument(help="legsim .json, RTK .xml, or matrices.")],
    phantom: Annotated[
        Path | None, typer.Option(help="A PHANTOM.toml: say what of it is cut off.")
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
) -> None:
    """Field of view, angular range, magnification, and what of a phantom is cut off."""
    from legsim.cli import commands

    for line in commands.describe_geometry(
        file, detector=commands.DetectorSize(columns, rows, pixel_mm), phantom=phantom
    ):
        _out.print(line, markup=False)


@geometry_app.command("convert")
def geometry_convert(
    file: Annotated[Path, typer.Argument(help="legsim .json, RTK .xml, or matrices.")],
    out: Annotated[
        Path, typer.Option("--out", help="The ending says the format: .json, .xml, .txt or .npy.")
    ],
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
) -> None:
    """Write the same geometry in another format."""
    from legsim.cli import commands

    for line in commands.convert_geometry(
        file, out, detector=commands.DetectorSize(columns, rows, pixel_mm)
    ):
        _out.print(line, markup=False)


@app.command()
def view(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder made by run or replay, or a recording.")
    ],
) -> None:
    """Open the recording in the rerun viewer."""
    from legsim.cli import commands

    commands.open_recording(folder)


@app.command("doctor")
def doctor_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where results would go.")] = Path(),
) -> None:
    """What works here: OpenCL devices (each probed by running a kernel), memory, disk, rerun,
    formats.
    """
    from legsim.cli import doctor

    findings = doctor.examine(folder)
    for finding in findings:
        mark = "[green]ok[/]  " if finding.good else "[red]bad[/] "
        _out.print(
            mark
            + escape(
                f" {finding.topic}: {finding.detail}"
                + (f"; {finding.cure}" if not finding.good else "")
            )
        )
    if not all(finding.good for finding in findings):
        raise typer.Exit(1)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show where an error came from.")] = False,
) -> None:
    if version:
        _out.print(f"legsim {__version__}")
        raise typer.Exit
    if debug:
        os.environ["LEGSIM_DEBUG"] = "1"


def _warn(message: Warning | str, *_: object) -> None:
    """Once, numbers aside: much the same holds for every volume of a run."""
    told = re.sub(r"[\d.]+", "", str(message))
    if told in _warned:
        return
    _warned.add(told)
    _err.print(f"[yellow]warning:[/] {escape(str(message))}")


def _explain(error: Exception) -> str | None:
    """The one line for an error that a user can mend, None for one that is ours."""
    if isinstance(error, LegsimError):
        return str(error)
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return (
            f"{error.filename or 'the output folder'}: the disk is full; free some space or "
            "choose another folder, then run this again"
        )
    if isinstance(error, OSError):
        return (
            f"{error.filename or ''}: {error.strerror or error}; check the path and its permissions"
        )
    if isinstance(error, MemoryError):
        return (
            "the memory is full; use a smaller preset or grid (legsim doctor tells what there is)"
        )
    return None


class _Terminated(SystemExit):
    """What SIGTERM becomes, so that half-written files are removed on the way out."""


@contextmanager
def _termination_told() -> Iterator[None]:
    """SIGTERM, as batch systems and process managers send it, ends a command as Ctrl-C does."""
    if (
        threading.current_thread() is not threading.main_thread()
    ):  # where Python lets nobody set handlers
        yield
        return

    def terminate(number: int, _: object) -> None:
        raise _Terminated(128 + number)

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell_end(how: str, arguments: list[str]) -> None:
    """One line on what a command that was stopped leaves behind."""
    command = next((a for a in arguments if not a.startswith("-")), "")
    kept = "finished stages are kept, the same command continues from there"
    restarted = "half-written files are removed, the same command starts again"
    _err.print(f"{how}; {kept if command in _RESUMED else restarted}")


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; exit code 0 only on success, 130 on Ctrl-C, 143 on SIGTERM, one line
    for an error unless --debug.
    """
    handler: Callable[..., None] = _warn
    warnings.showwarning = handler
    arguments = sys.argv[1:] if arguments is None else arguments
    if "--debug" in arguments:  # wherever it stands on the line
        arguments = ["--debug", *(a for a in arguments if a != "--debug")]
    try:
        with _termination_told():
            code = app(args=arguments, prog_name="legsim", standalone_mode=False) or 0
        if code == _INTERRUPTED:
            _tell_end("interrupted", arguments)
        sys.exit(code)
    except _Terminated:
        _tell_end("terminated", arguments)
        raise
    except typer.exceptions.TyperException as error:
        _err.print(
            f"error: {error.format_message()} (the command's --help says more)".replace("\n", " "),
            style="red",
            markup=False,
        )
        sys.exit(error.exit_code)
    except Exception as error:
        line = _explain(error)
        if line is None or "--debug" in arguments:
            raise
        _err.print(f"error: {line}".replace("\n", " "), style="red", markup=False)
        sys.exit(1)
