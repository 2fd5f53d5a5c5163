"""Times of the day, of the hour and dates are seconds that go on."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import moments


def read(cells):
    return moments.seconds(Path("a.csv"), range(2, 2 + len(cells)), cells, "t")


@pytest.mark.parametrize(("cells", "seconds"), [
    (["00:01.230", "00:01.480", "01:00.000"], [1.23, 1.48, 60]),
    (["59:59.900", "00:00.100"], [3599.9, 3600.1]),
    (["9:00:00.000", "10:00:00,125"], [32400, 36000.125]),
    (["23:59:59.990", "", "00:00:00.010", "00:00:00.030"], [86399.99, np.nan, 86400.01, 86400.03]),
    (["12:00:00Z", "12:00:01+01:00"], [43200, 43201]),
    (["1970-01-01T00:00:01", "1970-01-02 00:00:00.5", "1970/01/01 00:00:02Z"], [1, 86400.5, 2]),
])  # fmt: skip
def test_what_loggers_write_is_seconds(cells, seconds):
    np.testing.assert_allclose(read(cells), seconds)


@pytest.mark.parametrize("cells", [
    ["2025-5-24 9:4:7.125", "2025-5-24 9:4:8.000"],
    ["2025.05.24 9:04:07.125", "2025.05.24 09:04:08"],
    ["24.05.2025 09:04:07,125", "24.05.2025 09:04:08,000"],
    ["24.05.25 09:04:07,125", "24.05.25 09:04:08,000"],
    ["5/24/2025 09:04:07.125", "5/24/2025 09:04:08.000"],
    ["24/05/2025, 09:04:07.125", "24/05/2025, 09:04:08.000"],
    ["5/24/2025 9:04:07.125 AM", "5/24/2025 9:04:08.000 AM"],
    ["24-May-2025 09:04:07.125", "24-May-2025 09:04:08.000"],
    ["May 24 2025 09:04:07.125", "May 24 2025 09:04:08.000"],
    ["May 24, 2025, 9:04:07.125 AM", "May 24, 2025, 9:04:08.000 AM"],
    ["25-05-24 09:04:07.125", "25-05-24 09:04:08.000"],
    ["2025/05/24 09:04:07:125", "2025/05/24 09:04:08:000"],
])  # fmt: skip
def test_dates_of_any_order_are_one_moment(cells):
    begin, end = read(cells)
    assert begin == pytest.approx(1748077447.125, abs=1e-6)
    assert end - begin == pytest.approx(0.875, abs=1e-6)


def test_of_a_date_that_may_be_either_the_day_is_what_changes():
    for cells in (
        ["3/4/2025 23:59:59", "3/5/2025 0:00:01"],
        ["4/3/2025 23:59:59", "5/3/2025 0:0:1"],
    ):
        assert np.diff(read(cells)) == [2.0]


@pytest.mark.parametrize("dates", [
    ("25-12-30", "25-12-31"), ("25.12.30", "25.12.31"), ("30-12-25", "31-12-25"),
    ("25-12-31", "26-01-01"), ("12/31/25", "1/1/26"), ("31/12/25", "01/01/26"),
    ("05-06-07", "05-06-08"), ("05/06/07", "06/06/07"), ("05/06/07", "05/07/07"),
    ("25-Dec-30", "25-Dec-31"), ("31-Jan-2025", "01-Feb-2025"), ("Dec 31 2024", "Jan 1 2025"),
    ("4/30/2025", "5/1/2025"), ("30/4/2025", "1/5/2025"),
])  # fmt: skip
def test_the_order_of_a_date_is_that_by_which_days_go_on(dates):
    before, after = dates
    assert np.diff(read([f"{before} 23:59:59", f"{after} 0:00:01"])) == [2.0]


def test_dates_that_leap_by_every_order_are_refused():
    with pytest.raises(LegsimError, match=r"'1/2/2025 .*column 't' may be .*'dmy' or 'mdy'.*leap"):
        read(["1/2/2025 12:00:00", "2/3/2025 12:00:00"])


def test_a_date_that_is_none_is_named_though_the_others_have_another_order():
    with pytest.raises(LegsimError, match=r"a.csv \(line 4\): '33/05/2025 1:00:00' in"):
        read(["24/05/2025 1:00:00", "25/05/2025 1:00:00", "33/05/2025 1:00:00"])


def test_a_clock_of_twelve_hours_goes_past_noon_and_midnight():
    times = read(["11:59:59.5 AM", "12:00:00 PM", "1:00:00 PM", "11:59:59 PM", "12:00:01 AM"])
    np.testing.assert_allclose(times - times[0], [0, 0.5, 3600.5, 43199.5, 43201.5])


@pytest.mark.parametrize(
    "cell", ["12:60:00", "00:61", "12:00:00 AM", "noon", "31.01.2025 12:00:00", "2025-01-31 12:00"]
)
def test_what_is_no_time_is_refused_with_its_line(cell):
    with pytest.raises(LegsimError, match=r"a.csv \(line 3\): '.*' in column 't' is no date"):
        read(["12:00:00", cell])
    with pytest.raises(LegsimError, match=r"a.csv \(line 3\)"):
        read(["5/24/2025 12:00:00", "5/33/2025 12:00:00"])


def test_milliseconds_may_stand_behind_a_third_colon():
    times = read(["23:59:59:750", "00:00:00:000", "00:00:00:250"])
    np.testing.assert_allclose(np.diff(times), 0.25, atol=1e-9)
    assert read(["2025-01-31 12:00:00:125"]) == read(["2025-01-31T12:00:00.125"])
