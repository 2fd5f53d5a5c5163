"""Benchmarks, one sub-command each: `python tools/bench.py ik --data ../shared/data`."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="Benchmarks of legsim against other toolkits and itself.", no_args_is_help=True)


@app.callback()
def main() -> None:
    """Benchmarks of legsim, side by side with other toolkits where there is one."""


@app.command()
def ik(
    data: Annotated[Path, typer.Option(help="Folder with mocap/ and opensim/.")],
    out: Annotated[Path | None, typer.Option(help="Markdown file whose section between the marks `<!-- ik -->` is replaced.")] = None,
) -> None:
    """Inverse kinematics beside OpenSim's: coordinates, residuals, frames a second."""
    import bench_ik

    text = bench_ik.run(data)
    typer.echo(text)
    if out is not None:
        bench_ik.replace_section(out, text)


if __name__ == "__main__":
    app()
