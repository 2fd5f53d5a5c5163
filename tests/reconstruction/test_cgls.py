"""The projector is the adjoint of the back-projector, measures lengths, and CGLS inverts it."""

import numpy as np
import pytest
from scipy.optimize import nnls

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk
from legsim.reconstruction.cgls import LargeVoxelWarning, SystemMatrix
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


@pytest.mark.parametrize("moving", [False, True])
def test_cgls_finds_the_volume_of_consistent_projections(
    device: Device, rng: np.random.Generator, moving: bool
) -> None:
    geometry = scan(40, 6.2)
    motion = swaying(rng, geometry.times) if moving else None
    z, y, x = np.meshgrid(*GRID.axes()[::-1], indexing="ij")
    truth = (20 * np.exp(-((x - 0.01) ** 2 + y**2 + (z + 0.005) ** 2) / 0.015**2)).astype(
        np.float32
    )
    projections = Projections(geometry, SystemMatrix(geometry, GRID, device, motion).forward(truth))
    found = cgls.cgls(projections, GRID, device=device, motion=motion, iterations=25)
    assert np.abs(found.attenuation - truth).max() < 0.05 * 20
    again = cgls.cgls(
        projections,
        GRID,
        device=device,
        motion=motion,
        iterations=1,
        start=Volume(GRID, truth.copy()),
    )
    np.testing.assert_allclose(again.attenuation, truth, atol=1e-3)


SMALL = VolumeGrid((4, 5, 6), (0.012, 0.012, 0.012), (0.01, 0.0, -0.005))


def residual(system: SystemMatrix, projections: Projections, found: np.ndarray) -> float:
    return float(np.linalg.norm(system.forward(found) - projections.line_integrals))


@pytest.mark.filterwarnings("ignore:voxels of 12 mm")
def test_nonnegative_values_are_those_of_a_direct_solver(
    device: Device, rng: np.random.Generator
) -> None:
    """Images that no volume of positive values explains, so that many voxels end at 0."""
    geometry = scan()
    system = SystemMatrix(geometry, SMALL, device)
    voxels = np.eye(120, dtype=np.float32).reshape(-1, *SMALL.shape_zyx)
    matrix = np.stack([system.forward(voxel).ravel() for voxel in voxels], -1).astype(float)
    values = matrix @ rng.normal(3, 10, 120) + rng.normal(0, 0.01, len(matrix))
    projections = Projections(geometry, values.reshape(9, 24, 30))
    best, least = nnls(matrix, projections.line_integrals.ravel().astype(float))
    found = cgls.cgls(projections, SMALL, iterations=400, nonnegative=True, device=device)
    assert 30 < (best == 0).sum() < 90
    np.testing.assert_allclose(found.attenuation.ravel(), best, atol=1e-3 * best.max())
    assert residual(system, projections, found.attenuation) == pytest.approx(least, rel=1e-5)


def test_nonnegative_steps_never_raise_the_residual(
    device: Device, rng: np.random.Generator
) -> None:
    geometry = scan()
    motion = swaying(rng, geometry.times)
    images = rng.normal(0.2, 1, (9, 24, 30)).astype(np.float32)
    projections, system = (
        Projections(geometry, images),
        SystemMatrix(geometry, GRID, device, motion),
    )
    sizes = [float(np.linalg.norm(images))]
    for steps in (1, 2, 3, 5, 8, 20):
        found = cgls.cgls(
            projections, GRID, motion=motion, iterations=steps, nonnegative=True, device=device
        ).attenuation
        assert found.min() >= 0
        sizes.append(residual(system, projections, found))
    assert (np.diff(sizes) < 0).all()
    free = cgls.cgls(projections, GRID, motion=motion, iterations=20, device=device).attenuation
    assert free.min() < 0, "the images do ask for negative values"


