"""Finds by how much a scanner's detector is shifted along its rows, from projections alone.

    python docs/examples/align_detector.py projections.mha geometry.xml 96 2.0

The last two are voxels along each side and their size in mm. Of all shifts, the one whose volume
has the least entropy of its gradient is taken, by L-BFGS with exact derivatives. Filtering is done
once. Any other number that the matrices depend on is found in the same way, as far as it blurs the
volume: a shift along the columns does not, since the source stays in one plane.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import legsim as ls
from legsim.geometry.scan_files import read_scan


def found_shift(projections: ls.Projections, grid: ls.VolumeGrid) -> float:
    """Columns to add to what the geometry says."""
    given = projections.geometry
    filtered = ls.filtered_scan(projections, grid)
    criterion = ls.GradientEntropy(np.ones(grid.shape_zyx, bool))
    # (u w, v w, w) becomes ((u + shift) w, v w, w)
    by_shift = np.array([[0.0, 0, 1], [0, 0, 0], [0, 0, 0]]) @ given.matrices

    def entropy(shift: np.ndarray) -> tuple[float, np.ndarray]:
        shifted = replace(given, matrices=given.matrices + shift[0] * by_shift)
        found = ls.image_gradient(filtered.under(shifted), grid, criterion)
        slope = (found.by_matrices * by_shift).sum()
        # entropies differ by hundredths a pixel: in these units L-BFGS takes steps of a pixel
        return 1e2 * found.value, np.array([1e2 * slope])

    return float(minimize(entropy, np.zeros(1), jac=True, method="L-BFGS-B").x[0])


def main(projections_file: Path, geometry_file: Path, count: int, voxel_mm: float) -> None:
    """From files to a number."""
    scan = read_scan(projections_file, geometry_file)
    x, y, z = scan.geometry.rotation_center()
    grid = ls.VolumeGrid.cubic(count, 1e-3 * voxel_mm, (x, y, z))
    print(f"the detector is shifted by {found_shift(scan.projections, grid):.3f} columns")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
