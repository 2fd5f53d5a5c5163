"""Finished stages that run folders share: one folder per stage and key.

A folder is filled as a whole or not at all; its files are hard links. A stage's key is a hash of
all that decides its output, so that an entry never changes: several processes, also on other
machines that see the same file system, may fill and read one store.
"""

import contextlib
import errno
import json
import os
import shutil
import time
import uuid
from pathlib import Path
from typing import Any, TypeGuard

from legsim.core.errors import file_error
from legsim.core.files import full_disk, is_file
from legsim.core.values import LARGEST

_ENTRY = "entry.json"

_ABANDONED_SECONDS = 24 * 3600.0
"""after which nobody still writes a partial entry"""


class StageCache:
    """A folder of finished stages."""

    def __init__(self, path: Path) -> None:
        """Opens the store; its folder is made when a stage is kept."""
        self.path = path

    def fetch(self, stage: str, key: str, into: Path) -> dict[str, Any] | None:
        """Puts the stage's files into the folder ``into`` and returns its manifest entry.

        None where the store does not have it as a whole.
        """
        place = self._place(stage, key)
        try:
            entry = json.loads((place / _ENTRY).read_text("utf-8"))
        except (FileNotFoundError, ValueError, RecursionError):
            entry = None
        if (
            not is_entry(entry)
            or entry["key"] != key
            or not all(is_file(place / name) for name in entry["files"])
        ):
            self.drop(stage, key)
            return None
        try:
            for name in entry["files"]:
                _link(place / name, into / name)
        except FileNotFoundError:  # another process has dropped it
            return None
        return entry

    def keep(self, stage: str, key: str, entry: dict[str, Any], folder: Path) -> None:
        """Keeps the files that ``entry`` names, as they are in ``folder``.

        An existing entry is not changed.
        """
        place = self._place(stage, key)
        if (place / _ENTRY).exists():
            return
        partial = place.with_name(f".partial-{uuid.uuid4().hex}")
        try:
            partial.mkdir(parents=True)
            for name in entry["files"]:
                _link(folder / name, partial / name)
            (partial / _ENTRY).write_text(json.dumps(entry), "utf-8")
            with contextlib.suppress(
                OSError
            ):  # another process was faster: the same content is already there
                os.rename(partial, place)
        except OSError as error:
            if (full := full_disk(place, error)) is None:
                raise
            raise full from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def drop(self, stage: str, key: str) -> None:
        """Removes a damaged entry, so that the next one is kept."""
        place = self._place(stage, key)
        aside = place.with_name(f".partial-{uuid.uuid4().hex}")
        with contextlib.suppress(
            FileNotFoundError
        ):  # it was never there, or another process was faster
            os.rename(place, aside)
            shutil.rmtree(aside, ignore_errors=True)

    def _place(self, stage: str, key: str) -> Path:
        return self.path / stage / key


def is_entry(entry: Any) -> TypeGuard[dict[str, Any]]:
    """Whether this says of a finished stage what a manifest holds; files lie within its folder."""
    if not isinstance(entry, dict) or not entry.keys() >= {"key", "seconds", "peak_mib", "files"}:
        return False
    files = entry["files"]
    numbers = entry["seconds"], entry["peak_mib"] or 0
    return (
        all(isinstance(number, int | float) and abs(number) < LARGEST for number in numbers)
        and isinstance(entry["key"], str)
        and isinstance(files, dict)
        and all(_within(name) for name in files)
        and all(isinstance(f, dict) and isinstance(f.get("sha256"), str) for f in files.values())
    )


def _within(name: str) -> bool:
    """Whether a file's name does not lead out of its folder."""
    return not Path(name).is_absolute() and ".." not in Path(name).parts


def check_shared(store: Path, folder: Path) -> None:
    """Checks that stages can be linked between the store and the folder; makes both.

    They are then not copied.

    Raises:
        LegsimError: they are on two file systems, or the store is a study's own folder.
    """
    inside = store / "store"
    if inside.is_dir():
        raise file_error(
            store, "is a study's folder, not a store of finished stages", f"give {inside}"
        )
    trial = f".partial-{uuid.uuid4().hex}"
    try:
        for made in (store, folder):
            made.mkdir(parents=True, exist_ok=True)
        (store / trial).touch()
        os.link(store / trial, folder / trial)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise file_error(
                store,
                f"cannot be shared with {folder} ({error.strerror})",
                "choose another folder with --store",
            ) from error
        problem = (
            f"is on another file system than {folder}, and finished stages are shared as hard "
            "links, which need one"
        )
        raise file_error(
            store, problem, "choose --store and --out on the same file system"
        ) from error
    finally:
        _remove_abandoned(store)
        for made in (store, folder):
            with contextlib.suppress(OSError):  # it was not made
                (made / trial).unlink()


def _remove_abandoned(store: Path) -> None:
    """Removes what processes that were killed left half kept, more than a day ago."""
    for partial in store.glob("*/.partial-*"):
        with contextlib.suppress(OSError):  # another process was faster
            if time.time() - partial.stat().st_mtime > _ABANDONED_SECONDS:
                shutil.rmtree(partial, ignore_errors=True)


def _link(source: Path, target: Path) -> None:
    """Links the same file under another name; copies where the file system has no links."""
    partial = target.with_name(f".partial-{uuid.uuid4().hex}-{target.name}")
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, partial)
    except OSError:
        try:
            shutil.copy2(source, partial)
        except OSError as error:  # half a copy where the disk is full
            partial.unlink(missing_ok=True)
            raise full_disk(target, error) or error from error
    os.replace(partial, target)
    # rename leaves both names where they are already one file
    partial.unlink(missing_ok=True)