def test_nonnegative_values_start_from_a_volume_without_its_negative_part(
    device: Device, rng: np.random.Generator
) -> None:
    truth = rng.random(GRID.shape_zyx, np.float32)
    geometry = scan()
    projections = Projections(geometry, SystemMatrix(geometry, GRID, device).forward(truth))
    below = Volume(GRID, np.where(truth > 0.5, truth, -truth))
    kept = Volume(GRID, np.maximum(below.attenuation, 0))
    first, second = (
        cgls.cgls(projections, GRID, iterations=2, nonnegative=True, start=start, device=device)
        for start in (below, kept)
    )
    np.testing.assert_array_equal(first.attenuation, second.attenuation)
    true = Volume(GRID, truth.copy())
    done = cgls.cgls(projections, GRID, iterations=1, nonnegative=True, start=true, device=device)
    np.testing.assert_allclose(done.attenuation, truth, atol=1e-5)


def test_refusals(device: Device) -> None:
    projections = Projections(scan(), np.zeros((9, 24, 30), np.float32))
    with pytest.raises(LegsimError, match="at least 1"):
        cgls.cgls(projections, GRID, device=device, iterations=0)
    other = VolumeGrid.cubic(4, 0.004, (0.0, 0.0, 0.0))
    with pytest.raises(LegsimError, match="another grid"):
        cgls.cgls(
            projections, GRID, device=device, start=Volume(other, np.zeros((4, 4, 4), np.float32))
        )
    assert not cgls.cgls(projections, GRID, device=device, iterations=3).attenuation.any()
    with pytest.raises(LegsimError, match="noise of 0 was given"):
        cgls.cgls(projections, GRID, device=device, noise=0.0)
    with pytest.warns(LargeVoxelWarning, match="voxels of 12 mm are larger than a pixel"):
        cgls.cgls(projections, SMALL, device=device)


FEW = VolumeGrid((44, 30, 44), (0.0036,) * 3, (0.0, 0.0, 0.0))
SOLIDS = [
    Ellipsoid((0.0, 0.0, 0.0), (0.07, 0.04, 0.06), 20.0),
    Ellipsoid((0.03, 0.0, 0.01), (0.018, 0.02, 0.018), 15.0),
    Ellipsoid((-0.03, 0.0, -0.03), (0.015, 0.015, 0.02), -10.0),
]


def averaged_truth() -> np.ndarray:
    """Attenuation of the ellipsoids on FEW, as a mean of 3 x 3 x 3 points of each voxel."""
    z, y, x = np.meshgrid(*FEW.axes()[::-1], indexing="ij")
    truth = np.zeros(FEW.shape_zyx)
    for shift in np.ndindex(3, 3, 3):
        points = np.stack([x, y, z], -1) + (np.array(shift) - 1) * 0.0012
        for e in SOLIDS:
            inside = (((points - e.center) / e.radii) ** 2).sum(-1) < 1
            truth += e.attenuation / 27 * inside
    return truth


@pytest.mark.parametrize(("sigma", "noise"), [(0.02, None), (0.1, None), (0.1, 0.1)])
def test_few_views_end_near_the_best_step_and_beat_fdk(
    device: Device, rng: np.random.Generator, sigma: float, noise: float | None
) -> None:
    geometry = ConeBeamGeometry.circular(
        times=np.arange(62) * 1.0,
        angles=np.radians(np.arange(62) * 360 / 62),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(40, 52),
        pixel_pitch=6e-3,
    )
    images = project(geometry, SOLIDS).line_integrals
    images = images + sigma * rng.normal(size=images.shape)
    scan_of_few, truth = Projections(geometry, images.astype(np.float32)), averaged_truth()

    def error(volume: Volume) -> float:
        return float(np.sqrt(np.mean((volume.attenuation - truth) ** 2)))

    stopped = error(cgls.cgls(scan_of_few, FEW, noise=noise, device=device))
    best = min(
        error(cgls.cgls(scan_of_few, FEW, iterations=k, device=device)) for k in (4, 5, 6, 7, 8, 10)
    )
    assert stopped < 1.1 * best
    kept = error(cgls.cgls(scan_of_few, FEW, noise=noise, nonnegative=True, device=device))
    filtered = error(fdk.fdk(scan_of_few, FEW, device=device))
    assert kept < filtered
    assert sigma < 0.1 or stopped < filtered
