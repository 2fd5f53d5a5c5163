"""How exact the projector is: path lengths against float64 ray casting of the same meshes
(tests/references/projector.py).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device, open_device
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import projector
from tests.references import projector as reference_projector


@dataclass(frozen=True, slots=True)
class Case:
    """Rays through one object of attenuation 1/m, so that line integrals are path lengths."""

    name: str
    phantom: Phantom
    geometry: ConeBeamGeometry
    pixels: np.ndarray
    """(n, 2) columns and rows"""
    nudge: tuple[float, float] = (0.0, 0.0)
    """pixels that the reference's rays stand aside, where they would hit edges exactly"""


def scan(
    views: int = 1,
    angle: float = 0.1,
    shape_vu: tuple[int, int] = (480, 620),
    pitch: float = 0.616e-3,
) -> ConeBeamGeometry:
    """Some views of the paper's scan."""
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 31.0,
        angles=angle + np.arange(views),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=shape_vu,
        pixel_pitch=pitch,
    )


def part(mesh: trimesh.Trimesh, moved: np.ndarray | None = None, name: str = "part") -> Part:
    """Attenuation 1/m."""
    return Part(
        name,
        "unit",
        1.0,
        transforms.apply(np.eye(4) if moved is None else moved, mesh.vertices),
        mesh.faces,
    )


def ball(
    subdivisions: int,
    radius: float,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "ball",
) -> Part:
    """A tessellated ball."""
    return part(
        trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius),
        transforms.translation(center),
        name,
    )


def anywhere(geometry: ConeBeamGeometry, count: int, seed: int = 1) -> np.ndarray:
    """Pixels drawn evenly from the whole detector."""
    rows, columns = geometry.shape_vu
    rng = np.random.default_rng(seed)
    return np.stack([rng.integers(0, columns, count), rng.integers(0, rows, count)], 1)


def silhouette(
    phantom: Phantom, geometry: ConeBeamGeometry, device: Device, count: int
) -> np.ndarray:
    """Pixels next to where the image falls to 0: the grazing ones."""
    image = projector.project(phantom, geometry, device).line_integrals[0]
    hit = image > 0
    beside = np.zeros_like(hit)
    beside[1:-1, 1:-1] = ~(hit[:-2, 1:-1] & hit[2:, 1:-1] & hit[1:-1, :-2] & hit[1:-1, 2:])
    v, u = np.nonzero(hit & beside)
    chosen = np.random.default_rng(2).permutation(len(u))[:count]
    return np.stack([u[chosen], v[chosen]], 1)


def grazing_box(angle: float) -> Phantom:
    """A face that the rays of column 400 cross at ``angle`` (rad) in the middle of its 100 mm
    depth.
    """
    geometry = scan()
    source, ray = geometry.sources()[0], geometry.ray_directions(400.0, 239.5)[0]
    along = ray / np.linalg.norm(ray)
    up = np.array([0.0, 1.0, 0.0])
    rotation = transforms.axis_rotation(up, angle) @ np.stack([along, up, np.cross(along, up)], 1)
    box = trimesh.creation.box(bounds=[[-0.05, -0.05, -0.04], [0.05, 0.05, 0.0]])
    return Phantom((part(box, transforms.rigid(rotation, source + 0.75 * along)),))


def pinhole() -> ConeBeamGeometry:
    """Source at the origin looking along z, u = 64 x / z + 32: pixels hit vertices at powers of two
    exactly.
    """
    return ConeBeamGeometry(
        np.zeros(1), np.array([[[64.0, 0, 32, 0], [0, 64.0, 32, 0], [0, 0, 1, 0]]]), (64, 64)
    )


