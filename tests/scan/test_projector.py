"""The projector against float64 ray casting, exact hits of edges and vertices, invariances and the
rule for overlaps.
"""

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device
from legsim.phantom import materials
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import projector
from legsim.scan.spectrum import Spectrum
from tests.examples.bodies import circular, looking_along_z, part, sphere
from tests.references import projector as reference_projector

MEAN, WORST = 1e-6, 2e-5
"""m of path length: what the project promises"""


def errors(
    phantom: Phantom, geometry: ConeBeamGeometry, device: Device, view: int, nudge=(0.0, 0.0)
) -> np.ndarray:
    """|projector - reference| over all pixels of a view."""
    rows, columns = geometry.shape_vu
    v, u = np.mgrid[:rows, :columns]
    pixels = np.stack([u.ravel() + nudge[0], v.ravel() + nudge[1]], 1)
    expected = reference_projector.line_integrals(phantom, geometry, view, pixels)
    assert expected.max() > 0
    return np.abs(
        projector.project(phantom, geometry, device).line_integrals[view].ravel() - expected
    )


@pytest.mark.parametrize(
    "center",
    [(0, 0, 0), (0.05, 0, 0), (0, 0.04, 0), (0, 0, -0.05), (0.06, -0.09, 0.05), (0.13, 0, 0.0)],
)
def test_sphere_at_any_place_agrees_with_float64_ray_casting(device, center):
    found = errors(Phantom((sphere("ball", 0.05, center),)), circular(), device, 1)
    assert found.mean() < MEAN
    assert found.max() < WORST


def test_chords_through_a_fine_sphere_are_those_of_a_ball(device):
    geometry, radius, center = circular(1), 0.06, np.array([0.01, -0.02, 0.015])
    image = projector.project(
        Phantom((sphere("ball", radius, center, 20.0, 6),)), geometry, device
    ).line_integrals[0]
    v, u = np.mgrid[:48, :62]
    directions = geometry.ray_directions(u, v)[0]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    to_center = center - geometry.sources()[0]
    squared = radius**2 - (to_center @ to_center - (directions @ to_center) ** 2)
    chords = 2 * np.sqrt(np.maximum(squared, 0))
    inner = squared > (0.5 * radius) ** 2
    np.testing.assert_allclose(image[inner] / 20.0, chords[inner], atol=2e-5)


def test_object_larger_than_the_detector_and_close_to_the_source(device):
    body = part(
        "body",
        trimesh.creation.box(extents=(0.6, 1.4, 0.5)),
        20.0,
        transforms.rigid(transforms.axis_rotation((1, 2, 3), 0.3), (0.02, 0, 0)),
    )
    found = (
        errors(Phantom((body, sphere("ball", 0.2, (0.1, 0.5, 0), 7.0))), circular(), device, 2)
        / 20.0
    )
    assert found.mean() < MEAN
    assert found.max() < WORST


def test_long_slivers_are_exact_to_their_silhouette(device):
    """A pipe of 400 facets a meter long: without exact edge functions its grazing rays are off by
    0.04 mm.
    """
    geometry = circular(1, (480, 620), 0.616e-3)
    mesh = trimesh.creation.cylinder(radius=0.02, height=1.0, sections=400)
    pipe = Phantom((part("pipe", mesh, moved=transforms.translation((0.03, 0, 0))),))
    image = projector.project(pipe, geometry, device).line_integrals[0]
    v, u = np.nonzero(image[:, 1:-1] * ((image[:, :-2] == 0) | (image[:, 2:] == 0)))
    pixels = np.stack([u + 1, v], 1)
    expected = reference_projector.line_integrals(pipe, geometry, 0, pixels.astype(float))
    found = np.abs(image[pixels[:, 1], pixels[:, 0]] - expected)
    assert len(found) > 500
    assert found.mean() < MEAN
    assert found.max() < WORST


def test_overlapping_parts_give_way_to_the_last(device):
    parts = (
        sphere("a", 0.06, attenuation=20.0),
        sphere("b", 0.05, (0.04, 0.01, 0), 50.0),
        sphere("c", 0.05, (0, 0.01, 0.04), 5.0),
    )
    for order in ((0, 1, 2), (2, 1, 0), (1, 0, 2)):
        assert (
            errors(Phantom(tuple(parts[k] for k in order)), circular(), device, 0).max()
            < 50 * WORST
        )


