"""Lists of numbers and names, as segmentation programs write them beside their files.

JSON (TotalSegmentator's and nnU-Net's, either way around), color tables of 3D Slicer (.ctbl, .txt),
label descriptions of ITK-SNAP (.txt, .label) and the header of 3D Slicer's .seg.nrrd. They do not
say tissues: names that the maps of legsim know have theirs.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from legsim.core.errors import file_error
from legsim.core.files import is_file

SUFFIXES = (".json", ".ctbl", ".txt", ".label", ".nrrd")

_SNAP = re.compile(r'^\s*(\d+)\s+(?:[\d.]+\s+){4,6}"([^"]*)"\s*$')
"""number, color, opacity, visibility, visibility of the mesh, "name" """

_SLICER = re.compile(r"^\s*(\d+)\s+(\S+)(?:\s+\d+){4}\s*$")
"""number, name without blanks, color and opacity"""

_SEGMENT = re.compile(r"^Segment(\d+)_(LabelValue|Name|Layer):=(.*)$", re.M)

_NOTHING = ("background", "clear label", "clear_label", "none", "unknown", "")

_SAME = {
    "femoral": "femur",
    "tibial": "tibia",
    "fibular": "fibula",
    "patellar": "patella",
    "menisci": "meniscus",
    "l": "left",
    "r": "right",
}
"""words for what the maps call otherwise"""

_IDLE = ("bone", "the", "of")


def read(path: Path) -> dict[int, str]:
    """Names by number, above 0.

    Raises:
        LegsimError: no such file, or no list of numbers and names in it.
    """
    if not is_file(path):
        raise file_error(path, "no such file", "check the name of the map")
    if path.suffix == ".nrrd":
        found = _segments(path)
    elif path.suffix == ".json":
        found = _json(path)
    else:
        text = path.read_text("utf-8", "replace")
        lines = [_SNAP.match(line) or _SLICER.match(line) for line in text.splitlines()]
        found = {int(match[1]): match[2] for match in lines if match}
    named = {n: name for n, name in found.items() if n > 0 and name.lower() not in _NOTHING}
    if not named:
        raise file_error(
            path,
            "holds no numbers with names",
            "give JSON, a color table of 3D Slicer, ITK-SNAP's label descriptions or a .toml",
        )
    return named


def words(name: str) -> tuple[str, ...]:
    """What a name is compared by: its words in small letters, sorted."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()
    found: list[str] = re.findall(r"[a-z]+|\d+", apart)
    return tuple(sorted(_SAME.get(word, word) for word in found if word not in _IDLE))


def _json(path: Path) -> dict[int, str]:
    try:
        content = json.loads(path.read_text("utf-8-sig"))
    except ValueError as error:  # also of what is no UTF-8
        raise file_error(path, f"is not JSON ({error})", "correct it there") from error
    return _pairs(content.get("labels", content)) if isinstance(content, dict) else {}


def _pairs(content: Any) -> dict[int, str]:
    """Of {"1": "femur"} or {"femur": 1}; numbers of regions (lists) are no structure's."""
    found: dict[int, str] = {}
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if isinstance(value, str) and str(key).isdecimal():
            found[int(key)] = value
        elif isinstance(value, int) and not isinstance(value, bool):
            found[value] = str(key)
    return found


def _segments(path: Path) -> dict[int, str]:
    with path.open("rb") as stream:
        header = stream.read(1 << 20).partition(b"\n\n")[0].decode("utf-8", "replace")
    fields: dict[str, dict[str, str]] = {}
    for number, key, value in _SEGMENT.findall(header.replace("\r", "")):
        fields.setdefault(number, {})[key] = value.strip()
    return {
        int(one["LabelValue"]): one["Name"]
        for one in fields.values()
        if one.get("LabelValue", "").isdecimal() and "Name" in one
    }
