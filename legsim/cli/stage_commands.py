"""`legsim convert`, `project`, `reconstruct` and `evaluate`: one stage, from files to files."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from legsim.cli import console, progress
from legsim.cli.console import print_lines, print_table
from legsim.cli.options import ColumnsOption, DeviceOption, GeometryOption, PixelOption, RowsOption


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
    minus_x = "-x"
    minus_y = "-y"
    minus_z = "-z"


class Angles(StrEnum):
    """Units of angles in a file of coordinates."""

    degrees = "degrees"
    radians = "radians"


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
        typer.Option(help="Of lengths, where the file is wrong or silent."),
    ] = None,
    up: Annotated[
        Axis | None,
        typer.Option(help="Axis of the markers that points up, where it is not recognized."),
    ] = None,
    angles: Annotated[
        Angles | None,
        typer.Option(help="Unit of the coordinates' angles, where the file is wrong or silent."),
    ] = None,
    degrees: Annotated[
        bool, typer.Option("--degrees", help="Write coordinates in degrees.")
    ] = False,
) -> None:
    """Write a recording in another format: markers in m, y up; coordinates in rad and m."""
    from legsim.cli import file_stages

    lines = file_stages.convert_motion(
        motion,
        out,
        unit=unit and unit.value,
        up=up and up.value,
        in_degrees=degrees,
        angles=angles and angles.value,
    )
    print_lines(lines)


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
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Repair meshes: merge doubles, close small holes, orient triangles alike.",
        ),
    ] = False,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
    device: DeviceOption = None,
) -> None:
    """Line integrals of any set of closed meshes."""
    from legsim.cli import file_stages

    with progress.of_stages(console.err) as on_progress:
        detector = file_stages.DetectorSize(columns, rows, pixel_mm)
        lines = file_stages.project(
            phantom,
            geometry,
            out,
            detector=detector,
            energy_kev=energy_kev,
            settings=tuple(settings or ()),
            repair=repair,
            device=device,
            on_progress=on_progress,
        )
    print_lines(lines)


def reconstruct(
    projections: Annotated[
        Path, typer.Argument(metavar="PROJECTIONS.mha", help="Line integrals, one slice per view.")
    ],
    geometry: GeometryOption,
    motion: Annotated[
        Path | None, typer.Option(help="motion-<method>.npz of a run: the motion to compensate.")
    ] = None,
    like: Annotated[Path | None, typer.Option(help="A volume whose grid to use.")] = None,
    shape_zyx: Annotated[
        tuple[int, int, int] | None,
        typer.Option(
            help="Voxels along z, y, x; where there is no --like. Default: the field of view."
        ),
    ] = None,
    spacing_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            help="Voxel spacing along x, y, z; where there is no --like. Default: a pixel at the "
            "isocenter."
        ),
    ] = None,
    center_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Middle of the grid. Default: the rotation center."),
    ] = None,
    algorithm: Annotated[
        Literal["fdk", "cgls"] | None,
        typer.Option(
            help="fdk (default): filtered back-projection. cgls: conjugate gradients, for few "
            "views, gaps and wide cones."
        ),
    ] = None,
    window: Annotated[
        Literal["ram-lak", "shepp-logan", "hann"] | None,
        typer.Option(help="fdk: window of the ramp filter. Default: shepp-logan."),
    ] = None,
    water_attenuation_per_mm: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="fdk: water cylinder that continues a cut-off object; 0 leaves rows cut off. "
            "Default: 0.02.",
        ),
    ] = None,
    redundancy: Annotated[
        Literal["parker", "none"] | None,
        typer.Option(
            help="fdk: weights of lines measured more than once; none counts every view half. "
            "Default: parker."
        ),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="cgls: steps; fewer are smoother. Default: until a step gains little, 60 at most.",
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="cgls: standard deviation of the line integrals; steps end where the misfit is "
            "as large."
        ),
    ] = None,
    nonnegative: Annotated[
        bool, typer.Option("--nonnegative", help="cgls: keep attenuation at 0 or above.")
    ] = False,
    out: Annotated[Path, typer.Option("--out", help="Volume, 1/mm.")] = Path("volume.mha"),
    device: DeviceOption = None,
) -> None:
    """Reconstruct projections, static or motion-compensated."""
    from legsim.cli import file_stages

    options = {
        "algorithm": algorithm,
        "window": window,
        "water_attenuation_per_mm": water_attenuation_per_mm,
        "redundancy": redundancy,
        "iterations": iterations,
        "noise": noise,
        "nonnegative": nonnegative or None,
    }
    with progress.of_stages(console.err) as on_progress:
        lines = file_stages.reconstruct(
            projections,
            geometry,
            out,
            motion=motion,
            like=like,
            shape_zyx=shape_zyx,
            spacing_mm=spacing_mm,
            center_mm=center_mm,
            options={name: value for name, value in options.items() if value is not None},
            device=device,
            on_progress=on_progress,
        )
    print_lines(lines)


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
    from legsim.cli import file_stages

    rows = file_stages.evaluate(volume, reference, out, regions=regions, register=register)
    print_table(
        f"{volume} against {reference}",
        ("region", "SSIM", "RMSE", "gradient entropy", "voxels"),
        rows,
    )
    console.out.print(f"numbers: {out}")
