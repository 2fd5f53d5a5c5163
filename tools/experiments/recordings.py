"""Methods on every recording, one row each. `python -m tools.experiments.recordings --data FOLDER`,
for docs/methods.md.

Every row is a run of its own, as `legsim run` makes it: with the demo's field of view in half the
views and coarser pixels (--small), or as --preset says. Cells are one number per method, in the
order in which the methods are named: residual motion of femur, tibia, patella and skin (RMS in mm
over points and views), pixels after similarity over all bones and of the tibia, SSIM and RMSE of
the leg. Below the table is what `articulated` does not fulfil, where it runs beside others: less
residual motion than nonrigid-3d, and SSIM within 0.001 of the true field.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from legsim import config
from legsim.core.errors import LegsimError
from legsim.correction.articulated import around_center, limbs_of
from legsim.correction.limb_motion import articulated_motion
from legsim.correction.method import Correction, Scan
from legsim.evaluation.scores import MethodResult
from legsim.run import pipeline

SHIPPED = tuple(f"subject0{k}/squat_{angle}.trc" for k in range(1, 8) for angle in (30, 60))

_QUICK = ("scan.rate_hz=31",)
"""a scan of 4 s, for a person who stands still for less than 8 s"""

REAL: dict[str, tuple[str, ...]] = {
    "standing_bmc/static_run.trc": (),
    "standing_biobuddy/anat_pose_ECH.c3d": ("motion.up=z",),
    "standing_c3dio/Capture0008_Standing.c3d": ("scan.start_s=4", *_QUICK),
    "squat_dart/squat.c3d": (),
    "squats_subject4/squats1.trc": (),
    "squats_subject4/static1.trc": _QUICK,
    "walk_opensim/subject01_static.trc": _QUICK,
}
"""recordings of the folder --data, and what a scan of them needs"""

_SMALL = (
    *("scan.views=124", "scan.increment_deg=1.6", "scan.rate_hz=15.5", "scan.columns=124"),
    *("scan.rows=96", "scan.pixel_mm=3.08", "grid.voxels=128", "grid.voxel_mm=2"),
)

BONES_AND_SKIN = ("femur", "tibia", "patella", "skin")
_FROM_TRUTH = 0.001


def two_bodies(scan: Scan) -> Correction:
    """`articulated` where no bone was looked for: --methods "… tools/….py:two_bodies"."""
    nodes = around_center(scan.projections)
    loose = articulated_motion(scan.times, limbs_of(scan), nodes).on_grid(nodes)
    return Correction("two_bodies", scan.projections, loose)


def _mm(structure: str) -> Callable[[MethodResult], str]:
    def shown(result: MethodResult) -> str:
        found = {r.structure: r.mm for r in result.residuals}.get(structure)
        return "–" if found is None else f"{found:.3f}"

    return shown


def _tibia_px(result: MethodResult) -> str:
    found = {r.structure: r.pixels_after_similarity for r in result.residuals}.get("tibia")
    return "–" if found is None else f"{found:.2f}"


COLUMNS: Mapping[str, Callable[[MethodResult], str]] = {
    **{f"{name} (mm)": _mm(name) for name in BONES_AND_SKIN},
    "bones (px)": lambda result: f"{result.residual_px_after_similarity:.2f}",
    "tibia (px)": _tibia_px,
    "SSIM": lambda result: f"{result.metrics.of('leg').ssim:.4f}",
    "RMSE": lambda result: f"{result.metrics.of('leg').rmse:.4f}",
}


def row(results: Mapping[str, MethodResult]) -> str:
    """Cells of one recording."""
    return " | ".join(" / ".join(map(shown, results.values())) for shown in COLUMNS.values())


def missed(results: Mapping[str, MethodResult]) -> Iterator[str]:
    """Where `articulated` is not what it should be."""
    ours = results.get("articulated")
    if ours is None:
        return
    if other := results.get("nonrigid-3d"):
        for mine, its in zip(ours.residuals, other.residuals, strict=True):
            if mine.mm is None or its.mm is None or not mine.mm < its.mm:
                yield f"{mine.structure} is no nearer than by nonrigid-3d"
    if truth := results.get("oracle-nonrigid"):
        below = truth.metrics.of("leg").ssim - ours.metrics.of("leg").ssim
        if not below <= _FROM_TRUTH:
            yield f"SSIM is {below:.4f} below the true field's"


def recordings(data: Path | None, files: str) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Name, file and what it needs, of each recording to scan."""
    for name in files.split() or (*SHIPPED, *(REAL if data else ())):
        file = str(data / name) if data and name in REAL else name
        yield name, file, REAL.get(name, ())


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of the real recordings.")] = None,
    files: Annotated[str, typer.Option(help="These alone, separated by spaces.")] = "",
    methods: str = "nonrigid-3d articulated oracle-nonrigid",
    settings: Annotated[Path | None, typer.Option(help="A run's TOML, below --set.")] = None,
    preset: str = "demo",
    small: bool = True,
    change: Annotated[list[str] | None, typer.Option("--set")] = None,
    notes: Annotated[bool, typer.Option(help="What the methods say.")] = False,
) -> None:
    """Prints one row per recording."""
    typer.echo(f"| recording | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 1)}")
    asked = f"methods.run={json.dumps(methods.split())}"
    failed: list[str] = []
    for name, file, own in recordings(data, files):
        given = (f"motion.file={file}", asked, *(_SMALL if small else ()), *own, *(change or ()))
        with TemporaryDirectory() as folder:
            try:
                wanted = config.load_settings(settings, preset=preset, overrides=given)
                found = pipeline.run_scan(wanted, folder, presented=False)
            except LegsimError as error:
                typer.echo(f"| {name} | {error} |")
                continue
            said = [p.read_text("utf-8") for p in sorted(Path(folder).glob("correction-*.json"))]
        results = {one.method: one for one in found.methods if one.method != "static"}
        typer.echo(f"| {name} | {row(results)} |")
        failed += [f"{name}: {line}" for line in missed(results)]
        if notes:
            typer.echo("".join(said), err=True)
    typer.echo("\n".join(failed))


if __name__ == "__main__":
    typer.run(main)
