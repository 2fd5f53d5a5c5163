"""Damaged files that reach code which valid ones do not; kept in an archive for each reader."""

import io
import tarfile
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).with_name("corpus")


def load(name: str, folder: Path = FOLDER) -> tuple[bytes, ...]:
    """The inputs kept for a reader; none, where there is no archive."""
    path = folder / f"{name}.tar.xz"
    if not path.exists():
        return ()
    with tarfile.open(path) as archive:
        files = (archive.extractfile(member) for member in archive)
        return tuple(file.read() for file in files if file is not None)


def save(name: str, inputs: Sequence[bytes], folder: Path = FOLDER) -> None:
    """Keeps the inputs of a reader instead of those before; equal inputs make equal archives."""
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(folder / f"{name}.tar.xz", "w:xz", preset=9) as archive:
        for k, data in enumerate(sorted(inputs, key=lambda data: (len(data), data))):
            member = tarfile.TarInfo(f"{k:03d}")
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
