"""Small faults put into modules one at a time: do the modules' own tests notice?

A mutant has one comparison, operator, number, truth value or condition of a module changed, outside
of error messages and texts. Its module's test file (where it has none, every test of its package),
which must pass without a change, is run in a fork of this process in which the changed text stands
in the module's place, quick tests first; a mutant survives where all pass. Mutants are drawn at
random, seeded, equally many of each package. Survivors are listed by place and change, to be read:
some change nothing that can be seen.

    python -m tools.mutate core geometry --mutants 60 --seconds 1200
"""

import ast
import importlib.abc
import importlib.util
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

ROOT = Path(__file__).parents[1]

LIMIT_S = 300
"""for the tests of one mutant; one that runs into it counts as killed: its loop does not end"""

COMPARED = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}

COMPUTED = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


def modules_of(package: str) -> list[str]:
    """Modules of a package."""
    paths = sorted((ROOT / "legsim" / package).glob("*.py"))
    return [f"legsim.{package}.{p.stem}" for p in paths if p.stem != "__init__"]


def tests_of(module: str) -> Path:
    """The module's test file; the folder of its package's tests where it has none."""
    _, package, name = module.split(".")
    folder = ROOT / "tests" / package
    own = folder / f"test_{name.lstrip('_')}.py"
    return own if own.exists() else folder


def source_of(module: str) -> Path:
    """The module's file."""
    return ROOT / f"{module.replace('.', '/')}.py"


