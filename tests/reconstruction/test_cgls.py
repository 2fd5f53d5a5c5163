"""CGLS inverts the projector, without and with values kept at 0 or above."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk
from legsim.reconstruction.system_matrix import LargeVoxelWarning, SystemMatrix
from tests.examples import few_views
from tests.reconstruction.test_system_matrix import GRID, scan, swaying


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


@pytest.mark.parametrize(("sigma", "noise"), [(0.02, None), (0.1, None), (0.1, 0.1)])
def test_few_views_end_near_the_best_step_and_beat_fdk(
    device: Device, rng: np.random.Generator, sigma: float, noise: float | None
) -> None:
    scan_of_few = few_views.noisy(62, sigma, rng)
    stopped = few_views.error(cgls.cgls(scan_of_few, few_views.FEW, noise=noise, device=device))
    best = min(
        few_views.error(cgls.cgls(scan_of_few, few_views.FEW, iterations=k, device=device))
        for k in (4, 5, 6, 7, 8, 10)
    )
    assert stopped < 1.1 * best
    kept = few_views.error(
        cgls.cgls(scan_of_few, few_views.FEW, noise=noise, nonnegative=True, device=device)
    )
    filtered = few_views.error(fdk.fdk(scan_of_few, few_views.FEW, device=device))
    assert kept < filtered
    assert sigma < 0.1 or stopped < filtered


def test_a_start_may_come_from_a_file_but_must_be_finite(device: Device) -> None:
    """Files round positions; one voxel that is no number would spread over the volume."""
    rounded = replace(GRID, center=tuple(c + 1e-12 for c in GRID.center))
    projections = Projections(scan(), np.ones((9, 24, 30), np.float32))
    start = np.full(GRID.shape_zyx, 2.0, np.float32)
    expected = cgls.cgls(projections, GRID, iterations=2, start=Volume(GRID, start))
    found = cgls.cgls(projections, GRID, iterations=2, start=Volume(rounded, start))
    np.testing.assert_array_equal(found.attenuation, expected.attenuation)
    bad = start.copy()
    bad[3, 4, 5] = np.nan
    with pytest.raises(LegsimError, match="start from holds values that are not finite"):
        cgls.cgls(projections, GRID, iterations=2, start=Volume(GRID, bad))


def test_voxels_larger_than_a_low_pixel_are_reported(device: Device) -> None:
    fine_rows = replace(
        scan(), matrices=np.array([1, 4.0, 1])[:, None] * scan().matrices, shape_vu=(96, 30)
    )
    projections = Projections(fine_rows, np.zeros((9, 96, 30), np.float32))
    with pytest.warns(LargeVoxelWarning, match=r"4 mm are larger than a pixel .* \(1.111 mm\)"):
        cgls.cgls(projections, GRID, device=device, iterations=1)
