"""Names that a segmentation's own file has for its numbers.

TotalSegmentator and Connectome Workbench write a table, Caret's XML, into an extension of NIfTI's
header (https://nifti.nimh.nih.gov, "The NIfTI-1 extension"); 3D Slicer (.seg.nrrd) and MITK write
pairs of key and value into NRRD's. Other files hold none.
"""

import json
import re
import struct
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from legsim.core import files
from legsim.core.errors import file_error
from legsim.geometry import _whole_files

SUFFIXES = (".nii", ".nii.gz", ".hdr", ".hdr.gz", ".nrrd", ".nhdr")
"""of files that may hold names"""

_LONGEST = 1 << 24
"""bytes of a header, beyond which no names are sought"""

_EXTENSIONS = 352
"""bytes before the first extension of NIfTI-1; the fourth last is 0 where there is none"""

_SEGMENT = re.compile(r"^Segment(\d+)_(LabelValue|Name|Layer):=(.*)$", re.M)

_GROUPS = re.compile(r"^org\.mitk\.multilabel\.segmentation\.labelgroups:=(.*)$", re.M)


def read(path: Path) -> dict[int, tuple[str, ...]]:
    """Names by number, above 0, as :func:`by_number`; none where the file has no names.

    Raises:
        LegsimError: segments in several layers.
    """
    name = path.name.lower()
    if not name.endswith(SUFFIXES):
        return {}
    nrrd = name.endswith((".nrrd", ".nhdr"))
    return by_number(_of_nrrd(path) if nrrd else _of_nifti(path))


def by_number(pairs: Iterable[tuple[int, str]]) -> dict[int, tuple[str, ...]]:
    """The names, each once, of each number above 0: one, or several that are in doubt."""
    found: dict[int, tuple[str, ...]] = {}
    for number, name in pairs:
        so_far = found.get(number, ())
        if number > 0 and name not in so_far:
            found[number] = (*so_far, name)
    return found


def unique(path: Path, named: Mapping[int, tuple[str, ...]], cure: str) -> dict[int, str]:
    """Names by number, of which each must have one.

    Raises:
        LegsimError: a number has several; with the cure.
    """
    for number, names in named.items():
        if len(names) > 1:
            problem = f"number {number} has two names, {names[0]} and {names[1]}"
            raise file_error(path, problem, cure)
    return {number: name for number, (name,) in named.items()}


def records(listed: Any) -> list[tuple[int, str]]:
    """Numbers and names of a list of objects that hold both, as MITK's JSON and others'."""
    found: list[tuple[int, str]] = []
    for one in listed if isinstance(listed, list) else ():
        if isinstance(one, list):
            found += records(one)
        elif isinstance(one, dict):
            number = next((one[key] for key in ("value", "labelID", "id") if key in one), None)
            name = next((one[key] for key in ("name", "SegmentLabel") if key in one), None)
            if isinstance(number, int) and isinstance(name, str):
                found.append((number, name))
            found += records(one.get("labels"))
    return found


def _of_nrrd(path: Path) -> list[tuple[int, str]]:
    start = files.beginning(path, _LONGEST)
    header = start.replace(b"\r", b"").partition(b"\n\n")[0]
    text = header.decode("utf-8", "replace")
    fields: dict[str, dict[str, str]] = {}
    for number, key, value in _SEGMENT.findall(text):
        fields.setdefault(number, {})[key] = value.strip()
    layers = {one["Layer"] for one in fields.values() if "Layer" in one}
    if len(layers) > 1:
        raise file_error(
            path,
            f"holds segments of {len(layers)} layers, which overlap",
            "export it from 3D Slicer as a labelmap, with its color table",
        )
    groups = _GROUPS.search(text)
    if groups is not None:
        return _of_mitk(groups[1])
    return [
        (int(one["LabelValue"]), one["Name"])
        for one in fields.values()
        if one.get("LabelValue", "").isdecimal() and "Name" in one
    ]


def _of_mitk(value: str) -> list[tuple[int, str]]:
    """Of MITK's groups of labels; NRRD writes line ends and backslashes of a value with another."""
    plain = re.sub(r"\\([n\\])", lambda found: "\n" if found[1] == "n" else "\\", value)
    try:
        return records(json.loads(plain))
    except (ValueError, RecursionError):
        return []


def _of_nifti(path: Path) -> list[tuple[int, str]]:
    files.beginning(path, 2)  # refuses what may not be read
    try:
        with _whole_files.opened(path) as stream:
            head = stream.read(_EXTENSIONS)
            order, second = _whole_files.nifti_layout(head)
            if second or head[_EXTENSIONS - 4 :][:1] in (b"", b"\0"):
                return []  # ITK does not read NIfTI-2
            single = head[344:347] == b"n+1"  # else the voxels are in another file
            end = struct.unpack_from(f"{order}f", head, 108)[0] if single else _LONGEST
            extensions = stream.read(max(0, min(int(end), _LONGEST) - _EXTENSIONS))
    except (EOFError, OSError, OverflowError, ValueError, zlib.error, struct.error):
        return []  # who reads the voxels says so
    found: list[tuple[int, str]] = []
    while len(extensions) >= 8:
        length = struct.unpack_from(f"{order}i", extensions)[0]
        if not 8 <= length <= len(extensions):
            break
        found += _of_caret(extensions[8:length])
        extensions = extensions[length:]
    return found


def _of_caret(content: bytes) -> list[tuple[int, str]]:
    text = content.strip(b"\0 \t\r\n")
    if b"<CaretExtension" not in text[:1024] or b"<!DOCTYPE" in text:
        return []
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError):
        return []
    return [
        (int(label.get("Key", "")), (label.text or "").strip())
        for label in root.iter("Label")
        if label.get("Key", "").isdecimal()
    ]
