"""Total variation: its value, its proximal map, its weight in physical units, and few views."""

import dataclasses

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk, total_variation
from legsim.reconstruction.system_matrix import LargeVoxelWarning, SystemMatrix
from legsim.reconstruction.total_variation import TotalVariation, default_weight, noise_of, tv
from tests.examples import few_views
from tests.reconstruction.test_system_matrix import GRID, scan, swaying

OBLONG = VolumeGrid((5, 6, 7), (0.002, 0.003, 0.005), (0.0, 0.0, 0.0))


def slopes(volume: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    """(3, z, y, x) forward differences along x, y, z over the spacing, 0 past the last."""
    found = np.zeros((3, *volume.shape))
    for axis, spacing in enumerate(grid.spacing_xyz):
        along = 2 - axis
        last = np.take(volume, [-1], along)
        found[axis] = np.diff(volume, axis=along, append=last) / spacing
    return found


def variation(volume: np.ndarray, grid: VolumeGrid) -> float:
    return float(np.sqrt((slopes(volume.astype(float), grid) ** 2).sum(0)).sum())


def test_its_value_is_the_sum_of_gradients(device: Device, rng: np.random.Generator) -> None:
    volume = rng.random(OBLONG.shape_zyx, np.float32)
    expected = 0.3 * variation(volume, OBLONG)
    assert TotalVariation(OBLONG, 0.3, device).value(volume) == pytest.approx(expected, rel=1e-6)
    flat = np.full(OBLONG.shape_zyx, 20.0, np.float32)
    assert TotalVariation(OBLONG, 0.3, device).value(flat) == 0


def test_the_nearest_of_a_constant_volume_is_itself(device: Device) -> None:
    flat = np.full(OBLONG.shape_zyx, 20.0, np.float32)
    np.testing.assert_array_equal(TotalVariation(OBLONG, 1.0, device).nearest(flat, 3.0), flat)
    below = np.full(OBLONG.shape_zyx, -1.0, np.float32)
    assert not TotalVariation(OBLONG, 1.0, device).nearest(below, 3.0).any()


def test_the_nearest_volume_is_that_of_a_plain_reference(
    device: Device, rng: np.random.Generator
) -> None:
    """Projected gradient ascent of the dual in float64, by many plain steps."""
    volume, scale = rng.normal(1, 1, OBLONG.shape_zyx).astype(np.float32), 4e-4
    dual, norm = np.zeros((3, *OBLONG.shape_zyx)), 4 * sum(s**-2 for s in OBLONG.spacing_xyz)

    def primal() -> np.ndarray:
        drawn = np.zeros(OBLONG.shape_zyx)
        for axis, spacing in enumerate(OBLONG.spacing_xyz):
            drawn += np.diff(dual[axis], axis=2 - axis, prepend=0) / spacing
        return np.maximum(volume + scale * drawn, 0)

    for _ in range(20000):
        dual += slopes(primal(), OBLONG) / (scale * norm)
        dual /= np.maximum(1, np.sqrt((dual**2).sum(0)))
    penalty = TotalVariation(OBLONG, scale, device)
    found = volume
    for _ in range(50):
        found = penalty.nearest(volume, 1.0)
    assert (primal() == 0).any()
    assert variation(primal(), OBLONG) < 0.7 * variation(volume, OBLONG)
    np.testing.assert_allclose(found, primal(), atol=1e-4)


def test_weight_zero_is_nonnegative_least_squares(device: Device, rng: np.random.Generator) -> None:
    images = rng.normal(0.2, 1, (9, 24, 30)).astype(np.float32)
    projections, motion = Projections(scan(), images), swaying(rng, scan().times)
    given = {"motion": motion, "iterations": 6, "device": device}
    expected = cgls.cgls(projections, GRID, nonnegative=True, **given)
    found = tv(projections, GRID, weight=0.0, **given)
    np.testing.assert_array_equal(found.attenuation, expected.attenuation)


def test_motion_is_followed_as_if_the_scanner_had_moved(
    device: Device, rng: np.random.Generator
) -> None:
    still = few_views.turn(20)
    turns, shifts = rng.normal(0, 0.03, (20, 3)), rng.normal(0, 0.003, (20, 3))
    motion = RigidMotion(
        still.times, transforms.rigid(transforms.rotation_from_vector(turns), shifts)
    )
    images = few_views.noisy(20, 0.02, rng).line_integrals
    following = tv(
        Projections(still, images), few_views.FEW, motion=motion, iterations=5, device=device
    )
    moved = still.moved(motion.moved_from_reference)
    around = tv(Projections(moved, images), few_views.FEW, iterations=5, device=device)
    # the moved scanner's isocenter, and so a pixel's size there, differs by a little
    np.testing.assert_allclose(
        following.attenuation, around.attenuation, atol=0.02 * around.attenuation.max()
    )


def larger(geometry: ConeBeamGeometry, factor: float) -> ConeBeamGeometry:
    """The same scanner with all lengths times ``factor``."""
    matrices = geometry.matrices.copy()
    matrices[:, :, 3] *= factor
    return dataclasses.replace(
        geometry, matrices=matrices, pixel_pitch=factor * geometry.pixel_pitch
    )


def test_the_weight_is_a_length(device: Device, rng: np.random.Generator) -> None:
    """All lengths doubled, the weight too: half the attenuation. Views twice: the same volume."""
    projections = few_views.noisy(15, 0.05, rng)
    weight = default_weight(projections)
    plain = tv(projections, few_views.FEW, weight=weight, iterations=8, device=device).attenuation
    doubled = VolumeGrid(few_views.FEW.shape_zyx, (0.0072,) * 3, (0.0, 0.0, 0.0))
    grown = Projections(larger(projections.geometry, 2.0), projections.line_integrals)
    assert default_weight(grown) == pytest.approx(2 * weight, rel=1e-6)
    found = tv(grown, doubled, weight=2 * weight, iterations=8, device=device).attenuation
    np.testing.assert_allclose(2 * found, plain, atol=1e-3 * plain.max())
    denser = dataclasses.replace(
        projections.geometry,
        matrices=np.repeat(projections.geometry.matrices, 2, axis=0),
        times=np.arange(30) * 1.0,
    )
    twice = Projections(denser, np.repeat(projections.line_integrals, 2, axis=0))
    found = tv(twice, few_views.FEW, weight=weight, iterations=8, device=device).attenuation
    np.testing.assert_allclose(found, plain, atol=1e-3 * plain.max())


def test_attenuation_and_weight_scale_together(device: Device, rng: np.random.Generator) -> None:
    projections = few_views.noisy(15, 0.05, rng)
    weight = default_weight(projections)
    stronger = Projections(projections.geometry, 3 * projections.line_integrals)
    assert default_weight(stronger) == pytest.approx(3 * weight, rel=1e-5)
    plain = tv(projections, few_views.FEW, weight=weight, iterations=8, device=device)
    found = tv(stronger, few_views.FEW, weight=3 * weight, iterations=8, device=device)
    np.testing.assert_allclose(
        found.attenuation, 3 * plain.attenuation, atol=3e-3 * plain.attenuation.max()
    )


def test_a_ball_loses_the_contrast_that_the_weight_says(device: Device) -> None:
    """2 w / r^2, within a third: the loss also draws a faint halo, which the rule leaves out."""
    grid, radius = VolumeGrid.cubic(32, 0.0025, (0.0, 0.0, 0.0)), 0.02
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    ball = np.where(x**2 + y**2 + z**2 < radius**2, 20.0, 0.0).astype(np.float32)
    geometry = few_views.turn(40)
    projections = Projections(geometry, SystemMatrix(geometry, grid, device).forward(ball))
    inside = x**2 + y**2 + z**2 < (0.7 * radius) ** 2
    weight = 2e-4
    found = tv(projections, grid, weight=weight, iterations=150, device=device).attenuation
    loss = 20 - float(found[inside].mean())
    assert loss == pytest.approx(2 * weight / radius**2, rel=0.34)


def test_noise_alone_becomes_flat(device: Device, rng: np.random.Generator) -> None:
    """At the default weight noise of mean zero draws next to nothing; at a tenth it does."""
    geometry = few_views.turn(31)
    images = rng.normal(0, 0.1, (31, 40, 52)).astype(np.float32)
    projections = Projections(geometry, images)
    kept, small = (
        tv(projections, few_views.FEW, weight=share * w, device=device).attenuation.std()
        for w in [default_weight(projections, noise=0.1)]
        for share in (1.0, 0.1)
    )
    assert kept < 0.1 * small


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3])
def test_noise_is_seen_in_the_images(rng: np.random.Generator, sigma: float) -> None:
    assert noise_of(few_views.noisy(31, sigma, rng)) == pytest.approx(sigma, rel=0.25, abs=0.02)


