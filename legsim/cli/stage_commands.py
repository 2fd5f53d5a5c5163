"""`legsim convert`, `project`, `reconstruct` and `evaluate`: one stage, from files to files."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from legsim.cli import console, progress
from legsim.cli.console import print_lines, print_table
from legsim.cli.options import (
    AirOption,
    BadPixelsOption,
    ColumnsOption,
    DarkOption,
    DeviceOption,
    FlatOption,
    GeometryFormatOption,
    GeometryOption,
    I0Option,
    LineIntegralsOption,
    OriginOption,
    PixelOption,
    RawOption,
    RowsOption,
    TurnRowsOption,
    UpOption,
    Vertical,
    pixel_sizes,
)
from legsim.core.errors import LegsimError


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
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Markers (.trc, .c3d, .csv), coordinates (.mot, .sto, .csv), or a volume in 1/mm "
            "(.mha, .nii, .nii.gz, .nrrd), or a folder of DICOM CT slices.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="The ending says the format: .trc or .csv of markers, "
            ".mot, .sto or .csv of coordinates, .mha, .nii, .nii.gz or .nrrd of volumes; a folder "
            "gets a DICOM CT series.",
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
    axes: Annotated[
        Literal["lps", "world"] | None,
        typer.Option(
            help="Of a volume: its physical axes are left, posterior, superior, or world's. "
            "Default: by its directions; world's where they turn nothing."
        ),
    ] = None,
    water_per_mm: Annotated[
        float | None, typer.Option(help="Attenuation of water, for a DICOM series.")
    ] = None,
    energy_kev: Annotated[
        float | None,
        typer.Option(
            help="Photon energy for water's attenuation instead. Default where a series is "
            "written: 60."
        ),
    ] = None,
) -> None:
    """Write a recording or a volume in another format: markers in m, y up; coordinates in rad and
    m; volumes with anatomical directions.
    """
    from legsim.cli import file_stages, volume_stages

    motion_only = {"unit": unit, "up": up, "angles": angles, "degrees": degrees or None}
    volume_only = {"axes": axes, "water-per-mm": water_per_mm, "energy-kev": energy_kev}
    of_volume = volume_stages.is_volume(source)
    for name, value in (motion_only if of_volume else volume_only).items():
        if value is not None:
            kind = "volume" if of_volume else "recording"
            raise LegsimError(f"{source}: a {kind}, to which --{name} cannot apply; leave it out")
    if of_volume:
        print_lines(
            volume_stages.convert_volume(
                source,
                out,
                axes=axes,
                water_per_mm=water_per_mm,
                energy_kev=energy_kev,
            )
        )
        return
    lines = file_stages.convert_motion(
        source,
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
    format: GeometryFormatOption = None,
    up: UpOption = Vertical.y,
    device: DeviceOption = None,
) -> None:
    """Line integrals of any set of closed meshes."""
    from legsim.cli import file_stages

    with progress.of_stages(console.err) as on_progress:
        reading = file_stages.GeometryOptions(
            columns, rows, pixel_sizes(pixel_mm), format and format.value, up.value
        )
        lines = file_stages.project(
            phantom,
            geometry,
            out,
            reading=reading,
            energy_kev=energy_kev,
            settings=tuple(settings or ()),
            repair=repair,
            device=device,
            on_progress=on_progress,
        )
    print_lines(lines)


def reconstruct(
    projections: Annotated[
        Path,
        typer.Argument(
            metavar="PROJECTIONS",
            help="Line integrals or counts: one file (.mha, .nii, .nrrd, TIFF, DICOM, .npy, raw), "
            "a folder of views, or a pattern as in 'scan/view_*.tif'.",
        ),
    ],
    geometry: GeometryOption,
    i0: I0Option = None,
    air: AirOption = None,
    flat: FlatOption = None,
    dark: DarkOption = None,
    bad_pixels: BadPixelsOption = None,
    raw: RawOption = None,
    pixel_mm: PixelOption = None,
    origin_mm: OriginOption = None,
    turn_rows: TurnRowsOption = False,
    line_integrals: LineIntegralsOption = False,
    format: GeometryFormatOption = None,
    up: UpOption = Vertical.y,
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
        Literal["fdk", "cgls", "tv"] | None,
        typer.Option(
            help="fdk (default): filtered back-projection. cgls: conjugate gradients, for few "
            "views, gaps and wide cones. tv: total variation, for few views of few materials."
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
            help="cgls, tv: steps; fewer are smoother. Default: until a step gains little.",
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the line integrals. cgls: steps end where the misfit is as "
            "large. tv: gives the weight. Default of tv: from the images."
        ),
    ] = None,
    nonnegative: Annotated[
        bool, typer.Option("--nonnegative", help="cgls: keep attenuation at 0 or above.")
    ] = False,
    tv_weight_mm: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="tv: a ball of radius r loses 2 x weight / r^2 of its contrast. Default: by the "
            "noise.",
        ),
    ] = None,
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
        "tv_weight_mm": tv_weight_mm,
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
            images=file_stages.ImageOptions(
                i0,
                air,
                flat,
                dark,
                bad_pixels,
                raw,
                pixel_sizes(pixel_mm),
                origin_mm,
                turn_rows,
                line_integrals,
            ),
            reading=file_stages.GeometryOptions(format=format and format.value, up=up.value),
            device=device,
            on_progress=on_progress,
        )
    print_lines(lines)


def evaluate(
    volume: Annotated[
        Path,
        typer.Argument(
            metavar="VOLUME",
            help="1/mm: .mha, .nii or whatever else ITK reads; or a folder of DICOM CT slices.",
        ),
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
    resample: Annotated[
        bool,
        typer.Option("--resample", help="Bring the volume onto the reference's grid first."),
    ] = False,
    scaling: Annotated[
        Literal["reference", "reference-leg", "percentiles", "extremes"],
        typer.Option(
            help=(
                "Which attenuations become 0 and 1: the reference's range over the grid or in the "
                "regions, or of each volume the 0.5 and 99.5 percentiles or the extremes."
            )
        ),
    ] = "reference",
    window: Annotated[
        Literal["uniform", "gaussian"],
        typer.Option(help="Of SSIM: 7 voxels, or a Gaussian of 1.5 voxels."),
    ] = "uniform",
    water_per_mm: Annotated[
        float | None, typer.Option(help="Attenuation of water, for DICOM slices.")
    ] = None,
    energy_kev: Annotated[
        float | None, typer.Option(help="Photon energy for water's attenuation instead.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The numbers as JSON.")] = Path("metrics.json"),
) -> None:
    """SSIM and RMSE of a volume against a reference, and its gradient entropy, by region."""
    from legsim.cli import file_stages

    scores = file_stages.evaluate(
        volume,
        reference,
        out,
        regions=regions,
        register=register,
        resample=resample,
        scaling=scaling,
        window=window,
        water_per_mm=water_per_mm,
        energy_kev=energy_kev,
    )
    print_table(
        f"{volume} against {reference}. {scores.protocol}",
        ("region", "SSIM", "RMSE", "gradient entropy", "voxels"),
        list(scores.rows()),
    )
    console.out.print(f"numbers: {out}")
