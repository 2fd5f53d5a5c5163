"""Layouts of tables that contradict themselves."""

from dataclasses import replace

import pytest

from legsim.core.errors import LegsimError
from legsim.imu.table_layout import SensorColumns, TableLayout

SENSOR = SensorColumns("shank", ("ax", "ay", "az"), ("gx", "gy", "gz"))


def test_a_layout_has_one_clock():
    with pytest.raises(LegsimError, match=r"give one of them"):
        TableLayout((SENSOR,), time="t", rate_hz=100)
    with pytest.raises(LegsimError, match=r"needs rate_hz"):
        TableLayout((SENSOR,), time="t", counter="n")


def test_counts_and_a_unit_are_not_both_given():
    with pytest.raises(LegsimError, match=r"counts_per_g is given beside the unit g"):
        TableLayout((SENSOR,), "g", time="t", counts_per_g=16384)


def test_texts_of_rows_and_their_column_are_given_together():
    with_rows = replace(SENSOR, acceleration_rows="A", angular_velocity_rows="G")
    for sensor, column in (
        (with_rows, None),
        (SENSOR, 1),
        (replace(SENSOR, acceleration_rows="A"), 1),
    ):
        with pytest.raises(LegsimError, match="rows_by needs acceleration_rows and angular"):
            TableLayout((sensor,), time="t", rows_by=column)
