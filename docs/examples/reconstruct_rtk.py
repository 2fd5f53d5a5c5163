"""Reconstructs projections that RTK made: a stack of line integrals and RTK's geometry XML.

    python docs/examples/reconstruct_rtk.py projections.mha geometry.xml volume.nii.gz 256 1.0

The last two are voxels along each side and their size in mm. The volume lies about the point that
the scanner turns about. `legsim reconstruct` does the same from the command line, and more.
"""

import sys
from pathlib import Path

from legsim.geometry import image_files
from legsim.geometry.scan_files import read_scan
from legsim.geometry.volume import VolumeGrid
from legsim.reconstruction.fdk import fdk


def main(
    projections_file: Path, geometry_file: Path, out: Path, count: int, voxel_mm: float
) -> None:
    """From files to a file."""
    scan = read_scan(projections_file, geometry_file)
    x, y, z = scan.geometry.rotation_center()
    grid = VolumeGrid.cubic(count, 1e-3 * voxel_mm, (x, y, z))
    volume = fdk(scan.projections, grid)
    image_files.save_volume(out, volume)
    print(f"{'x'.join(map(str, grid.shape_zyx))} voxels from {len(scan.geometry)} views: {out}")


if __name__ == "__main__":
    main(
        Path(sys.argv[1]),
        Path(sys.argv[2]),
        Path(sys.argv[3]),
        int(sys.argv[4]),
        float(sys.argv[5]),
    )
