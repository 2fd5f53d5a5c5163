"""Files of a folder or a pattern that hold one view each, in the order of their view numbers."""

import os
import re
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error

_VIEWS = (
    ".tif",
    ".tiff",
    ".dcm",
    ".ima",
    ".dicom",
    ".npy",
    ".mha",
    ".mhd",
    ".png",
    ".raw",
    ".bin",
    ".img",
)
"""Endings of files that hold a view; others in a folder are left out"""


_PIXELS = (".raw", ".bin", ".img")
"""Endings of what headers (.mhd) name"""


def is_pattern(path: Path) -> bool:
    """Whether a path's last part stands for several files, by * or ?; brackets do not."""
    return any(mark in path.name for mark in "*?") and not os.path.exists(path)


def matching(pattern: Path) -> list[Path]:
    """Files of a pattern."""
    return [p for p in pattern.parent.glob(pattern.name.replace("[", "[[]")) if p.is_file()]


def members(place: Path) -> tuple[list[Path], tuple[str, ...]]:
    """(images in a folder or of a pattern, a note on what is left out).

    Raises:
        LegsimError: there are none.
    """
    files = matching(place / "*" if os.path.isdir(place) else place)
    files = [path for path in files if path.name[0] != "."]
    found = [path for path in files if path.suffix.lower() in _VIEWS]
    if any(path.suffix.lower() == ".mhd" for path in found):
        found = [path for path in found if path.suffix.lower() not in _PIXELS]
    bare = [path for path in files if not path.suffix]  # as of DICOM
    if len(bare) > len(found):
        found = [*found, *bare]
    if not found:
        raise file_error(place, "holds no images", f"expected files like {', '.join(_VIEWS)}")
    left = sorted({path.name for path in files} - {path.name for path in found})
    return found, (f"not images, left out: {', '.join(left[:5])}",) if left else ()


def by_number(place: Path, members: list[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """(files in the order of the number that differs between their names, notes).

    Raises:
        LegsimError: files of several kinds or names, one number twice, no number, or names that
            differ in several numbers.
    """
    _check_alike(place, members)
    found, column = _numbers(place, members)
    numbered = sorted(zip(found, members, strict=True))
    numbers = [number for number, _ in numbered]
    twice = [k for k, number in enumerate(numbers[1:]) if number == numbers[k]]
    if twice:
        raise file_error(
            numbered[twice[0]][1],
            f"has the same view number, {numbers[twice[0]]}, as {numbered[twice[0] + 1][1].name}",
            "leave one of them out",
        )
    steps = np.diff(numbers)
    notes = _decimals([path for _, path in numbered], column)
    if len(steps) and (steps != np.median(steps)).any():
        k = int(np.flatnonzero(steps != np.median(steps))[0])
        notes.append(
            f"view numbers jump from {numbers[k]} to {numbers[k + 1]}: views may be missing"
        )
    return [path for _, path in numbered], tuple(notes)


def _check_alike(place: Path, members: list[Path]) -> None:
    """Refuses files whose names differ in more than their numbers."""
    kinds: dict[str, int] = {}
    for path in members:
        kind = re.sub(r"\d+", "#", path.stem) + path.suffix.lower()
        kinds[kind] = kinds.get(kind, 0) + 1
    if len(kinds) > 1:
        names = ", ".join(f"{kind} ({count})" for kind, count in kinds.items())
        raise file_error(
            place,
            f"holds images of several names: {names[:200]}",
            "give a pattern, as in 'folder/view_*.tif', or a folder with the views alone",
        )


def _decimals(ordered: list[Path], column: int) -> list[str]:
    """A note where view numbers look like decimals of different lengths, which others sort."""
    names = [list(re.finditer(r"\d+", path.stem))[column:][:1] for path in ordered]
    digits = [m.group() for found in names for m in found]
    after_point = all(
        re.search(r"(?<![\d.])\d+\.$", m.string[: m.start()]) and m.string[m.end() :][:1] != "."
        for found in names
        for m in found
    )
    if not after_point or len({len(d) for d in digits}) < 2:
        return []
    return [
        f"view numbers follow a point and are read as whole ones: {ordered[0].name} comes before "
        f"{ordered[-1].name}; if they are decimals, number the files instead"
    ]


def _numbers(place: Path, members: list[Path]) -> tuple[list[int], int]:
    """(the number of each file, whose names are alike, that differs between them; which it is)."""
    found = [[int(digits) for digits in re.findall(r"\d+", path.stem)] for path in members]
    if len(members) == 1:
        return [0], 0
    if not found[0]:
        raise file_error(place, "holds images without view numbers", "number the files")
    columns = list(zip(*found, strict=True))
    differing = [column for column in columns if len(set(column)) > 1]
    # a number beside its time or angle: those that are each file's own agree on the order
    own = [column for column in differing if len(set(column)) == len(column)]
    orders = {tuple(np.argsort(column, kind="stable").tolist()) for column in own}
    if len(differing) > 1 and len(orders) != 1:
        raise file_error(
            place,
            f"holds images whose names differ in {len(differing)} numbers, as {members[0].name} "
            f"and {members[1].name}",
            "rename them so that only the view number differs, or give a pattern for one scan",
        )
    chosen = (own or differing or columns[-1:])[0]
    place_in_name = columns.index(chosen)
    texts = [list(re.finditer(r"\d+", path.stem))[place_in_name] for path in members]
    before = members[0].stem[: texts[0].start()]
    # a minus stands before no number that is 0 or padded by zeros
    padded = any(text[0][0] == "0" for text in texts)
    if len(own) < 2 and not padded and re.search(r"(?:^|[^A-Za-z0-9)\]-])-$", before):
        raise file_error(
            place,
            f"holds images with negative view numbers, as {members[0].name}",
            "number the files from 0 in the order of their views",
        )
    return list(chosen), place_in_name
