"""LABELS.toml: what the numbers of a segmentation are, for :mod:`legsim.phantom.from_labels`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from legsim.core import files as core_files
from legsim.core import resources
from legsim.core.errors import LegsimError, file_error
from legsim.geometry import label_names
from legsim.geometry.label_images import LabelImage
from legsim.kinematics.skeleton import SEGMENTS
from legsim.phantom import label_lists, materials

BONE = "bone"
"""tissue that becomes a cortex around cancellous bone"""

_FOLDER = "label_maps"

_KEYS = {"number": int, "name": str, "tissue": str, "segment": str, "envelope": bool}

_PAIRED = (*sorted({name[:-2] for name in SEGMENTS if name[-2:] in ("_l", "_r")}), "soft")
"""segments of which each leg has one"""

_SIDES = frozenset(("left", "right"))

_SEVERAL = {"tarsal": frozenset(("talus", "calcn"))}
"""segments of names that hold bones of more than one"""

_APART = (
    (("skin", "fat"), ("muscle",), ("cartilage", "meniscus")),
    (("skin",), ("muscle", "blood", "water", "tendon")),
)
"""in each line, groups of tissues of which one is never meant by another's name

Soft tissue may hold all of them; vessels and tendons are often counted with muscle or fat.
"""


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
    def bony(self) -> bool:
        """Whether it is of bone."""
        return self.tissue in (BONE, "cortical_bone", "cancellous_bone")

    @property
    def bodies(self) -> frozenset[str]:
        """Segments with bones that it moves with; none of what is soft or at rest."""
        if self.segment is None or self.segment == "soft":
            return frozenset()
        return _SEVERAL.get(self.name, frozenset((self.segment,)))

    @property
    def rank(self) -> int:
        """Place among the others, outermost first."""
        if self.envelope:
            return 0
        return 3 if self.bony else 2 if self.bodies else 1


@dataclass(frozen=True, slots=True)
class LabelMap:
    """The structures of a segmentation and the numbers that are left out."""

    path: Path
    entries: tuple[LabelEntry, ...]
    left_out: dict[int, str]
    """names by number: known, but no part of a leg"""
    foreign: dict[int, str] = field(default_factory=dict)
    """names by number of a list that no map of legsim has: their tissues are not known"""
    remarks: tuple[str, ...] = ()
    """what a user may not expect of it"""


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
    if path.name.lower().endswith(label_lists.SUFFIXES):
        return _of_names(path, label_lists.read(path))
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


def own_map(image: LabelImage) -> LabelMap:
    """The map of a segmentation by :func:`own_names`.

    Raises:
        LegsimError: it has no names, two for a number, or no structure that a shipped map has.
    """
    cure = (
        f"say what they are by --map ({', '.join(names())}, a .toml, or the list of names that "
        "its program wrote)"
    )
    here = {n: called for n, called in image.names.items() if n in image.numbers}
    label_names.unique(image.path, here, cure)
    named, where = own_names(image)
    if not named:
        raise file_error(image.path, "does not name its numbers", cure)
    found = _of_names(image.path, named)
    taken = sorted(entry.number for entry in found.entries if entry.number in image.numbers)
    listed = ", ".join(f"{n} {named[n]}" for n in taken)
    remark = f"{image.path}: numbers by the names {where}: {listed or 'none of a leg'}"
    return replace(found, remarks=(remark,))


def own_names(image: LabelImage) -> tuple[dict[int, str], str]:
    """(names by number that are in a segmentation's file, without those of which a number has two,
    "in it"); of a mask of one number without any, its file's name where a shipped map has it, and
    "of the file".
    """
    one_each = {n: called[0] for n, called in image.names.items() if len(called) == 1}
    named = label_lists.named_structures(one_each)
    stem = _stem(image.path)
    if not named and len(image.numbers) == 1 and known().of(stem) is not None:
        return {image.numbers[0]: stem}, "of the file"
    return named, "in it"


def _stem(path: Path) -> str:
    """A file's name without its ending; points within it stay: tibia.cartilage is no tibia."""
    packed = re.sub(r"\.gz$", "", path.name, flags=re.I)
    return re.sub(r"\.seg$", "", Path(packed).stem, flags=re.I)


