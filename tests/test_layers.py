"""The shape of the code: imports go one way, one heavy dependency has one home, no file is long."""

import ast
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "legsim"
ORDER = (
    *("core", "config", "opencl", "geometry", "mocap", "kinematics", "imu", "phantom", "scan"),
    *("deformation", "reconstruction", "evaluation", "correction", "simulation", "scene"),
    *("figures", "view"),
    *("report", "run", "study", "cli"),
)
"""Packages from the bottom up: each imports only from those before it"""
READ_SETTINGS = ("run", "study", "cli")
"""Packages that import the configuration"""
HOMES = {
    "pyopencl": {"opencl"},
    "xraylib": {"phantom"},
    "spekpy": {"scan"},
    "mujoco": {"kinematics"},
    "rerun": {"view"},
    "matplotlib": {"figures"},
    "typer": {"cli"},
    "rich": {"cli"},
    "jinja2": {"report"},
    "pydantic": {"config", "study"},
    "SimpleITK": {"geometry", "evaluation"},
    "tifffile": {"geometry"},
    "pydicom": {"geometry"},
    "trimesh": {"phantom"},
    "distributed": {"study"},
}
SLOW = {
    "rerun": "rerun_bindings",
    "matplotlib": "matplotlib.figure",
    "SimpleITK": "SimpleITK.SimpleITK",
    "trimesh": "trimesh.base",
    "pyopencl": "pyopencl.version",
}
"""Dependency that is loaded where it is first used, and a part of it that shows it is loaded"""


TESTED_ELSEWHERE = {
    **{
        f"config/{name}": "settings alone; tests/config/test_settings.py reads them"
        for name in (
            "ik",
            "imu",
            "imu_file",
            "measured_scan",
            "methods",
            "motion",
            "reconstruction",
            "scan",
            "tree",
        )
    },
    "core/constants": "numbers alone",
    "core/progress": "a type alone",
    "correction/marker_based": "tests/laws/test_methods.py holds the laws of all methods",
    "correction/nonrigid": "tests/laws/test_methods.py holds the laws of all methods",
    "view/layout": "what a person sees first; tests/view/test_recording.py loads it",
}
"""Public modules without a test file of their own, and why"""


def sources() -> list[Path]:
    """Modules of the package, its public face left out."""
    return sorted(p for p in PACKAGE.rglob("*.py") if p.parent != PACKAGE)


