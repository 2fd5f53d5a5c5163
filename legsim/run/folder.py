"""The run folder: a manifest confirms which stages are done.

A stage has a key, a hash of all that decides its output. Where the manifest holds the same key and
the files still have the recorded sha256, the stage is skipped. One process at a time writes into a
folder: :mod:`legsim.run.lock`.
"""

import json
import os
import subprocess
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from legsim.core import memory
from legsim.core.errors import LegsimError, file_error, printable
from legsim.core.files import PREFIX, is_file, sha256, write_text
from legsim.evaluation.registration import RegistrationError
from legsim.run.lock import FolderLock
from legsim.run.store import StageCache, is_entry

_PACKAGE = Path(__file__).parents[1]

SCHEMA = 2

Kind = Literal["run", "replay", "correct", "study"]
"""the command whose results a folder holds"""

_ABANDONED_S = 3600.0
"""age after which a partial file that nobody writes to is deleted"""


def _remove_leftovers(folder: Path) -> None:
    """Deletes files that killed processes left half written.

    Files written within the last hour may be another running process's and stay.
    """
    for leftover in folder.glob(f"{PREFIX}*"):
        with suppress(FileNotFoundError):
            if time.time() - leftover.stat().st_ctime > _ABANDONED_S:
                leftover.unlink()


class RunFolder:
    """A folder of results with its manifest, locked for one writer until it is closed."""

    def __init__(
        self,
        path: Path,
        about: dict[str, Any],
        store: StageCache | None = None,
        *,
        kind: Kind = "run",
    ) -> None:
        """Opens or makes the folder, and locks it; to be used in a ``with`` statement.

        ``about`` (version, device, config hash ...) heads the manifest. Stages that ``store`` holds
        are taken from there. Stages finished here are added to it for other folders.

        Raises:
            LegsimError: the folder cannot be made or written to, another writer holds it, or it
                holds the results of another kind of command.
        """
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            trial = path / f"{PREFIX}{os.getpid()}-test"
            trial.write_bytes(b"")
            trial.unlink()
        except OSError as error:
            raise file_error(
                path, f"cannot be written to ({error.strerror})", "choose another folder with --out"
            ) from error
        self._lock = FolderLock(path)
        try:
            check_kind(path, kind)
            _remove_leftovers(path)
            self._stages = _entries(path)
        except BaseException:
            self._lock.release()
            raise
        self._kind = kind
        self._store = store
        self.about = about
        """Head of the manifest."""

    def close(self) -> None:
        """Gives the folder free for other writers."""
        self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def done(self, stage: str, key: str) -> bool:
        """Whether the manifest confirms the stage, or the store has it.

        A confirmed stage has the same key, and all its files are present and unchanged. A warning
        names a file that is not.
        """
        entry = self._stages.get(stage)
        if entry is not None and entry["key"] == key:
            altered = self._altered(entry)
            if altered is None:
                return True
            warnings.warn(
                f"{printable(self.path / altered)}: is not as the stage {stage!r} left it; the "
                "stage is computed again",
                stacklevel=3,
            )
        found = None if self._store is None else self._store.fetch(stage, key, self.path)
        if self._store is None or found is None:
            return False
        if self._altered(found) is not None:
            self._store.drop(stage, key)
            return False
        self._stages[stage] = found
        self.write_manifest()
        return True

    def _altered(self, entry: dict[str, Any]) -> str | None:
        """First file of the entry that is missing or has other content; None where all are kept."""
        for name, recorded in entry["files"].items():
            path = self.path / name
            if not is_file(path) or sha256(path) != recorded["sha256"]:
                return name
        return None

    def cached(self, stage: str, key: str, make: Callable[[], Sequence[str]]) -> bool:
        """Runs a stage unless it is finished under this key; returns whether it ran.

        ``make`` writes files into the folder and returns their names. They are entered in the
        manifest with the stage's time, memory and hashes.
        """
        if self.done(stage, key):
            return False
        start = time.perf_counter()
        memory.begin_peak()
        files = make()
        seconds, peak = round(time.perf_counter() - start, 3), memory.peak_mebibytes()
        entries = {
            name: {"sha256": sha256(self.path / name), "bytes": (self.path / name).stat().st_size}
            for name in files
        }
        self._stages[stage] = {
            "key": key,
            "seconds": seconds,
            "peak_mib": peak and round(peak),
            "files": entries,
        }
        self.write_manifest()
        if self._store is not None:
            self._store.keep(stage, key, self._stages[stage], self.path)
        return True

    def seconds(self, stage: str) -> float:
        """Seconds that the stage took when it was computed."""
        return float(self._stages[stage]["seconds"])

    def has(self, file: str) -> bool:
        """Whether some finished stage wrote the file."""
        return any(file in entry["files"] for entry in self._stages.values())

    def hash_of(self, file: str) -> str:
        """Recorded sha256 of a file that some stage wrote."""
        return next(
            entry["files"][file]["sha256"]
            for entry in self._stages.values()
            if file in entry["files"]
        )

    def write_manifest(self) -> None:
        """Writes manifest.json with the current entries."""
        content = {"schema": SCHEMA, "kind": self._kind, **self.about, "stages": self._stages}
        write_text(self.path / "manifest.json", json.dumps(content, indent=1) + "\n")


