"""Meshes that state a patient's axes, as 3D Slicer writes them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from legsim.core.errors import LegsimError
from legsim.phantom import files, stated_axes

LOW, HIGH = np.array([10.0, 20, 300]), np.array([40.0, 60, 500])
"""mm to the left, posterior and superior of a box"""


def write(path: Path, space: str, *, text: bool = False) -> None:
    """A box with the words that 3D Slicer puts into each kind of file."""
    box = trimesh.creation.box(bounds=[LOW, HIGH])
    words = f"3D Slicer output. SPACE={space}"
    if path.suffix == ".stl":
        plain, binary = box.export(file_type="stl_ascii"), box.export(file_type="stl")
        assert isinstance(plain, str)
        assert isinstance(binary, bytes)
        content = (
            plain.replace("solid", f"solid {words}", 1).encode()
            if text
            else words.encode().ljust(80) + binary[80:]
        )
    elif path.suffix == ".ply":
        ply = box.export(file_type="ply", encoding="ascii" if text else "binary")
        assert isinstance(ply, bytes)
        content = ply.replace(b"element", f"comment SPACE={space}\nelement".encode(), 1)
    elif path.suffix == ".obj":
        corners = [f"v {x} {y} {z}" for x, y, z in box.vertices]
        faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.faces]
        content = "\n".join([f"# {words}", *corners, *faces, ""]).encode()
    else:
        content = vtp_text(box, space).encode()
    path.write_bytes(content)


def vtp_text(box: trimesh.Trimesh, space: str) -> str:
    codes = " ".join(str(code) for code in (*space.encode(), 0))
    numbers = " ".join(map(str, box.vertices.ravel()))
    corners = " ".join(map(str, box.faces.ravel()))
    ends = " ".join(map(str, 3 * np.arange(1, 13)))
    return (
        '<VTKFile type="PolyData"><PolyData><FieldData><Array type="String" Name="SPACE" '
        f'NumberOfTuples="1" format="ascii">{codes}</Array></FieldData><Piece><Points><DataArray '
        f'type="Float64" format="ascii">{numbers}</DataArray></Points><Polys><DataArray '
        f'type="Int64" Name="connectivity" format="ascii">{corners}</DataArray><DataArray '
        f'type="Int64" Name="offsets" format="ascii">{ends}</DataArray></Polys></Piece></PolyData>'
        "</VTKFile>"
    )


def phantom(folder: Path, file: str, axes: str = "") -> Path:
    path = folder / "phantom.toml"
    path.write_text(
        f'{axes}\n[[part]]\nname = "a"\nfile = "{file}"\nunit = "mm"\nmaterial = "water"\n'
    )
    return path


def ends(path: Path) -> list[list[float]]:
    vertices = 1e3 * files.load_phantom(path).parts[0].vertices
    return np.round([vertices.min(axis=0), vertices.max(axis=0)], 3).tolist()


KINDS = [("a.stl", False), ("a.stl", True), ("a.ply", False), ("a.ply", True), ("a.obj", True)]


@pytest.mark.parametrize(("name", "text"), [*KINDS, ("a.vtp", True)])
def test_stated_axes_are_read_and_asked_about(tmp_path: Path, name: str, text: bool) -> None:
    write(tmp_path / name, "LPS", text=text)
    assert stated_axes.read(tmp_path / name) == "lps"
    said = r"\(part 'a'\): says that its coordinates are .*SPACE=LPS.*give axes = \"lps\""
    for axes in ("", 'axes = "ras"'):
        with pytest.raises(LegsimError, match=said):
            files.load_phantom(phantom(tmp_path, name, axes))
    world = ends(phantom(tmp_path, name, 'axes = "world"'))
    assert world == [LOW.tolist(), HIGH.tolist()]
    # anterior, superior, right
    turned = ends(phantom(tmp_path, name, 'axes = "lps"'))
    assert turned == [[-60, 300, -40], [-20, 500, -10]]


def test_the_same_numbers_along_right_anterior_superior_lie_on_the_other_side(
    tmp_path: Path,
) -> None:
    write(tmp_path / "a.stl", "RAS")
    turned = ends(phantom(tmp_path, "a.stl", 'axes = "ras"'))
    assert turned == [[20, 300, 10], [60, 500, 40]]


def test_axes_of_a_file_that_states_none_are_world_s_unless_given(tmp_path: Path) -> None:
    trimesh.creation.box(bounds=[LOW, HIGH]).export(tmp_path / "a.stl")
    assert stated_axes.read(tmp_path / "a.stl") is None
    assert ends(phantom(tmp_path, "a.stl")) == [LOW.tolist(), HIGH.tolist()]
    assert ends(phantom(tmp_path, "a.stl", 'axes = "lps"'))[1] == [-20, 500, -10]
    with pytest.raises(LegsimError, match=r"axes = 'up'; known: world, lps, ras"):
        files.load_phantom(phantom(tmp_path, "a.stl", 'axes = "up"'))


SPACE = 'Array type="String" Name="SPACE"'


@pytest.mark.parametrize(
    ("plain", "written"),
    [
        (">76 80 83 0<", ">LPS<"),
        (SPACE, "Array type='String' Name='SPACE'"),
        (SPACE, 'Array Name = "SPACE" type="String"'),
    ],
)
def test_fields_as_other_programs_write_them_state_axes(
    tmp_path: Path, plain: str, written: str
) -> None:
    box = trimesh.creation.box(bounds=[LOW, HIGH])
    assert plain in vtp_text(box, "LPS")
    (tmp_path / "a.vtp").write_text(vtp_text(box, "LPS").replace(plain, written))
    assert stated_axes.read(tmp_path / "a.vtp") == "lps"


@pytest.mark.parametrize(
    "written",
    [
        'format="binary">AAAA<',
        'format="binary">AA<',
        'format="binary">////fw==<',
        'format="appended" offset="x"><',
        'format="ascii">nan 300<',
        'format="ascii">1e9 0<',
        'format="ascii">76 P 83<',
    ],
)
def test_a_field_that_is_damaged_is_refused_in_one_line(tmp_path: Path, written: str) -> None:
    box = trimesh.creation.box(bounds=[LOW, HIGH])
    text = vtp_text(box, "LPS").replace('format="ascii">76 80 83 0<', written)
    (tmp_path / "a.vtp").write_text(text)
    with pytest.raises(LegsimError, match=r"a\.vtp.*its field SPACE cannot be read .*; export"):
        files.load_phantom(phantom(tmp_path, "a.vtp"))


def test_an_obj_in_utf16_states_its_axes(tmp_path: Path) -> None:
    write(tmp_path / "a.obj", "LPS", text=True)
    (tmp_path / "a.obj").write_text((tmp_path / "a.obj").read_text(), "utf-16")
    assert stated_axes.read(tmp_path / "a.obj") == "lps"


def test_rotations_do_not_mirror() -> None:
    for turn in stated_axes.WORLD_FROM.values():
        assert np.linalg.det(turn) == pytest.approx(1.0)
