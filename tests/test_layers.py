"""The shape of the code: imports go one way, one heavy dependency has one home, no file grows past
500 lines.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "legsim"
HOMES = {
    "pyopencl": {"opencl"},
    "xraylib": {"materials"},
    "spekpy": {"spectra"},
    "mujoco": {"leg"},
    "rerun": {"view"},
    "matplotlib": {"figures"},
    "typer": {"cli"},
    "jinja2": {"report"},
    "pydantic": {"config", "study_config"},
    "SimpleITK": {"images", "evaluation"},
}
SLOW = {
    "rerun": "rerun_bindings",
    "matplotlib": "matplotlib.figure",
    "SimpleITK": "SimpleITK.SimpleITK",
    "trimesh": "trimesh.base",
    "pyopencl": "pyopencl.version",
}
"""Dependency that is loaded where it is first used, and a part of it that is there only once it is
loaded
"""


def layers() -> dict[str, int]:
    """Module to layer, read from the table in docs/design.md so that the page stays true."""
    table = re.findall(r"^\| (\d) [a-z]+ \| (.+?) \|", (ROOT / "docs/design.md").read_text(), re.M)
    return {
        name: int(number) for number, cell in table for name in re.findall(r"`([a-z_0-9]+)`", cell)
    }


def modules() -> list[str]:
    """Names of the package's modules and sub-packages."""
    names = [p.stem for p in PACKAGE.glob("*.py")] + [
        p.parent.name for p in PACKAGE.glob("*/__init__.py")
    ]
    return sorted(n for n in names if n not in ("__init__", "__main__"))


def sources(module: str) -> list[Path]:
    return (
        [PACKAGE / f"{module}.py"]
        if (PACKAGE / f"{module}.py").exists()
        else sorted((PACKAGE / module).glob("*.py"))
    )


def imports(module: str) -> set[str]:
    """Full dotted names that a module imports anywhere, `from a import b` counted as a.b."""
    found = set()
    for path in sources(module):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def own_imports(module: str) -> set[str]:
    return {name.split(".")[1] for name in imports(module) if name.startswith("legsim.")} - {
        module,
        "__version__",
    }


@pytest.mark.parametrize("module", modules())
def test_a_module_imports_only_from_layers_below(module):
    layer = layers()
    assert module in layer, f"{module} has no layer: enter it in the table of docs/design.md"
    limit = layer[module]
    for name in own_imports(module):
        assert layer[name] < limit or (limit in (0, 1, 2, 4) and layer[name] == limit), (
            f"{module} (layer {limit}) imports {name} (layer {layer[name]})"
        )


def test_imports_have_no_cycle():
    graph = {module: own_imports(module) for module in modules()}
    while graph:
        leaves = [m for m, needs in graph.items() if not needs & graph.keys()]
        assert leaves, f"a cycle among {sorted(graph)}"
        for leaf in leaves:
            del graph[leaf]


@pytest.mark.parametrize("dependency", sorted(HOMES))
def test_a_heavy_dependency_has_one_home(dependency):
    users = {m for m in modules() if any(name.split(".")[0] == dependency for name in imports(m))}
    assert users <= HOMES[dependency]


def loaded_by(modules: str) -> set[str]:
    """Names of all modules that importing ``modules`` loads."""
    program = f"import sys, {modules}; print(*sys.modules)"
    return set(
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        ).stdout.split()
    )


def test_the_command_line_starts_without_any_stage():
    names = loaded_by("legsim.cli.main")
    assert {name for name in names if name.startswith("legsim")} == {
        "legsim",
        "legsim.cli.main",
        "legsim.core.errors",
        "legsim.cli.progress",
        "legsim.study.engine",
    }
    assert not {"numpy", *SLOW.values()} & names


def test_a_slow_dependency_is_loaded_where_it_is_used():
    assert not set(SLOW.values()) & loaded_by("legsim.cli.commands, legsim.run.stages")


def test_what_tells_that_a_slow_dependency_is_loaded_does_tell():
    assert set(SLOW.values()) <= loaded_by("matplotlib.figure, rerun, SimpleITK, trimesh, pyopencl")


def test_every_layered_module_exists():
    assert set(layers()) <= set(modules())


def test_no_file_has_more_than_500_lines():
    files = [
        p
        for folder in ("legsim", "tests", "tools")
        for suffix in ("py", "cl", "j2")
        for p in (ROOT / folder).rglob(f"*.{suffix}")
    ]
    long = {
        str(p.relative_to(ROOT)): n for p in files if (n := len(p.read_text().splitlines())) > 500
    }
    assert not long


@pytest.mark.parametrize("module", modules())
def test_every_module_has_its_test_file(module):
    assert (ROOT / "tests" / f"test_{module}.py").exists()
