"""What is cut off at a plane is closed, and has the volume of what is left; the projector sees the
part in front of the source.
"""

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom import clipping, winding
from legsim.phantom.meshes import Part, Phantom
from legsim.phantom.raster import require_closed
from legsim.scan import projector
from tests.examples.bodies import circular, looking_along_z, part, sphere


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def cut(mesh: trimesh.Trimesh, normal, nearest: float) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.asarray(mesh.vertices)
    return clipping.in_front(vertices, np.asarray(mesh.faces), vertices @ normal, nearest)


@pytest.mark.parametrize("height", [-0.9, -0.2, 0.0, 0.31, 0.9])
def test_a_ball_is_cut_to_its_cap(height):
    vertices, triangles = cut(trimesh.creation.icosphere(5, 1.0), [0, 0.6, 0.8], height)
    require_closed(Part("ball", "water", 1.0, vertices, triangles))
    assert (vertices[np.unique(triangles)] @ [0, 0.6, 0.8]).min() > height - 1e-12
    cap = np.pi * (1 - height) ** 2 * (2 + height) / 3
    sag = 2e-4 * 2 * np.pi * (1 - height)  # of flat triangles, times the area
    assert volume(vertices, triangles) == pytest.approx(cap, abs=sag)


def test_a_cut_of_several_rings_is_closed_by_one_fan():
    """Two legs and a hollow between them: three rings, and one that faces inwards."""
    legs = [trimesh.creation.box((0.2, 0.2, 1.0)).apply_translation([x, 0, 0]) for x in (-1, 1)]
    shell = trimesh.creation.icosphere(3, 0.5)
    hollow = trimesh.creation.icosphere(3, 0.4)
    hollow.invert()
    mesh = trimesh.util.concatenate([*legs, shell, hollow])
    assert isinstance(mesh, trimesh.Trimesh)
    vertices, triangles = cut(mesh, [0, 0, 1.0], 0.0)
    require_closed(Part("legs", "water", 1.0, vertices, triangles))
    assert volume(vertices, triangles) == pytest.approx(
        0.5 * volume(np.asarray(mesh.vertices), np.asarray(mesh.faces)), rel=1e-9
    )
    for point, inside in (
        ((-1, 0, 0.2), True),
        ((1.05, 0.05, 0.4), True),
        ((0, 0, 0.2), False),
        ((0, 0, 0.45), True),
        ((0.7, 0, 0.01), False),
        ((-1, 0, -0.2), False),
    ):
        assert winding.numbers(vertices, triangles, np.array([point], float))[0] == inside


def test_a_plane_through_vertices_leaves_no_hole():
    box = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide()
    for height in (0.0, -0.5):
        vertices, triangles = cut(box, [0, 0, 1.0], height)
        require_closed(Part("box", "water", 1.0, vertices, triangles))
        assert volume(vertices, triangles) == pytest.approx(0.5 - height, abs=1e-12)


def test_all_or_nothing_is_left_where_the_plane_is_beside():
    ball = trimesh.creation.icosphere(2, 1.0)
    assert len(cut(ball, [1.0, 0, 0], -2.0)[1]) == len(ball.faces)
    assert len(cut(ball, [1.0, 0, 0], 2.0)[1]) == 0


WORST = 2e-5
"""m of path length: what the project promises of the projector"""


def test_source_inside_the_phantom_is_refused(device):
    geometry = circular()[1:2]
    with pytest.raises(LegsimError, match=r"view 0: the source is inside of part 'a'"):
        projector.project(Phantom((sphere("a", 0.3, geometry.sources()[0]),)), geometry, device)


def test_a_source_in_the_hollow_of_a_part_is_no_obstacle(device):
    """A shell about the source: its bounding box holds the source, its wall does not."""
    geometry = looking_along_z((32, 32))
    outer, inner = (trimesh.creation.icosphere(4, radius) for radius in (0.5, 0.3))
    inner.invert()
    shell = part("a", trimesh.util.concatenate([outer, inner]), 10.0)
    image = projector.project(Phantom((shell,)), geometry, device).line_integrals
    np.testing.assert_allclose(image, 10 * 0.2, rtol=5e-3)  # the faces of the spheres are flat


