"""Closedness of parts, and that only what moved is sent to the device again."""

import numpy as np
import pytest
import trimesh

from legsim.core.errors import LegsimError
from legsim.phantom.meshes import Part, Phantom
from legsim.phantom.raster import TILE, MeshRaster, group_bands, require_closed


def part(faces: np.ndarray, vertices: np.ndarray, name: str = "a") -> Part:
    return Part(name, "water", 1.0, vertices, faces)


def test_closed_surfaces_of_any_kind_pass(rng):
    for mesh in (
        trimesh.creation.box(),
        trimesh.creation.torus(2, 1),
        trimesh.creation.icosphere(4),
    ):
        require_closed(part(mesh.faces, mesh.vertices))
        require_closed(part(rng.permutation(mesh.faces), mesh.vertices))
        require_closed(part(np.concatenate([mesh.faces, mesh.faces[:, ::-1]]), mesh.vertices))


@pytest.mark.parametrize("change", ["missing", "doubled", "turned"])
def test_every_single_fault_is_found_and_counted(change):
    mesh = trimesh.creation.icosphere(1)
    for k in range(len(mesh.faces)):
        faces = mesh.faces.copy()
        if change == "missing":
            faces = np.delete(faces, k, axis=0)
        elif change == "doubled":
            faces = np.concatenate([faces, faces[k : k + 1]])
        else:
            faces[k] = faces[k, ::-1]
        with pytest.raises(
            LegsimError,
            match="'leaky' is not a closed, consistently oriented surface: 3 of its edges",
        ):
            require_closed(part(faces, mesh.vertices, "leaky"))


def test_only_what_moved_is_sent_again(device, monkeypatch):
    mesh = trimesh.creation.box()
    phantom = Phantom(
        (part(mesh.faces, mesh.vertices, "rests"), part(mesh.faces, mesh.vertices, "moves"))
    )
    raster = MeshRaster(phantom, device)
    raster.move(None)
    sent, upload = [], type(device).upload
    monkeypatch.setattr(
        type(device), "upload", lambda self, array: sent.append(array.shape) or upload(self, array)
    )
    raster.move([phantom.parts[0].vertices, phantom.parts[1].vertices + 1.0])
    assert sent == [(8, 6)]
    raster.move([phantom.parts[0].vertices, raster.vertices[1]])
    assert sent == [(8, 6)] * 2, "an array that can be written to may have changed"


@pytest.mark.parametrize("limit", [1, 15, 16, 32, 48, 64, 1024])
def test_a_work_group_fits_the_device_and_divides_the_tile(limit):
    bands = group_bands(limit)
    assert (TILE // 2) % bands == 0
    assert bands == 1 or 2 * TILE * bands <= limit
    assert bands == TILE // 2 or 2 * TILE * 2 * bands > limit
