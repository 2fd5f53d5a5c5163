"""Benchmarks, one sub-command each: `python -m tools.benchmarks ik --data RECORDINGS`."""

from pathlib import Path
from typing import Annotated

import typer

from legsim.core.errors import LegsimError
from legsim.opencl.device import open_device

app = typer.Typer(
    help="Benchmarks of legsim against other toolkits and itself.", no_args_is_help=True
)


@app.callback()
def main() -> None:
    """Benchmarks of legsim, side by side with other toolkits where there is one."""


@app.command()
def device(name: Annotated[str, typer.Argument(help="As in LEGSIM_DEVICE.")] = "gpu") -> None:
    """Look for a device, so that the other commands need not begin without it."""
    try:
        typer.echo(open_device(name))
    except LegsimError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(1) from None


@app.command()
def ik(
    data: Annotated[Path, typer.Option(help="Folder with mocap/ and opensim/.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Markdown file whose section between the marks `<!-- ik -->` is replaced."
        ),
    ] = None,
) -> None:
    """Inverse kinematics beside OpenSim's: coordinates, residuals, frames per second."""
    from tools.benchmarks import ik as bench_ik

    text = bench_ik.run(data)
    typer.echo(text)
    if out is not None:
        bench_ik.replace_section(out, text)


@app.command()
def project(
    sizes: Annotated[
        str, typer.Option(help="Comma-separated, of 1e4, 1e5, 1e6, 1e7 triangles.")
    ] = "1e4,1e5,1e6",
    views: Annotated[int, typer.Option(help="Views a scene; 248 make a scan.")] = 8,
    device: Annotated[str | None, typer.Option(help="OpenCL device, as in LEGSIM_DEVICE.")] = None,
    gvxr_python: Annotated[
        str | None, typer.Option(help="A Python with the gvxr wheel, to compare with.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="JSON file for the rows.")] = None,
) -> None:
    """Projection: seconds a view of 620x480 against triangles, beside gVirtualXray's on the same
    meshes.
    """
    from tools.benchmarks import projection as bench_project

    bench_project.run(sizes.split(","), views, device, gvxr_python, out, typer.echo)


@app.command()
def project_errors(
    device: Annotated[str | None, typer.Option(help="OpenCL device, as in LEGSIM_DEVICE.")] = None,
) -> None:
    """Projection: path lengths against float64 ray casting, situation by situation."""
    from tools.benchmarks import projection_errors as bench_project_errors

    bench_project_errors.table(open_device(device), typer.echo)


@app.command()
def fdk(
    views: Annotated[
        int, typer.Option(help="Views over the paper's range of 197.6 degrees.")
    ] = 248,
    count: Annotated[int, typer.Option(help="Voxels along each side of the cube of 256 mm.")] = 512,
    binning: Annotated[
        int,
        typer.Option(help="Detector pixels are this many times as large as the paper's 0.616 mm."),
    ] = 1,
    device: Annotated[str | None, typer.Option(help="Part of an OpenCL device's label.")] = None,
    rtk_python: Annotated[
        Path | None, typer.Option(help="A Python with itk-rtk, to run RTK on the same projections.")
    ] = None,
    textures: Annotated[
        bool | None,
        typer.Option(
            help="Images from buffers and through texture units, one after the other; by default "
            "on GPUs. CPUs do the latter in software, which is slow."
        ),
    ] = None,
) -> None:
    """Filtered back-projection: seconds and errors, beside RTK's."""
    from tools.benchmarks import fdk as bench_fdk

    typer.echo(bench_fdk.run(views, count, binning, device, rtk_python, textures))


@app.command()
def fdk_rounding(
    views: Annotated[
        int, typer.Option(help="Views over the paper's range of 197.6 degrees.")
    ] = 248,
    slices: Annotated[int, typer.Option(help="Slices of 512 x 512 voxels of 0.5 mm.")] = 8,
    noise: Annotated[
        float, typer.Option(help="Standard deviation of noise in the line integrals.")
    ] = 0.02,
    device: Annotated[str | None, typer.Option(help="Part of an OpenCL device's label.")] = None,
) -> None:
    """Filtered back-projection: what texture units change that know places in a pixel to 8 bits."""
    from tools.benchmarks import fdk_rounding as bench_fdk_rounding

    for line in bench_fdk_rounding.run(views, slices, noise, device):
        typer.echo(line)


@app.command()
def fdk_profile(
    views: Annotated[
        int, typer.Option(help="Views over the paper's range of 197.6 degrees.")
    ] = 248,
    count: Annotated[int, typer.Option(help="Voxels along each side of the cube of 256 mm.")] = 512,
    binning: Annotated[
        int,
        typer.Option(help="Detector pixels are this many times as large as the paper's 0.616 mm."),
    ] = 1,
    device: Annotated[str | None, typer.Option(help="Part of an OpenCL device's label.")] = None,
) -> None:
    """Filtered back-projection: seconds per stage, and how far the kernels are from what the device
    can do.
    """
    from tools.benchmarks import fdk_profile as bench_fdk_profile

    typer.echo(bench_fdk_profile.run(views, count, binning, device))


@app.command()
def evaluation(
    counts: Annotated[
        str, typer.Option(help="Comma-separated: voxels along each side of the cube of 256 mm.")
    ] = "256,512",
    device: Annotated[str | None, typer.Option(help="Part of an OpenCL device's label.")] = None,
) -> None:
    """Comparison of a volume with its reference: time and memory, beside SimpleITK and
    scikit-image.
    """
    from tools.benchmarks import evaluation as bench_evaluation

    bench_evaluation.run([int(count) for count in counts.split(",")], device, typer.echo)


@app.command()
def fdk_motion() -> None:
    """Filtered back-projection along known motion: slow errors by whose path the weights belong
    to.
    """
    from tools.benchmarks import fdk_motion as bench_fdk_motion

    for line in bench_fdk_motion.table():
        typer.echo(line)


@app.command()
def gradient(
    views: Annotated[int, typer.Option(help="Views over the paper's range.")] = 248,
    voxel_mm: Annotated[float, typer.Option(help="Voxels of the box of 110x70x110 mm.")] = 1.6,
    repeats: Annotated[int, typer.Option(help="Runs whose median is taken.")] = 9,
    device: Annotated[str | None, typer.Option(help="Part of an OpenCL device's label.")] = None,
) -> None:
    """Gradient of a box by all views: seconds, and times those of its back-projection."""
    from tools.benchmarks import gradient as bench_gradient

    for line in bench_gradient.run(views, voxel_mm, repeats, device):
        typer.echo(line)


if __name__ == "__main__":
    app()
