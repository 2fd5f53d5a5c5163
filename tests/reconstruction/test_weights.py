"""Redundancy weights: every line counts once, whatever the range."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.reconstruction.source_path import fan_angles, source_arc
from legsim.reconstruction.weights import ShortScanWarning, redundancy_weights, warn_if_incomplete


def scan(span_deg: float, views: int, start_deg: float = 0.0) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(start_deg + np.linspace(0, span_deg, views)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(12, 62),
        pixel_pitch=6.16e-3,
        isocenter=(0.1, -0.2, 0.3),
    )


def shares_of(geometry: ConeBeamGeometry) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    arc = source_arc(geometry)
    fans = fan_angles(geometry, arc, np.arange(geometry.shape_vu[1], dtype=float))
    return arc.angles, fans, redundancy_weights(arc, fans), arc.coverage


@pytest.mark.end_to_end
@given(span=st.floats(100, 353), start=st.floats(-180, 180), backwards=st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_shares_of_one_line_add_up_to_one(span: float, start: float, backwards: bool) -> None:
    views = int(span) + 1
    arc = source_arc(scan(-span if backwards else span, views, start))
    angles, fans, shares, coverage = shares_of(scan(-span if backwards else span, views, start))
    assert np.isfinite(shares).all()
    assert shares.min() >= 0
    assert shares.max() <= 1
    opposite = np.mod(angles[:, None] + np.pi + 2 * fans, 2 * np.pi)
    measured = opposite < coverage
    for column in range(fans.shape[1]):
        seen = measured[:, column]
        again = redundancy_weights(
            replace(arc, angles=opposite[:, column]), -fans[:, column : column + 1]
        )[:, 0]
        np.testing.assert_allclose((shares[:, column] + again)[seen], 1.0, atol=1e-12)
    np.testing.assert_allclose(shares[~measured], 1.0)


def test_a_complete_short_scan_has_parkers_weights() -> None:
    span = 210.0
    angles, fans, shares, coverage = shares_of(scan(span, 421))
    virtual = 0.5 * (coverage - np.pi)
    b, g = angles[:, None], fans
    rising, falling = b < 2 * (virtual - g), b > np.pi - 2 * g
    parker = np.where(rising, np.sin(np.pi / 4 * b / (virtual - g)) ** 2, 1.0)
    parker = np.where(
        falling, np.sin(np.pi / 4 * (np.pi + 2 * virtual - b) / (virtual + g)) ** 2, parker
    )
    np.testing.assert_allclose(shares, parker, atol=1e-9)


def test_a_full_turn_counts_every_line_twice_and_once_where_a_view_repeats() -> None:
    for geometry in (scan(359, 360), scan(360, 361), scan(719, 720)):
        _, _, shares, coverage = shares_of(geometry)
        np.testing.assert_allclose(shares, 0.5, atol=1e-12)
        assert coverage == pytest.approx(2 * np.pi)
    assert source_arc(scan(360, 361)).increments[0] == pytest.approx(np.radians(0.5))


def test_the_warning_gives_the_numbers() -> None:
    for span, expected in ((197.6, True), (199.0, False), (359.0, False)):
        geometry = scan(span, 360 if span > 300 else 248)
        arc = source_arc(geometry)
        fans = fan_angles(geometry, arc, np.array([-0.5, 61.5]))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            warn_if_incomplete(arc, fans)
        assert bool(caught) is expected
        if expected:
            assert issubclass(caught[0].category, ShortScanWarning)
            assert "197.6 deg" in str(caught[0].message)
            assert "198.1 deg" in str(caught[0].message)


@pytest.mark.parametrize(("missing", "expected"), [(0, False), (4, False), (8, True)])
def test_a_part_of_the_arc_that_is_missing_is_reported(missing: int, expected: bool) -> None:
    """248 views over 210 degrees without ``missing`` of them in the middle."""
    whole = scan(210.0, 248)
    geometry = replace(
        whole,
        matrices=np.delete(whole.matrices, np.s_[100 : 100 + missing], 0),
        times=np.delete(whole.times, np.s_[100 : 100 + missing]),
    )
    arc = source_arc(geometry)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_if_incomplete(arc, fan_angles(geometry, arc, np.array([-0.5, 61.5])))
    assert [str(w.message).split(" deg")[0] for w in caught] == (
        ["the sources leave 7.7"] if expected else []
    )


@pytest.mark.parametrize("step_deg", [2.0, 6.0, 12.0])
def test_a_second_turn_from_the_same_places_is_no_gap(step_deg: float) -> None:
    views = int(720 / step_deg)
    geometry = scan(720 - step_deg, views)
    arc = source_arc(geometry)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_if_incomplete(arc, fan_angles(geometry, arc, np.array([-0.5, 61.5])))
