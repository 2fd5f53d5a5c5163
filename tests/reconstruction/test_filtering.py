"""Filters and weights against what theory says of them."""

import numpy as np
import pytest

from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction import filtering, ramp_filter
from legsim.reconstruction.ramp_filter import FilterOptions


def scan(
    shape_vu: tuple[int, int] = (5, 64), views: int = 40, angles: np.ndarray | None = None
) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(np.linspace(0, 220, views)) if angles is None else angles,
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=shape_vu,
        pixel_pitch=4e-3,
    )


@pytest.mark.parametrize("window", ["ram-lak", "shepp-logan"])
def test_filtering_is_the_linear_convolution_with_the_kernel(
    window: ramp_filter.Window, rng: np.random.Generator
) -> None:
    geometry = scan()
    options = FilterOptions(window=window, water_attenuation=None)
    plan = filtering.plan_filter(geometry, options)
    image = rng.normal(size=(1, 5, 64)).astype(np.float32)
    kernel = (
        ramp_filter.shepp_logan_kernel(64)
        if window == "shepp-logan"
        else ramp_filter.ramp_kernel(64)
    )
    weighted = image[0] * plan.ray_weights(7) * plan.shares[7]
    expected = [np.convolve(row, kernel)[63:127] for row in weighted]
    np.testing.assert_allclose(
        filtering.filter_batch(plan, image, slice(7, 8))[0],
        expected,
        atol=1e-5 * np.abs(expected).max(),
    )


def test_cosines_are_those_of_a_flat_detector_facing_the_source() -> None:
    geometry = scan()
    plan = filtering.plan_filter(geometry, FilterOptions(water_attenuation=None))
    v, u = np.mgrid[:5, :64]
    expected = 1.198 / np.sqrt(1.198**2 + (4e-3 * (u - 31.5)) ** 2 + (4e-3 * (v - 2)) ** 2)
    np.testing.assert_allclose(plan.ray_weights(11), expected * 1.198 / 4e-3, rtol=1e-6)


def test_batches_come_in_order_and_do_not_depend_on_their_size(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    geometry = scan()
    projections = Projections(geometry, rng.normal(size=(40, 5, 64)).astype(np.float32))
    whole = np.concatenate([b for _, b in filtering.filtered_views(projections, FilterOptions())])
    monkeypatch.setattr(filtering, "_BATCH_ELEMENTS", 1)
    seen: list[int] = []
    single = list(
        filtering.filtered_views(projections, FilterOptions(), lambda done, _: seen.append(done))
    )
    assert [s.start for s, _ in single] == list(range(40))
    assert seen == list(range(1, 41))
    np.testing.assert_array_equal(np.concatenate([b for _, b in single]), whole)
