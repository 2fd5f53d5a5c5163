"""Cells of text files: every runtime's "not a number", and what is no number at all."""

import math

import pytest

from legsim.mocap.cells import number


@pytest.mark.parametrize("text", [
    "nan", "NaN", "-nan", "+NaN", "nan(ind)", "-nan(ind)", "-NaN(IND)", "nan(snan)", "-nan(snan)", "nan(0x8000000000000)", "1.#QNAN",
    "-1.#QNAN0", "1.#QNANB", "-1.#IND", "-1.#IND00", "1.#IND000", "1.#SNAN", "1.#R", "1.#QO", "NaNQ", "NaNS", "N/A", "n/a", "#N/A", "NA",
    "<NA>", "NULL", "None", "missing", ".nan", "#NUM!", "-", "--",
])  # fmt: skip
def test_not_a_number_in_any_spelling(text):
    found = number(text)
    assert found is not None
    assert math.isnan(found)


@pytest.mark.parametrize("text", [
    "inf", "-Inf", "Infinity", "1.#INF", "-1.#INF00", "1.#J", "1e999", "1_000", "1,5", "one", "", "nano", "nan nan", "0x10", "1.#",
])  # fmt: skip
def test_what_is_no_number_is_none(text):
    assert number(text) is None


@pytest.mark.parametrize(("text", "value"), [("1.5", 1.5), ("-.5E-3", -0.0005), ("+7", 7.0)])
def test_numbers(text, value):
    assert number(text) == value


@pytest.mark.parametrize("text", ["1e31", "-1e300", "1e309", "inf", "1_000"])
def test_what_no_quantity_can_be_is_no_number(text):
    assert number(text) is None
    assert number("1e29") == 1e29
