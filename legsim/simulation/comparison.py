"""Several methods on one simulated scan: their volumes and a table of their scores."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.method import Correction, CorrectionMethod, checked
from legsim.deformation.models import placed
from legsim.evaluation.regions import Box
from legsim.evaluation.scaling import Scaling
from legsim.evaluation.similarity import REGISTERED, Registered, Scores, html_table, prepare
from legsim.evaluation.ssim import Window
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction.fdk import fdk
from legsim.simulation.simulated_scan import SimulatedScan

REFERENCE = "static"
"""name of the volume of the scan at rest"""


@dataclass(frozen=True, slots=True)
class ScoreTable:
    """Scores of each method, in the order in which they ran."""

    scores: Mapping[str, Scores]

    def __getitem__(self, method: str) -> Scores:
        if method not in self.scores:
            raise LegsimError(
                f"unknown method {method!r}; known: {', '.join(map(str, self.scores))}"
            )
        return self.scores[method]

    def __iter__(self) -> Iterator[str]:
        return iter(self.scores)

    @property
    def protocol(self) -> str:
        """How volumes were scaled and which windows SSIM has, in words."""
        return next(iter(self.scores.values())).protocol

    def columns(self) -> tuple[str, ...]:
        """Column names of :meth:`rows`."""
        regions = next(iter(self.scores.values())).regions
        return ("method", *(f"{kind} {r.region}" for kind in ("SSIM", "RMSE") for r in regions))

    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Formats method, SSIM by region and RMSE by region as text."""
        return tuple(
            (
                name,
                *(f"{r.ssim:.3f}" for r in scores.regions),
                *(f"{r.rmse:.3f}" for r in scores.regions),
            )
            for name, scores in self.scores.items()
        )

    def __repr__(self) -> str:
        table = [self.columns(), *self.rows()]
        widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
        lines = ("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in table)
        return "\n".join([*(line.rstrip() for line in lines), self.protocol])

    def _repr_html_(self) -> str:
        """Formats the scores as an HTML table for notebooks."""
        return html_table(self.protocol, self.columns(), self.rows())


class Comparison(NamedTuple):
    """Result of :func:`compare`."""

    volumes: dict[str, Volume]
    """of the scan at rest, under :data:`REFERENCE`, and of each method"""
    table: ScoreTable


def compare(
    scan: SimulatedScan,
    methods: Mapping[str, CorrectionMethod],
    grid: VolumeGrid | None = None,
    *,
    registered: Registered = "reconstructed",
    scaling: Scaling = "reference",
    window: Window = "uniform",
) -> Comparison:
    """Corrects, reconstructs and scores one scan by several methods.

    All share grid, back-projection, reference and regions.

    Args:
        scan: to correct.
        methods: by the name that they have in the table; any function of a ``Scan`` that returns
            a ``Correction``.
        grid: of the volumes; None for ``scan.grid()``.
        registered: how a volume that lies elsewhere is brought to the reference before it is
            scored: reconstructed there (fair to all methods), resampled (as volumes of unknown
            origin have to be), or not at all.
        scaling: which attenuations become 0 and 1.
        window: of SSIM.

    Raises:
        LegsimError: no method, one named like the reference, or one that fails; the line names it.
            An unknown ``registered``.

    >>> volumes, table = compare(scan, {"rigid": Rigid("shank_l")})
    """
    if not isinstance(methods, Mapping) or not methods or REFERENCE in methods:
        raise LegsimError(f"compare needs methods by name, none of them called {REFERENCE!r}")
    if registered not in REGISTERED:
        raise LegsimError(
            f"unknown registered {registered!r}; choose one of {', '.join(REGISTERED)}"
        )
    if not isinstance(scan, SimulatedScan):
        raise LegsimError(
            "compare needs a SimulatedScan, whose scan at rest is the reference, not "
            f"{type(scan).__name__}; correct and evaluate others one by one"
        )
    chosen = scan.grid() if grid is None else grid
    regions = scan.regions(chosen)
    volumes = {REFERENCE: fdk(scan.at_rest, chosen, device=scan.device)}
    prepared = prepare(
        volumes[REFERENCE], regions, scaling=scaling, window=window, device=scan.device
    )
    scores = {}
    for name, method in methods.items():
        corrected = checked(name, method)(scan.seen)
        volumes[name] = fdk(corrected, chosen, device=scan.device)
        scores[name] = prepared.scores(
            volumes[name],
            register=registered != "none",
            reconstructed_at=partial(_moved, corrected, chosen, scan.device)
            if registered == "reconstructed"
            else None,
        )
    return Comparison(volumes, ScoreTable(scores))


def _moved(
    corrected: Correction, grid: VolumeGrid, device: Device, at: FloatArray, box: Box
) -> Volume:
    """The volume of a correction with the voxels of ``box`` where ``at`` (4, 4) m carries them."""
    images = corrected.projections
    motion = placed(corrected.motion, images.geometry.times, at, grid)
    return fdk(images, grid.cropped(box), motion=motion, device=device)
