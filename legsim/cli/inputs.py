"""What a command reads: it may not write there."""

import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

_WRITTEN = ("out", "image", "store")
"""parameters of commands that name what is written"""


def kept(command: Callable[..., None]) -> Callable[..., None]:
    """The command, which refuses to write over any file that its arguments name as input."""

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> None:
        from legsim.core import files

        given = {name: value for name, value in options.items() if name not in _WRITTEN}
        with files.reading(paths_in(given.values())):
            for name in _WRITTEN:
                value = options.get(name)
                if isinstance(value, Path):
                    files.refuse_input(value)
            command(*arguments, **options)

    return run


def paths_in(values: Iterable[Any]) -> list[Path]:
    """Files and folders that values name: paths, patterns, texts, and texts after an equals sign.

    Trees and lists of values are searched. A text that is no file is passed over.
    """
    from legsim.geometry import view_files

    found: list[Path] = []
    for value in values:
        if isinstance(value, Path):
            found += view_files.matching(value) if view_files.is_pattern(value) else [value]
        elif isinstance(value, str):
            name = value.partition("=")[2] or value
            found += [Path(name)] if name and "\n" not in name else []
        elif isinstance(value, Mapping):
            found += paths_in(value.values())
        elif isinstance(value, (list, tuple)):
            found += paths_in(value)
    return found
