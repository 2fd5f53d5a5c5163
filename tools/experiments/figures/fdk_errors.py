"""Draws docs/images/fdk_errors.png: slices of the benchmark's phantom, reconstructed at rest and
from a swaying scan, and their errors.
"""

import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np

from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import open_device
from legsim.reconstruction import fdk
from legsim.reconstruction.weights import ShortScanWarning

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.axes import Axes

from tools.benchmarks import fdk as bench_fdk


def main() -> None:
    """Writes fdk_errors.png."""
    geometry, device = bench_fdk.scan(248, 2), open_device()
    motion = bench_fdk.sway(len(geometry))
    still = bench_fdk.projected(geometry)
    swaying = replace(
        bench_fdk.projected(geometry.moved(motion.moved_from_reference)), geometry=geometry
    )
    grids = (
        VolumeGrid((384, 1, 384), (5e-4, 5e-4, 5e-4), (0.0, 0.0, 0.0)),
        VolumeGrid((1, 384, 384), (5e-4, 5e-4, 5e-4), (0.0, 0.0, 0.0)),
    )
    cases = (
        ("at rest", still, None),
        ("swaying, corrected", swaying, motion),
        ("swaying, uncorrected", swaying, None),
    )
    figure, panels = pyplot.subplots(4, 3, figsize=(9, 12), layout="constrained")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortScanWarning)
        for column, (name, projections, moved) in enumerate(cases):
            for row, grid in enumerate(grids):
                found = fdk.fdk(projections, grid, device=device, motion=moved).attenuation
                expected, _ = bench_fdk.truth(grid)
                _show(panels[2 * row, column], found.squeeze(), (0.0, 50.0), "gray", name)
                _show(
                    panels[2 * row + 1, column],
                    (found - expected).squeeze(),
                    (-2.0, 2.0),
                    "RdBu_r",
                    "error, 1/m",
                )
    out = Path(__file__).parents[3] / "docs" / "images" / "fdk_errors.png"
    figure.savefig(out, dpi=110)


def _show(
    axes: Axes, values: np.ndarray, limits: tuple[float, float], colors: str, title: str
) -> None:
    shown = axes.imshow(values, cmap=colors, vmin=limits[0], vmax=limits[1], origin="lower")
    axes.set_title(title, fontsize=9)
    axes.axis("off")
    axes.figure.colorbar(shown, ax=axes, shrink=0.8)


if __name__ == "__main__":
    main()
