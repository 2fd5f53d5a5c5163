"""PHANTOM.toml: any set of closed meshes as a phantom, checked.

Errors name the file that causes them. Parts are in order of priority, outermost first where they
nest: at each point the last part that contains it decides. Meshes are PLY, STL, OBJ, GLB or VTP
with coordinates in world, or along a patient's axes, at the reference pose where a part moves with
a segment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core import files as core_files
from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.phantom import landmarks, materials, mesh_files, stated_axes, surfaces, winding
from legsim.phantom.meshes import Part, Phantom

UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 25.4e-3}

SMALLEST, LARGEST = 0.1e-3, 5.0
"""m: extents of a part below or above which its unit is taken for mistaken"""

_SMALL_PART = 0.5e-3
"""m: extent of a part below which its unit is doubted: a bead, or a bone in another unit"""

_SMALL_WHOLE = 10e-3
"""m: below this length a phantom's unit is taken for mistaken"""

_KEYS = {
    "name": str,
    "file": str,
    "unit": str,
    "material": str,
    "attenuation_per_mm": (int, float),
    "segment": str,
    "repair": bool,
    "axes": str,
}

_WORDS = {"attenuation_per_mm": "a number", "repair": "true or false"}
"""what values are that are no text"""

_FOR_ALL = ("repair", "axes")
"""keys that may stand above all parts"""

_MOST_PER_MM = 1e6
"""beyond all matter at the energies of the tables, and safe in single precision"""

_LEAST_VOLUME = 1e-9
"""of the cube of a part's length: the volume of a flat part after rounding"""

_SAMPLES, _MORE_SAMPLES = 12, 100


@dataclass(frozen=True, slots=True, eq=False)
class PhantomFile:
    """Content of a PHANTOM.toml."""

    phantom: Phantom
    segments: tuple[str | None, ...]
    """segment that carries each part, None for a part at rest"""
    remarks: tuple[str, ...]
    """repairs and overlapping parts, one line each"""
    landmarks: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    """points (3,) m in world by side and name, of :mod:`legsim.phantom.landmarks`"""

    def posed(
        self, segment_names: Sequence[str], moved_from_reference: FloatArray
    ) -> list[FloatArray]:
        """World vertices of each part after the segments (s,) moved by (s, 4, 4).

        The motion is from the reference pose.

        Raises:
            LegsimError: a part's segment is not among the names.
        """
        names = list(segment_names)
        unknown = sorted(
            {segment for segment in self.segments if segment is not None and segment not in names}
        )
        if unknown:
            raise LegsimError(
                f"parts move with {', '.join(unknown)}; the poses have {', '.join(names)}"
            )
        return [
            part.vertices
            if segment is None
            else transforms.apply(moved_from_reference[names.index(segment)], part.vertices)
            for part, segment in zip(self.phantom.parts, self.segments, strict=True)
        ]


def load_phantom(path: Path | str, *, energy_kev: float = materials.DEFAULT_ENERGY_KEV) -> Phantom:
    """Loads the phantom of a PHANTOM.toml at rest, its materials at one photon energy.

    Errors are as in :func:`read`.

    >>> load_phantom("PHANTOM.toml", energy_kev=50.0).parts[0].name
    'skin'
    """
    return read(path, energy_kev=energy_kev).phantom


