"""The projector is the adjoint of the back-projector, and measures lengths."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.deformation.models import Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction.system_matrix import SystemMatrix
from tests.reconstruction.test_backprojection import as_field, bending
from tests.references.backprojection import Ellipsoid, project

GRID = VolumeGrid((16, 14, 18), (0.004, 0.004, 0.004), (0.01, 0.0, -0.005))


def scan(views: int = 9, turn: float = 4.0) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.linspace(0, turn, views),
        source_isocenter=0.5,
        source_detector=0.9,
        shape_vu=(24, 30),
        pixel_pitch=8e-3,
    )


def swaying(rng: np.random.Generator, times: np.ndarray) -> RigidMotion:
    turns, shifts = rng.normal(0, 0.05, (len(times), 3)), rng.normal(0, 0.005, (len(times), 3))
    return RigidMotion(times, transforms.rigid(transforms.rotation_from_vector(turns), shifts))


@pytest.mark.parametrize("kind", ["still", "rigid", "moving least squares", "field"])
def test_the_projector_is_the_adjoint(device: Device, rng: np.random.Generator, kind: str) -> None:
    geometry = scan()
    bent = bending(rng, geometry.times)
    motions: dict[str, Motion | None] = {
        "still": None,
        "rigid": swaying(rng, geometry.times),
        "moving least squares": bent,
    }
    motion = as_field(bent, 0.01) if kind == "field" else motions[kind]
    system = SystemMatrix(geometry, GRID, device, motion)
    volume, images = rng.random(GRID.shape_zyx, np.float32), rng.random((9, 24, 30), np.float32)
    seen = np.vdot(system.forward(volume).astype(float), images)
    back = np.vdot(volume.astype(float), system.adjoint(images))
    assert seen == pytest.approx(back, rel=1e-5)


def test_upside_down_detectors_too(device: Device, rng: np.random.Generator) -> None:
    turned = scan().moved(
        transforms.rigid(transforms.rotation_from_vector([np.pi, 0, 0]), [0.0, 0.0, 0.0])
    )
    system = SystemMatrix(turned, GRID, device)
    volume, images = rng.random(GRID.shape_zyx, np.float32), rng.random((9, 24, 30), np.float32)
    assert np.vdot(system.forward(volume).astype(float), images) == pytest.approx(
        np.vdot(volume.astype(float), system.adjoint(images)), rel=1e-5
    )


def test_images_are_line_integrals(device: Device) -> None:
    fine = VolumeGrid.cubic(60, 0.002, (0.0, 0.0, 0.0))
    z, y, x = np.meshgrid(*fine.axes()[::-1], indexing="ij")
    ball = np.where(x**2 + y**2 + z**2 < 0.05**2, 20.0, 0.0).astype(np.float32)
    geometry = scan()
    seen = SystemMatrix(geometry, fine, device).forward(ball)
    expected = project(geometry, [Ellipsoid((0.0, 0.0, 0.0), (0.05,) * 3, 20.0)]).line_integrals
    assert np.sqrt(np.mean((seen - expected) ** 2)) < 0.03 * expected.max()
    assert seen.sum() == pytest.approx(expected.sum(), rel=0.01)
