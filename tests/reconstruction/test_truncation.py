"""Rows that are cut off at the detector's edge are continued, others are left."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from legsim.reconstruction import truncation


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