def chords(geometry: ConeBeamGeometry, view: int, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Lengths (rows, columns) m of the rays within a box, from the source on."""
    v, u = np.mgrid[: geometry.shape_vu[0], : geometry.shape_vu[1]]
    rays = geometry.ray_directions(u, v)[view]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    source = geometry.sources()[view]
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(low - source) / rays, (high - source) / rays]), axis=0)
    return np.maximum(ends[1].min(-1) - np.maximum(ends[0].max(-1), 0), 0)


@pytest.mark.parametrize(
    ("views", "size", "middle"),
    [
        (1, (1.0, 1.0, 2.5), (0.6, 0.0, 0.0)),  # a wall beside the source
        (1, (0.2, 0.2, 5.0), (-0.2, 0.05, 0.5)),  # a bar past it
        (3, (3.0, 1.0, 3.0), (0.0, -0.6, 0.0)),  # the floor
    ],
)
def test_of_what_reaches_behind_the_source_the_part_in_front_is_projected(
    device, views, size, middle
):
    """Two triangles a side, so that those that rays meet reach behind the source too."""
    geometry = circular(views, pitch=1.5e-2)
    box = part("a", trimesh.creation.box(size), 10.0, transforms.translation(middle))
    ball = sphere("b", 0.05, (0.0, 0.15, 0.0), attenuation=25.0)
    images, alone = (
        projector.project(Phantom(parts), geometry, device).line_integrals
        for parts in ((ball, box), (ball,))
    )
    low, high = np.array(middle) - np.array(size) / 2, np.array(middle) + np.array(size) / 2
    assert (geometry.project(trimesh.creation.box(bounds=[low, high]).vertices)[1] < 0).any()
    for view, image in enumerate(images):
        lengths = chords(geometry, view, low, high)
        aside = alone[view] == 0
        np.testing.assert_allclose(image[aside], 10 * lengths[aside], atol=10 * WORST)
        assert (lengths > 0).mean() > 0.02


@pytest.mark.parametrize("place", [(0.0, 0.0, 1.5), (0.0, 1.4, 0.0)], ids=["behind", "above"])
def test_parts_behind_the_source_that_no_ray_meets_are_no_obstacle(device, place):
    """A part behind the source of the first view alone, and one that reaches behind all, above."""
    size = (0.2, 0.2, 0.2) if place[2] else (2.0, 0.2, 2.0)
    other = part("b", trimesh.creation.box(size), 10.0, transforms.rigid(np.eye(3), place))
    ball = sphere("a", 0.05, (0, 0, 0))
    geometry = circular()[:2] if place[2] else circular()
    together = projector.project(Phantom((ball, other)), geometry, device).line_integrals
    alone = projector.project(Phantom((ball,)), geometry, device).line_integrals
    np.testing.assert_allclose(together, alone, atol=1e-5)
    assert together.max() > 0


def bar(end: float) -> trimesh.Trimesh:
    """Of fine triangles, from beyond the middle ray aslant to the left, ``end`` m towards -x, -z.

    Beyond 1.1 m it is behind the source of :func:`looking_along_z`.
    """
    mesh = trimesh.creation.box((0.05, 0.05, 0.3 + end))
    mesh.apply_translation([0, 0, 0.5 * (0.3 - end)])
    for _ in range(6):
        mesh = mesh.subdivide()
    turned = transforms.rotation_from_vector([0, np.pi / 4, 0])
    mesh.apply_transform(transforms.rigid(turned, [0.0, 0.1, 0.8]))
    return mesh


def test_what_of_a_part_is_behind_the_source_where_no_ray_meets_it_is_no_obstacle(device):
    """The bar reaches behind beside the rays: the image is that of a bar which ends before."""
    geometry = looking_along_z((48, 64))
    whole, short = bar(1.7), bar(1.0)
    assert whole.vertices[:, 2].min() < -0.3
    assert short.vertices[:, 2].min() > 0.05
    found, expected = (
        projector.project(Phantom((part("bar", mesh, 10.0),)), geometry, device).line_integrals
        for mesh in (whole, short)
    )
    np.testing.assert_allclose(found, expected, atol=10 * WORST)
    assert (expected > 0).mean() > 0.05
