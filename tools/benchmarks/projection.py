"""How fast and how exact the projector is: a curve over triangles, and gVirtualXray on the same
meshes in the same run.
"""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device, open_device
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import projector

# subdivisions of an icosahedron, 20 * 4^n triangles, part by part
SIZES = {"1e4": (4, 4), "1e5": (5, 6), "1e6": (7, 7, 7), "1e7": (9, 9)}
RADII, ATTENUATIONS, MIDDLES = (0.09, 0.045, 0.02), (20.0, 50.0, 25.0), (0.0, -0.025, 0.055)
"""m, 1/m and m along x: two balls side by side in a third, since gVirtualXray knows one level of
nesting
"""


@dataclass(frozen=True, slots=True)
class Row:
    """One mesh, one machine, one run."""

    triangles: int
    seconds_a_view: float
    moving_seconds_a_view: float
    """where every vertex of every part moves at every view"""
    gvxr_seconds_a_view: float | None
    mean_difference_mm: float | None
    """of path lengths, weighted to the first part's attenuation, from gVirtualXray's"""


def lumpy(name: str, subdivisions: int, radius: float, attenuation: float, middle: float) -> Part:
    """A ball with bumps of 5 %, so that silhouettes and hollows are those of a bone rather than of
    a ball.
    """
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    bumps = 1 + 0.05 * np.sin(9 * x) * np.cos(7 * y + 1) * np.sin(8 * z + 2)
    return Part(
        name,
        "tissue",
        attenuation,
        mesh.vertices * (radius * bumps)[:, None] + np.array([middle, 0, 0]),
        mesh.faces,
    )


def scene(size: str) -> Phantom:
    """Lumpy balls of about that many triangles."""
    return Phantom(
        tuple(
            lumpy(f"part {k}", n, RADII[k], ATTENUATIONS[k], MIDDLES[k])
            for k, n in enumerate(SIZES[size])
        )
    )


def scan(views: int) -> ConeBeamGeometry:
    """``views`` spread over the paper's scan."""
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31.0,
        angles=np.deg2rad(197.6 * np.arange(views) / max(views - 1, 1)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
    )


def measure(size: str, views: int, device: Device, gvxr_python: str | None) -> Row:
    """Times one scene; the first view, which builds kernels and checks meshes, is not counted."""
    phantom, geometry = scene(size), scan(views)
    moves = [[part.vertices + 1e-4 * (view % 2) for part in phantom.parts] for view in range(2)]
    seconds = _seconds_a_view(phantom, geometry, device, None)
    moving = _seconds_a_view(phantom, geometry, device, moves)
    if gvxr_python is None:
        return Row(sum(len(p.triangles) for p in phantom.parts), seconds, moving, None, None)
    images = projector.project(phantom, geometry, device).line_integrals
    other, theirs = gvxr_images(phantom, geometry, gvxr_python)
    difference = 1e3 * float(np.abs(images - other).mean()) / ATTENUATIONS[0]
    return Row(sum(len(p.triangles) for p in phantom.parts), seconds, moving, theirs, difference)


def _seconds_a_view(
    phantom: Phantom, geometry: ConeBeamGeometry, device: Device, moves: list | None
) -> float:
    ends: list[float] = []
    posed = None if moves is None else lambda view: moves[view % 2]
    projector.project(
        phantom, geometry, device, posed=posed, progress=lambda *_: ends.append(time.perf_counter())
    )
    return float(np.median(np.diff(ends)))


def gvxr_images(
    phantom: Phantom, geometry: ConeBeamGeometry, python: str
) -> tuple[np.ndarray, float]:
    """gVirtualXray's line integrals, rows upwards as ours, and its median seconds a view."""
    rows, columns = geometry.shape_vu
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = []
        for k, part in enumerate(phantom.parts):
            trimesh.Trimesh(1e3 * part.vertices, part.triangles, process=False).export(
                folder / f"{k}.stl"
            )
            parts.append(
                {
                    "name": part.name,
                    "file": f"{k}.stl",
                    "attenuation_per_mm": 1e-3 * part.attenuation,
                }
            )
        u, v = (
            np.array([(columns - 1) / 2, (columns + 1) / 2, (columns - 1) / 2]),
            np.array([(rows - 1) / 2, (rows - 1) / 2, (rows + 1) / 2]),
        )
        # the detector stands where neighboring rays are a pixel apart
        focal = 1.198
        rays = geometry.ray_directions(u, v) * focal
        views = [
            {
                "source": s,
                "detector": (s + r[0]),
                "right": (r[1] - r[0]) / geometry.pixel_pitch,
                "up": (r[2] - r[0]) / geometry.pixel_pitch,
            }
            for s, r in zip(geometry.sources(), rays, strict=True)
        ]
        listed = [
            {
                k: ((1e3 if k in ("source", "detector") else 1.0) * x).tolist()
                for k, x in view.items()
            }
            for view in views
        ]
        content = {
            "columns": columns,
            "rows": rows,
            "pixel_mm": 1e3 * geometry.pixel_pitch,
            "parts": parts,
            "views": listed,
        }
        (folder / "scene.json").write_text(json.dumps(content))
        script = Path(__file__).parent / "peers" / "gvxr_projection.py"
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        done = subprocess.run(
            [python, str(script), str(folder)],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        if done.returncode:
            raise LegsimError(
                f"gVirtualXray failed in {python}: "
                f"{(done.stderr.strip().splitlines() or ['no message'])[-1]}"
            )
        return np.load(folder / "images.npy"), float(
            np.median(json.loads((folder / "times.json").read_text())["seconds"][1:])
        )


def run(
    sizes: Sequence[str],
    views: int,
    device: str | None,
    gvxr_python: str | None,
    out: Path | None,
    say: Callable[[str], None],
) -> None:
    """Measures the ``sizes``, of :data:`SIZES`, and says a row each; ``out`` gets them as JSON."""
    opened = open_device(device)
    say(f"{opened.label}; {views} views of 620x480")
    say(
        "triangles   ms/view   moving ms/view   248 views s   gvxr ms/view   ratio   mean "
        "difference mm"
    )
    rows = []
    for size in sizes:
        row = measure(size, views, opened, gvxr_python)
        rows.append(row)
        line = (
            f"{row.triangles:9d} {1e3 * row.seconds_a_view:9.1f} "
            f"{1e3 * row.moving_seconds_a_view:16.1f} {248 * row.seconds_a_view:13.1f}"
        )
        if row.gvxr_seconds_a_view is not None and row.mean_difference_mm is not None:
            ratio = row.gvxr_seconds_a_view / row.seconds_a_view
            line += (
                f" {1e3 * row.gvxr_seconds_a_view:14.1f} {ratio:7.1f} "
                f"{row.mean_difference_mm:20.2e}"
            )
        say(line)
    if out is not None:
        out.write_text(
            json.dumps({"device": opened.label, "rows": [asdict(row) for row in rows]}, indent=1)
            + "\n"
        )
