"""Which tests a marker expression selects."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = (
    "tests/correction/test_fiducials.py",  # some of its tests are slow: those of 5000 poses
    "tests/end_to_end/test_wheel.py",
    "tests/peers/test_rtk.py",
)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("", {"correction", "end_to_end"}),
        ("slow", {"correction", "5000"}),
        ("peer or not end_to_end", {"correction", "peers"}),
    ],
)
def test_slow_peer_and_gpu_run_only_where_they_are_named(expression: str, expected: set[str]):
    command = [sys.executable, "-m", "pytest", "--collect-only", "-m", expression, *FILES]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    words = ("correction/", "end_to_end/", "peers/", "5000")
    assert {word.strip("/") for word in words if word in answer.stdout} == expected
