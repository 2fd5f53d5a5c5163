"""The table of differences shows the worst of each quantity, and what was not compared."""

import io
import math

import pytest
from rich.console import Console

from tests.peers import agreement


def printed(rows) -> str:
    stream = io.StringIO()
    Console(file=stream, width=120, color_system=None).print(agreement.table(rows))
    return stream.getvalue()


def test_the_worst_of_each_quantity_is_shown():
    rows = [("angle", "Nobody", 0.01, d, "deg") for d in (0.002, 0.007, 0.004)]
    (line,) = [x for x in printed(rows).splitlines() if "angle" in x]
    assert [cell.strip() for cell in line.split("|")[1:-1]] == [
        *("angle", "Nobody", "0.01", "0.007", "deg", "3", "")
    ]


@pytest.mark.parametrize("bad", [0.02, math.nan])
def test_a_quantity_that_failed_once_says_so(bad):
    rows = [("angle", "Nobody", 0.01, d, "deg") for d in (0.002, bad, 0.004)]
    assert "FAILED" in printed(rows)


def test_a_difference_that_is_no_number_fails(agree):
    with pytest.raises(AssertionError, match="angle beside Nobody"):
        agree("angle", "Nobody", math.nan, 0.01, "deg")


def test_reasons_for_missing_peers_are_counted():
    skipped = [
        pytest.TestReport(
            f"tests/peers/test_{k}.py::t",
            ("", 0, ""),
            {},
            "skipped",
            ("file", 1, "Skipped: no toolkit"),
            "setup",
        )
        for k in range(3)
    ]
    assert agreement.reasons(skipped) == ["not compared (3 tests): no toolkit"]
