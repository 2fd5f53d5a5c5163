"""`legsim geometry show` and `convert`: the views of a scan."""

from pathlib import Path
from typing import Annotated

import typer

from legsim.cli.console import print_lines
from legsim.cli.options import (
    ColumnsOption,
    GeometryFormat,
    GeometryFormatOption,
    PixelOption,
    RowsOption,
    UpOption,
    Vertical,
    pixel_sizes,
)

_FILE = "legsim or TIGRE .json, RTK or CONRAD .xml, matrices, ASTRA's vectors or projtable."


def show(
    file: Annotated[Path, typer.Argument(help=_FILE)],
    phantom: Annotated[
        Path | None, typer.Option(help="A PHANTOM.toml: say what of it is cut off.")
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
    format: GeometryFormatOption = None,
    up: UpOption = Vertical.y,
) -> None:
    """Field of view, angular range, magnification, and what of a phantom is cut off."""
    from legsim.cli import file_stages

    reading = file_stages.GeometryOptions(
        columns, rows, pixel_sizes(pixel_mm), format and format.value, up.value
    )
    print_lines(file_stages.describe_geometry(file, reading=reading, phantom=phantom))


def convert(
    file: Annotated[Path, typer.Argument(help=_FILE)],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="The ending says the format: .json (legsim), .xml (RTK), .txt or .npy (matrices), "
            "unless --to does.",
        ),
    ],
    to: Annotated[
        GeometryFormat | None,
        typer.Option(
            help="Format to write: tigre as .json, conrad as .xml, astra as .txt or .npy, "
            "projtable as .txt."
        ),
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
    format: GeometryFormatOption = None,
    up: UpOption = Vertical.y,
    turn_rows: Annotated[
        bool,
        typer.Option(
            "--turn-rows",
            help="Count the detector's rows from the other edge, for images whose rows are turned.",
        ),
    ] = False,
) -> None:
    """Write the same geometry in another format."""
    from legsim.cli import file_stages

    reading = file_stages.GeometryOptions(
        columns, rows, pixel_sizes(pixel_mm), format and format.value, up.value
    )
    print_lines(
        file_stages.convert_geometry(
            file, out, reading=reading, to=to and to.value, turn_rows=turn_rows
        )
    )
