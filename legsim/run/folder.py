"""The run folder: a manifest confirms which stages are done.

A stage has a key, a hash of all that decides its output. Where the manifest holds the same key and
the files still have the recorded sha256, the stage is skipped. One process at a time writes into a
folder.
"""

import errno
import fcntl
import json
import os
import socket
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legsim.core import memory
from legsim.core.errors import file_error
from legsim.core.files import PREFIX, sha256, write_text
from legsim.evaluation.registration import RegistrationError
from legsim.run.store import StageCache

_PACKAGE = Path(__file__).parents[1]

SCHEMA = 2

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
    """A folder of results with its manifest."""

    def __init__(self, path: Path, about: dict[str, Any], store: StageCache | None = None) -> None:
        """Opens or makes the folder.

        ``about`` (version, device, config hash ...) heads the manifest. Stages that ``store`` holds
        are taken from there. Stages finished here are added to it for other folders.

        Raises:
            LegsimError: the folder cannot be made or written to.
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
        _remove_leftovers(path)
        self._stages: dict[str, Any] = self._read().get("stages", {})
        self._store = store
        self.about = about
        """Head of the manifest."""

    def _read(self) -> dict[str, Any]:
        manifest = self.path / "manifest.json"
        if not manifest.exists():
            return {}
        try:
            content = json.loads(manifest.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise file_error(
                manifest,
                f"is not a manifest ({error})",
                "delete the file, or choose another folder with --out",
            ) from error
        return content if isinstance(content, dict) and content.get("schema") == SCHEMA else {}

    def done(self, stage: str, key: str) -> bool:
        """Whether the manifest confirms the stage, or the store has it.

        A confirmed stage has the same key, and all its files are present and unchanged.
        """
        entry = self._stages.get(stage)
        if entry is not None and entry["key"] == key and self._unchanged(entry):
            return True
        found = None if self._store is None else self._store.fetch(stage, key, self.path)
        if self._store is None or found is None:
            return False
        if not self._unchanged(found):
            self._store.drop(stage, key)
            return False
        self._stages[stage] = found
        self.write_manifest()
        return True

    def _unchanged(self, entry: dict[str, Any]) -> bool:
        return all(
            (self.path / name).is_file() and sha256(self.path / name) == f["sha256"]
            for name, f in entry["files"].items()
        )

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
        content = {"schema": SCHEMA, **self.about, "stages": self._stages}
        write_text(self.path / "manifest.json", json.dumps(content, indent=1) + "\n")


@dataclass(frozen=True, slots=True)
class FinishedStage:
    """An entry of a manifest."""

    stage: str
    key: str
    seconds: float
    peak_mib: float | None


def finished_stages(folder: Path) -> tuple[FinishedStage, ...]:
    """Every stage that the folder's manifest confirms; none where there is no manifest."""
    path = folder / "manifest.json"
    entries = json.loads(path.read_text("utf-8"))["stages"] if path.is_file() else {}
    return tuple(
        FinishedStage(stage, e["key"], e["seconds"], e["peak_mib"]) for stage, e in entries.items()
    )


REGISTRATION_ERROR_FILE = "registration-error.json"


def registration_error(folder: Path) -> RegistrationError | None:
    """The registration's own error as measured by a run; None where it was not measured."""
    path = folder / REGISTRATION_ERROR_FILE
    return RegistrationError(**json.loads(path.read_text("utf-8"))) if path.is_file() else None


def commit() -> str:
    """Commit of a checkout, empty for an installed package."""
    asked = ["git", "-C", str(_PACKAGE), "rev-parse", "HEAD"]
    if not (_PACKAGE.parent / ".git").exists():
        return ""
    answer = subprocess.run(asked, capture_output=True, text=True, check=False)
    return answer.stdout.strip()


_LOCK = ".in-use"


@contextmanager
def sole_use(folder: Path) -> Iterator[None]:
    """Locks the folder, which must exist, for the duration of the block.

    The system releases the lock when the process ends, for any reason.

    Raises:
        LegsimError: another process holds it.
    """
    with (folder / _LOCK).open("a+", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "another process"
            raise file_error(
                folder,
                f"is in use by {holder}",
                "wait until that has ended, or choose another folder with --out",
            ) from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
                raise
            warnings.warn(
                f"{folder}: its file system has no locks; make sure that nothing else writes there",
                stacklevel=3,
            )
        stream.truncate(0)
        stream.write(f"process {os.getpid()} on {socket.gethostname()}")
        stream.flush()
        yield
