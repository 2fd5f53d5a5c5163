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


class GeometryFormat(StrEnum):
    """Formats of geometry files (:data:`legsim.geometry.files.FORMATS`)."""

    legsim = "legsim"
    rtk = "rtk"
    matrices = "matrices"
    astra = "astra"
    tigre = "tigre"
    conrad = "conrad"
    projtable = "projtable"


class Vertical(StrEnum):
    """The axis of a geometry file that points up."""

    x = "x"
    y = "y"
    z = "z"


GeometryOption = Annotated[
    Path,
    typer.Option(
        "--geometry",
        help="legsim or TIGRE .json, RTK or CONRAD .xml, matrices, ASTRA's vectors or projtable "
        "(.txt, .npy, .mat).",
    ),
]

GeometryFormatOption = Annotated[
    GeometryFormat | None,
    typer.Option("--format", help="Of the geometry file, where its content does not tell."),
]

UpOption = Annotated[
    Vertical,
    typer.Option("--up", help="Axis of the geometry file that becomes world's vertical, y."),
]

ColumnsOption = Annotated[
    int | None,
    typer.Option("--columns", help="Detector columns, where the geometry file does not say."),
]

RowsOption = Annotated[
    int | None, typer.Option("--rows", help="Detector rows, where the geometry file does not say.")
]


def pixel_sizes(text: str | None) -> tuple[float, float] | None:
    """(between columns, between rows) in mm of "0.4" or "0.4x0.3"; None of None.

    Raises:
        typer.BadParameter: it is neither.
    """
    if text is None:
        return None
    try:
        sizes = [float(word) for word in text.lower().split("x")]
    except ValueError:
        sizes = []
    if len(sizes) not in (1, 2) or not all(0 < size < float("inf") for size in sizes):
        raise typer.BadParameter(f"{text!r} is no size; give one as in 0.4 or 0.4x0.3 (mm)")
    return sizes[0], sizes[-1]


def _checked_sizes(text: str | None) -> str | None:
    """The text of a pixel's size, which typer keeps, once it is known to be one."""
    pixel_sizes(text)
    return text


PixelOption = Annotated[
    str | None,
    typer.Option(
        "--pixel-mm",
        metavar="U[xV]",
        callback=_checked_sizes,
        help="Pixel pitch, where the file does not say: 0.4, or 0.4x0.3 between columns and "
        "between rows.",
    ),
]

I0Option = Annotated[
    float | None,
    typer.Option("--i0", help="For counts: the reading without an object, the same everywhere."),
]

AirOption = Annotated[
    str | None,
    typer.Option(
        "--air",
        metavar="X0:X1,Y0:Y1",
        help="For counts: columns and rows that see no object in any view.",
    ),
]

FlatOption = Annotated[
    Path | None, typer.Option("--flat", help="For counts: images without an object; their mean.")
]

DarkOption = Annotated[
    Path | None, typer.Option("--dark", help="For counts: images without a beam; their mean.")
]

BadPixelsOption = Annotated[
    Path | None,
    typer.Option("--bad-pixels", help="For counts: an image that is not 0 where a pixel is bad."),
]

RawOption = Annotated[
    str | None,
    typer.Option(
        "--raw",
        metavar="TYPE:UxVxVIEWS[:BYTES]",
        help="Layout of images without a header, as in U16:620x480x248:512.",
    ),
]

OriginOption = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--origin-mm",
        help="Center of the first pixel on the detector (u, v), for RTK's geometries, where the "
        "images do not say it.",
    ),
]

TurnRowsOption = Annotated[
    bool,
    typer.Option("--turn-rows", help="Take the rows of the images from the last to the first."),
]

LineIntegralsOption = Annotated[
    bool,
    typer.Option(
        "--line-integrals", help="The images hold line integrals, whatever their values look like."
    ),
]
