"""What a GLB's reader would leave out or misread is refused by name."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from legsim.core.errors import LegsimError
from legsim.phantom import mesh_files


def write(path: Path, change: dict[str, Any] | None = None) -> trimesh.Trimesh:
    """A box as a GLB whose JSON has some of its parts changed."""
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    blobs = box.vertices.astype("<f4").tobytes(), box.faces.astype("<u4").tobytes()
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": len(blobs[0])},
        {"buffer": 0, "byteOffset": len(blobs[0]), "byteLength": len(blobs[1])},
    ]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 36, "type": "SCALAR"},
    ]
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": sum(map(len, blobs))}],
        **(change or {}),
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(0x4E4F534A, text), (0x004E4942, b"".join(blobs))]
    body = b"".join(struct.pack("<II", len(data), kind) + data for kind, data in chunks)
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(body)) + body)
    return box


def primitive(**more: Any) -> dict[str, Any]:
    return {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **more}]}]}


def accessors(**more: Any) -> dict[str, Any]:
    first = {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", **more}
    second = {"bufferView": 1, "componentType": 5125, "count": 36, "type": "SCALAR"}
    return {"accessors": [first, second]}


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"extensionsRequired": ["KHR_materials_unlit", "MSFT_texture_dds", "KHR_texture_basisu"]},
        {"extensionsRequired": ["KHR_animation_pointer", "KHR_node_visibility"]},
        {"nodes": [{"mesh": 0}, {"skin": 0}, {"weights": [1.0]}]},
        {"meshes": [*primitive()["meshes"], primitive()["meshes"][0] | {"weights": [1.0]}]},
        {"meshes": [*primitive()["meshes"], *primitive(mode=6)["meshes"]]},
    ],
)
def test_a_plain_mesh_is_read(tmp_path: Path, change: dict[str, Any]) -> None:
    box = write(tmp_path / "a.glb", change)
    vertices, triangles = mesh_files.read(tmp_path / "a.glb", "a")
    np.testing.assert_allclose(vertices, box.vertices, rtol=1e-6)
    np.testing.assert_array_equal(triangles, box.faces)


def test_a_node_scales_its_mesh(tmp_path: Path) -> None:
    box = write(tmp_path / "a.glb", {"nodes": [{"mesh": 0, "scale": [2, 2, 2]}]})
    vertices, _ = mesh_files.read(tmp_path / "a.glb", "a")
    np.testing.assert_allclose(vertices, 2 * box.vertices, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"extensionsRequired": ["KHR_draco_mesh_compression"]},
            "needs KHR_draco_mesh_compression, .*; write it without compression",
        ),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "needs EXT_meshopt.*compression"),
        ({"extensionsRequired": ["A_b"]}, "needs A_b, .*; write it without that extension"),
        (accessors(sparse={"count": 1}), "sparse numbers; write them in full"),
        (accessors(normalized=True), "stand for fractions; write it unquantized"),
        (primitive(mode=6), "fans of triangles; write them as single triangles"),
        (
            {"meshes": [primitive()["meshes"][0] | {"weights": [0.5]}]},
            "blended; write the mesh as it is",
        ),
        ({"nodes": [{"mesh": 0, "weights": [1.0]}]}, "blended; write the mesh as it is"),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "a skeleton moves; write the mesh as it is"),
        (
            {"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]},
            "several places by an extension; write each of them",
        ),
        (
            {
                "nodes": [
                    {"mesh": 0},
                    {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}},
                ]
            },
            "hidden .KHR_node_visibility.; write only what is to be seen",
        ),
    ],
)
def test_what_is_not_read_is_refused_by_name(
    tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    write(tmp_path / "a.glb", change)
    with pytest.raises(LegsimError, match=rf"a\.glb \(part 'a'\): [^;]*{said}$"):
        mesh_files.read(tmp_path / "a.glb", "a")
