"""`legsim correct`: a measured scan, its sensors and methods, to volumes without any truth."""

from pathlib import Path
from typing import Annotated

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
    I0Option,
    LineIntegralsOption,
    OriginOption,
    OutFolder,
    PixelOption,
    RawOption,
    RowsOption,
    TurnRowsOption,
    UpOption,
    Vertical,
    pixel_sizes,
)


def correct(
    scan: Annotated[
        Path,
        typer.Argument(
            metavar="SCAN.toml|PROJECTIONS",
            help="All that was recorded, as docs/correct.md describes it; or images alone.",
        ),
    ],
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="rigid, rigid@<sensor>, nonrigid-3d, fused, autofocus or another of "
            "docs/methods.md, or your own as path/to/file.py:function. May be repeated. The "
            "uncorrected scan always comes along.",
        ),
    ] = None,
    geometry: Annotated[
        Path | None,
        typer.Option(help="With PROJECTIONS: as of `legsim reconstruct`."),
    ] = None,
    imu: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="With PROJECTIONS: a file of sensors, or a TOML about one with where the sensors "
            "start. May be repeated.",
        ),
    ] = None,
    view_rate_hz: Annotated[
        float | None,
        typer.Option(help="With PROJECTIONS: views per second; the first view is at 0 s."),
    ] = None,
    view_times: Annotated[
        Path | None, typer.Option(help="With PROJECTIONS: a file of one time in s per view.")
    ] = None,
    like: Annotated[
        Path | None, typer.Option(help="With PROJECTIONS: a volume whose grid to use.")
    ] = None,
    shape_zyx: Annotated[
        tuple[int, int, int] | None,
        typer.Option(help="With PROJECTIONS: voxels along z, y, x. Default: the field of view."),
    ] = None,
    spacing_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="With PROJECTIONS: voxel spacing along x, y, z. Default: a pixel's."),
    ] = None,
    center_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="With PROJECTIONS: middle of the grid. Default: the rotation center."),
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
    origin_mm: OriginOption = None,
    raw: RawOption = None,
    turn_rows: TurnRowsOption = False,
    line_integrals: LineIntegralsOption = False,
    format: GeometryFormatOption = None,
    up: UpOption = Vertical.y,
    i0: I0Option = None,
    air: AirOption = None,
    flat: FlatOption = None,
    dark: DarkOption = None,
    bad_pixels: BadPixelsOption = None,
    out: OutFolder = Path("corrected"),
    device: DeviceOption = None,
) -> None:
    """Correct the motion of a measured scan by its sensors, or by a method of your own."""
    from legsim.core.errors import LegsimError
    from legsim.run import correct as run_correct

    if not method:
        raise LegsimError("which method? give --method NAME, as in --method rigid")
    grid = {"shape_zyx": shape_zyx, "spacing_mm": spacing_mm, "center_mm": center_mm}
    options = {
        "geometry": geometry,
        "imu": imu or None,
        "view_rate_hz": view_rate_hz,
        "view_times": view_times,
        "columns": columns,
        "rows": rows,
        "pixel_mm": pixel_sizes(pixel_mm),
        "origin_mm": origin_mm,
        "raw": raw,
        "turn_rows": turn_rows or None,
        "line_integrals": line_integrals or None,
        "format": format and format.value,
        "up": None if up is Vertical.y else up.value,
        "i0": i0,
        "air": air,
        "flat": flat,
        "dark": dark,
        "bad_pixels": bad_pixels,
        **grid,
        "like": like,
    }
    given = {name: value for name, value in options.items() if value is not None}
    with progress.of_stages(console.err) as on_progress:
        result = run_correct.correct(
            run_correct.described(scan, given), method, out, device=device, on_progress=on_progress
        )
    print_table(
        "Sharpness by gradient entropy (lower is sharper), and motion against the first view",
        result.columns(),
        result.rows(),
    )
    print_lines(result.lines())