@dataclass(frozen=True, slots=True)
class KnownNames:
    """What the shipped maps know, by the words of its name (:func:`label_lists.words`)."""

    entries: Mapping[tuple[str, ...], LabelEntry]
    outside: frozenset[tuple[str, ...]]
    """names that they leave out"""

    def of(self, name: str) -> LabelEntry | None:
        """The entry of a name; of a side, also where the map leaves sides open."""
        words = label_lists.words(name)
        if words in self.entries:
            return self.entries[words]
        sides, found = _sides(name), self.entries.get(_sideless(name))
        if found is None or len(sides) != 1 or not found.paired or found.side is not None:
            return None
        return replace(found, side=sides.pop())

    def leaves_out(self, name: str) -> bool:
        """Whether the name is left out, with its side or, of both sides, without."""
        return bool({label_lists.words(name), _sideless(name)} & self.outside)

    def differ(self, own: str, called: str, mapped: LabelEntry | None) -> bool:
        """Whether a number's own name is of something else than a map makes of it.

        Names of the same may be coarser or finer (fat, subcutaneous fat; bone, femur), so that what
        they become counts: sides, segments with bones, bone or not, tissues. A name that the
        shipped maps leave out may have any tissue, but is no bone that moves.

        Args:
            own: the name that is not the map's.
            called: the map's.
            mapped: what the map makes of it; None where it leaves it out.
        """
        first, second = self.of(own), mapped or self.of(called)
        if first is not None and second is not None:
            sides = [_sides(own) or {first.side}, _sides(called) or {second.side}]
            if len(set[str | None]().union(*sides) - {None}) > 1:
                return True
        if _sideless(own) == _sideless(called):
            return False
        if first is not None and second is not None:
            return _differ(first, second)
        one, other = (first, called) if second is None else (second, own)
        return one is not None and one.bony and bool(one.bodies) and self.leaves_out(other)


def _differ(first: LabelEntry, second: LabelEntry) -> bool:
    """Whether two entries cannot be of the same structure."""
    if first.bony != second.bony:
        return True
    if first.bodies and second.bodies and first.bodies.isdisjoint(second.bodies):
        return True
    if {_sideless(first.name), _sideless(second.name)} == {("tibia",), ("fibula",)}:
        return True  # the two whole bones of one segment
    return any(
        first.tissue in group and any(second.tissue in other for other in line if other != group)
        for line in _APART
        for group in line
    )


def _sideless(name: str) -> tuple[str, ...]:
    """Its words (:func:`label_lists.words`) without sides."""
    return tuple(word for word in label_lists.words(name) if word not in _SIDES)


def _sides(name: str) -> set[str]:
    """The sides among its words, "l" or "r"."""
    return {word[0] for word in label_lists.words(name) if word in _SIDES}


@cache
def known() -> KnownNames:
    """Of all maps that ship with legsim."""
    entries: dict[tuple[str, ...], LabelEntry] = {}
    outside: set[tuple[str, ...]] = set()
    for name in names():
        shipped = load_label_map(name)
        outside |= {label_lists.words(left) for left in shipped.left_out.values()}
        for entry in shipped.entries:
            entries.setdefault(label_lists.words(f"{entry.name} {entry.side or ''}"), entry)
    return KnownNames(entries, frozenset(outside))


def _of_names(path: Path, listed: Mapping[int, str]) -> LabelMap:
    """The structures of a list whose names a shipped map has, with its tissue and segment."""
    entries = [
        replace(found, number=number)
        for number, name in listed.items()
        if (found := known().of(name)) is not None
    ]
    if not entries:
        some = ", ".join(list(listed.values())[:8])
        raise file_error(
            path,
            f"names no structure that legsim knows ({some})",
            "it says no tissues: write a .toml like models/label_maps/leg.toml",
        )
    others = {n: name for n, name in listed.items() if n not in {e.number for e in entries}}
    left_out = {n: name for n, name in others.items() if known().leaves_out(name)}
    foreign = {n: name for n, name in others.items() if n not in left_out}
    _refuse_twice(path, entries, listed)
    return LabelMap(path, tuple(entries), left_out, foreign)


def _refuse_twice(path: Path, entries: list[LabelEntry], listed: Mapping[int, str]) -> None:
    first: dict[tuple[str, str | None], LabelEntry] = {}
    for entry in entries:
        same = first.setdefault((entry.name, entry.side), entry)
        if same is not entry:
            both = " and ".join(f"{e.number} {listed[e.number]}" for e in (same, entry))
            raise file_error(
                path,
                f"names {entry.name} twice, {both}",
                "give them one number if they are pieces of one, or two names in a .toml like "
                "models/label_maps/leg.toml",
            )


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
        if key not in _KEYS:
            cure = f"known: {', '.join(_KEYS)}"
            raise file_error(path, f"unknown key {key!r}", cure, place=place)
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
    cure = f"known: pelvis, {', '.join(_PAIRED)}, each of the latter also with _l or _r"
    raise file_error(path, f"unknown segment {text!r}", cure, place=place)
