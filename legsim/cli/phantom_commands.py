"""`legsim phantom from-labels`: a phantom from a segmentation."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from legsim.cli.console import print_lines, print_table
from legsim.core.errors import LegsimError


def from_labels(
    labels: Annotated[
        list[Path],
        typer.Argument(
            metavar="LABELS...",
            help="Segmentations on one grid (.nii.gz, .nrrd, .mha); later ones displace earlier.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of PHANTOM.toml and its meshes.")],
    maps: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="MAP",
            help="What the numbers are: a .toml, totalsegmentator_total and the like, or a list of "
            "names (.json, .ctbl, ITK-SNAP's .txt, dseg.tsv); one per segmentation. Default: the "
            "names in the segmentation itself (TotalSegmentator, 3D Slicer, MITK), or a mask's "
            "file name.",
        ),
    ] = None,
    side: Annotated[
        Literal["left", "right"] | None,
        typer.Option(help="Of a single leg, where the map leaves it open."),
    ] = None,
    axes: Annotated[
        Literal["lps", "world"],
        typer.Option(
            help="Physical axes of the files: lps (left, posterior, superior), as of a scanner and "
            "of legsim's volumes, or world."
        ),
    ] = "lps",
    cortex_mm: Annotated[
        float, typer.Option(help="Cortex of bones; 0: cancellous throughout.")
    ] = 2.0,
    cartilage_mm: Annotated[
        float, typer.Option(help="Cartilage added to the faces of the joints; 0: none.")
    ] = 0.0,
    ignore: Annotated[
        str, typer.Option(metavar="N,N,...", help="Numbers to leave out that no map names.")
    ] = "",
) -> None:
    """Smooth closed meshes of a segmentation, as a phantom that moves with the leg model."""
    from legsim.geometry.label_images import load_label_image
    from legsim.phantom import from_labels as meshing
    from legsim.phantom.label_maps import load_label_map, own_map
    from legsim.phantom.label_structures import structure_grid

    given = [load_label_map(name) for name in maps or ()]
    images = [load_label_image(path, axes=axes) for path in labels]
    read = given or [own_map(image) for image in images]
    grid = structure_grid(images, read, side=side and side[0], ignore=_numbers(ignore))
    meshed = meshing.mesh_labels(grid, meshing.Layers(1e-3 * cortex_mm, 1e-3 * cartilage_mm))
    path = meshing.save(out, meshed)
    print_table(
        f"{len(meshed.parts)} parts",
        ("structure", "labels cm3", "with what is below others", "mesh cm3", "difference"),
        [
            (
                row.name,
                f"{1e6 * row.labels:.2f}",
                f"{1e6 * row.meshed:.2f}",
                f"{1e6 * row.mesh:.2f}",
                f"{100 * (row.mesh / row.meshed - 1):+.2f} %",
            )
            for row in meshed.volumes
        ],
    )
    print_lines([*meshed.remarks, f"phantom: {path}"])


def _numbers(text: str) -> frozenset[int]:
    words = text.replace(",", " ").split()
    if not all(word.isdecimal() for word in words):
        raise LegsimError(f"--ignore {text}: expected whole numbers, as in --ignore 3,17")
    return frozenset(int(word) for word in words)