@pytest.mark.parametrize(("views", "sigma"), [(31, 0.0), (31, 0.1), (62, 0.0), (62, 0.1)])
def test_few_views_of_few_materials_beat_fdk_and_cgls(
    device: Device, rng: np.random.Generator, views: int, sigma: float
) -> None:
    projections, grid = few_views.noisy(views, sigma, rng), few_views.FEW
    found = few_views.error(tv(projections, grid, device=device))
    others = (
        fdk.fdk(projections, grid, device=device),
        cgls.cgls(projections, grid, device=device),
        cgls.cgls(projections, grid, nonnegative=True, device=device),
    )
    assert found < 0.7 * min(few_views.error(other) for other in others)


def test_the_default_weight_is_near_the_best(device: Device, rng: np.random.Generator) -> None:
    projections = few_views.noisy(31, 0.1, rng)
    weight = default_weight(projections)
    errors = [
        few_views.error(tv(projections, few_views.FEW, weight=share * weight, device=device))
        for share in (0.5, 1.0, 2.0)
    ]
    assert errors[1] < 1.05 * min(errors)


def test_refusals(device: Device) -> None:
    projections = Projections(scan(), np.zeros((9, 24, 30), np.float32))
    for given, words in (
        ({"iterations": 0}, "at least 1"),
        ({"weight": -1e-3}, "a weight of -0.001 m was given"),
        ({"noise": -1.0}, "noise of -1 was given"),
        ({"noise": 0.1, "weight": 1e-6}, "both say how smooth"),
    ):
        with pytest.raises(LegsimError, match=words):
            tv(projections, GRID, device=device, **given)
    nothing: Volume = tv(projections, GRID, device=device)
    assert not nothing.attenuation.any()
    coarse = VolumeGrid((4, 5, 6), (0.012, 0.012, 0.012), (0.01, 0.0, -0.005))
    with pytest.warns(LargeVoxelWarning, match="voxels of 12 mm are larger than a pixel"):
        tv(projections, coarse, device=device)


def test_memory_is_stated_before(device: Device) -> None:
    least = total_variation.needed_bytes(scan(), GRID, device=device)
    assert least > 4 * 8 * np.prod(GRID.shape_zyx)
