"""Lists of numbers and names, as segmentation programs write them beside their files.

JSON (TotalSegmentator's and nnU-Net's, either way around), color tables of 3D Slicer (.ctbl, .txt),
label descriptions of ITK-SNAP (.txt, .label) and the header of 3D Slicer's .seg.nrrd. They do not
say tissues: names that the maps of legsim know have theirs.
"""

import json
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from legsim.core.errors import file_error
from legsim.core.files import is_file, refuse_packed

SUFFIXES = (".json", ".ctbl", ".txt", ".label", ".nrrd")

_SNAP = re.compile(r'^\s*(\d+)\s+(?:[\d.]+\s+){4,6}"([^"]*)"\s*$')
"""number, color, opacity, visibility, visibility of the mesh, "name" """

_SLICER = re.compile(r'^\s*(\d+)\s+"?(\S.*?)"?(?:\s+\d+){4}\s*$')
"""number, name, color and opacity"""

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

_SIDES = {"left", "right"}


def read(path: Path) -> dict[int, str]:
    """Names by number, above 0.

    Raises:
        LegsimError: no such file that can be read, no list of numbers and names in it, a number
            with two names, or segments in several layers.
    """
    if not is_file(path):
        raise file_error(path, "no such file", "check the name of the map")
    refuse_packed(path)
    if path.suffix.lower() == ".nrrd":
        found = _segments(path)
    elif path.suffix.lower() == ".json":
        found = _json(path)
    else:
        text = path.read_text("utf-8", "replace")
        lines = [_SNAP.match(line) or _SLICER.match(line) for line in text.splitlines()]
        found = [(int(match[1]), match[2]) for match in lines if match]
    named = _unique(path, found)
    named = {n: name for n, name in named.items() if name.lower() not in _NOTHING}
    if not named:
        raise file_error(
            path,
            "holds no numbers with names",
            "give JSON, a color table of 3D Slicer, ITK-SNAP's label descriptions or a .toml",
        )
    return named


def words(name: str) -> tuple[str, ...]:
    """What a name is compared by: its words in small letters, sorted; none of a name without any.

    "bone" says nothing beside another word, except a side.
    """
    composed = unicodedata.normalize("NFC", name)
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", composed).lower()
    found: list[str] = re.findall(r"[^\W\d_]+|\d+", apart)
    kept = [_SAME.get(word, word) for word in found if word not in _IDLE]
    if "bone" in found and _SIDES.issuperset(kept):
        kept.append("bone")
    return tuple(sorted(kept))


def _unique(path: Path, pairs: list[tuple[int, str]]) -> dict[int, str]:
    """Names by number, above 0, of which each has one."""
    found: dict[int, str] = {}
    for number, name in pairs:
        if number > 0 and found.setdefault(number, name) != name:
            problem = f"number {number} has two names, {found[number]} and {name}"
            raise file_error(path, problem, "give each structure its own number")
    return found


def _json(path: Path) -> list[tuple[int, str]]:
    try:
        content = json.loads(path.read_text("utf-8-sig"), object_pairs_hook=_object)
    except ValueError as error:  # also of what is no UTF-8
        raise file_error(path, f"is not JSON ({error})", "correct it there") from error
    return _pairs(content.get("labels", content)) if isinstance(content, dict) else []


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, whose keys must differ: json would keep the last."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key!r} occurs twice")
        found[key] = value
    return found


def _pairs(content: Any) -> list[tuple[int, str]]:
    """Of {"1": "femur"} or {"femur": 1}; numbers of regions (lists) are no structure's."""
    found: list[tuple[int, str]] = []
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if isinstance(value, str) and str(key).isdecimal():
            found.append((int(key), value))
        elif isinstance(value, int) and not isinstance(value, bool):
            found.append((value, str(key)))
    return found


def _segments(path: Path) -> list[tuple[int, str]]:
    with path.open("rb") as stream:
        header = stream.read(1 << 20).partition(b"\n\n")[0].decode("utf-8", "replace")
    fields: dict[str, dict[str, str]] = {}
    for number, key, value in _SEGMENT.findall(header.replace("\r", "")):
        fields.setdefault(number, {})[key] = value.strip()
    layers = {one["Layer"] for one in fields.values() if "Layer" in one}
    if len(layers) > 1:
        raise file_error(
            path,
            f"holds segments of {len(layers)} layers, which overlap",
            "export it from 3D Slicer as a labelmap, with its color table",
        )
    return [
        (int(one["LabelValue"]), one["Name"])
        for one in fields.values()
        if one.get("LabelValue", "").isdecimal() and "Name" in one
    ]
