"""One table of what was compared with other toolkits: quantity, authority, tolerance, difference.

tests/conftest.py takes the fixture and the hook from here for all tests.
"""

import importlib.metadata
from collections.abc import Callable, Iterable

import pytest
from _pytest.terminal import TerminalReporter
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

PROPERTY = "agreement"
PACKAGES = {
    "OpenSim": "opensim",
    "RTK": "itk-rtk",
    "ASTRA": "astra-toolbox",
    "gVirtualXray": "gvxr",
    "GTSAM": "gtsam",
}
"""Authorities, and the distributions that they come in"""

Check = Callable[[str, str, float, float, str], None]


@pytest.fixture
def agree(record_property: Callable[[str, object], None]) -> Check:
    """Compares a difference with its tolerance, and enters both into the table."""

    def check(quantity: str, authority: str, difference: float, tolerance: float, unit: str):
        row = (quantity, authority, float(tolerance), float(difference), unit)
        record_property(PROPERTY, row)
        assert difference <= tolerance, f"{quantity} beside {authority}, {unit}"

    return check


def pytest_terminal_summary(terminalreporter: TerminalReporter) -> None:
    """Prints the table after ``-m peer``, and which authorities were missing."""
    if "peer" not in terminalreporter.config.option.markexpr:
        return
    stats = terminalreporter.stats
    reports = [r for kind in ("passed", "failed") for r in stats.get(kind, ())]
    rows = [v for r in reports for name, v in getattr(r, "user_properties", ()) if name == PROPERTY]
    missing = stats.get("skipped", ())
    if rows or missing:
        terminalreporter.section("beside other toolkits")
    if rows:
        # written by the reporter, since pytest holds the streams back
        console = Console(width=120, color_system=None)
        with console.capture() as text:
            console.print(table(rows))
        terminalreporter.write(text.get())
    for line in reasons(missing):
        terminalreporter.line(line)


def table(rows: Iterable[tuple[str, str, float, float, str]]) -> Table:
    """The largest difference of each quantity over all tests that measured it."""
    found: dict[tuple[str, str, float, str], list[float]] = {}
    for quantity, authority, tolerance, difference, unit in rows:
        found.setdefault((quantity, authority, tolerance, unit), []).append(difference)
    out = Table(box=MARKDOWN)
    for head in ("quantity", "authority", "tolerance", "difference", "unit", "checks", ""):
        out.add_column(head, justify="right" if head in ("tolerance", "difference") else "left")
    for (quantity, authority, tolerance, unit), values in sorted(found.items()):
        # a NaN fails its check and must not hide behind the others
        worst = max(values, key=lambda v: (v != v, v))
        numbers = (f"{tolerance:.2g}", f"{worst:.2g}", unit, str(len(values)))
        out.add_row(quantity, version(authority), *numbers, "" if worst <= tolerance else "FAILED")
    return out


def version(authority: str) -> str:
    """The authority with the version that is installed."""
    try:
        return f"{authority} {importlib.metadata.version(PACKAGES[authority])}"
    except (KeyError, importlib.metadata.PackageNotFoundError):
        return authority


def reasons(skipped: Iterable[pytest.TestReport]) -> list[str]:
    """One line for each reason of tests that were left out."""
    counts: dict[str, int] = {}
    for report in skipped:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else "no reason given"
        reason = reason.removeprefix("Skipped: ")
        counts[reason] = counts.get(reason, 0) + 1
    return [f"not compared ({n} tests): {reason}" for reason, n in counts.items()]
