"""Counts to line integrals: Lambert and Beer's law back to front, and what is refused."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import counts
from legsim.geometry.counts import Counts, Region


def integrals(views=3, shape=(16, 24)):
    """A body in the middle of each view, air at its sides."""
    u, v = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    middle = [np.clip(4 - 0.1 * ((u - 12) ** 2 + (v - 8 - k) ** 2), 0, None) for k in range(views)]
    return np.stack(middle).astype(np.float32)


def test_a_flat_and_a_dark_field_give_back_the_line_integrals(rng):
    gain, dark = rng.uniform(3e4, 5e4, (16, 24)), rng.uniform(90, 110, (16, 24))
    images = dark + gain * np.exp(-integrals())
    made = counts.line_integrals(images, Counts(flat=gain + dark, dark=dark))
    np.testing.assert_allclose(made.values, integrals(), atol=1e-5)
    assert not made.notes


def test_one_reading_without_an_object_includes_the_dark_one():
    images = 100 + 4e4 * np.exp(-integrals())
    made = counts.line_integrals(images, Counts(i0=40100.0, dark=np.full((16, 24), 100.0)))
    np.testing.assert_allclose(made.values, integrals(), atol=1e-5)


def test_air_scales_each_view_alone():
    tube = np.array([1.0, 1.1, 0.9])[:, None, None]
    images = 4e4 * tube * np.exp(-integrals())
    made = counts.line_integrals(images, Counts(air=Region.parsed("0:4,0:16")))
    np.testing.assert_allclose(made.values, integrals(), atol=1e-5)
    both = Counts(air=Region.parsed("0:4,0:16"), flat=np.full((16, 24), 7e4))
    np.testing.assert_allclose(counts.line_integrals(images, both).values, integrals(), atol=1e-5)


def test_bad_pixels_are_interpolated_and_counted():
    images = np.rint(4e4 * np.exp(-integrals())).astype(np.uint16)
    images[:, 8, 12] = 0
    images[1, 3, 3] = 0
    images[2, 14, 20] = 65535
    made = counts.line_integrals(images, Counts(i0=4e4))
    np.testing.assert_allclose(made.values, integrals(), atol=0.2)
    assert "1 bad pixels interpolated in all views: 0 given, 1 dead, 0 stuck" in made.notes[0]
    assert "2 pixels that read nothing or are saturated in single views" in made.notes[1]


def test_air_at_the_end_of_the_range_stays():
    images = np.rint(65535 * np.exp(-integrals())).astype(np.uint16)
    made = counts.line_integrals(images, Counts(i0=65535.0))
    np.testing.assert_allclose(made.values, integrals(), atol=1e-3)
    assert not made.notes


@pytest.mark.parametrize(
    ("change", "given", "message"),
    [
        (lambda i: 65000 - i, {"i0": 1000.0}, "a twentieth of all line integrals is below"),
        (lambda i: i, {"i0": 3e4}, "reading without an object is wrong"),
        (lambda i: i, {"flat": np.full((4, 4), 5e4)}, r"flat image has \(4, 4\) columns"),
        (lambda i: i, {"air": Region((0, 99), (0, 2))}, "is not part of 24 columns and 16 rows"),
        (
            lambda i: i,
            {"flat": np.full((16, 24), 5.0), "dark": np.full((16, 24), 9.0)},
            "exchange flat",
        ),
        (lambda i: np.where(i > 3.9e4, 0, i), {"i0": 4e4}, "view 0: .* % of the pixels are bad"),
    ],
)
def test_impossible_counts_are_refused(change, given, message):
    images = change(4e4 * np.exp(-integrals()))
    with pytest.raises(LegsimError, match=message):
        counts.line_integrals(images, Counts(**given))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "make no line integrals"),
        ({"dark": np.ones((2, 2))}, "make no line integrals"),
        ({"i0": -1.0}, "give the positive reading"),
        ({"i0": 1.0, "air": Region((0, 1), (0, 1))}, "give one"),
    ],
)
def test_too_much_and_too_little_is_refused(given, message):
    with pytest.raises(LegsimError, match=message):
        Counts(**given)


@pytest.mark.parametrize("text", ["0:4", "a:b,c:d", "0:4:5,1:2", ""])
def test_a_region_is_columns_and_rows(text):
    with pytest.raises(LegsimError, match="is no region"):
        Region.parsed(text)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (np.rint(4e4 * np.exp(-integrals())).astype(np.uint16), "holds whole numbers"),
        (4e4 * np.exp(-integrals()), r"above 20, up to 4e\+04"),
        (np.exp(-integrals()), "looks like transmissions"),
        (-1 - integrals(), "a twentieth of its values is below"),
        (-integrals(), "their mean is .* turn their sign"),
    ],
)
def test_what_is_no_line_integral_is_refused(images, message):
    with pytest.raises(LegsimError, match=rf"p\.mha: .*{message}"):
        counts.refuse_counts(images, "p.mha")


def test_line_integrals_pass_with_noise_metal_and_bodies_beyond_the_view(rng):
    noisy = integrals() + rng.normal(0, 0.1, integrals().shape)
    metal = integrals()
    metal[0, 8, 12] = 60.0
    for images in (integrals(), noisy, metal, 3 + integrals(), np.zeros((2, 4, 5), np.float32)):
        counts.refuse_counts(images, "p.mha")


def test_the_air_region_may_be_its_text(rng):
    images = rng.integers(20000, 30000, (2, 8, 9)).astype(np.uint16)
    texts, regions = (
        counts.line_integrals(images, counts.Counts(air=air)).values  # pyright: ignore[reportArgumentType]
        for air in ("0:3,0:8", counts.Region((0, 3), (0, 8)))
    )
    np.testing.assert_array_equal(texts, regions)