def _manifest(folder: Path) -> dict[str, Any]:
    """Content of the folder's manifest; empty where there is none.

    Raises:
        LegsimError: the file is not a manifest.
    """
    path = folder / "manifest.json"
    fix = "delete the file, or choose another folder with --out"
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise file_error(path, f"is not a manifest ({error})", fix) from error
    if not isinstance(content, dict) or not isinstance(content.get("stages", {}), dict):
        raise file_error(path, "is not a manifest", fix)
    return content


def _entries(folder: Path) -> dict[str, Any]:
    """Stages that the folder's manifest confirms, damaged entries left out."""
    return _confirmed(_manifest(folder))


def _confirmed(content: dict[str, Any]) -> dict[str, Any]:
    if content.get("schema") != SCHEMA:
        return {}
    return {stage: entry for stage, entry in content.get("stages", {}).items() if is_entry(entry)}


def check_kind(folder: Path, kind: Kind) -> None:
    """Refuses to mix the results of two commands in one folder.

    Raises:
        LegsimError: the folder holds the results of another command.
    """
    held = kind_of(folder)
    if held is not None and held != kind:
        raise file_error(
            folder,
            f"holds the results of `legsim {held}`, not of `legsim {kind}`",
            "choose another folder with --out",
        )


def kind_of(folder: Path) -> str | None:
    """Finds the command whose results the folder holds; None where it holds none."""
    if (folder / "study.toml").is_file():
        return "study"
    content = _manifest(folder)
    stages = content.get("stages", {})
    # folders of older versions do not say it
    older = "replay" if "replay" in stages else "run" if "geometry" in stages else None
    return content.get("kind", older)


@dataclass(frozen=True, slots=True)
class FinishedStage:
    """An entry of a manifest."""

    stage: str
    key: str
    seconds: float
    peak_mib: float | None


def finished_stages(folder: Path) -> tuple[FinishedStage, ...]:
    """Every stage that the folder's manifest confirms; none without a manifest that can be read."""
    return tuple(
        FinishedStage(stage, e["key"], e["seconds"], e["peak_mib"])
        for stage, e in _confirmed(head(folder)).items()
    )


def head(folder: Path) -> dict[str, Any]:
    """Content of the folder's manifest; empty where there is none, or none that can be read."""
    try:
        return _manifest(folder)
    except LegsimError:
        return {}


REGISTRATION_ERROR_FILE = "registration-error.json"


def registration_error(folder: Path) -> RegistrationError | None:
    """The registration's own error as measured by a run; None where it was not measured.

    Raises:
        LegsimError: the file is damaged.
    """
    path = folder / REGISTRATION_ERROR_FILE
    if not path.is_file():
        return None
    try:
        return RegistrationError(**json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        fix = f"delete {folder}, and run again"
        raise file_error(path, f"cannot be read ({error})", fix) from error


def commit() -> str:
    """Commit of a checkout, empty for an installed package."""
    asked = ["git", "-C", str(_PACKAGE), "rev-parse", "HEAD"]
    if not (_PACKAGE.parent / ".git").exists():
        return ""
    answer = subprocess.run(asked, capture_output=True, text=True, check=False)
    return answer.stdout.strip()
