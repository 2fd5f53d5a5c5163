"""The section on measured sensors beside predicted ones."""

from collections.abc import Sequence

from legsim import figures
from legsim.imu.comparison import BandAgreement, SensorComparison
from legsim.report.page import PageSection, Picture, Table

_NOTE = (
    "RMS of the vector in each band, after the lag and the mounting rotation; the difference is of "
    "measured minus predicted. Markers are filtered to 6 Hz: above it the prediction holds nothing."
)
_CAPTION = "Angular velocity up to 6 Hz, measured in the predicted sensor's axes and clock."


def imu_section(compared: Sequence[SensorComparison], lines: Sequence[str]) -> PageSection:
    """Builds lines, table and curves of all compared sensors."""
    head = ("sensor", "quantity", "band (Hz)", "measured", "predicted", "difference", "correlation")
    rows = tuple(_row(one, band) for one in compared for band in one.bands)
    drawn = figures.png(figures.imu_comparison(compared))
    return PageSection(
        "Measured sensors",
        tuple(lines),
        (Table("Measured and predicted", head, rows, _NOTE),),
        (Picture(_CAPTION, drawn),),
    )


def _row(one: SensorComparison, band: BandAgreement) -> tuple[str, ...]:
    unit = "deg/s" if band.quantity == "rate" else "mg"
    low, high = band.band_hz
    numbers = (f"{v:.3g}" for v in (band.measured, band.predicted, band.difference))
    what = "angular velocity" if band.quantity == "rate" else "specific force"
    return (
        one.measured.name, f"{what} ({unit})", f"{low:g} to {high:g}", *numbers,
        f"{band.correlation:.2f}",
    )  # fmt: skip
