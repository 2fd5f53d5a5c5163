"""Scores that a study has computed, in a file each, believed only while it is as it was written."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from legsim.core import files
from legsim.core.files import key_of


def entries(
    path: Path, key: str, compute: Callable[[], list[dict[str, Any]]]
) -> list[dict[str, Any]]:
    """What the file holds if it was written under this key, else what is computed now and written
    there.

    A file that is damaged is written anew.
    """
    found = _read(path, key)
    if found is not None:
        return found
    # as it will be read the next time, so that both times give the same
    made = json.loads(json.dumps(compute()))
    content = {"key": key, "sha256": key_of(made), "entries": made}
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write_text(path, json.dumps(content, indent=1) + "\n")
    return made


def _read(path: Path, key: str) -> list[dict[str, Any]] | None:
    """Entries that the file holds under this key; None where it has others or is damaged."""
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict) or content.get("key") != key:
        return None
    made = content.get("entries")
    return made if content.get("sha256") == key_of(made) else None
