"""FDK by RTK, for bench_fdk.py: run by a Python that has `itk-rtk`; prints one line of JSON.

Arguments: a folder with projections.npy (view, v, u) and scan.json; volume.npy (z, y, x, 1/mm) is
written beside them.
"""

import json
import resource
import sys
import time
from pathlib import Path

import itk  # pyright: ignore[reportMissingImports]
import numpy as np
from itk import RTK as rtk  # pyright: ignore[reportMissingImports]


def main(folder: Path) -> None:
    """Reconstructs the scan in ``folder`` and prints how long it took."""
    scan = json.loads((folder / "scan.json").read_text())
    image = itk.Image[itk.F, 3]
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    for angle in scan["angles_deg"]:
        geometry.AddProjection(scan["source_isocenter_mm"], scan["source_detector_mm"], angle)
    pixels = np.load(folder / "projections.npy")
    projections = itk.image_from_array(pixels)
    pitch = scan["pixel_mm"]
    projections.SetSpacing([pitch, pitch, 1.0])
    projections.SetOrigin(
        [-0.5 * (pixels.shape[2] - 1) * pitch, -0.5 * (pixels.shape[1] - 1) * pitch, 0.0]
    )
    count, spacing = scan["count"], scan["voxel_mm"]
    empty = rtk.ConstantImageSource[image].New()
    empty.SetSize([count] * 3)
    empty.SetSpacing([spacing] * 3)
    empty.SetOrigin([-0.5 * (count - 1) * spacing] * 3)
    begin, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
    parker = rtk.ParkerShortScanImageFilter[image].New()
    parker.SetInput(projections)
    parker.SetGeometry(geometry)
    fdk = rtk.FDKConeBeamReconstructionFilter[image].New()
    fdk.SetInput(0, empty.GetOutput())
    fdk.SetInput(1, parker.GetOutput())
    fdk.SetGeometry(geometry)
    fdk.GetRampFilter().SetTruncationCorrection(0.0)
    fdk.Update()
    seconds, now = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF)
    np.save(folder / "volume.npy", itk.array_from_image(fdk.GetOutput()))
    cpu = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    print(json.dumps({"seconds": seconds, "cpu_seconds": cpu}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