def read(
    path: Path | str, *, energy_kev: float = materials.DEFAULT_ENERGY_KEV, repair: bool = False
) -> PhantomFile:
    """Reads a PHANTOM.toml and its meshes.

    Doubled vertices (as in every STL) are merged. Shells that face inward, other than hollows in
    another, are turned, and a remark reports it. ``repair``, or repair = true in the file, for all
    parts or one, repairs what is open or disagrees (:func:`legsim.phantom.surfaces.repaired`).

    Raises:
        LegsimError: the file or a mesh is missing, malformed, open, inconsistently oriented, of an
            implausible size, or completely hidden by a later part.
    """
    path = Path(path)
    content = _content(path)
    tables = content.tables
    remarks: list[str] = []
    parts = [
        _part(path, k, table, energy_kev, remarks, repair=repair) for k, table in enumerate(tables)
    ]
    names = [part.name for part in parts]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise file_error(
            path, f"two parts are named {doubled[0]!r}", "give every part a name of its own"
        )
    remarks += [] if content.overlaps == "intended" else _nesting(path, parts, tables)
    corners = np.concatenate(
        [[part.vertices.min(axis=0), part.vertices.max(axis=0)] for part in parts]
    )
    length = np.ptp(corners, axis=0).max()
    if length < _SMALL_WHOLE:
        remarks.append(
            f"{path}: the phantom is {1e3 * length:.3g} mm long; if that is too small, its "
            "files are in m, not mm"
        )
    return PhantomFile(
        Phantom(tuple(parts)),
        tuple(table.get("segment") for table in tables),
        tuple(remarks),
        content.landmarks,
    )


def named_meshes(path: Path) -> list[Path]:
    """Paths of the meshes that a PHANTOM.toml names; errors are as in :func:`read`."""
    return [path.parent / table["file"] for table in _content(path).tables]


@dataclass(frozen=True, slots=True)
class _Content:
    """Content of the file itself, checked."""

    tables: list[dict[str, Any]]
    overlaps: str
    landmarks: dict[str, dict[str, FloatArray]]


def _content(path: Path) -> _Content:
    content = core_files.load_toml(path)
    unknown = sorted(set(content) - {"part", "repair", "overlaps", "landmarks", "axes"})
    if unknown:
        known = (
            "known: repair, axes, overlaps, [landmarks.l], [landmarks.r] and a list of [[part]] "
            "tables"
        )
        raise file_error(path, f"unknown key {unknown[0]!r}", known)
    overlaps = content.get("overlaps", "reported")
    if overlaps not in ("reported", "intended"):
        raise file_error(path, f"overlaps = {overlaps!r}", "known: reported, intended")
    tables = content.get("part")
    if (
        not isinstance(tables, list)
        or not tables
        or not all(isinstance(table, dict) for table in tables)
    ):
        raise file_error(
            path, "holds no [[part]]", "give one table a closed surface, outermost first"
        )
    of_all = {key: content[key] for key in _FOR_ALL if key in content}
    _check_values(path, "", of_all)
    tables = [{**of_all, **table} for table in tables]
    for k, table in enumerate(tables):
        _check_table(path, f"part {k + 1}", table)
    return _Content(tables, overlaps, landmarks.read(path, content.get("landmarks", {})))


def _check_table(path: Path, place: str, table: dict[str, Any]) -> None:
    unknown = sorted(set(table) - set(_KEYS))
    if unknown:
        raise file_error(
            path, f"unknown key {unknown[0]!r}", f"known: {', '.join(_KEYS)}", place=place
        )
    _check_values(path, place, table)
    missing = [key for key in ("name", "file", "unit") if key not in table]
    if missing:
        raise file_error(
            path,
            f"lacks {', '.join(missing)}",
            'expected name, file, unit ("mm", "m", "cm", "in"), and material or attenuation_per_mm',
            place=place,
        )
    if table["unit"] not in UNITS:
        raise file_error(
            path, f"unit = {table['unit']!r}", f"known: {', '.join(UNITS)}", place=place
        )
    if ("material" in table) == ("attenuation_per_mm" in table):
        raise file_error(
            path,
            "needs either material or attenuation_per_mm",
            "give exactly one of them",
            place=place,
        )
    if not 0 <= table.get("attenuation_per_mm", 0) <= _MOST_PER_MM:
        problem, cure = (
            f"attenuation_per_mm = {table['attenuation_per_mm']}",
            f"give a number from 0 to {_MOST_PER_MM:g}",
        )
        raise file_error(path, problem, cure, place=place)


