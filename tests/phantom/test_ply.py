"""PLY of any kind of numbers, and of faces with any number of corners."""

import struct
from pathlib import Path

import numpy as np
import pytest

from legsim.phantom import ply, surfaces

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [1, 1.5, 4]], float)
"""a pyramid on a rectangle"""

FACES = [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def written(path: Path, form: str, *, faces=FACES, number="float", length="uchar") -> Path:
    """The pyramid with a color per vertex, and a list and a number more per face."""
    order, letters = FORMATS[form], {"float": "f", "double": "d", "uchar": "B", "int": "i"}
    header = ["ply", f"format {form} 1.0", "comment a pyramid", "element vertex 5"]
    header += [f"property {number} {axis}" for axis in "xyz"] + ["property uchar red"]
    header += [f"element face {len(faces)}", f"property list {length} int vertex_indices"]
    header += ["property list uchar float texcoord", "property uchar flags", "end_header"]
    rows = [(3 * letters[number] + "B", (*corner, 7)) for corner in CORNERS]
    rows += [(f"{letters[length]}{len(f)}iBffB", (len(f), *f, 2, 0.25, 0.5, 1)) for f in faces]
    if order:
        body = b"".join(struct.pack(order + kinds, *values) for kinds, values in rows)
    else:
        body = "".join(" ".join(f"{x:g}" for x in v) + "\n" for _, v in rows).encode()
    path.write_bytes("\n".join([*header, ""]).encode() + body)
    return path


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(("number", "length"), [("float", "uchar"), ("double", "int")])
def test_triangles_and_quads_are_one_closed_surface(tmp_path, form, number, length):
    vertices, triangles = ply.read(written(tmp_path / "a.ply", form, number=number, length=length))
    np.testing.assert_array_equal(vertices, CORNERS)
    assert len(triangles) == 6
    assert surfaces.is_closed(triangles)
    assert surfaces.volume(vertices, triangles) == pytest.approx(2 * 3 * 4 / 3)


@pytest.mark.parametrize("form", FORMATS)
def test_the_order_of_faces_does_not_matter(tmp_path, form):
    """Faces are read in runs of one length."""
    several = [FACES[k % 5] for k in (1, 2, 0, 3, 4, 4, 0, 0, 1)]
    _, triangles = ply.read(written(tmp_path / "a.ply", form, faces=several))
    expected = [(f[0], *f[k : k + 2]) for f in several for k in range(1, len(f) - 1)]
    np.testing.assert_array_equal(triangles, expected)


@pytest.mark.parametrize("form", FORMATS)
def test_a_file_that_is_cut_short_is_refused(tmp_path, form):
    path = written(tmp_path / "a.ply", form)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(ValueError, match="cut short"):
        ply.read(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("element face 5", "element face 4", "more numbers than its header says"),
        ("property float x", "property float q", "have no x"),
        ("vertex_indices", "corners", "have no vertex_indices"),
        ("element face", "element tristrips", "strips of triangles"),
        ("ply", "plx", "no header"),
        ("4 3 2 1 0", "x 3 2 1 0", "no number"),
        ("4 3 2 1 0", "4.5 3 2 1 0", "the length 4.5"),
        ("4 3 2 1 0", "nan 3 2 1 0", "the length nan"),
        ("4 3 2 1 0", "4 2.7 2 1 0", "index 2.7, which is no whole number"),
        ("4 3 2 1 0", "4 nan 2 1 0", "index nan, which is no whole number"),
        ("property float x", "property real x", "unknown type 'real'"),
        ("element vertex 5", "element vertex -5", "line 'element vertex -5'"),
        ("element vertex 5\n", "", "line 'property float x'"),
        ("property float x", "property float", "line 'property float'"),
        ("property float y", "property float x", "x of the element 'vertex' occurs twice"),
        ("element face", "element vertex", "element 'vertex' occurs twice"),
        ("list uchar int vertex_indices", "int vertex_indices", "vertex_indices are no lists"),
        ("property float x", "property list uchar float x", "x of its vertices is a list"),
    ],
)
def test_what_a_header_or_row_lacks_is_named(tmp_path, old, new, said):
    path = written(tmp_path / "a.ply", "ascii")
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=said):
        ply.read(path)


def test_a_comment_does_not_end_the_header(tmp_path):
    path = written(tmp_path / "a.ply", "ascii")
    path.write_text(
        path.read_text().replace("a pyramid", "the end_header follows\nobj_info end_header")
    )
    assert len(ply.read(path)[1]) == 6


def test_a_length_beyond_any_file_is_refused(tmp_path):
    path = written(tmp_path / "a.ply", "binary_little_endian", length="int")
    face = struct.pack("<i4i", 4, *FACES[0])
    path.write_bytes(path.read_bytes().replace(face, struct.pack("<i4i", 2**31 - 1, *FACES[0])))
    with pytest.raises(ValueError, match="cut short"):
        ply.read(path)
