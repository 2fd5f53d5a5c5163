"""gVirtualXray on the views of a bench: run by bench_project.py in a process of its own, with
whatever Python has the gvxr wheel.

Argument: a folder with scene.json (parts, detector, views; mm and 1/mm) and the STL files it names
(it crashes on PLY); images.npy and times.json go there too.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from gvxrPython3 import gvxr  # pyright: ignore[reportMissingImports]

PHOTONS = 1000


def place(view: dict) -> None:
    """Source and detector of one view, mm in world."""
    gvxr.setSourcePosition(*view["source"], "mm")
    gvxr.setDetectorPosition(*view["detector"], "mm")
    gvxr.setDetectorRightVector(*view["right"])
    gvxr.setDetectorUpVector(*view["up"])


def main(folder: Path) -> None:
    """Projects the scene in ``folder``."""
    scene = json.loads((folder / "scene.json").read_text())
    gvxr.createOpenGLContext()
    place(scene["views"][0])
    gvxr.usePointSource()
    gvxr.setMonoChromaticPerPixelAtSDD(60.0, "keV", PHOTONS)
    gvxr.setDetectorNumberOfPixels(scene["columns"], scene["rows"])
    gvxr.setDetectorPixelSize(scene["pixel_mm"], scene["pixel_mm"], "mm")
    for k, part in enumerate(scene["parts"]):
        gvxr.loadMeshFile(part["name"], str(folder / part["file"]), "mm", False, "root")
        gvxr.setLinearAttenuationCoefficient(
            part["name"], 10.0 * part["attenuation_per_mm"], "cm-1"
        )
        if k == 0:
            gvxr.addPolygonMeshAsOuterSurface(part["name"])
        else:
            gvxr.addPolygonMeshAsInnerSurface(part["name"])
    images, seconds = [], []
    for view in scene["views"]:
        start = time.perf_counter()
        place(view)
        images.append(np.array(gvxr.computeXRayImage(False), np.float32))
        seconds.append(time.perf_counter() - start)
    np.save(folder / "images.npy", -np.log(np.stack(images) / PHOTONS))
    (folder / "times.json").write_text(
        json.dumps({"seconds": seconds, "renderer": gvxr.getOpenGlRenderer()})
    )
    gvxr.destroy()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