def test_nested_ellipsoids(device):
    shells = []
    for k, scale in enumerate((1.0, 0.7, 0.69, 0.3)):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.apply_scale(np.array([0.08, 0.11, 0.05]) * scale)
        shells.append(part(f"shell {k}", mesh, (20.0, 50.0, 0.0, 30.0)[k]))
    assert errors(Phantom(tuple(shells)), circular(), device, 1).max() < 50 * WORST


def test_more_parts_than_bits_in_a_word(device):
    balls = tuple(
        sphere(f"ball {k}", 0.05 - 0.0005 * k, (0.0007 * k, 0, 0), 1.0 + k, 2) for k in range(70)
    )
    assert errors(Phantom(balls), circular(1, (12, 16), 24e-3), device, 0).max() < 70 * WORST


def test_more_crossings_than_fit_in_local_memory(device, rng):
    places = rng.uniform(-0.05, 0.05, (60, 3)) * (0.1, 0.1, 1)
    balls = [sphere(f"ball {k}", 0.02, place, 1.0 + k, 2) for k, place in enumerate(places)]
    geometry = circular(1, (24, 31), 6e-3)
    crossed = [2 * sum(np.linalg.norm(places[:, :2], axis=1) < 0.018)]
    assert max(crossed) > 48, "the case does not test what it should"
    assert errors(Phantom(tuple(balls)), geometry, device, 0).max() < 60 * WORST


def test_a_hollow_bounded_by_an_inward_surface_is_empty(device):
    outer, inner = (
        trimesh.creation.icosphere(3, radius=0.06),
        trimesh.creation.icosphere(3, radius=0.03),
    )
    inner.invert()
    hollow = Phantom((part("shell", trimesh.util.concatenate([outer, inner]), 20.0),))
    solid = Phantom((part("shell", outer, 20.0), sphere("hollow", 0.03, attenuation=0.0)))
    geometry = circular()
    first, second = (projector.project(p, geometry, device).line_integrals for p in (hollow, solid))
    np.testing.assert_allclose(first, second, atol=20 * 1e-6)


def test_a_part_that_overlaps_itself_counts_once(device):
    """Two balls in one part: where they overlap the surface winds around twice."""
    meshes = [
        trimesh.creation.icosphere(3, radius=0.05).apply_translation((x, 0, 0))
        for x in (-0.02, 0.02)
    ]
    double = part("double", trimesh.util.concatenate(meshes), 20.0)
    assert (
        errors(
            Phantom((double, sphere("inner", 0.01, attenuation=3.0))), circular(), device, 2
        ).max()
        < 20 * WORST
    )


def test_box_whose_edges_and_vertices_meet_pixel_centers(device):
    box = trimesh.creation.box(bounds=[[-0.5, -0.25, 2.0], [0.5, 0.75, 4.0]])
    for _ in range(3):
        box = box.subdivide()
    found = errors(
        Phantom((part("box", box),)), looking_along_z((64, 64)), device, 0, nudge=(1e-7, 1e-8)
    )
    assert found.max() < 1e-5


def test_every_vertex_on_a_pixel_center_leaks_nowhere(device, rng):
    """A closed surface over integer (u, v): rays hit its vertices, run along its edges, and
    silhouettes fall onto pixels.
    """
    geometry = looking_along_z((40, 40))
    mesh = trimesh.creation.icosphere(subdivisions=3)
    u, v = np.rint(mesh.vertices[:, 0] * 9.0) + 20, np.rint(mesh.vertices[:, 1] * 9.0) + 20
    depth = 3.0 + 0.8 * mesh.vertices[:, 2] + rng.uniform(-0.02, 0.02, len(u))
    depth = np.ldexp(np.rint(np.ldexp(depth, 10)), -10)
    points = np.stack([(u - 20) / 64 * depth, (v - 20) / 64 * depth, depth], 1)
    lump = Phantom((Part("lump", "water", 1.0, points, np.asarray(mesh.faces)),))
    assert errors(lump, geometry, device, 0, nudge=(1e-7, 1e-9)).max() < 1e-4


