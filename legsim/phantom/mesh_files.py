"""Meshes as their files hold them: STL, OBJ and GLB by trimesh, PLY and VTP by our own readers."""

import codecs
import io
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file, refuse_packed
from legsim.core.values import FloatArray, within
from legsim.phantom import _gltf, ply, vtp

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")

SUFFIXES = (".ply", ".stl", ".obj", ".glb", ".vtp")

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""bytes of a binary STL before its triangles, and of one of them"""


def read(file: Path, name: str) -> tuple[FloatArray, np.ndarray]:
    """Vertices (p, 3) in the file's unit and triangles (t, 3), unchanged from the file.

    Raises:
        LegsimError: there is no such file, or no mesh of finite numbers in it; the line names the
            part ``name``.
    """
    place = f"part {name!r}"
    if is_file(file):
        refuse_packed(file)
    if file.suffix.lower() not in SUFFIXES:
        raise file_error(
            file,
            f"unknown kind of mesh {file.suffix!r}",
            f"convert it to one of {', '.join(SUFFIXES)}",
            place=place,
        )
    if not is_file(file):
        raise file_error(file, "no such file", "paths are relative to the TOML", place=place)
    try:
        vertices, triangles = _arrays(file, place)
    except LegsimError:
        raise
    except Exception as error:  # trimesh's readers raise any exception at a malformed file
        # a binary STL that was cut short is tried as text, for which a reader is missing
        known = (
            ""
            if isinstance(error, ImportError) or not str(error)
            else f" ({type(error).__name__}: {str(error).splitlines()[0]})"
        )
        cure = "it may be cut short or of another kind: export it again"
        raise file_error(file, f"cannot be read as a mesh{known}", cure, place=place) from error
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        cure = "give x, y and z of each"
        raise file_error(file, "its vertices are not of three numbers", cure, place=place)
    if len(triangles) == 0:
        cure = "it may be cut short: export a triangle mesh again"
        raise file_error(file, "holds no triangles", cure, place=place)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise file_error(
            file,
            f"a triangle names a vertex beyond the {len(vertices)} of the file",
            "export it again",
            place=place,
        )
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    if not within(vertices[used]):
        problem = "a vertex is not a finite number, or too far away for a leg"
        raise file_error(file, problem, "export it again", place=place)
    return vertices[used], (np.cumsum(used) - 1)[triangles]


def _arrays(file: Path, place: str) -> tuple[FloatArray, np.ndarray]:
    """Vertices and triangles; none of a file that holds no mesh."""
    kind = file.suffix.lower()
    if kind == ".vtp":
        return vtp.read(file)
    if kind == ".ply":
        return ply.read(file)
    content = file.read_bytes()
    if kind == ".obj":
        stream: io.StringIO | io.BytesIO = io.StringIO(_plain_obj(_decoded(content)))
    elif kind == ".stl":
        stream = io.BytesIO(_whole_stl(content))
    else:
        _gltf.check(file, place, content)
        stream = io.BytesIO(content)
    mesh = trimesh.load_mesh(stream, file_type=kind[1:], process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces)


def _decoded(content: bytes) -> str:
    """Text of any editor: a mark at its begin is none of its first word."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", "replace")
    return content.decode("utf-8-sig", "replace")


def _whole_stl(content: bytes) -> bytes:
    """A binary STL without bytes behind its last triangle, too few for another; text as it is."""
    count = int.from_bytes(content[_STL_HEADER - 4 : _STL_HEADER], "little")
    end = _STL_HEADER + _STL_TRIANGLE * count
    # four characters of text are a count far beyond the file's end
    return content[:end] if 0 <= len(content) - end < _STL_TRIANGLE else content


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