def cases(device: Device) -> list[Case]:
    """Every situation that is promised."""
    geometry = scan()
    fine, coarse = Phantom((ball(5, 0.09),)), Phantom((ball(2, 0.09),))
    slab = trimesh.creation.box(extents=(0.5, 1.2, 0.3))
    body = Phantom(
        (part(slab, transforms.rigid(transforms.axis_rotation((1, 2, 3), 0.3), (0.02, 0, 0))),)
    )
    pipe = Phantom(
        (
            part(
                trimesh.creation.cylinder(radius=0.02, height=1.0, sections=400),
                transforms.translation((0.03, 0, 0)),
            ),
        )
    )
    needle = transforms.rigid(transforms.axis_rotation((0, 0, 1), 0.7), np.zeros(3))
    turned = Phantom(
        (part(trimesh.creation.cylinder(radius=0.0005, height=0.2, sections=64), needle),)
    )
    grid = (
        trimesh.creation.box(bounds=[[-0.5, -0.25, 2.0], [0.5, 0.75, 4.0]])
        .subdivide()
        .subdivide()
        .subdivide()
    )
    every = np.stack(np.meshgrid(np.arange(64), np.arange(64)), -1).reshape(-1, 2)
    v = np.arange(120, 360)
    return [
        Case("ball of 20 480 triangles, anywhere", fine, geometry, anywhere(geometry, 2000)),
        Case("its silhouette", fine, geometry, silhouette(fine, geometry, device, 1000)),
        Case(
            "ball of 320 triangles, silhouette",
            coarse,
            geometry,
            silhouette(coarse, geometry, device, 1000),
        ),
        Case(
            "off center by (90, -80, 60) mm",
            Phantom((ball(4, 0.03, (0.09, -0.08, 0.06)),)),
            geometry,
            anywhere(geometry, 3000),
        ),
        Case(
            "outside the field, half seen",
            Phantom((ball(4, 0.06, (0.12, 0.09, 0.0)),)),
            geometry,
            anywhere(geometry, 3000),
        ),
        Case("slab larger than the detector", body, geometry, anywhere(geometry, 3000)),
        Case(
            "pipe of long slivers, silhouette",
            pipe,
            geometry,
            silhouette(pipe, geometry, device, 1500),
        ),
        Case(
            "needle 1 mm thick, silhouette",
            turned,
            geometry,
            silhouette(turned, geometry, device, 1500),
        ),
        Case(
            "box face 1e-2 rad from the rays",
            grazing_box(1e-2),
            geometry,
            np.stack([np.full(len(v), 400), v], 1),
        ),
        Case(
            "box face 1e-3 rad from the rays",
            grazing_box(1e-3),
            geometry,
            np.stack([np.full(len(v), 400), v], 1),
        ),
        Case(
            "box face 1e-4 rad from the rays",
            grazing_box(1e-4),
            geometry,
            np.stack([np.full(len(v), 400), v], 1),
        ),
        Case(
            "edges and vertices hit exactly",
            Phantom((part(grid),)),
            pinhole(),
            every,
            (1e-9, 1e-10),
        ),
        Case("three balls that overlap", _overlapping(), geometry, anywhere(geometry, 2000)),
    ]


def _overlapping() -> Phantom:
    return Phantom(
        (
            ball(4, 0.06, name="a"),
            ball(4, 0.05, (0.04, 0.01, 0), "b"),
            ball(4, 0.05, (0, 0.01, 0.04), "c"),
        )
    )


def table(device: Device, say: Callable[[str], None]) -> None:
    """Prints one row per case: rays that hit, mean and worst error in mm."""
    say("| rays | hits | mean error mm | worst error mm |")
    say("|---|---|---|---|")
    for case in cases(device):
        image = projector.project(case.phantom, case.geometry, device).line_integrals[0]
        expected = reference_projector.line_integrals(
            case.phantom, case.geometry, 0, case.pixels + np.array(case.nudge)
        )
        error = 1e3 * np.abs(image[case.pixels[:, 1], case.pixels[:, 0]] - expected)
        hits = expected > 0
        say(f"| {case.name} | {hits.sum()} | {error[hits].mean():.1e} | {error.max():.1e} |")


if __name__ == "__main__":
    table(open_device(), print)
