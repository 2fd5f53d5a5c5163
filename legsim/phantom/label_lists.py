"""Lists of numbers and names, as segmentation programs write them beside their files.

JSON (TotalSegmentator's and nnU-Net's, either way around, MITK's), color tables of 3D Slicer
(.ctbl, .txt, .csv), label descriptions of ITK-SNAP (.txt, .label), BIDS' dseg.tsv, and
segmentations whose header has names (:mod:`legsim.geometry.label_names`). They do not say tissues:
names that the maps of legsim know have theirs.
"""

import csv
import json
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from legsim.core.errors import file_error
from legsim.core.files import is_file, refuse_packed
from legsim.geometry import label_names

SUFFIXES = (".json", ".ctbl", ".txt", ".label", ".csv", ".tsv", *label_names.SUFFIXES)

_COLUMNS = (("labelvalue", "index", "label", "value", "number", "id"), ("name", "label_name"))
"""of tables with a line of names: that of numbers and that of names, in small letters"""

_SIDE_COLUMNS = ("side", "hemi", "hemisphere", "laterality")
"""where a table says the side apart from the name"""

_SNAP = re.compile(r'^\s*(\d+)\s+(?:[\d.]+\s+){4,6}"([^"]*)"\s*$')
"""number, color, opacity, visibility, visibility of the mesh, "name" """

_SLICER = re.compile(r'^\s*(\d+)\s+"?(\S.*?)"?(?:\s+\d+){4}\s*$')
"""number, name, color and opacity"""

_NOTHING = ("background", "clear label", "clear_label", "none", "unknown", "")

_ADJECTIVES = {"femoral": "femur", "tibial": "tibia", "fibular": "fibula", "patellar": "patella"}
"""words that mean a bone only beside a noun: alone they may be an artery's or a nerve's"""

_SAME = {
    "menisci": "meniscus",
    "bones": "bone",
    "muscles": "muscle",
    "l": "left",
    "r": "right",
}
"""words for what the maps call otherwise"""

_IDLE = ("the", "of", "distal", "proximal")

_SIDES = {"left", "right"}

_SIDE_CELLS = (*_SIDES, "l", "r")
"""of a column of sides; others, as BIDS' n/a, state none"""


def read(path: Path) -> dict[int, str]:
    """Names by number, above 0.

    Raises:
        LegsimError: no such file that can be read, no list of numbers and names in it, a number
            with two names, or segments in several layers.
    """
    if not is_file(path):
        raise file_error(path, "no such file", "check the name of the map")
    if not path.name.lower().endswith(".gz"):
        refuse_packed(path)
    if path.name.lower().endswith(label_names.SUFFIXES):
        found = label_names.read(path)
    else:
        found = label_names.by_number(_listed(path))
    cure = "give each structure its own number"
    named = named_structures(label_names.unique(path, found, cure))
    if not named:
        raise file_error(
            path,
            "holds no numbers with names",
            "give JSON, a color table of 3D Slicer, ITK-SNAP's label descriptions or a .toml",
        )
    return named


def named_structures(named: Mapping[int, str]) -> dict[int, str]:
    """Names by number, without those that say that nothing is there."""
    return {n: name for n, name in named.items() if name.lower() not in _NOTHING}


def words(name: str) -> tuple[str, ...]:
    """What a name is compared by: its words in small letters, each once and sorted; none of a name
    without any.

    "bone" says nothing beside another word, except a side.
    """
    composed = unicodedata.normalize("NFC", name)
    apart = re.sub(r"([a-z])([A-Z])", r"\1 \2", composed).lower()
    parts: list[str] = re.findall(r"[^\W\d_]+|\d+", apart)
    found = {_SAME.get(word, word) for word in parts}.difference(_IDLE)
    if not found <= {*_SIDES, *_ADJECTIVES}:
        found = {_ADJECTIVES.get(word, word) for word in found}
    if not found <= {*_SIDES, "bone"}:
        found.discard("bone")
    return tuple(sorted(found))


def _listed(path: Path) -> list[tuple[int, str]]:
    """Numbers and names of a list that is no segmentation."""
    if path.suffix.lower() == ".json":
        return _json(path)
    lines = path.read_text("utf-8-sig", "replace").splitlines()
    if path.suffix.lower() in (".csv", ".tsv"):
        return _table(lines)
    matches = [_SNAP.match(line) or _SLICER.match(line) for line in lines]
    return [(int(match[1]), match[2]) for match in matches if match]


def _table(lines: list[str]) -> list[tuple[int, str]]:
    """Of a table of tabs, commas or semicolons, whose columns have names."""
    dividers = "\t;,"
    divider = max(dividers, key=(lines or [""])[0].count)
    header, *rows = csv.reader(lines, delimiter=divider) if lines else [[]]
    titles = [title.strip().lower() for title in header]
    known = (*_COLUMNS, _SIDE_COLUMNS)
    number, name, side = (next((titles.index(c) for c in k if c in titles), None) for k in known)
    if number is None or name is None:
        return []
    return [
        (
            int(row[number]),
            f"{row[name].strip()} {'' if side is None else _side(row[side])}".strip(),
        )
        for row in rows
        if len(row) > max(number, name, side or 0) and row[number].strip().isdecimal()
    ]


def _side(cell: str) -> str:
    """The side that a cell states, or nothing."""
    stated = cell.strip()
    return stated if stated.lower() in _SIDE_CELLS else ""


def _json(path: Path) -> list[tuple[int, str]]:
    try:
        content = json.loads(path.read_text("utf-8-sig"), object_pairs_hook=_object)
    except ValueError as error:  # also of what is no UTF-8
        raise file_error(path, f"is not JSON ({error})", "correct it there") from error
    if not isinstance(content, dict):
        return []
    listed = next(
        (content[k] for k in ("labels", "groups", "segmentAttributes") if k in content), 0
    )
    return label_names.records(listed) or _pairs(content.get("labels", content))


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
