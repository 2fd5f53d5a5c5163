"""PHANTOM.toml: any set of closed meshes as a phantom, checked.

Errors name the file that causes them. Parts are in order of priority, outermost first where they
nest: at each point the last part that contains it decides. Meshes are PLY, STL, OBJ or GLB with
coordinates in world, at the reference pose where a part moves with a segment.
"""

import io
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.phantom import landmarks, materials
from legsim.phantom.meshes import Part, Phantom

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


SUFFIXES = (".ply", ".stl", ".obj", ".glb")

UNITS = {"mm": 1e-3, "m": 1.0}

SMALLEST, LARGEST = 0.5e-3, 5.0
"""m: extents of a part below or above which its unit is taken for mistaken"""

_SMALL_WHOLE = 10e-3
"""m: below this length a phantom's unit is taken for mistaken"""

_KEYS = {
    "name": str,
    "file": str,
    "unit": str,
    "material": str,
    "attenuation_per_mm": (int, float),
    "segment": str,
}

_MOST_PER_MM = 1e6
"""beyond all matter at the energies of the tables, and safe in single precision"""

_LEAST_VOLUME = 1e-9
"""of the cube of a part's length: the volume of a flat part after rounding"""

_GRAIN = 1e-6
"""of a part's length: greatest distance of copies of a vertex

Text formats and single precision may round them apart.
"""

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
    """
    return read(path, energy_kev=energy_kev).phantom


def read(path: Path | str, *, energy_kev: float = materials.DEFAULT_ENERGY_KEV) -> PhantomFile:
    """Reads a PHANTOM.toml and its meshes.

    Doubled vertices (as in every STL) are merged. Meshes that face inward are turned, and a remark
    reports it.

    Raises:
        LegsimError: the file or a mesh is missing, malformed, open, inconsistently oriented, of an
            implausible size, or completely hidden by a later part.
    """
    path = Path(path)
    content = _content(path)
    tables = content.tables
    remarks: list[str] = []
    parts = [_part(path, k, table, energy_kev, remarks) for k, table in enumerate(tables)]
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


def mesh_files(path: Path) -> list[Path]:
    """Paths of the meshes that a PHANTOM.toml names; errors are as in :func:`read`."""
    return [path.parent / table["file"] for table in _content(path).tables]


@dataclass(frozen=True, slots=True)
class _Content:
    """Content of the file itself, checked."""

    tables: list[dict[str, Any]]
    overlaps: str
    landmarks: dict[str, dict[str, FloatArray]]


def _content(path: Path) -> _Content:
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise file_error(
            path, f"cannot be read ({error.strerror or error})", "check the path"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise file_error(path, f"is not TOML ({error})", "fix that place") from error
    unknown = sorted(set(content) - {"part", "overlaps", "landmarks"})
    if unknown:
        known = "a phantom is a list of [[part]] tables, and may have overlaps and [landmarks.l]"
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
    for k, table in enumerate(tables):
        _check_table(path, f"part {k + 1}", table)
    return _Content(tables, overlaps, landmarks.read(path, content.get("landmarks", {})))


def _check_table(path: Path, place: str, table: dict[str, Any]) -> None:
    unknown = sorted(set(table) - set(_KEYS))
    if unknown:
        raise file_error(
            path, f"unknown key {unknown[0]!r}", f"known: {', '.join(_KEYS)}", place=place
        )
    for key, value in table.items():
        if not isinstance(value, _KEYS[key]) or isinstance(value, bool):
            raise file_error(
                path,
                f"{key} = {value!r} is of the wrong type",
                "give text in quotes, or a number for attenuation_per_mm",
                place=place,
            )
    missing = [key for key in ("name", "file", "unit") if key not in table]
    if missing:
        raise file_error(
            path,
            f"lacks {', '.join(missing)}",
            'expected name, file, unit = "mm" or "m", and material or attenuation_per_mm',
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


def _part(
    path: Path, number: int, table: dict[str, Any], energy_kev: float, remarks: list[str]
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
    vertices, triangles = _closed(file, name, *_mesh(file, name))
    vertices = vertices * UNITS[table["unit"]]
    _check_size(file, name, vertices, table["unit"])
    volume = _volume(vertices, triangles)
    if abs(volume) < _LEAST_VOLUME * np.ptp(vertices, axis=0).max() ** 3:
        raise file_error(
            file,
            "the surface encloses no volume",
            "give it a thickness, or orient its pieces alike",
            place=f"part {name!r}",
        )
    if volume < 0:
        triangles = triangles[:, ::-1]
        remarks.append(f"{file} (part {name!r}): its triangles faced inward and were turned")
    return Part(name, material, attenuation, vertices, triangles)


def _mesh(file: Path, name: str) -> tuple[FloatArray, np.ndarray]:
    """Vertices (p, 3) in the file's unit and triangles (t, 3), unchanged from the file."""
    place = f"part {name!r}"
    if file.suffix.lower() not in SUFFIXES:
        raise file_error(
            file,
            f"unknown kind of mesh {file.suffix!r}",
            f"convert it to one of {', '.join(SUFFIXES)}",
            place=place,
        )
    if not file.is_file():
        raise file_error(file, "no such file", "paths are relative to the TOML", place=place)
    try:
        if file.suffix.lower() == ".obj":
            mesh = trimesh.load_mesh(
                io.StringIO(_plain_obj(file.read_text("utf-8", "replace"))),
                file_type="obj",
                process=False,
            )
        else:
            mesh = trimesh.load_mesh(file, process=False)
    except Exception as error:  # trimesh's readers raise any exception at a malformed file
        # a binary STL that was cut short is tried as text, for which a reader is missing
        known = (
            ""
            if isinstance(error, ImportError) or not str(error)
            else f" ({type(error).__name__}: {str(error).splitlines()[0]})"
        )
        mixed = (
            ", or a binary PLY whose faces are not all triangles: export it again, in triangles"
            if file.suffix.lower() == ".ply"
            else ""
        )
        cure = f"it may be cut short or of another kind{mixed or ': export it again'}"
        raise file_error(file, f"cannot be read as a mesh{known}", cure, place=place) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise file_error(file, "holds no triangles", "export a triangle mesh", place=place)
    vertices, triangles = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise file_error(
            file,
            f"a triangle names a vertex beyond the {len(vertices)} of the file",
            "export it again",
            place=place,
        )
    if not np.isfinite(vertices[triangles]).all():
        raise file_error(file, "a vertex is not a finite number", "export it again", place=place)
    used, corners = np.unique(triangles, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


def _plain_obj(text: str) -> str:
    """Removes comments from OBJ text and counts the vertices of faces from the first.

    The reader trimesh fails at comments behind a face. It also counts indices below 0, which count
    back from the vertex before the face, from the end of the file.

    Raises:
        ValueError: a face names vertex 0, or no number.
    """
    lines, so_far = [], 0
    for line in text.replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        if words[:1] == ["v"]:
            so_far += 1
        if words[:1] == ["f"]:
            words[1:] = [str(_counted(word.partition("/")[0], so_far)) for word in words[1:]]
        if words[:1] in (["v"], ["f"]):
            lines.append(" ".join(words))
    return "\n".join(lines)


def _counted(number: str, so_far: int) -> int:
    if int(number) == 0:
        raise ValueError("a face names vertex 0, but OBJ counts from 1")
    return int(number) if int(number) > 0 else so_far + 1 + int(number)


def _closed(
    file: Path, name: str, vertices: FloatArray, triangles: np.ndarray
) -> tuple[FloatArray, np.ndarray]:
    """Merges vertices where that closes the surface.

    First the identical ones that STL, and normals or colors in OBJ and GLB, double; then those that
    text formats rounded apart.
    """
    open_edges = _unpaired(triangles)
    if len(open_edges):
        vertices, triangles = _merged(vertices, triangles, vertices)
        open_edges = _unpaired(triangles)
    if len(open_edges):
        rounded = _merged(
            vertices, triangles, _clusters(vertices, _GRAIN * float(np.ptp(vertices, axis=0).max()))
        )
        if len(_unpaired(rounded[1])) == 0:
            return rounded
    if len(open_edges):
        middle = vertices[open_edges[0]].mean(axis=0)
        where = ", ".join(f"{x:.4g}" for x in middle)
        unsigned = _unpaired(triangles, signed=False)
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
        raise file_error(file, problem, cure, place=f"part {name!r}")
    return vertices, triangles


def _clusters(points: FloatArray, distance: float) -> np.ndarray:
    """Labels points (p, 3) by cluster: (p, 1) numbers.

    Points connected by a chain of steps of at most ``distance`` share a number.
    """
    near = KDTree(points).query_pairs(distance, output_type="ndarray")
    linked = coo_array((np.ones(len(near), np.int8), near.T), shape=(len(points), len(points)))
    return connected_components(linked, directed=False)[1][:, None]


def _merged(
    vertices: FloatArray, triangles: np.ndarray, keys: np.ndarray
) -> tuple[FloatArray, np.ndarray]:
    """Merges the vertices with equal ``keys``.

    Triangles that lose a corner by it are dropped.
    """
    _, first, inverse = np.unique(keys + 0.0, axis=0, return_index=True, return_inverse=True)
    merged = inverse.reshape(-1)[triangles]
    kept = (
        (merged[:, 0] != merged[:, 1])
        & (merged[:, 1] != merged[:, 2])
        & (merged[:, 2] != merged[:, 0])
    )
    return vertices[first], merged[kept]


def _unpaired(triangles: np.ndarray, *, signed: bool = True) -> np.ndarray:
    """Edges (n, 2) that occur more often in one direction than in the other.

    Unsigned: edges that an odd number of triangles share.
    """
    begins, ends = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    edges, inverse = np.unique(
        np.minimum(begins, ends).astype(np.int64) << 32 | np.maximum(begins, ends),
        return_inverse=True,
    )
    balance = np.bincount(
        inverse, weights=np.sign(ends - begins) if signed else None, minlength=len(edges)
    )
    chosen = edges[balance != 0] if signed else edges[balance % 2 == 1]
    return np.stack([chosen >> 32, chosen & 0xFFFFFFFF], axis=-1)


def _check_size(file: Path, name: str, vertices: FloatArray, unit: str) -> None:
    extent = np.ptp(vertices, axis=0).max()
    if not SMALLEST <= extent <= LARGEST:
        other = "m" if unit == "mm" else "mm"
        raise file_error(
            file,
            f"with unit = {unit!r} it is {extent * 1e3:.4g} mm long",
            f"is its unit {other!r}?",
            place=f"part {name!r}",
        )


def _volume(vertices: FloatArray, triangles: np.ndarray) -> float:
    """Volume in m^3, negative where the surface faces inward."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6)


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
    return sum(abs(_winding(other, point)) > 0.5 for point in boxed) / len(points)


def _winding(part: Part, point: FloatArray) -> float:
    """Winding number of the surface around the point.

    It is the solid angle over 4 pi (Van Oosterom and Strackee 1983).
    """
    a, b, c = np.moveaxis((part.vertices - point)[part.triangles], 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    ab, bc, ca = (np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return float(
        np.arctan2(
            np.einsum("ti,ti->t", a, np.cross(b, c)), la * lb * lc + ab * lc + bc * la + ca * lb
        ).sum()
        / (2 * np.pi)
    )
