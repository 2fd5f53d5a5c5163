"""The section on measured sensors."""

from legsim.imu.comparison import compare
from legsim.report.imu_section import imu_section
from tests.examples.sensors import swaying


def test_each_band_of_each_sensor_is_a_row():
    section = imu_section([compare(swaying(), swaying().named("own"))], ["a line"])
    (table,) = section.tables
    assert section.lines == ("a line",)
    assert len(table.rows) == 6
    first = table.rows[0]
    assert first[:3] == ("own", "angular velocity (deg/s)", "0.2 to 6")
    assert first[3] == first[4]
    assert float(first[5]) < 1e-9
    assert first[6] == "1.00"
    assert section.figures[0].png.startswith(b"\x89PNG")
