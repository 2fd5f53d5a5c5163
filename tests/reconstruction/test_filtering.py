"""Filters and weights against what theory says of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction import filtering, ramp_filter, truncation
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


def test_the_ramp_has_the_slope_of_the_frequency() -> None:
    length, response = ramp_filter.filter_response(2000, "ram-lak")
    frequency = np.fft.rfftfreq(length)
    np.testing.assert_allclose(response, frequency, atol=2e-4)


def test_shepp_logan_is_the_ramp_times_a_sinc() -> None:
    length, response = ramp_filter.filter_response(2000, "shepp-logan")
    frequency = np.fft.rfftfreq(length)
    np.testing.assert_allclose(response, frequency * np.sinc(frequency), atol=2e-4)


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


def test_a_water_cylinder_cut_off_at_the_edge_is_continued_as_it_was() -> None:
    x = np.arange(-200, 200) + 0.5
    chord = 2 * 0.02 * np.sqrt(np.maximum(120.0**2 - (x - 15) ** 2, 0.0))
    row = chord[120:280].astype(np.float32)[None]
    full = truncation.extended_rows(row, 120, 0.02)[0]
    assert np.abs(full - chord).mean() < 0.02 * chord.max()
    cut = np.where((x > -80) & (x < 80), chord, 0.0)
    assert np.abs(cut - chord).mean() > 4 * np.abs(full - chord).mean()
    assert full.sum() == pytest.approx(chord.sum(), rel=0.06)


@given(
    rows=arrays.arrays(np.float32, (3, 40), elements=st.floats(-5, 20, width=32)),
    reach=st.integers(1, 60),
)
@settings(max_examples=60, deadline=None)
def test_extended_rows_are_finite_and_end_in_zero(rows: np.ndarray, reach: int) -> None:
    extended = truncation.extended_rows(rows, reach, 0.01)
    assert extended.shape == (3, 40 + 2 * reach)
    assert np.isfinite(extended).all()
    np.testing.assert_array_equal(extended[:, reach : reach + 40], rows)
    np.testing.assert_allclose(extended[:, [0, -1]], 0.0, atol=1e-5)
    assert extended[:, :reach].min() >= -1e-5


def test_an_object_inside_the_detector_is_not_continued(rng: np.random.Generator) -> None:
    rows = np.zeros((4, 80), np.float32)
    rows[:, 20:60] = rng.uniform(0, 3, (4, 40))
    assert not truncation.extended_rows(rows, 50, 0.01)[:, :50].any()


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


def test_options_that_make_no_sense_are_refused() -> None:
    with pytest.raises(LegsimError, match="ram-lak, shepp-logan, hann"):
        FilterOptions(window="gauss")  # type: ignore[arg-type]
    with pytest.raises(LegsimError, match="water_attenuation"):
        FilterOptions(water_attenuation=-1.0)
