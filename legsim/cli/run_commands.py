"""`legsim run`, `replay`, `view` and `doctor`: the whole chain for one scan or one recording."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from legsim.cli import console, progress
from legsim.cli.console import print_lines, print_table
from legsim.cli.inputs import paths_in
from legsim.cli.options import DeviceOption, OutFolder, Preset


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
    force: Annotated[
        bool, typer.Option("--force", help="Scan even a movement that no leg makes.")
    ] = False,
) -> None:
    """Simulate, correct and score one scan, with a report and a recording."""
    from legsim import config
    from legsim.core import files
    from legsim.run import pipeline

    forced = ("motion.implausible=scan",) if force else ()
    settings_tree = config.load_settings(
        config_file, preset=preset.value, overrides=(*(settings or ()), *forced)
    )
    named = paths_in([settings_tree.model_dump()])
    with files.reading(named), progress.of_stages(console.err) as on_progress:
        result = pipeline.run_scan(settings_tree, out, device=device, on_progress=on_progress)
    print_table(
        f"Against the motion-free scan. {result.protocol} Residual motion; at the bones in the "
        "images",
        result.columns(),
        result.rows(),
    )
    print_lines([*(f"warning: {line}" for line in result.warnings), *result.places()])


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
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.osim",
            help="OpenSim model to use, with its markers. Default: legsim's leg.",
        ),
    ] = None,
    marker_set: Annotated[
        Path | None,
        typer.Option(
            metavar="MARKERS.xml",
            help="OpenSim's marker set for the model: replaces its markers of the same names and "
            "adds others.",
        ),
    ] = None,
    scale_model: Annotated[
        bool,
        typer.Option(
            "--scale-model", help="Scale the model to the person by its markers. Default: as it is."
        ),
    ] = False,
    scale_file: Annotated[
        Path | None,
        typer.Option(
            metavar="SCALES.xml", help="OpenSim's scale factors, for legsim's leg or the model."
        ),
    ] = None,
    tasks: Annotated[
        Path | None,
        typer.Option(
            metavar="TASKS.xml",
            help="OpenSim's tasks of inverse kinematics: an IKTaskSet or a whole set-up.",
        ),
    ] = None,
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
    imu: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SEGMENT=]FILE",
            help="Real sensors of the same movement (imu.csv, Xsens .txt, .sto, or a TOML about "
            "another table), to set beside the predicted ones. May be repeated.",
        ),
    ] = None,
) -> None:
    """Kinematics, IMU signals and a recording from one motion file."""
    from legsim import config
    from legsim.core import files
    from legsim.run.replay import replay as replay_recording

    # a path is taken as it is: as an override, a file called 1 would be a number
    options = {"model": model, "marker_set": marker_set, "scale_file": scale_file}
    given: dict[str, object] = {key: str(path) for key, path in options.items() if path}
    if scale_model:
        given["scale_model"] = True
    if tasks:
        given["ik"] = {"tasks_file": str(tasks)}
    if filter_hz is not None:
        given["filter_hz"] = filter_hz
    trees = [config.parse_override(text, config.RunConfig) for text in settings or ()]
    asked = config.from_trees("paper", {"motion": {"file": str(motion)}}, *trees, {"motion": given})
    named = paths_in([asked.model_dump()])
    with files.reading(named), progress.of_stages(console.err) as on_progress:
        result = replay_recording(
            asked,
            out,
            filtered=filter_hz is not None,
            image=image,
            on_progress=on_progress,
            measured=tuple(imu or ()),
        )
    print_lines(result.lines())


def view(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder made by run or replay, or a recording.")
    ],
) -> None:
    """Open the recording in the rerun viewer."""
    from legsim.cli import file_stages

    file_stages.open_recording(folder)


def doctor(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where results would go.")] = Path(),
) -> None:
    """Check OpenCL devices (by running a kernel), packages, memory, disk and viewer."""
    from legsim.cli.doctor import examine

    findings = examine(folder)
    for finding in findings:
        mark = Text("ok  ", "green") if finding.good else Text("bad ", "red")
        cure = "" if finding.good else f"; {finding.cure}"
        console.out.print(mark + f" {finding.topic}: {finding.detail}{cure}")
    if not all(finding.good for finding in findings):
        raise typer.Exit(1)
