"""Meshes as their files hold them."""

import gzip
from pathlib import Path

import numpy as np
import pytest
import trimesh

from legsim.core.errors import LegsimError
from legsim.phantom import mesh_files
from tests.phantom import test_vtp


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".glb"])
def test_triangles_come_as_the_file_has_them(tmp_path: Path, suffix: str) -> None:
    mesh = trimesh.creation.box((1, 2, 3))
    mesh.export(tmp_path / f"a{suffix}")
    vertices, triangles = mesh_files.read(tmp_path / f"a{suffix}", "a")
    np.testing.assert_allclose(
        np.sort(vertices[triangles], axis=None), np.sort(mesh.triangles, axis=None)
    )


def test_polygons_of_vtk_are_read(tmp_path: Path) -> None:
    path = test_vtp.write(tmp_path / "a.vtp", "raw")
    vertices, triangles = mesh_files.read(path, "a")
    np.testing.assert_array_equal(vertices, test_vtp.POINTS)
    assert triangles.tolist() == test_vtp.TRIANGLES
    path.write_bytes(path.read_bytes().replace(b"Polys", b"Verts"))
    with pytest.raises(LegsimError, match=r"a\.vtp \(part 'bone'\): holds no triangles"):
        mesh_files.read(path, "bone")


@pytest.mark.parametrize(("third", "said"), [("", "three numbers"), (" 1e200", "too far away")])
def test_vertices_that_are_no_points_are_refused(tmp_path: Path, third: str, said: str) -> None:
    corners = [f"v {x} {y}{third}" for x, y in ((0, 0), (1, 0), (0, 1))]
    (tmp_path / "a.obj").write_text("\n".join([*corners, "f 1 2 3", ""]))
    with pytest.raises(LegsimError, match=said):
        mesh_files.read(tmp_path / "a.obj", "a")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_an_obj_is_read_in_the_encodings_of_editors(tmp_path: Path, encoding: str) -> None:
    """A mark before the first word is none of it: the first vertex would be lost."""
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n# caf\xe9\n"
    (tmp_path / "a.obj").write_bytes(text.encode(encoding))
    vertices, triangles = mesh_files.read(tmp_path / "a.obj", "a")
    assert (vertices.tolist(), triangles.tolist()) == (
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 1, 2]],
    )


def test_bytes_behind_the_last_triangle_of_an_stl_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    trimesh.creation.box().export(path)
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0" * 12)
    assert len(mesh_files.read(path, "a")[1]) == 12
    # half of the triangles would be lost without a word
    path.write_bytes(whole[:80] + (6).to_bytes(4, "little") + whole[84:])
    with pytest.raises(LegsimError, match="holds no triangles"):
        mesh_files.read(path, "a")


def test_a_packed_mesh_is_to_be_unpacked(tmp_path: Path) -> None:
    for name in ("a.stl.gz", "a.stl"):
        (tmp_path / name).write_bytes(gzip.compress(b"solid a"))
        with pytest.raises(LegsimError, match=r"is packed \(gzip\); unpack it"):
            mesh_files.read(tmp_path / name, "a")