def _check_values(path: Path, place: str, table: dict[str, Any]) -> None:
    """Refuses values of the wrong type, and unknown axes."""
    for key, value in table.items():
        if not isinstance(value, _KEYS[key]) or isinstance(value, bool) != (key == "repair"):
            raise file_error(
                path,
                f"{key} = {value!r} is of the wrong type",
                f"give {_WORDS.get(key, 'text in quotes')}",
                place=place,
            )
    if table.get("axes", "world") not in stated_axes.WORLD_FROM:
        known = f"known: {', '.join(stated_axes.WORLD_FROM)}"
        raise file_error(path, f"axes = {table['axes']!r}", known, place=place)


def _part(
    path: Path,
    number: int,
    table: dict[str, Any],
    energy_kev: float,
    remarks: list[str],
    *,
    repair: bool,
) -> Part:
    name = table["name"]
    if "material" in table:
        try:
            attenuation, material = (
                materials.attenuation(table["material"], energy_kev),
                table["material"],
            )
        except LegsimError as error:
            raise LegsimError(f"{path} (part {number + 1}, {name!r}): {error}") from error
    else:
        attenuation, material = table["attenuation_per_mm"] * 1e3, "stated"
    file = path.parent / table["file"]
    repair = repair or table.get("repair", False)
    vertices, triangles, done = _surface(file, name, *mesh_files.read(file, name), repair=repair)
    vertices = vertices * UNITS[table["unit"]] @ _axes(file, name, table.get("axes")).T
    remarks += _check_size(file, name, vertices, table["unit"])
    shells = surfaces.shells(triangles)
    if (
        surfaces.enclosed(vertices, triangles, shells)
        < _LEAST_VOLUME * np.ptp(vertices, axis=0).max() ** 3
    ):
        raise file_error(
            file,
            "the surface encloses no volume",
            "give it a thickness, or orient its pieces alike",
            place=f"part {name!r}",
        )
    triangles, turned = _facing_outward(file, name, vertices, triangles, shells, repair=repair)
    covered = surfaces.covered_shells(vertices, triangles, shells)
    if covered:
        turned.append(
            f"{len(covered)} of its shells, the first of {len(covered[0])} triangles, lie inside "
            "another one and change nothing; if they bound hollows, turn them inward"
        )
    remarks += [f"{file} (part {name!r}): {what}" for what in (*done, *turned)]
    return Part(name, material, attenuation, vertices, triangles)


def _surface(
    file: Path, name: str, vertices: FloatArray, triangles: np.ndarray, *, repair: bool
) -> tuple[FloatArray, np.ndarray, list[str]]:
    """The closed surface, and what a repair did.

    Raises:
        LegsimError: it is open, or neighboring triangles disagree; with ``repair``, still.
    """
    closed = surfaces.closed(vertices, triangles)
    open_edges = surfaces.unpaired(closed[1])
    done: list[str] = []
    if len(open_edges) and repair:
        fixed = surfaces.repaired(vertices, triangles)
        closed, done = fixed[:2], fixed[2]
        open_edges = surfaces.unpaired(closed[1])
    if len(open_edges) == 0:
        return *closed, done
    where = ", ".join(f"{x:.4g}" for x in closed[0][open_edges[0]].mean(axis=0))
    unsigned = surfaces.unpaired(closed[1], signed=False)
    if len(unsigned):
        problem, cure = (
            f"the surface is open: {len(unsigned)} edges, one at ({where}) in the file's unit",
            "close its holes",
        )
    else:
        problem, cure = (
            f"neighboring triangles disagree about the outside at {len(open_edges)} edges, "
            f"one at ({where})",
            "orient them alike",
        )
    if repair:
        problem += " that a repair leaves"
    else:
        cure += ", or give repair = true (--repair)"
    raise file_error(file, problem, cure, place=f"part {name!r}")


def _axes(file: Path, name: str, given: str | None) -> FloatArray:
    """Rotation (3, 3) to world's axes from those of a part's file.

    Raises:
        LegsimError: the file says others than were given, or says some and none were given.
    """
    stated = stated_axes.read(file)
    if stated is None or given in (stated, "world"):
        return stated_axes.WORLD_FROM[given or "world"]
    raise file_error(
        file,
        f"says that its coordinates are along a patient's axes (SPACE={stated.upper()})",
        f'give axes = "{stated}" in the part, or above all; or "world" if they are along world\'s',
        place=f"part {name!r}",
    )


