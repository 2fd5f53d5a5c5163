"""Views that no scanner takes are named; those of a scan are not."""

import numpy as np
import pytest

from legsim.geometry import odd_views


@pytest.fixture
def views(rng) -> np.ndarray:
    return np.maximum(rng.normal(1.5, 1.0, (8, 6, 7)), 0).astype(np.float32)


def said(values: np.ndarray, by_reading: bool = False) -> str:
    return "\n".join(odd_views.objections(values, by_reading=by_reading))


def test_a_scan_is_not_doubted(views):
    assert said(views) == said(views, by_reading=True) == ""


def test_dropped_views_are_named(views):
    views[3] = 0
    assert said(views).startswith("view 3 has one value throughout")
    views[5] = 2
    assert said(views).startswith("views 3, 5 have one value throughout")


def test_repeated_views_are_named_once(views):
    views[4] = views[3]
    assert said(views).startswith("view 4 has the same image as the one before")
    views[1:] = 0  # one kind of mistake, not two
    assert "same image" not in said(views)


@pytest.mark.parametrize("value", [0.0, 2.0])
def test_a_scan_of_nothing_is_named(value):
    assert said(np.full((4, 5, 6), value, np.float32)).startswith("every view has one value")


def test_a_reading_without_an_object_that_is_ten_times_too_large_is_named(views):
    wrong = views + np.float32(np.log(10))
    assert "10 times too large" in said(wrong, by_reading=True)
    # line integrals that somebody else made may be of a body that fills every view
    assert said(wrong) == ""


def test_values_that_no_body_reaches_are_named(views):
    assert "no body reaches 20" in said(views * 1000)


def test_images_of_eight_bits_are_named():
    line = odd_views.coarse(np.array([[[0, 255], [9, 3]]], np.uint8))
    assert "0.69 of a line integral" in line[0]
    assert odd_views.coarse(np.array([[[0, 60000]]], np.uint16)) == ()
    assert odd_views.coarse(np.array([[[0.0, 1.0]]], np.float32)) == ()
