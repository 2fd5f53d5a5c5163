"""VTK's XML polygons in every encoding."""

import base64
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from legsim.phantom import vtp

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
POLYGONS = ([0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4])
TRIANGLES = [[0, 3, 2], [0, 2, 1], *POLYGONS[1:]]


def packed(array: np.ndarray, order: str, header: str, *, compressed: bool, text: bool) -> bytes:
    """One array as VTK writes it; compressed in two blocks."""
    data = array.tobytes()

    def count(*numbers: int) -> bytes:
        return struct.pack(f"{order}{len(numbers)}{header}", *numbers)

    encoded = base64.b64encode if text else bytes
    if not compressed:
        return encoded(count(len(data)) + data)
    size = max(1, len(data) // 2)
    blocks = [data[k : k + size] for k in range(0, len(data), size)]
    squeezed = [zlib.compress(block) for block in blocks]
    last = len(blocks[-1]) if len(blocks[-1]) < size else 0
    head = count(len(blocks), size, last, *(len(block) for block in squeezed))
    return encoded(head) + encoded(b"".join(squeezed))


def write(
    path: Path, form: str, order: str = "<", header: str = "I", *, compressed: bool = False
) -> Path:
    connectivity = np.concatenate(POLYGONS)
    offsets = np.cumsum([len(p) for p in POLYGONS])
    body, appended = {}, b""
    for name, array, kind in (
        ("Points", POINTS, "f4"),
        ("connectivity", connectivity, "i8"),
        ("offsets", offsets, "i4"),
    ):
        typed = {"f4": "Float32", "i8": "Int64", "i4": "Int32"}[kind]
        start = f'<DataArray type="{typed}" Name="{name}" NumberOfComponents="3" format='
        if form == "ascii":
            text = " ".join(f"{x:g}" for x in array.ravel())
            body[name] = f'{start}"ascii">{text}</DataArray>'
            continue
        text_of = form != "raw"
        data = packed(
            array.astype(order + kind), order, header, compressed=compressed, text=text_of
        )
        if form == "inline":
            body[name] = f'{start}"binary">\n {data.decode()}\n</DataArray>'
        else:
            body[name] = f'{start}"appended" offset="{len(appended)}"/>'
            appended += data
    xml = (
        f'<?xml version="1.0"?><VTKFile type="PolyData" version="1.0" '
        f'byte_order="{"LittleEndian" if order == "<" else "BigEndian"}" '
        f'header_type="{"UInt32" if header == "I" else "UInt64"}"'
        + (' compressor="vtkZLibDataCompressor"' if compressed else "")
        + "><PolyData><Piece><Points>"
        + f"{body['Points']}</Points><Polys>{body['connectivity']}{body['offsets']}</Polys>"
        + "</Piece></PolyData>"
    ).encode()
    if appended:
        encoding = b"raw" if form == "raw" else b"base64"
        xml += b'<AppendedData encoding="' + encoding + b'">\n_' + appended + b"</AppendedData>"
    path.write_bytes(xml + b"</VTKFile>")
    return path


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(("order", "header"), [("<", "I"), (">", "Q")])
@pytest.mark.parametrize("form", ["ascii", "inline", "appended", "raw"])
def test_every_encoding_gives_the_same_triangles(
    tmp_path: Path, form: str, order: str, header: str, compressed: bool
) -> None:
    path = write(tmp_path / "a.vtp", form, order, header, compressed=compressed)
    vertices, triangles = vtp.read(path)
    np.testing.assert_array_equal(vertices, POINTS)
    np.testing.assert_array_equal(triangles, TRIANGLES)


def test_strips_and_pieces(tmp_path: Path) -> None:
    piece = (
        '<Piece><Points><DataArray type="Float32" format="ascii">0 0 0 1 0 0 0 1 0 1 1 0'
        '</DataArray></Points><Strips><DataArray type="Int32" Name="connectivity" '
        'format="ascii">0 1 2 3</DataArray><DataArray type="Int32" Name="offsets" '
        'format="ascii">4</DataArray></Strips></Piece>'
    )
    path = tmp_path / "a.vtp"
    path.write_text(f'<VTKFile type="PolyData"><PolyData>{piece}{piece}</PolyData></VTKFile>')
    vertices, triangles = vtp.read(path)
    assert len(vertices) == 8
    assert triangles.tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6], [6, 5, 7]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<VTKFile", "is not XML"),
        ('<VTKFile type="ImageData"/>', "not PolyData"),
        ('<VTKFile type="PolyData" compressor="vtkLZ4DataCompressor"/>', "vtkLZ4DataCompressor"),
        ('<VTKFile type="PolyData"><PolyData><Piece/></PolyData></VTKFile>', "no Points"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.vtp").write_text(text)
    with pytest.raises(ValueError, match=message):
        vtp.read(tmp_path / "a.vtp")


def test_cut_files_are_refused(tmp_path: Path) -> None:
    content = write(tmp_path / "a.vtp", "raw").read_bytes()
    (tmp_path / "cut.vtp").write_bytes(content[: content.index(b"\n_") + 40])
    with pytest.raises(ValueError, match="cut short"):
        vtp.read(tmp_path / "cut.vtp")
