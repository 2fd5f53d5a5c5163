"""Every tool can be imported and is started by the command that the documents name."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for path in (ROOT / "tools").rglob("*.py")
)
PEERS = {"itk", "opensim", "gvxrPython3"}
"""Other toolkits, from the extra "peer\""""


def documented() -> set[str]:
    """Modules that documents and tools start with `python -m`."""
    pages = [p for p in ROOT.rglob("*.md") if not p.relative_to(ROOT).parts[0].startswith(".")]
    texts = [path.read_text("utf-8") for path in (*pages, *(ROOT / "tools").rglob("*.py"))]
    found = (re.findall(r"python\s+-m\s+(tools[\w.]*\w)(?!\.?[<\w])", text) for text in texts)
    return {name for names in found for name in names}


@pytest.mark.parametrize("name", MODULES)
def test_every_module_imports(name: str):
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in PEERS:
            raise
        pytest.skip(f"needs {error.name}")


def test_documented_commands_are_there():
    runnable = {name.removesuffix(".__main__") for name in MODULES}
    assert len(documented()) > 10
    assert not documented() - runnable


@pytest.mark.parametrize("command", ["tools.benchmarks", "tools.experiments.ray_streaks"])
def test_help_starts(command: str):
    answer = subprocess.run(
        [sys.executable, "-m", command, "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr
    assert "Usage" in answer.stdout
