"""Meshes as their files hold them."""

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
