"""GLB files whose triangles trimesh would not read as they are.

It takes numbers that were left to a decoder for 0, numbers that stand for fractions for themselves,
and passes over the rest. The format is that of Khronos' "glTF 2.0 Specification".
"""

import json
from pathlib import Path
from typing import Any

from legsim.core.errors import file_error

_START = 20
"""bytes before the JSON: the file's header, and the chunk's length and kind"""

_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "MSFT_packing_",
    "KHR_lights_",
    "KHR_xmp",
    "KHR_animation_",
    "KHR_node_",
    # quantized numbers that are not normalized are read as they are
    "KHR_mesh_quantization",
)
"""how extensions begin that say nothing about where vertices are, or what nodes say themselves"""

_FAN = 6
"""mode of a primitive"""


def check(file: Path, place: str, content: bytes) -> None:
    """Refuses a GLB by what its reader would leave out or misread. Meshes of no node are not read.

    Raises:
        LegsimError: an extension or a way of storing triangles that is not read; the line names
            it, the ``place``, and how to write the file without.
        ValueError: it is malformed.
    """
    length = int.from_bytes(content[12:16], "little")
    header = json.loads(content[_START : _START + length])
    if not isinstance(header, dict):
        raise ValueError("its JSON is no object")
    found = _not_read(header)
    if found is not None:
        raise file_error(file, found[0], found[1], place=place)


def _not_read(header: dict[str, Any]) -> tuple[str, str] | None:
    """The first that is not read, and its cure."""
    for name in header.get("extensionsRequired", ()):
        if not name.startswith(_HARMLESS):
            packed = "compression" if "compress" in name else "that extension"
            return f"needs {name}, which is not read", f"write it without {packed}"
    nodes, meshes = header.get("nodes", ()), header.get("meshes", ())
    for node in nodes:
        extensions = node.get("extensions", {})
        if not extensions.get("KHR_node_visibility", {}).get("visible", True):
            return "holds what is hidden (KHR_node_visibility)", "write only what is to be seen"
        if "mesh" not in node:
            continue
        if "skin" in node:
            return "holds a mesh that a skeleton moves", "write the mesh as it is"
        if any(node.get("weights", ())):
            return _BLENDED
        if "EXT_mesh_gpu_instancing" in extensions:
            return "holds a mesh in several places by an extension", "write each of them"
    for number in sorted({node["mesh"] for node in nodes if "mesh" in node}):
        if any(meshes[number].get("weights", ())):
            return _BLENDED
        for primitive in meshes[number]["primitives"]:
            found = _not_read_of(primitive, header.get("accessors", ()))
            if found is not None:
                return found
    return None


_BLENDED = "holds shapes that are blended", "write the mesh as it is"


def _not_read_of(
    primitive: dict[str, Any], accessors: list[dict[str, Any]]
) -> tuple[str, str] | None:
    if primitive.get("mode") == _FAN:
        return "holds fans of triangles", "write them as single triangles"
    for number in (primitive["attributes"].get("POSITION"), primitive.get("indices")):
        accessor = {} if number is None else accessors[number]
        if "sparse" in accessor:
            return "holds sparse numbers", "write them in full"
        if accessor.get("normalized"):
            return "holds whole numbers that stand for fractions", "write it unquantized"
    return None