def sites(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that can be changed, in a fixed order."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            texts = (ast.Raise, ast.JoinedStr, ast.Assert)
            if isinstance(child, ast.AST) and not isinstance(child, texts):
                if mutated(child) is not None:
                    yield child
                yield from sites(child)


def mutated(node: ast.AST) -> tuple[str, str, Any] | None:
    """(what is changed, field, new value) of a node; None where nothing can be."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARED:
        new = COMPARED[type(node.ops[0])]
        return f"{_name(node.ops[0])} to {new.__name__}", "ops", [new()]
    if isinstance(node, ast.BinOp) and type(node.op) in COMPUTED:
        new = COMPUTED[type(node.op)]
        return f"{_name(node.op)} to {new.__name__}", "op", new()
    if isinstance(node, ast.BoolOp):
        new = ast.Or if isinstance(node.op, ast.And) else ast.And
        return f"{_name(node.op)} to {new.__name__}", "op", new()
    if isinstance(node, ast.Constant) and isinstance(value := node.value, (bool, int, float)):
        changed = (not value) if isinstance(value, bool) else value + 1 if value < 2 else 2 * value
        return f"{value} to {changed}", "value", changed
    if isinstance(node, (ast.If, ast.IfExp)):
        return "condition to False", "test", ast.Constant(value=False)
    return None


def _name(node: ast.AST) -> str:
    return type(node).__name__


def mutant(module: str, number: int) -> tuple[str, str]:
    """(place and change, text of the module) of one of its sites."""
    tree = ast.parse(source_of(module).read_text("utf-8"))
    node = list(sites(tree))[number]
    found = mutated(node)
    assert found is not None
    change, field, value = found
    setattr(node, field, value)
    line = getattr(node, "lineno", 0)
    return f"{module}:{line}: {change}", ast.unparse(ast.fix_missing_locations(tree))


class _Standing(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads a changed text in a module's place."""

    def __init__(self, module: str, text: str) -> None:
        self._module, self._text = module, text

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != self._module:
            return None
        return importlib.util.spec_from_file_location(fullname, source_of(fullname), loader=self)

    def create_module(self, spec: Any) -> None:
        return None

    def exec_module(self, module: Any) -> None:
        exec(compile(self._text, str(source_of(self._module)), "exec"), module.__dict__)


class FastFirst:
    """Runs tests in the order of their seconds, which a first run of them leaves in a file."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._known = json.loads(file.read_text("utf-8")) if file.exists() else {}
        self._seen: dict[str, float] = {}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items.sort(key=lambda item: self._known.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: Any) -> None:
        self._seen[report.nodeid] = self._seen.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self) -> None:
        if not self._known:
            self._file.write_text(json.dumps(self._seen), "utf-8")


def tested(module: str, text: str, folder: Path, whole: bool) -> str:
    """ "killed", "survived" or "endless" of a module's tests with a text in its place.

    ``folder`` keeps the seconds of the tests; ``whole`` runs those of whole scans as well.
    """
    process = os.fork()
    if process == 0:
        os.setsid()
        _run_tests(module, text, folder / module, whole)
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return "survived" if os.waitstatus_to_exitcode(status) == 0 else "killed"
        time.sleep(0.05)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return "endless"


def _run_tests(module: str, text: str, seconds: Path, whole: bool) -> None:
    """Runs the test file, quietly; ends the process."""
    import pytest

    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    sys.meta_path.insert(0, _Standing(module, text))
    options = ["-x", "-q", "-p", "no:cacheprovider", *([] if whole else ["-m", "not end_to_end"])]
    os._exit(int(pytest.main([*options, str(tests_of(module))], plugins=[FastFirst(seconds)])))


def drawn(package: str, seed: int) -> list[tuple[str, int]]:
    """(module, number of the site) of every mutant of a package, in the order of a draw."""
    found = [
        (module, k)
        for module in modules_of(package)
        for k in range(len(list(sites(ast.parse(source_of(module).read_text("utf-8"))))))
    ]
    random.Random(f"{package} {seed}").shuffle(found)
    return found


def main(
    packages: Annotated[list[str], typer.Argument(help="Packages of legsim.")],
    mutants: Annotated[int, typer.Option(help="Drawn of each package.", min=1)] = 40,
    seconds: Annotated[float, typer.Option(help="For each package, at most.")] = 3600.0,
    seed: Annotated[int, typer.Option(help="Of the draw.")] = 0,
    only: Annotated[str, typer.Option(help="A file of survivors' lines to try again.")] = "",
    whole: Annotated[
        bool, typer.Option(help="Tests of whole scans as well: minutes each.")
    ] = False,
) -> None:
    """Draws mutants of each package, runs their tests, lists those that survive, and counts."""
    # libraries are loaded once, before the forks; no module of legsim is, nor what pytest rewrites
    for name in ("numpy", "scipy.spatial", "scipy.ndimage", "pytest", "SimpleITK"):
        importlib.import_module(name)
    again = Path(only).read_text("utf-8") if only else ""
    for package in packages:
        found = drawn(package, seed)
        chosen = found if only else found[:mutants]
        with tempfile.TemporaryDirectory() as folder:
            counts = _counted(chosen, again, time.monotonic() + seconds, Path(folder), whole)
        tried = counts.total()
        typer.echo(
            f"{package}: {tried} of {len(found)} mutants, {tried - counts['survived']} killed "
            f"({counts['endless']} of them endless), {counts['survived']} survived"
        )
        sys.stdout.flush()


def _counted(
    chosen: list[tuple[str, int]], again: str, until: float, folder: Path, whole: bool
) -> Counter[str]:
    """What became of mutants; ``again`` holds the lines of those to try, empty for all."""
    counts, sound = Counter[str](), dict[str, bool]()
    for module, k in chosen:
        if time.monotonic() > until:
            break
        place, text = mutant(module, k)
        if again and f"survived: {place}\n" not in again:
            continue
        if module not in sound:
            unchanged = ast.unparse(ast.parse(source_of(module).read_text("utf-8")))
            sound[module] = tested(module, unchanged, folder, whole) == "survived"
            if not sound[module]:
                typer.echo(f"{module}: its tests fail without any change")
        if sound[module]:
            became = tested(module, text, folder, whole)
            counts[became] += 1
            if became == "survived":
                typer.echo(f"survived: {place}")
            sys.stdout.flush()
    return counts


if __name__ == "__main__":
    typer.run(main)
