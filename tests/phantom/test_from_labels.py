"""A segmentation becomes closed, nested parts of the right size, in a PHANTOM.toml that loads."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.label_images import LabelImage
from legsim.phantom import files as phantom_files
from legsim.phantom import from_labels, leg_phantom
from legsim.phantom._stance import objections
from legsim.phantom.from_labels import Layers, MeshedLabels, MeshedPart
from legsim.phantom.label_maps import LabelEntry, LabelMap
from legsim.phantom.label_structures import Structure, structure_grid
from legsim.phantom.meshes import Part
from legsim.phantom.raster import require_closed

VOXEL = 0.002
PLACED = np.array([[0.0, 0, VOXEL, 0], [0, VOXEL, 0, 0], [VOXEL, 0, 0, 0], [0, 0, 0, 1]])
ENTRIES = (
    LabelEntry(1, "skin", "skin", "soft", None, True),
    LabelEntry(2, "fat", "fat", "soft", None, True),
    LabelEntry(3, "muscle", "muscle", "soft", None, False),
    LabelEntry(4, "femur", "bone", "femur", None, False),
    LabelEntry(5, "tibia", "bone", "tibia", None, False),
)


DEFAULT = Layers()


def cylinders() -> np.ndarray:
    """Skin, fat, muscle and two bones, one above the other, 6 mm apart: (k, j, i)."""
    k, j, i = np.indices((30, 50, 30))
    far = np.hypot(k - 14.6, i - 14.7)
    labels = np.where(far < 13, 1, 0)
    labels[far < 12] = 2
    labels[far < 10] = 3
    labels[(far < 7) & (j > 26) & (j < 43)] = 4
    labels[(far < 7) & (j < 24) & (j > 6)] = 5
    labels[:, (*range(3), *range(47, 50))] = 0
    return labels


def meshed(labels=None, layers=DEFAULT, ignore=()) -> MeshedLabels:
    image = LabelImage(
        Path("knee.nrrd"), np.array(cylinders() if labels is None else labels, np.int32), PLACED
    )
    grid = structure_grid([image], [LabelMap(Path("m.toml"), ENTRIES, {})], side="l", ignore=ignore)
    return from_labels.mesh_labels(grid, layers)


def surface(part: MeshedPart) -> trimesh.Trimesh:
    return trimesh.Trimesh(part.vertices, part.triangles, process=False)


@pytest.fixture(scope="module")
def knee() -> MeshedLabels:
    return meshed(layers=Layers(cortex=0.003, cartilage=0.002))


def part(made: MeshedLabels, name: str) -> MeshedPart:
    return next(p for p in made.parts if p.name == name)


def test_parts_are_closed_and_in_order(knee):
    assert [p.name for p in knee.parts] == [
        "skin_l",
        "fat_l",
        "muscle_l",
        "femur_cartilage_tibia_l",
        "tibia_cartilage_femur_l",
        "femur_cortex_l",
        "femur_cancellous_l",
        "tibia_cortex_l",
        "tibia_cancellous_l",
    ]
    for one in knee.parts:
        require_closed(Part(one.name, one.material, 0.0, one.vertices, one.triangles))
        assert surface(one).volume > 0


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        ("fat_l", "skin_l"),
        ("femur_cortex_l", "fat_l"),
        ("femur_cancellous_l", "femur_cortex_l"),
        ("tibia_cancellous_l", "tibia_cortex_l"),
    ],
)
def test_what_is_within_another_stays_within_it(knee, inner, outer):
    inside, around = part(knee, inner), surface(part(knee, outer))
    touching = np.isin(
        np.round(inside.vertices, 7).view([("", float)] * 3).ravel(),
        np.round(around.vertices, 7).view([("", float)] * 3).ravel(),
    )
    assert around.contains(inside.vertices[~touching]).all()


def test_cortex_is_as_thick_as_asked(knee):
    outer, inner = part(knee, "femur_cortex_l"), part(knee, "femur_cancellous_l")
    middle = np.abs(inner.vertices[:, 1] - inner.vertices[:, 1].mean()) < 0.006
    center = VOXEL * np.array([14.6, 14.7])
    radius = np.hypot(*(inner.vertices[middle][:, [0, 2]] - center).T)
    assert radius.mean() == pytest.approx(7 * VOXEL - 0.003, abs=0.25 * VOXEL)
    assert inner.material == "cancellous_bone"
    assert outer.material == "cortical_bone"


def test_cartilage_lies_between_the_bones_and_meets_halfway(knee):
    femur, tibia = part(knee, "femur_cartilage_tibia_l"), part(knee, "tibia_cartilage_femur_l")
    assert femur.segment == "femur_l"
    # bones end at 26.5 and 23.5 voxels: 3 mm of cartilage each would cross, so both end at 25
    assert femur.vertices[:, 1].min() == pytest.approx(25 * VOXEL, abs=0.5 * VOXEL + 0.001)
    assert tibia.vertices[:, 1].max() == pytest.approx(25 * VOXEL, abs=0.5 * VOXEL + 0.001)
    assert tibia.vertices[:, 1].max() <= femur.vertices[:, 1].min() + 0.3 * VOXEL


def test_soft_tissue_reaches_below_bones_and_bones_below_nothing(knee):
    labels = {row.name: row for row in knee.volumes}
    voxel = 1e9 * VOXEL**3
    own = (cylinders() == 4).sum() * voxel
    assert 1e9 * labels["femur_l"].meshed == pytest.approx(own)
    muscle = labels["muscle_l"]
    assert 1e9 * muscle.labels == pytest.approx((cylinders() == 3).sum() * voxel)
    assert muscle.meshed > 1.1 * muscle.labels
    for row in knee.volumes:
        assert row.mesh == pytest.approx(row.meshed, rel=0.02), row.name


def test_a_wrong_voxel_size_shows_in_a_bone_of_no_adult(knee):
    assert any("femur_l" in line and "is not an adult's" in line for line in knee.remarks)


def test_what_the_image_cuts_is_named_and_has_no_cortex_there():
    labels = cylinders()
    labels[:, 41:] = labels[:, [40]]
    made = meshed(labels, Layers(cortex=0.003))
    assert any("cut by the image's border above" in line for line in made.remarks)
    top = part(made, "femur_cortex_l").vertices[:, 1].max()
    assert top == pytest.approx(49.5 * VOXEL, abs=0.5 * VOXEL)
    assert part(made, "femur_cancellous_l").vertices[:, 1].max() > top - 0.5 * VOXEL


def test_a_cavity_in_a_bone_is_filled():
    labels = cylinders()
    labels[14, 35:38, 14] = 0
    whole, holed = (
        next(row for row in meshed(x).volumes if row.name == "femur_l") for x in (None, labels)
    )
    assert whole.meshed == holed.meshed
    assert whole.labels > holed.labels


def test_bones_without_anything_around_them_are_reported():
    labels = np.where(cylinders() > 3, cylinders(), 0)
    assert any("what is not labeled is air" in line for line in meshed(labels).remarks)


@pytest.mark.parametrize("layers", [Layers(cortex=0.0005), Layers(cartilage=-0.001)])
def test_layers_that_the_grid_cannot_show_are_refused(layers):
    with pytest.raises(LegsimError, match="from half a voxel"):
        meshed(layers=layers)


def test_a_saved_phantom_loads_as_it_is(knee, tmp_path):
    path = from_labels.save(tmp_path / "made", knee)
    loaded = phantom_files.read(path)
    assert [p.name for p in loaded.phantom.parts] == [p.name for p in knee.parts]
    assert loaded.segments == tuple(p.segment for p in knee.parts)
    assert not loaded.remarks
    for before, after in zip(knee.parts, loaded.phantom.parts, strict=True):
        assert after.material == before.material
        assert len(after.vertices) == len(before.vertices)
        # PLY holds single precision in mm
        assert np.abs(after.vertices - before.vertices).max() < 1e-7


@pytest.mark.parametrize("cortex", [0.002, 0.006])
def test_distances_near_a_layers_border_are_all_that_it_takes(cortex, monkeypatch):
    layers = Layers(cortex=cortex, cartilage=0.002)
    quick = meshed(layers=layers)
    monkeypatch.setattr(from_labels, "_BAND", 100)
    exact = meshed(layers=layers)
    assert [p.name for p in quick.parts] == [p.name for p in exact.parts]
    for one, other in zip(quick.parts, exact.parts, strict=True):
        np.testing.assert_array_equal(one.triangles, other.triangles, err_msg=one.name)
        np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-9, err_msg=one.name)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interrupted_phantom_leaves_nothing_or_the_one_before(
    knee, tmp_path, monkeypatch, error
):
    before = from_labels.save(tmp_path / "before", meshed())
    content = {path: path.read_bytes() for path in before.parent.iterdir()}
    export = trimesh.Trimesh.export
    written = []

    def interrupted(mesh, path, **options):
        written.append(path)
        export(mesh, path, **options)
        if len(written) % 4 == 0:
            raise error

    monkeypatch.setattr(trimesh.Trimesh, "export", interrupted)
    for folder in ("before", "new/deep"):
        expected = KeyboardInterrupt if error is KeyboardInterrupt else LegsimError
        with pytest.raises(expected):
            from_labels.save(tmp_path / folder, knee)
    assert {path: path.read_bytes() for path in before.parent.iterdir()} == content
    assert sorted(path.name for path in tmp_path.iterdir()) == ["before"]


@pytest.mark.parametrize(
    ("degrees", "words"), [(10, None), (60, "53 degrees to the left"), (-90, "to the right")]
)
def test_a_leg_that_stands_turned_is_reported_and_not_doubted(degrees, words):
    legs = leg_phantom.load_leg_phantom()
    turn = transforms.axis_rotation((0, 1, 0), np.radians(degrees))
    bony = []
    for name in ("femur", "tibia", "patella"):
        part = legs.phantom.parts[legs.part_index(f"{name}_cortex_l")]
        structure = Structure(LabelEntry(1, name, "bone", name, None, False), "l")
        vertices = part.vertices @ turn.T
        bony.append(from_labels._Outer(structure, np.ones(1), np.eye(4), vertices, part.triangles))
    remarks: list[str] = []
    turns = from_labels._turns(bony, remarks)
    if words is None:
        assert (turns, remarks) == ({}, [])
        return
    assert words in remarks[0]
    back = {f"{o.structure.name}": o.vertices @ turns["l"] for o in bony}
    middles = {name: points.mean(axis=0) for name, points in back.items()}
    assert middles["patella_l"][0] > middles["femur_l"][0]
    assert objections(back) == []
