"""`legsim geometry show` and `convert`: the views of a scan."""

from pathlib import Path
from typing import Annotated

import typer

from legsim.cli.console import print_lines
from legsim.cli.options import ColumnsOption, PixelOption, RowsOption


def show(
    file: Annotated[Path, typer.Argument(help="legsim .json, RTK .xml, or matrices.")],
    phantom: Annotated[
        Path | None, typer.Option(help="A PHANTOM.toml: say what of it is cut off.")
    ] = None,
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
) -> None:
    """Field of view, angular range, magnification, and what of a phantom is cut off."""
    from legsim.cli import file_stages

    detector = file_stages.DetectorSize(columns, rows, pixel_mm)
    print_lines(file_stages.describe_geometry(file, detector=detector, phantom=phantom))


def convert(
    file: Annotated[Path, typer.Argument(help="legsim .json, RTK .xml, or matrices.")],
    out: Annotated[
        Path, typer.Option("--out", help="The ending says the format: .json, .xml, .txt or .npy.")
    ],
    columns: ColumnsOption = None,
    rows: RowsOption = None,
    pixel_mm: PixelOption = None,
) -> None:
    """Write the same geometry in another format."""
    from legsim.cli import file_stages

    detector = file_stages.DetectorSize(columns, rows, pixel_mm)
    print_lines(file_stages.convert_geometry(file, out, detector=detector))