def package(path: Path) -> str:
    """The package that a module belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Full dotted names that a module imports anywhere, `from a import b` counted as a.b."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def own_imports(path: Path) -> list[list[str]]:
    """Parts of the names that a module imports from this package, "legsim" left out."""
    names = sorted(n for n in imports(path) if n.startswith("legsim."))
    return [n.split(".")[1:] for n in names if n != "legsim.__version__"]


def test_the_order_names_every_package():
    assert set(ORDER) == {package(p) for p in sources()}


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_imports_only_from_its_package_and_those_below(path):
    home = package(path)
    for parts in own_imports(path):
        assert ORDER.index(parts[0]) <= ORDER.index(home), f"imports {'.'.join(parts)}"


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_private_modules_and_names_stay_at_home(path):
    for parts in own_imports(path):
        private = [part for part in parts if part.startswith("_")]
        assert not private or parts[0] == package(path), f"imports {'.'.join(parts)}"


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_runs_studies_and_the_command_line_know_the_settings(path):
    """Everything below takes arguments in SI units, so that a program needs no settings."""
    if package(path) not in ("config", *READ_SETTINGS):
        assert not [parts for parts in own_imports(path) if parts[0] == "config"]


def test_modules_have_no_cycle():
    names = {".".join(p.relative_to(PACKAGE).with_suffix("").parts): p for p in sources()}
    graph = {}
    for name, path in names.items():
        needs = {".".join(parts[:n]) for parts in own_imports(path) for n in (1, 2)}
        graph[name] = (needs & names.keys()) - {name}
    while graph:
        leaves = [m for m, needs in graph.items() if not needs & graph.keys()]
        assert leaves, f"a cycle among {sorted(graph)}"
        for leaf in leaves:
            del graph[leaf]


@pytest.mark.parametrize("dependency", sorted(HOMES))
def test_a_heavy_dependency_has_one_home(dependency):
    users = {package(p) for p in sources() if dependency in {n.split(".")[0] for n in imports(p)}}
    assert users
    assert users <= HOMES[dependency]


def loaded_by(modules: str) -> set[str]:
    """Names of all modules that importing ``modules`` loads."""
    program = f"import sys, {modules}; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


def test_the_public_face_loads_no_package():
    names = loaded_by("legsim")
    assert {n for n in names if n.startswith("legsim")} == {"legsim"}
    assert not {"numpy", *SLOW.values()} & names


def test_the_command_line_starts_without_any_stage():
    names = loaded_by("legsim.cli.main")
    packages = {n.split(".")[1] for n in names if n.startswith("legsim.")}
    assert packages <= {"cli", "core", "study"}
    assert not {"numpy", *SLOW.values()} & names


def test_a_slow_dependency_is_loaded_where_it_is_used():
    assert not set(SLOW.values()) & loaded_by("legsim.cli.file_stages, legsim.run.pipeline")


def test_what_tells_that_a_slow_dependency_is_loaded_does_tell():
    loaded = loaded_by("matplotlib.figure, rerun, SimpleITK, trimesh, pyopencl")
    assert set(SLOW.values()) <= loaded


def test_no_file_has_more_than_500_lines():
    folders, suffixes = ("legsim", "tests", "tools"), ("py", "cl", "j2")
    files = [p for f in folders for s in suffixes for p in (ROOT / f).rglob(f"*.{s}")]
    counts = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in files}
    assert not {name: n for name, n in counts.items() if n > 500}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("__init__.pyi")), ids=str)
def test_a_face_names_nothing_like_a_module_beside_it(path):
    """Such a name would be the module or the value, by what was imported first."""
    names = {alias.asname for node in ast.parse(path.read_text()).body
             if isinstance(node, ast.ImportFrom) for alias in node.names}  # fmt: skip
    beside = {p.stem for p in path.parent.glob("*.py")} | {
        p.name for p in path.parent.iterdir() if p.is_dir()
    }
    assert not names & beside


def test_packages_in_the_design_page_are_in_this_order():
    page = (ROOT / "docs/design.md").read_text()
    places = [page.index(f"\n| `{name}` |") for name in ORDER]
    assert all(a < b for a, b in pairwise(places))


def module_names() -> set[str]:
    """Public modules of the packages, as "geometry/volume"."""
    names = {p.relative_to(PACKAGE).with_suffix("").as_posix() for p in PACKAGE.glob("*/*.py")}
    return {name for name in names if "/_" not in name}


def names_of_tests() -> set[str]:
    """Modules that the test files of the packages are named after."""
    files = [p for folder in ORDER for p in (ROOT / "tests" / folder).glob("test_*.py")]
    return {f"{p.parent.name}/{p.stem.removeprefix('test_')}" for p in files}


def test_every_public_module_has_its_test_file():
    assert not module_names() - names_of_tests() - TESTED_ELSEWHERE.keys()


def test_every_test_file_has_its_module():
    """A private module's tests are in the file of its name without the underscore."""
    private = {f"{p.parent.name}/{p.stem.removeprefix('_')}" for p in PACKAGE.glob("*/_[a-z]*.py")}
    assert not names_of_tests() - module_names() - private


def test_test_files_that_documents_name_are_there():
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")]
    named = {name for p in pages for name in re.findall(r"tests/[\w/]+\.py", p.read_text("utf-8"))}
    assert named
    assert not [name for name in sorted(named) if not (ROOT / name).is_file()]