def _facing_outward(
    file: Path,
    name: str,
    vertices: FloatArray,
    triangles: np.ndarray,
    shells: np.ndarray,
    *,
    repair: bool,
) -> tuple[np.ndarray, list[str]]:
    """The triangles with all shells but hollows facing outward, and what was turned.

    Raises:
        LegsimError: two shells that overlap face opposite ways, and it is not to be repaired.
    """
    done = []
    if surfaces.volume(vertices, triangles) < 0:
        triangles = triangles[:, ::-1]
        done.append("its triangles faced inward and were turned")
    alone, overlapping = surfaces.inverted_shells(vertices, triangles, shells)
    if overlapping and not repair:
        where = ", ".join(f"{x:.4g}" for x in vertices[triangles[overlapping[0]]].mean((0, 1)))
        raise file_error(
            file,
            f"a shell of {len(overlapping[0])} triangles about ({where}) m faces inward, but "
            "overlaps one that faces outward: where they do would be a hole",
            "orient them alike, or give repair = true (--repair)",
            place=f"part {name!r}",
        )
    turned = [*alone, *overlapping]
    if turned:
        triangles = triangles.copy()
        for group in turned:
            triangles[group] = triangles[group][:, ::-1]
        done.append(f"{len(turned)} of its shells faced inward and were turned")
    return triangles, done


def _check_size(file: Path, name: str, vertices: FloatArray, unit: str) -> list[str]:
    """Refuses a part of another unit's size; a remark where it may be a bead."""
    extent = np.ptp(vertices, axis=0).max()
    if not SMALLEST <= extent <= LARGEST:
        other = "m" if unit == "mm" else "mm"
        raise file_error(
            file,
            f"with unit = {unit!r} it is {extent * 1e3:.4g} mm long",
            f"is its unit {other!r}?",
            place=f"part {name!r}",
        )
    if extent < _SMALL_PART:
        return [
            f"{file} (part {name!r}): it is {extent * 1e3:.3g} mm long; if that is too small, its "
            "unit is 'm'"
        ]
    return []


def _nesting(path: Path, parts: list[Part], tables: list[dict[str, Any]]) -> list[str]:
    """Reports partial overlaps.

    Raises:
        LegsimError: a part lies completely inside a later one, so that nothing of it is left.
    """
    remarks = []
    for k, earlier in enumerate(parts):
        for later, table in zip(parts[k + 1 :], tables[k + 1 :], strict=True):
            within = _fraction_inside(earlier, later)
            if within == 1.0 and _fraction_inside(earlier, later, _MORE_SAMPLES) == 1.0:
                problem = (
                    f"part {earlier.name!r} ({tables[k]['file']}) lies inside the later part "
                    f"{later.name!r} ({table['file']})"
                )
                raise file_error(
                    path,
                    f"{problem}, which displaces it completely",
                    f"list {later.name!r} before {earlier.name!r}",
                )
            if within > 0 and 0 < _fraction_inside(later, earlier) < 1:
                remarks.append(
                    f"{path}: parts {earlier.name!r} and {later.name!r} overlap; {later.name!r} "
                    "decides where they do"
                )
    return remarks


def _fraction_inside(part: Part, other: Part, samples: int = _SAMPLES) -> float:
    """Fraction of some of the part's vertices that lie inside the other."""
    low, high = other.vertices.min(axis=0), other.vertices.max(axis=0)
    used = part.vertices[np.unique(part.triangles)]
    spread = np.linspace(0, len(used) - 1, min(samples, len(used))).astype(int)
    points = used[np.concatenate([spread, used.argmin(axis=0), used.argmax(axis=0)])]
    boxed = points[((points > low) & (points < high)).all(axis=1)]
    if not len(boxed):
        return 0.0
    return np.count_nonzero(winding.numbers(other.vertices, other.triangles, boxed)) / len(points)
