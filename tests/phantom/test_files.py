"""PHANTOM.toml: every kind of mesh loads to the same surface, and each fault names its file."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry import files as geometry_files
from legsim.phantom import files as phantom_files
from legsim.phantom import materials
from legsim.phantom.mesh_files import SUFFIXES
from legsim.phantom.surfaces import volume


def ball(radius_mm: float, center=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius_mm)
    mesh.apply_translation(center)
    return mesh


def write(folder, *parts: dict, **meshes: trimesh.Trimesh):
    """Meshes as name_suffix=mesh, parts as tables."""
    for name, mesh in meshes.items():
        stem, _, suffix = name.rpartition("_")
        mesh.export(folder / f"{stem}.{suffix}")
    lines = []
    for part in parts:
        lines += [
            "[[part]]",
            *(f"{key} = {value!r}".replace("'", '"') for key, value in part.items()),
        ]
    path = folder / "phantom.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def entry(name: str, file: str, **more) -> dict:
    return {"name": name, "file": file, "unit": "mm", "material": "water"} | more


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "glb"])
def test_every_kind_of_mesh_gives_the_same_closed_surface(tmp_path, suffix):
    mesh = ball(30, (5, 0, 0))
    path = write(tmp_path, entry("ball", f"ball.{suffix}"), **{f"ball_{suffix}": mesh})
    part = phantom_files.load_phantom(path).parts[0]
    assert len(part.vertices) == 162
    assert len(part.triangles) == 320
    np.testing.assert_allclose(part.vertices.mean(axis=0), (0.005, 0, 0), atol=1e-7)
    assert volume(part.vertices, part.triangles) == pytest.approx(mesh.volume * 1e-9, rel=1e-5)
    assert part.attenuation == materials.attenuation("water")


def test_vertices_split_by_normals_are_merged(tmp_path):
    box = trimesh.creation.box(extents=(20, 30, 40))
    split = trimesh.Trimesh(
        box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    for suffix in ("glb", "obj", "ply"):
        path = write(tmp_path, entry("box", f"box.{suffix}"), **{f"box_{suffix}": split})
        assert len(phantom_files.load_phantom(path).parts[0].vertices) == 8


def test_vertices_rounded_apart_are_merged(tmp_path, rng):
    """Wherever the copies lie: a grid of roundings would part those beside its borders."""
    mesh = ball(30)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3) + rng.uniform(-4e-6, 4e-6, (960, 3))
    path = write(
        tmp_path,
        entry("ball", "ball.ply"),
        ball_ply=trimesh.Trimesh(corners, np.arange(960).reshape(-1, 3), process=False),
    )
    part = phantom_files.load_phantom(path).parts[0]
    assert (len(part.vertices), len(part.triangles)) == (162, 320)


def test_a_gap_is_not_merged_away(tmp_path):
    mesh = ball(30)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    corners[7] += 1e-3
    path = write(
        tmp_path,
        entry("ball", "ball.ply"),
        ball_ply=trimesh.Trimesh(corners, np.arange(960).reshape(-1, 3), process=False),
    )
    refuse(path, "the surface is open: 4 edges")


def test_vertices_of_no_triangle_do_not_count(tmp_path):
    mesh = ball(30)
    for stray in ((1e6, 0, 0), (np.nan, 0, 0)):
        strayed = trimesh.Trimesh([stray, *mesh.vertices], mesh.faces + 1, process=False)
        part = phantom_files.load_phantom(
            write(tmp_path, entry("ball", "ball.ply"), ball_ply=strayed)
        ).parts[0]
        np.testing.assert_allclose(part.vertices, mesh.vertices * 1e-3, atol=1e-8)


def obj_text(*meshes: trimesh.Trimesh, number=lambda corner, so_far: corner) -> str:
    """Objects one after the other, corners written as ``number`` says of their place in the file,
    from 1, and of the vertices so far.
    """
    lines, so_far = ["mtllib gone.mtl"], 0
    for k, mesh in enumerate(meshes):
        lines += [
            f"o object {k}",
            *("v {} {} {}".format(*vertex) for vertex in mesh.vertices),
            f"usemtl {k}",
        ]
        so_far, before = so_far + len(mesh.vertices), so_far
        lines += [
            "f " + " ".join(str(number(before + 1 + corner, so_far)) for corner in face)
            for face in mesh.faces
        ]
    return "\n".join(lines) + "\n"


def test_objects_of_an_obj_that_count_back_lie_where_those_that_count_forth_do(tmp_path):
    meshes = ball(30), ball(20, (80, 0, 0))
    path = write(tmp_path, entry("balls", "balls.obj"))
    found = []
    for number in (
        lambda corner, so_far: corner,
        lambda corner, so_far: corner - so_far - 1,
        lambda corner, _: f"{corner}//3",
    ):
        (tmp_path / "balls.obj").write_text(obj_text(*meshes, number=number))
        found.append(phantom_files.load_phantom(path).parts[0])
    for part in found:
        np.testing.assert_array_equal(part.vertices, found[0].vertices)
        np.testing.assert_array_equal(part.triangles, found[0].triangles)
    low, high = found[0].vertices.min(axis=0), found[0].vertices.max(axis=0)
    np.testing.assert_allclose([low, high], [[-0.03, -0.03, -0.03], [0.1, 0.03, 0.03]], atol=1e-6)


def test_an_obj_with_comments_anywhere_continued_lines_and_foreign_letters(tmp_path):
    text = obj_text(ball(30)).replace("\nf ", " # caf\xe9\nf ").replace("f 1 ", "f 1 \\\n")
    (tmp_path / "ball.obj").write_bytes(text.encode("latin-1"))
    assert (
        len(
            phantom_files.load_phantom(write(tmp_path, entry("ball", "ball.obj")))
            .parts[0]
            .triangles
        )
        == 320
    )
    (tmp_path / "ball.obj").write_text(text.replace("\nf 1 ", "\nf 0 "))
    refuse(
        tmp_path / "phantom.toml",
        r"ball\.obj \(part 'ball'\): cannot be read as a mesh .*a face names vertex 0",
    )


def test_units_energy_and_stated_attenuation(tmp_path):
    path = write(
        tmp_path,
        entry("a", "a.ply", unit="m", material="cortical_bone"),
        {"name": "b", "file": "b.ply", "unit": "mm", "attenuation_per_mm": 0.02},
        a_ply=ball(0.05),
        b_ply=ball(20),
    )
    phantom = phantom_files.load_phantom(path, energy_kev=80.0)
    assert phantom.parts[0].attenuation == materials.attenuation("cortical_bone", 80.0)
    assert phantom.parts[1].attenuation == pytest.approx(20.0)
    assert np.ptp(phantom.parts[0].vertices, axis=0).max() == pytest.approx(0.1, rel=1e-3)


def test_an_inward_mesh_is_turned_and_said_so(tmp_path):
    mesh = ball(30)
    mesh.invert()
    found = phantom_files.read(write(tmp_path, entry("ball", "ball.stl"), ball_stl=mesh))
    part = found.phantom.parts[0]
    assert volume(part.vertices, part.triangles) > 0
    assert len(found.remarks) == 1
    assert "ball.stl (part 'ball'): its triangles faced inward" in found.remarks[0]


def test_a_shell_that_bounds_no_hollow_is_remarked(tmp_path):
    """Two balls that both face outward are a full one: whoever means a pipe has to turn one."""
    full = trimesh.util.concatenate([ball(30), ball(20)])
    inner = ball(20)
    inner.invert()
    hollow = trimesh.util.concatenate([ball(30), inner])
    path = write(tmp_path, entry("a", "a.stl"), a_stl=full)
    (remark,) = phantom_files.read(path).remarks
    assert "1 of its shells, the first of 320 triangles, lie inside another one" in remark
    assert phantom_files.read(write(tmp_path, entry("a", "a.stl"), a_stl=hollow)).remarks == ()


def test_segments_move_their_parts(tmp_path):
    path = write(
        tmp_path,
        entry("a", "a.ply"),
        entry("b", "b.ply", segment="tibia_r"),
        a_ply=ball(50),
        b_ply=ball(20),
    )
    found = phantom_files.read(path)
    assert found.segments == (None, "tibia_r")
    moves = np.stack([np.eye(4), transforms.translation((0.0, 0.1, 0.0))])
    first, second = found.posed(("femur_r", "tibia_r"), moves)
    assert first is found.phantom.parts[0].vertices
    np.testing.assert_allclose(second, found.phantom.parts[1].vertices + np.array([0, 0.1, 0]))
    with pytest.raises(LegsimError, match="parts move with tibia_r; the poses have femur_r"):
        found.posed(("femur_r",), moves[:1])


def test_overlaps_are_remarked_and_nesting_is_not(tmp_path):
    path = write(
        tmp_path,
        entry("a", "a.ply"),
        entry("b", "b.ply"),
        entry("c", "c.ply"),
        a_ply=ball(50),
        b_ply=ball(20),
        c_ply=ball(20, (50, 0, 0)),
    )
    remarks = phantom_files.read(path).remarks
    assert len(remarks) == 1
    assert "parts 'a' and 'c' overlap; 'c' decides" in remarks[0]


def refuse(path, message: str) -> None:
    with pytest.raises(LegsimError, match=message) as caught:
        phantom_files.load_phantom(path)
    assert "\n" not in str(caught.value)


def test_open_and_disoriented_meshes_are_reported_with_their_file(tmp_path):
    opened, turned = ball(30), ball(30)
    opened.update_faces(np.arange(320) != 7)
    turned.faces = np.concatenate([turned.faces[:1, ::-1], turned.faces[1:]])
    for suffix in ("ply", "stl"):
        refuse(
            write(tmp_path, entry("x", f"x.{suffix}"), **{f"x_{suffix}": opened}),
            rf"x\.{suffix} \(part 'x'\): the surface is open: 3 edges",
        )
        refuse(
            write(tmp_path, entry("x", f"x.{suffix}"), **{f"x_{suffix}": turned}),
            r"disagree about the outside at 3 edges",
        )


def test_mistaken_units_are_suspected(tmp_path):
    refuse(
        write(tmp_path, entry("x", "x.ply", unit="m"), x_ply=ball(30)),
        r"x\.ply \(part 'x'\): with unit = 'm' it is 6e\+04 mm long; is its unit 'mm'\?",
    )
    refuse(write(tmp_path, entry("x", "x.ply"), x_ply=ball(0.03)), r"is its unit 'm'\?")
    bead = phantom_files.read(write(tmp_path, entry("x", "x.ply"), x_ply=ball(0.2)))
    assert "(part 'x'): it is 0.4 mm long; if that is too small" in bead.remarks[0]


def test_a_whole_phantom_of_a_few_mm_is_remarked_and_a_bead_in_a_larger_one_is_not(tmp_path):
    """A meter taken for a millimeter passes as a small bead would."""
    meters = trimesh.creation.box(extents=(0.3, 1.0, 0.2))
    (remark,) = phantom_files.read(write(tmp_path, entry("leg", "leg.ply"), leg_ply=meters)).remarks
    assert "the phantom is 1 mm long; if that is too small, its files are in m" in remark
    path = write(
        tmp_path,
        entry("ball", "ball.ply"),
        entry("bead", "bead.ply"),
        ball_ply=ball(30),
        bead_ply=ball(0.5),
    )
    assert phantom_files.read(path).remarks == ()


def test_a_hidden_part_is_reported(tmp_path):
    path = write(
        tmp_path, entry("bone", "b.ply"), entry("skin", "s.ply"), b_ply=ball(20), s_ply=ball(50)
    )
    refuse(
        path,
        r"part 'bone' \(b\.ply\) lies inside the later part 'skin' \(s\.ply\), which displaces it "
        r"completely; list 'skin' before 'bone'",
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[[part]\n", "is not TOML"),
        ("", r"holds no \[\[part\]\]"),
        ("part = 3", r"holds no \[\[part\]\]"),
        ("title = 3", "unknown key 'title'"),
        (
            "[[part]]\nname = 'a'\nfiles = 'x'",
            r"\(part 1\): unknown key 'files'; known: name, file, unit",
        ),
        ("[[part]]\nname = 'a'", r"\(part 1\): lacks file, unit"),
        ("[[part]]\nname = 3", r"name = 3 is of the wrong type; give text in quotes$"),
        ("axes = 3\n[[part]]", r"axes = 3 is of the wrong type; give text in quotes$"),
        (
            "axes = ['lps']\n[[part]]",
            r"axes = \['lps'\] is of the wrong type; give text in quotes$",
        ),
        ("repair = 'yes'\n[[part]]", r"repair = 'yes' is of the wrong type; give true or false$"),
        (
            "[[part]]\nattenuation_per_mm = true",
            r"attenuation_per_mm = True is of the wrong type; give a number$",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'km'\nmaterial = 'water'",
            "unit = 'km'; known: mm, m, cm, in",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'",
            "needs either material or attenuation_per_mm",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'\nattenuation_per_mm = -1",
            "attenuation_per_mm = -1",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'\nattenuation_per_mm = 1e40",
            r"1e\+40; give a number from 0 to 1e\+06",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'\nattenuation_per_mm = nan",
            "attenuation_per_mm = nan",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'\nmaterial = 'cheese'",
            r"\(part 1, 'a'\): unknown material 'cheese'",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.ply'\nunit = 'mm'\nmaterial = 'water'",
            r"x\.ply \(part 'a'\): no such file",
        ),
        (
            "[[part]]\nname = 'a'\nfile = 'x.vtk'\nunit = 'mm'\nmaterial = 'water'",
            r"unknown kind of mesh '\.vtk'",
        ),
    ],
)
def test_a_malformed_toml_is_reported_with_its_place(tmp_path, content, message):
    (tmp_path / "phantom.toml").write_text(content)
    refuse(tmp_path / "phantom.toml", message)


def test_other_refusals(tmp_path):
    refuse(tmp_path / "none.toml", "no such file")
    path = write(tmp_path, entry("a", "a.ply"), entry("a", "a.ply"), a_ply=ball(30))
    refuse(path, "two parts are named 'a'")
    for suffix in SUFFIXES:
        (tmp_path / f"bad{suffix}").write_bytes(b"\x00not a mesh at all")
        refuse(
            write(tmp_path, entry("a", f"bad{suffix}")),
            rf"bad\{suffix} \(part 'a'\): (cannot be read as a mesh|holds no triangles)",
        )


def test_meshes_that_no_reader_takes_are_reported_in_words_of_the_file(tmp_path):
    mesh = ball(30)
    mesh.export(tmp_path / "cut.stl")
    (tmp_path / "cut.stl").write_bytes((tmp_path / "cut.stl").read_bytes()[:3000])
    refuse(
        write(tmp_path, entry("a", "cut.stl")),
        r"cut\.stl \(part 'a'\): (cannot be read as a mesh|holds no triangles).*cut short",
    )
    ply = mesh.export(file_type="ply", encoding="ascii")
    assert isinstance(ply, bytes)
    lines = ply.decode().splitlines()
    for index in ("99999", "-7"):
        (tmp_path / "beyond.ply").write_text("\n".join([*lines[:-1], f"3 1 2 {index}"]) + "\n")
        refuse(
            write(tmp_path, entry("a", "beyond.ply")),
            r"a triangle names a vertex beyond the 162 of the file",
        )


def test_a_flat_part_encloses_nothing_and_a_thin_one_something(tmp_path):
    flat = trimesh.Trimesh(
        [[0, 0, 0], [50, 0, 0], [0, 50, 1]], [[0, 1, 2], [0, 2, 1]], process=False
    )
    refuse(
        write(tmp_path, entry("leaf", "flat.ply"), flat_ply=flat),
        r"flat\.ply \(part 'leaf'\): the surface encloses no volume",
    )
    foil = trimesh.creation.box(extents=(500, 500, 0.01))
    assert (
        len(
            phantom_files.load_phantom(
                write(tmp_path, entry("foil", "foil.ply"), foil_ply=foil)
            ).parts
        )
        == 1
    )


def test_a_part_that_juts_out_somewhere_is_not_hidden(tmp_path):
    """Nearly all its vertices lie in the later part, as those of a dense lump on a stalk."""
    inner = trimesh.util.concatenate(
        [trimesh.creation.icosphere(5, radius=10.0), ball(3, (60, 5, 0))]
    )
    assert isinstance(inner, trimesh.Trimesh)
    order = np.random.default_rng(2).permutation(len(inner.vertices))
    mixed = trimesh.Trimesh(inner.vertices[order], np.argsort(order)[inner.faces], process=False)
    path = write(
        tmp_path,
        entry("lump", "lump.ply"),
        entry("over", "over.ply"),
        lump_ply=mixed,
        over_ply=ball(30),
    )
    assert [part.name for part in phantom_files.load_phantom(path).parts] == ["lump", "over"]


def test_the_phantom_and_geometry_in_the_documents_are_whole(tmp_path, monkeypatch):
    section = (
        (Path(__file__).parents[2] / "docs/projector.md").read_text().partition("## Own meshes")[2]
    )
    (text,), (code,) = (
        re.findall(rf"```{kind}\n(.*?)```", section, re.S) for kind in ("toml", "python")
    )
    ball(40).export(tmp_path / "cup.stl")
    ball(10).export(tmp_path / "rod.ply")
    (tmp_path / "phantom.toml").write_text(text)
    phantom = phantom_files.load_phantom(tmp_path / "phantom.toml")
    assert [part.name for part in phantom.parts] == ["cup", "rod"]
    assert phantom.parts[0].attenuation < phantom.parts[1].attenuation
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert geometry_files.load_geometry(tmp_path / "geometry.json").shape_vu == (240, 310)


def overlapping(*, inverted: bool, apart: float = 40.0) -> trimesh.Trimesh:
    """Two balls of 30 mm in one mesh."""
    other = ball(30, (apart, 0, 0))
    if inverted:
        other.invert()
    return joined(ball(30), other)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """The parts in one mesh."""
    whole = trimesh.util.concatenate(parts)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def test_overlapping_shells_that_contradict_each_other_are_refused_or_repaired(tmp_path):
    path = write(tmp_path, entry("a", "o.stl"), o_stl=overlapping(inverted=True))
    refuse(path, r"o\.stl \(part 'a'\): a shell of 320 triangles .* faces inward, but overlaps")
    read = phantom_files.read(path, repair=True)
    assert "1 of its shells faced inward" in read.remarks[0]
    part = read.phantom.parts[0]
    expected = 2 * ball(30).volume * 1e-9
    assert volume(part.vertices, part.triangles) == pytest.approx(expected, rel=1e-5)


def test_shells_apart_are_turned_and_hollows_stay(tmp_path):
    path = write(tmp_path, entry("a", "o.stl"), o_stl=overlapping(inverted=True, apart=100))
    assert "1 of its shells faced inward" in phantom_files.read(path).remarks[0]
    hollow = ball(10)
    hollow.invert()
    shell = joined(ball(30), hollow)
    for mesh in (shell, trimesh.Trimesh(shell.vertices, shell.faces[:, ::-1], process=False)):
        part = phantom_files.load_phantom(write(tmp_path, entry("a", "h.ply"), h_ply=mesh)).parts[0]
        expected = (ball(30).volume - ball(10).volume) * 1e-9
        assert volume(part.vertices, part.triangles) == pytest.approx(expected, rel=1e-5)


def test_repair_is_a_key_of_the_file_and_of_a_part(tmp_path):
    holed = ball(30)
    holed.update_faces(np.arange(len(holed.faces)) > 5)
    path = write(tmp_path, entry("a", "h.ply"), h_ply=holed)
    refuse(path, r"the surface is open.*or give repair = true \(--repair\)")
    path = write(tmp_path, entry("a", "h.ply"))
    path.write_text("repair = true\n" + path.read_text())
    assert "holes closed" in phantom_files.read(path).remarks[0]
    path = write(tmp_path, entry("a", "h.ply"))
    path.write_text(path.read_text() + "repair = true\n")
    assert "holes closed" in phantom_files.read(path).remarks[0]
    path.write_text("repair = 1\n" + path.read_text())
    refuse(path, "repair = 1 is of the wrong type")
