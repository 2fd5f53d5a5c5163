"""LABELS.toml: what the numbers of a segmentation are, for :mod:`legsim.phantom.from_labels`."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from legsim.core import files as core_files
from legsim.core import resources
from legsim.core.errors import LegsimError, file_error
from legsim.kinematics.skeleton import SEGMENTS
from legsim.phantom import label_lists, materials

BONE = "bone"
"""tissue that becomes a cortex around cancellous bone"""

_FOLDER = "label_maps"

_KEYS = {"number": int, "name": str, "tissue": str, "segment": str, "envelope": bool}

_PAIRED = (*sorted({name[:-2] for name in SEGMENTS if name[-2:] in ("_l", "_r")}), "soft")
"""segments of which each leg has one"""


@dataclass(frozen=True, slots=True)
class LabelEntry:
    """One structure of a segmentation."""

    number: int
    name: str
    """without its side"""
    tissue: str
    """a material, or :data:`BONE`"""
    segment: str | None
    """what carries it, without its side; None for a structure at rest"""
    side: str | None
    """"l" or "r"; None where the map leaves it open, and for what is in the middle"""
    envelope: bool
    """whether it encloses all later structures, as skin and fat do"""

    @property
    def paired(self) -> bool:
        """Whether each leg has one."""
        return self.segment in _PAIRED

    @property
    def rank(self) -> int:
        """Place among the others, outermost first."""
        if self.envelope:
            return 0
        soft = self.segment is None or self.segment == "soft"
        return 3 if self.tissue in (BONE, "cortical_bone", "cancellous_bone") else 1 if soft else 2


@dataclass(frozen=True, slots=True)
class LabelMap:
    """The structures of a segmentation and the numbers that are left out."""

    path: Path
    entries: tuple[LabelEntry, ...]
    left_out: dict[int, str]
    """names by number: known, but no part of a leg"""
    foreign: dict[int, str] = field(default_factory=dict)
    """names by number of a list that no map of legsim has: their tissues are not known"""


def names() -> tuple[str, ...]:
    """Names of the maps that ship with legsim."""
    folder = resources.model_file(f"{_FOLDER}/slicer_generic_anatomy.toml").parent
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def load_label_map(name_or_path: Path | str) -> LabelMap:
    """Reads a map: one that ships with legsim by its name, a file, or a list of numbers and names.

    Of a list (:mod:`legsim.phantom.label_lists`) those structures are taken whose names a shipped
    map has; names that a shipped map leaves out are left out; other numbers stay unknown.

    Raises:
        LegsimError: no such map, malformed, an unknown key, tissue or segment, or a number or a
            name that occurs twice.
    """
    path = Path(name_or_path)
    if path.suffix.lower() in label_lists.SUFFIXES:
        return _of_list(path)
    if path.suffix != ".toml":
        if str(name_or_path) not in names():
            raise LegsimError(
                f"unknown label map {str(name_or_path)!r}; known: {', '.join(names())}, or a file "
                f"({', '.join(('.toml', *label_lists.SUFFIXES))})"
            )
        path = resources.model_file(f"{_FOLDER}/{name_or_path}.toml")
    content = _content(path)
    tables = content.get("label", [])
    if not isinstance(tables, list) or not tables:
        raise file_error(path, "holds no [[label]]", "give each number of the legs one table")
    entries = tuple(_entry(path, k, table) for k, table in enumerate(tables))
    left_out = {
        _number(path, f"left_out.{name}", n): name
        for name, n in content.get("left_out", {}).items()
    }
    numbers = [str(n) for n in (*(entry.number for entry in entries), *left_out)]
    named = [f"{entry.name} {entry.side or ''}".strip() for entry in entries]
    for what in (numbers, named):
        twice = sorted({x for x in what if what.count(x) > 1})
        if twice:
            raise file_error(path, f"{twice[0]} occurs twice", "give each structure one table")
    return LabelMap(path, entries, left_out)


def _of_list(path: Path) -> LabelMap:
    """The structures of a list whose names a shipped map has, with its tissue and segment."""
    known: dict[tuple[str, ...], LabelEntry] = {}
    outside: set[tuple[str, ...]] = set()
    for name in names():
        shipped = load_label_map(name)
        outside |= {label_lists.words(left) for left in shipped.left_out.values()}
        for entry in shipped.entries:
            known.setdefault(label_lists.words(f"{entry.name} {entry.side or ''}"), entry)
    listed = label_lists.read(path)
    entries = [
        replace(found, number=number)
        for number, name in listed.items()
        if (found := _sided(known, label_lists.words(name))) is not None
    ]
    if not entries:
        some = ", ".join(list(listed.values())[:8])
        raise file_error(
            path,
            f"names no structure that legsim knows ({some})",
            "it says no tissues: write a .toml like models/label_maps/leg.toml",
        )
    others = {n: name for n, name in listed.items() if n not in {e.number for e in entries}}
    left_out = {n: name for n, name in others.items() if _is_outside(outside, name)}
    foreign = {n: name for n, name in others.items() if n not in left_out}
    return LabelMap(path, _unlike(path, entries), left_out, foreign)


def _is_outside(outside: set[tuple[str, ...]], name: str) -> bool:
    """Whether shipped maps leave the name out, with its side or, of both sides, without."""
    words = label_lists.words(name)
    return bool({words, tuple(word for word in words if word not in ("left", "right"))} & outside)


def _sided(known: dict[tuple[str, ...], LabelEntry], words: tuple[str, ...]) -> LabelEntry | None:
    """The entry of these words; of a side, also where the map leaves sides open."""
    if words in known:
        return known[words]
    sides = {"left", "right"} & set(words)
    found = known.get(tuple(word for word in words if word not in sides))
    if found is None or len(sides) != 1 or not found.paired or found.side is not None:
        return None
    return replace(found, side=sides.pop()[0])


def _unlike(path: Path, entries: list[LabelEntry]) -> tuple[LabelEntry, ...]:
    """The entries, whose names must differ."""
    named = [(entry.name, entry.side) for entry in entries]
    twice = [entry for entry in entries if named.count((entry.name, entry.side)) > 1]
    if twice:
        problem = f"names {twice[0].name} twice, {' and '.join(str(e.number) for e in twice[:2])}"
        raise file_error(path, problem, "write a .toml like models/label_maps/leg.toml")
    return tuple(entries)


def _content(path: Path) -> dict[str, Any]:
    content = core_files.load_toml(path)
    unknown = sorted(set(content) - {"label", "left_out"})
    if unknown:
        raise file_error(path, f"unknown key {unknown[0]!r}", "known: [[label]] and [left_out]")
    if not isinstance(content.get("left_out", {}), dict):
        raise file_error(path, "left_out is no table", "give it lines like liver = 5")
    return content


def _number(path: Path, place: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise file_error(path, f"number {value!r}", "give a whole number above 0", place=place)
    return value


def _entry(path: Path, k: int, table: Any) -> LabelEntry:
    place = f"label {k + 1}"
    if not isinstance(table, dict):
        raise file_error(path, "is no table", "write [[label]]", place=place)
    for key, value in table.items():
        known = f"known: {', '.join(_KEYS)}"
        if key not in _KEYS:
            raise file_error(path, f"unknown key {key!r}", known, place=place)
        if not isinstance(value, _KEYS[key]) or (isinstance(value, bool) and _KEYS[key] is int):
            problem = f"{key} = {value!r} is of the wrong type"
            raise file_error(path, problem, f"expected {_KEYS[key].__name__}", place=place)
    missing = [key for key in ("number", "name", "tissue") if key not in table]
    if missing:
        fix = "expected number, name, tissue and, where it moves, segment"
        raise file_error(path, f"lacks {', '.join(missing)}", fix, place=place)
    _number(path, place, table["number"])
    name, tissue = table["name"], table["tissue"]
    if not name or not name.replace("_", "").isalnum() or not name.isascii():
        fix = "use letters, digits and _: it names a file"
        raise file_error(path, f"name = {name!r}", fix, place=place)
    if tissue != BONE and tissue not in materials.names():
        fix = f"known: {BONE}, {', '.join(materials.names())}"
        raise file_error(path, f"unknown tissue {tissue!r}", fix, place=place)
    segment, side = _segment(path, place, table.get("segment"))
    for ending, letter in (("_left", "l"), ("_right", "r"), ("_l", "l"), ("_r", "r")):
        if name.endswith(ending) and side == letter:
            name = name.removesuffix(ending)
    envelope = table.get("envelope", False)
    return LabelEntry(table["number"], name, tissue, segment, side, envelope)


def _segment(path: Path, place: str, text: str | None) -> tuple[str | None, str | None]:
    """(segment without its side, side) of "tibia_l", "tibia", "pelvis", "soft_r" or nothing."""
    if text is None:
        return None, None
    base, side = (text[:-2], text[-1]) if text[-2:] in ("_l", "_r") else (text, None)
    if base in _PAIRED or (text in SEGMENTS and side is None):
        return base, side
    known = f"known: pelvis, {', '.join(_PAIRED)}, each of the latter also with _l or _r"
    raise file_error(path, f"unknown segment {text!r}", known, place=place)
