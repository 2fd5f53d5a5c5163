"""Options that several commands share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


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