def test_moving_the_phantom_is_moving_the_scanner(device):
    geometry = circular(4)
    phantom = Phantom(
        (sphere("a", 0.06, (0.01, 0, 0), 20.0), sphere("b", 0.03, (0.02, 0.02, 0), 50.0))
    )
    turns = transforms.rotation_from_vector(np.outer(np.arange(4), (0.05, 0.1, -0.02)))
    moves = transforms.rigid(turns, np.outer(np.arange(4), (0.004, -0.01, 0.006)))
    posed = projector.project(
        phantom,
        geometry,
        device,
        posed=lambda view: [transforms.apply(moves[view], p.vertices) for p in phantom.parts],
    )
    scanned = projector.project(phantom, geometry.moved(moves), device)
    np.testing.assert_allclose(posed.line_integrals, scanned.line_integrals, atol=50 * 1e-5)
    assert abs(posed.line_integrals[0] - posed.line_integrals[3]).max() > 0.1


def test_a_part_that_rests_while_others_move(device):
    geometry = circular(3)
    phantom = Phantom((sphere("a", 0.06, attenuation=20.0), sphere("b", 0.02, attenuation=50.0)))
    rest = phantom.parts[0].vertices

    def posed(view: int):
        return rest, phantom.parts[1].vertices + 0.01 * view

    moving = projector.project(phantom, geometry, device, posed=posed).line_integrals
    for view in range(3):
        still = projector.project(
            phantom.with_vertices(posed(view)), geometry[view : view + 1], device
        ).line_integrals[0]
        np.testing.assert_array_equal(moving[view], still)


