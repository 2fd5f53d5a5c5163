"""What the choices of the comparison change: scaling of the volumes, window of SSIM, reference.

    python -m tools.experiments.scalings FOLDER [--preset half] [--set phantom.legs=scanned ...]

The folder gets the scan's run, or has it from an earlier call. Every volume is compared with the
motion-free one under each scaling, in both windows of SSIM under the default scaling, and with the
phantom. Published beside each table is the order of the methods.
"""

import warnings
from pathlib import Path
from typing import Annotated

import typer

from legsim import config
from legsim.evaluation import similarity
from legsim.evaluation.scaling import SCALINGS, Scaling
from legsim.evaluation.similarity import RegionScores
from legsim.evaluation.ssim import WINDOWS, Window
from legsim.geometry import image_files
from legsim.geometry.volume import Volume
from legsim.opencl.device import open_device
from legsim.reconstruction.weights import ShortScanWarning
from legsim.run import methods, pipeline
from legsim.run import motion as run_motion
from legsim.run.c_arm import c_arm
from legsim.simulation.setup import PhantomOptions, prepare_scan, scan_regions, true_volume

CHOICES: tuple[tuple[Scaling, Window], ...] = (
    *((scaling, "uniform") for scaling in SCALINGS),
    ("reference", "gaussian"),
)

Column = dict[str, RegionScores]
"""scores of the whole leg by method"""


def columns(settings: config.RunConfig, folder: Path) -> dict[tuple[Scaling, Window], Column]:
    """Scores of every method's volume in the run's folder, by choice."""
    device = open_device()
    person = run_motion.solve(settings.motion)
    options = PhantomOptions(
        settings.phantom.legs, settings.phantom.detail, settings.phantom.energy_kev
    )
    setup = prepare_scan(person, c_arm(settings.scan), side=settings.scan.side, phantom=options)
    reference = load(folder, methods.REFERENCE)
    margin = 1e-3 * settings.evaluation.air_margin_mm
    regions = scan_regions(setup, reference.grid, device, margin=margin)
    true = true_volume(setup, reference.grid, device, regions)
    found: dict[tuple[Scaling, Window], Column] = {choice: {} for choice in CHOICES}
    for name in dict.fromkeys((methods.REFERENCE, *map(methods.label, settings.methods.run))):
        volume = load(folder, name)
        for scaling, window in CHOICES:
            scores = similarity.evaluate(
                volume,
                reference,
                regions,
                scaling=scaling,
                window=window,
                phantom=true,
                device=device,
            )
            found[scaling, window][name] = scores.of("leg")
    return found


def load(folder: Path, name: str) -> Volume:
    """A method's volume."""
    return image_files.load_volume(folder / f"volume-{name}.mha")


def table(found: dict[tuple[Scaling, Window], Column], field: str, digits: int = 4) -> list[str]:
    """Rows of Markdown, a method each; a column per choice."""
    heads = [f"{scaling}, {window}" for scaling, window in found]
    lines = ["", f"| {field} | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    for name in next(iter(found.values())):
        cells = (f"{getattr(column[name], field):.{digits}f}" for column in found.values())
        lines.append(f"| {name} | {' | '.join(cells)} |")
    best = "best first"
    orders = []
    for column in found.values():
        others = [name for name in column if name != methods.REFERENCE]
        better = -1 if field.startswith("ssim") else 1
        others.sort(key=lambda name, c=column: better * getattr(c[name], field))
        orders.append(", ".join(others))
    return [*lines, f"| {best} | {' | '.join(orders)} |"]


def main(
    folder: Annotated[Path, typer.Argument(help="Of the scan's run.")],
    preset: Annotated[str, typer.Option(help="demo, half or paper.")] = "half",
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="a.b=c", help="As in `legsim run`.")
    ] = None,
) -> None:
    """Runs the scan where it was not run, and prints a table per measure."""
    chosen = config.load_settings(preset=preset, overrides=tuple(settings or ()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortScanWarning)
        pipeline.run_scan(chosen, folder, presented=False)
    for scaling, words in SCALINGS.items():
        typer.echo(f"{scaling}: {words}")
    for window, words in WINDOWS.items():
        typer.echo(f"{window}: {words}")
    found = columns(chosen, folder)
    for field in ("ssim", "rmse", "ssim_phantom", "rmse_phantom"):
        for line in table(found, field):
            typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
