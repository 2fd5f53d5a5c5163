"""Steps lead to the minimum, never uphill, whatever the penalty."""

import numpy as np
import pytest

from legsim.geometry.cone_beam import Projections
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, proximal_steps
from legsim.reconstruction.proximal_steps import Nonnegative
from legsim.reconstruction.system_matrix import SystemMatrix, energy
from legsim.reconstruction.total_variation import TotalVariation
from tests.reconstruction.test_system_matrix import GRID, scan, swaying


class Sum:
    """``weight`` x the sum of all values, whose proximal map is exact."""

    def __init__(self, weight: float) -> None:
        self.weight = weight

    def value(self, volume: np.ndarray) -> float:
        return self.weight * float(volume.sum(dtype=float))

    def nearest(self, volume: np.ndarray, length: float) -> np.ndarray:
        return np.maximum(volume - np.float32(length * self.weight), 0)


@pytest.mark.parametrize("kind", ["nonnegative", "sum", "total variation"])
def test_the_objective_never_grows_and_is_what_is_stated(
    device: Device, rng: np.random.Generator, kind: str
) -> None:
    geometry = scan()
    system = SystemMatrix(geometry, GRID, device, swaying(rng, geometry.times))
    images = rng.normal(0.2, 1, (9, 24, 30)).astype(np.float32)
    penalty = {
        "nonnegative": Nonnegative(),
        "sum": Sum(0.01),
        "total variation": TotalVariation(GRID, 1e-4, device),
    }[kind]
    found, residual = np.zeros(GRID.shape_zyx, np.float32), images.copy()
    objectives = [0.5 * energy(images)]
    for objective in proximal_steps.steps(system, found, residual, 40, penalty):
        objectives.append(objective)
        assert found.min() >= 0
    assert len(objectives) > 20
    assert (np.diff(objectives) <= 1e-6 * objectives[0]).all()
    misfit = 0.5 * energy(images - system.forward(found))
    assert misfit + penalty.value(found) == pytest.approx(objectives[-1], rel=1e-4)


def test_the_minimum_with_a_smooth_penalty_fulfils_its_conditions(
    device: Device, rng: np.random.Generator
) -> None:
    """Where values are above 0 the gradient is the penalty's slope, elsewhere it is no larger."""
    geometry = scan()
    system = SystemMatrix(geometry, GRID, device)
    truth = rng.random(GRID.shape_zyx, np.float32)
    images = system.forward(truth)
    # a slope of a third of the greatest pull, so that many voxels end at 0
    weight = 0.3 * float(system.adjoint(images).max())
    found, residual = np.zeros(GRID.shape_zyx, np.float32), images.copy()
    for _ in proximal_steps.steps(system, found, residual, 3000, Sum(weight)):
        pass
    pull = system.adjoint(residual)
    inside = found > 0.01 * found.max()
    assert 0.02 < inside.mean() < 0.98
    assert np.abs(pull[inside] / weight - 1).max() < 0.01
    assert pull.max() < 1.01 * weight


def test_without_a_penalty_they_are_nonnegative_least_squares(
    device: Device, rng: np.random.Generator
) -> None:
    geometry = scan()
    images = rng.normal(0.2, 1, (9, 24, 30)).astype(np.float32)
    system = SystemMatrix(geometry, GRID, device)
    found = np.zeros(GRID.shape_zyx, np.float32)
    list(proximal_steps.steps(system, found, images.copy(), 7, TotalVariation(GRID, 0.0, device)))
    expected = cgls.cgls(
        Projections(geometry, images), GRID, iterations=7, nonnegative=True, device=device
    )
    np.testing.assert_array_equal(found, expected.attenuation)


def test_they_end_at_once_at_the_minimum(device: Device) -> None:
    system = SystemMatrix(scan(), GRID, device)
    found, nothing = np.zeros(GRID.shape_zyx, np.float32), np.zeros((9, 24, 30), np.float32)
    for penalty in (Nonnegative(), Sum(1.0), TotalVariation(GRID, 1.0, device)):
        assert not list(proximal_steps.steps(system, found, nothing.copy(), 5, penalty))
    assert not found.any()
