"""The files that a user's own method is made of: its module, and what that takes from beside it.

They are its imports from its folder or package, those inside functions included, and files of the
folder that some string of its code names (a module loaded by name, a table, a network's weights).
"""

import ast
import importlib.util
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from legsim.core.errors import file_error
from legsim.core.files import is_file, key_of, sha256
from legsim.run import code


def fingerprint(module: Path) -> str:
    """Hash of the method's files, and of the code of legsim that they import."""
    found = files(module)
    names = {n for path in found for n in _imports(path) if n.split(".")[0] == "legsim"}
    contents = sorted((path.name, sha256(path)) for path in found)
    return key_of(contents, code.fingerprint_of(*sorted(names)) if names else "")


def files(module: Path) -> list[Path]:
    """Returns the module and every file beside it that it takes, directly or not."""
    module = module.resolve()
    roots = _roots(module)
    found: list[Path] = []
    waiting = [module]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.append(path)
        if path.suffix == ".py":
            for name in _imports(path):
                waiting += _beside(name, path, roots)
            waiting += _named(path, module.parent)
    return found


_loaded: dict[Path, dict[str, ModuleType]] = {}
"""modules that each user's method has imported from beside it"""


@contextmanager
def importable(module: Path, *, anew: bool = False) -> Iterator[None]:
    """Lets a user's module import what lies beside it, for the duration of the block.

    Helpers of other methods and of the caller that have the same names are out of sight meanwhile.

    Args:
        module: the file of the method.
        anew: imports the helpers as they are on the disk now.

    Raises:
        LegsimError: the name of a file beside it is that of an installed package.
    """
    module = module.resolve()
    folder = str(module.parent)
    names = _names_beside(module)
    others = _taken_out(names)
    sys.modules.update({} if anew else _loaded.get(module, {}))
    sys.path.append(folder)
    importlib.invalidate_caches()
    try:
        if anew:
            _check_found(names, module)
        yield
    finally:
        sys.path.remove(folder)
        _loaded[module] = _taken_out(names)
        sys.modules.update(others)


def _names_beside(module: Path) -> set[str]:
    """Names under which the module imports what lies beside it, without what follows a dot."""
    folder = module.parent
    helpers = [p for p in files(module)[1:] if p.suffix == ".py" and p.is_relative_to(folder)]
    return {p.relative_to(folder).parts[0].removesuffix(".py") for p in helpers}


def _taken_out(names: set[str]) -> dict[str, ModuleType]:
    """Removes the modules of these names from those that are loaded, and returns them."""
    found = [name for name in sys.modules if name.partition(".")[0] in names]
    return {name: sys.modules.pop(name) for name in found}


def _check_found(names: set[str], module: Path) -> None:
    for name in sorted(names):
        spec = importlib.util.find_spec(name)
        origin = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if origin is not None and not origin.is_relative_to(module.parent):
            raise file_error(
                module,
                f"has {name!r} beside it, but importing that name gives {origin}",
                "rename the file beside it",
            )


def _roots(module: Path) -> list[Path]:
    """Folders from which the module's absolute imports are found: its own, and its package's."""
    roots = [module.parent]
    while (roots[-1] / "__init__.py").is_file() and roots[-1] != roots[-1].parent:
        roots.append(roots[-1].parent)
    # what else is installed beside an installed package is not the method's
    inside = [root for root in roots if not any(root.glob("*.dist-info"))]
    return inside or roots[:1]


def _tree(path: Path) -> ast.Module:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(path.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        # loading it will say what is wrong, and warn
        return ast.Module([], [])


def _imports(path: Path) -> Iterator[str]:
    """Dotted names that a file imports anywhere; relative ones begin with dots."""
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = "." * node.level + (node.module or "")
            dotted = origin if origin.endswith(".") else f"{origin}."
            yield from (f"{dotted}{alias.name}" for alias in node.names)


def _beside(name: str, importer: Path, roots: list[Path]) -> Iterator[Path]:
    """Files that a dotted name runs through, below one of the roots."""
    dots = len(name) - len(name.lstrip("."))
    if dots:
        roots = [importer.parents[dots - 1]]
    for root in roots:
        place = root
        for part in name.lstrip(".").split("."):
            place = place / part
            found = [p for p in (place.with_suffix(".py"), place / "__init__.py") if is_file(p)]
            yield from (p.resolve() for p in found)
            if not os.path.isdir(place):  # no error where a name is too long for a file
                break


def _named(path: Path, folder: Path) -> Iterator[Path]:
    """Files of the folder that a string in the code names, also as a module without ending."""
    for node in ast.walk(_tree(path)):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        text = node.value
        if not 0 < len(text) < 200 or "\n" in text or "\0" in text or text in (".", ".."):
            continue
        for place in (folder / text, folder / f"{text}.py"):
            if is_file(place) and place.resolve().is_relative_to(folder):
                yield place.resolve()
