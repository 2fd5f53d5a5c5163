"""Folders for compiled kernels: the user's own, or temporary ones where that cannot be written.

pyopencl and PoCL keep kernels below XDG_CACHE_HOME or the home folder; in containers and batch
jobs neither may be writable, which pyopencl answers with an error and PoCL with a crash.
"""

import os
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

_NAMES = ("pyopencl", "pytools", "pocl")
"""folders that pyopencl and PoCL make"""


@cache
def prepare() -> None:
    """Gives pyopencl and PoCL a folder that can be written, before pyopencl is imported.

    Where there is none, kernels are compiled in every process.
    """
    # pyopencl looks this up, and fails where it is missing, once its cache has failed
    os.environ.setdefault("PYOPENCL_CACHE_FAILURE_FATAL", "")
    if all(_writable(_usual() / name) for name in _NAMES):
        return
    folder = own_folder("legsim-cache")
    if folder is None or sys.platform == "win32":
        os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    if folder is not None:
        os.environ["XDG_CACHE_HOME"] = str(folder)
        os.environ.setdefault("POCL_CACHE_DIR", str(folder / "pocl"))


def own_folder(name: str) -> Path | None:
    """Makes a folder for temporary files that only this user can write; None where none can be."""
    # on Windows the folder of temporary files is the user's own
    owner = os.getuid() if hasattr(os, "getuid") else "own"
    try:
        folder = Path(tempfile.gettempdir(), f"{name}-{owner}")
        with suppress(OSError):
            folder.mkdir(mode=0o700)
        mine = not hasattr(os, "getuid") or folder.lstat().st_uid == os.getuid()
        if mine and folder.is_dir() and not folder.is_symlink() and _writable(folder):
            return folder
        return Path(tempfile.mkdtemp(prefix=f"{name}-"))
    except OSError:
        return None


def _usual() -> Path:
    """Where caches are kept if nothing else is said."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~"))
    if named.strip() and (sys.platform == "darwin" or os.path.isabs(named)):
        return Path(named)
    return Path(os.path.expanduser("~"), *_USUAL_BELOW_HOME)


_USUAL_BELOW_HOME = ("Library", "Caches") if sys.platform == "darwin" else (".cache",)


def _writable(folder: Path) -> bool:
    """Whether the folder can be made and written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(b"1")
    except OSError:
        return False
    return True