def test_the_same_bits_every_time(device):
    phantom = Phantom((sphere("a", 0.06, attenuation=20.0), sphere("b", 0.06, (1e-3, 0, 0), 50.0)))
    first, second = (
        projector.project(phantom, circular(), device).line_integrals for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_progress_counts_views(device):
    seen = []
    projector.project(
        Phantom((sphere("a", 0.06),)),
        circular(),
        device,
        progress=lambda *counts: seen.append(counts),
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_a_phantom_outside_the_field_leaves_the_image_empty(device):
    image = projector.project(
        Phantom((sphere("a", 0.02, (0, 1.5, 0)),)), circular(), device
    ).line_integrals
    assert not image.any()


def test_an_open_surface_is_refused_with_the_number_of_open_edges(device):
    mesh = trimesh.creation.icosphere(2, radius=0.05)
    opened = Part("leaky", "water", 1.0, mesh.vertices, mesh.faces[1:])
    with pytest.raises(LegsimError, match=r"'leaky' is not a closed.*: 3 of its edges"):
        projector.project(Phantom((opened,)), circular(), device)


def test_posed_vertices_must_fit(device):
    phantom = Phantom((sphere("a", 0.05),))
    with pytest.raises(LegsimError, match="posed vertices for 0 parts"):
        projector.project(phantom, circular(), device, posed=lambda view: [])
    with pytest.raises(LegsimError, match="posed vertices of part 'a' have shape"):
        projector.project(phantom, circular(), device, posed=lambda view: [np.zeros((3, 3))])
    with pytest.raises(LegsimError, match="not a finite number"):
        projector.project(
            phantom, circular(), device, posed=lambda view: [np.full((642, 3), np.nan)]
        )


BROAD = Spectrum(np.array([25.0, 40.0, 60.0, 85.0]), np.array([1.0, 3.0, 2.0, 1.0]))


def made_of(name: str, material: str, mesh: trimesh.Trimesh, energy_kev: float = 60.0) -> Part:
    return Part(
        name,
        material,
        materials.attenuation(material, energy_kev),
        np.asarray(mesh.vertices),
        np.asarray(mesh.faces),
    )


def test_a_spectrum_of_one_line_projects_as_one_energy_does(device):
    overlapping = [
        trimesh.creation.icosphere(3, radius=r).apply_translation((x, 0, 0))
        for r, x in ((0.06, 0), (0.04, 0.03), (0.03, 0.05))
    ]
    filled = zip("abc", ("muscle", "cortical_bone", "air"), overlapping, strict=True)
    bead = trimesh.creation.icosphere(3, radius=0.01)
    phantom = Phantom(
        (
            *(made_of(*filling) for filling in filled),
            Part("d", "stated", 500.0, bead.vertices, bead.faces),
        )
    )
    one = projector.project(phantom, circular(), device).line_integrals
    line = projector.project_spectrum(
        phantom, circular(), device, Spectrum(np.array([60.0]), np.ones(1))
    ).line_integrals
    np.testing.assert_allclose(line, one, rtol=2e-6, atol=2e-6)
    assert one.max() > 10


def test_a_slab_of_water_hardens_the_beam_as_the_integral_over_energies_says(device):
    thicknesses = np.array([1e-5, 0.01, 0.05, 0.2, 0.6])
    found = []
    slabs = [
        trimesh.creation.box(bounds=[[-9, -9, 2.0], [9, 9, 2.0 + thickness]])
        for thickness in thicknesses
    ]
    for slab in slabs:
        found.append(
            projector.project_spectrum(
                Phantom((made_of("slab", "water", slab),)), looking_along_z((9, 9)), device, BROAD
            )
        )
    middle = np.array([projections.line_integrals[0, 4, 4] for projections in found])
    water = [materials.attenuation("water", energy) for energy in (25.0, 40.0, 60.0, 85.0)]
    shares = np.array([1, 3, 2, 1]) / 7
    expected = [
        -np.log(sum(share * np.exp(-mu * t) for share, mu in zip(shares, water, strict=True)))
        for t in thicknesses
    ]
    np.testing.assert_allclose(middle[1:], expected[1:], rtol=2e-5)
    assert middle[0] / thicknesses[0] == pytest.approx(shares @ water, rel=0.02)
    assert (np.diff(middle) > 0).all()
    assert (np.diff(middle[1:] / thicknesses[1:]) < 0).all()
    oblique = projector.project_spectrum(
        Phantom((made_of("s", "water", slabs[-1]),)), looking_along_z((9, 9), 4.0), device, BROAD
    )
    slant = np.sqrt(1 + (4 / 4) ** 2) * 0.6
    np.testing.assert_allclose(
        oblique.line_integrals[0, 4, 8],
        -np.log(sum(s * np.exp(-m * slant) for s, m in zip(shares, water, strict=True))),
        rtol=2e-5,
    )


@pytest.mark.peer
def test_images_agree_with_gvirtualxray(device, agree):
    """On nested lumpy balls; gVirtualXray rasterises in float32 and keeps 1000 photons a pixel,
    hence the margin.
    """
    python = os.environ.get("LEGSIM_GVXR_PYTHON") or (
        sys.executable if importlib.util.find_spec("gvxrPython3") else None
    )
    if python is None:
        pytest.skip(
            "gVirtualXray is not installed (pip install gvxr here, or name a Python that has it "
            "in LEGSIM_GVXR_PYTHON)"
        )
    starts = subprocess.run([python, "-c", "import gvxrPython3"], capture_output=True, text=True)
    if starts.returncode:
        # its wheel leaves libraries of the display to the system
        pytest.skip(f"gVirtualXray does not start: {starts.stderr.strip().splitlines()[-1]}")
    from tools.benchmarks import projection as bench_project

    phantom, geometry = bench_project.scene("1e4"), bench_project.scan(3)
    ours = projector.project(phantom, geometry, device).line_integrals
    theirs, _ = bench_project.gvxr_images(phantom, geometry, python)
    difference = np.abs(ours - theirs) / bench_project.ATTENUATIONS[0]
    agree("projections, mean by the path", "gVirtualXray", 1e3 * difference.mean(), 0.01, "mm")
    far = 1e3 * np.quantile(difference, 0.999)
    agree("projections, 99.9 % within", "gVirtualXray", far, 1.0, "mm")


@pytest.mark.parametrize(
    ("group", "local", "cpu"), [(64, 1 << 15, False), (32, 1 << 15, False), (16, 2048, True)]
)
def test_images_are_the_same_on_devices_of_small_groups_and_little_local_memory(
    device, monkeypatch, group, local, cpu
):
    """To the last bit: only who computes what changes, and crossings that do not fit are redone."""
    shells = [sphere(f"shell {k}", 0.08 - 0.01 * k, np.zeros(3), 20.0 + k, 3) for k in range(5)]
    phantom, geometry = Phantom(tuple(shells)), circular(2)
    usual = projector.project(phantom, geometry, device).line_integrals
    assert usual.max() > 1
    monkeypatch.setattr(Device, "group_size", group)
    monkeypatch.setattr(Device, "local_bytes", local)
    monkeypatch.setattr(Device, "is_cpu", cpu)
    images = projector.project(phantom, geometry, device).line_integrals
    np.testing.assert_array_equal(images, usual)
