"""GLB files whose triangles trimesh would not read as they are.

It takes numbers that were left to a decoder for 0, numbers that stand for fractions for themselves,
and passes over the rest. The format is that of Khronos' "glTF 2.0 Specification".
"""

import json
from typing import Any

_START = 20
"""bytes before the JSON: the file's header, and the chunk's length and kind"""

_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
"""how extensions begin that say nothing about where vertices are"""

_FAN = 6
"""mode of a primitive"""


def check(content: bytes) -> None:
    """Refuses a GLB by what its reader would leave out or misread.

    Raises:
        ValueError: an extension or a way of storing triangles that is not read; the text says which
            and how to write the file without.
    """
    length = int.from_bytes(content[12:16], "little")
    header = json.loads(content[_START : _START + length])
    if not isinstance(header, dict):
        raise ValueError("its JSON is no object")
    needed = [name for name in header.get("extensionsRequired", ()) if _moves_vertices(name)]
    if needed:
        raise ValueError(f"needs {needed[0]}, which is not read; write it without compression")
    for mesh in header.get("meshes", ()):
        if any(mesh.get("weights", ())):
            raise ValueError("holds shapes that are blended; write the mesh as it is")
        for primitive in mesh["primitives"]:
            _check_primitive(primitive, header.get("accessors", ()))
    for node in header.get("nodes", ()):
        if "skin" in node or any(node.get("weights", ())):
            raise ValueError("holds a mesh that a skeleton moves; write the mesh as it is")
        if "EXT_mesh_gpu_instancing" in node.get("extensions", ()):
            raise ValueError("holds a mesh in several places by an extension; write each of them")


def _moves_vertices(name: str) -> bool:
    # quantized numbers that are not normalized are read as they are
    return not name.startswith(_HARMLESS) and name != "KHR_mesh_quantization"


def _check_primitive(primitive: dict[str, Any], accessors: list[dict[str, Any]]) -> None:
    if primitive.get("mode") == _FAN:
        raise ValueError("holds fans of triangles; write them as single triangles")
    for number in (primitive["attributes"].get("POSITION"), primitive.get("indices")):
        accessor = {} if number is None else accessors[number]
        if "sparse" in accessor:
            raise ValueError("holds sparse numbers; write them in full")
        if accessor.get("normalized"):
            raise ValueError("holds whole numbers that stand for fractions; write it unquantized")
