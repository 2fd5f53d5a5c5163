"""The kernels against their plain float64 twin, and against each other where motion enters."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from legsim.core import transforms
from legsim.deformation import moving_least_squares
from legsim.deformation.models import ControlPointMotion, FieldMotion, Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl import device as opencl_device
from legsim.opencl import textures
from legsim.opencl.device import Device
from legsim.reconstruction import _backprojection_plan, backprojection
from legsim.reconstruction._backprojection_plan import Kernel
from tests.references.backprojection import backproject as reference
from tests.references.backprojection import backproject_moved as reference_moved
from tests.references.backprojection import steepest

VIEWS = 9
KERNELS: tuple[Kernel, ...] = ("voxels", "columns", "textures")
EXACT: tuple[Kernel, ...] = ("voxels", "textures")
"""Kernels that read images bilinearly at the voxels themselves"""


def scan(
    *, shape_vu: tuple[int, int] = (40, 50), pixel_pitch: float = 6e-3, turn: float = 4.0
) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(VIEWS) * 1.0,
        angles=np.linspace(0, turn, VIEWS),
        source_isocenter=0.5,
        source_detector=0.9,
        shape_vu=shape_vu,
        pixel_pitch=pixel_pitch,
    )


def tilts(rng: np.random.Generator, size: float = 0.1) -> np.ndarray:
    return transforms.rigid(
        transforms.rotation_from_vector(rng.normal(0, size, (VIEWS, 3))),
        rng.normal(0, 0.01, (VIEWS, 3)),
    )


def noise(
    rng: np.random.Generator, shape_vu: tuple[int, int] = (40, 50), smooth: float = 0.0
) -> np.ndarray:
    return gaussian_filter(rng.normal(size=(VIEWS, *shape_vu)), (0, smooth, smooth)).astype(
        np.float32
    )


def back_projected(
    images: np.ndarray,
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    *,
    kernel: Kernel | None = None,
    motion: Motion | None = None,
    slab_bytes: int = 1 << 28,
) -> np.ndarray:
    decided = _backprojection_plan.plan(
        geometry, grid, device, motion=motion, kernel=kernel, slab_bytes=slab_bytes
    )
    arranged = backprojection.arranged(images, np.array(decided.mirrored))
    batches = [(slice(0, 4), arranged[:4]), (slice(4, VIEWS), arranged[4:])]
    slabs = list(backprojection.slabs(batches, geometry, grid, device, decided, motion=motion))
    assert [start for start, _ in slabs] == list(range(0, grid.shape_zyx[0], decided.slab))
    return np.concatenate([slab for _, slab in slabs])


def places_off(device: Device, kernel: Kernel) -> float:
    """Pixels by which the kernel's places may be off: CPUs know them to float32, texture units of
    GPUs in 1/256, rounded or cut off.
    """
    if kernel != "textures":
        return 0.0
    off = textures.check(device.candidate).off
    return next(most for most in (0.0, 1 / 512, 1 / 256) if off < most + 2e-4)


def assert_near(
    found: np.ndarray, expected: np.ndarray, share: float, allowed: np.ndarray | float = 0.0
) -> None:
    """To a share of the peak, and what is allowed beside."""
    assert found.shape == expected.shape
    assert (np.abs(found - expected) <= share * np.abs(expected).max() + allowed).all()


GRIDS = {
    "inside": VolumeGrid((7, 9, 11), (0.006, 0.005, 0.004), (0.01, -0.02, 0.015)),
    "fine": VolumeGrid((5, 37, 6), (0.004, 0.001, 0.004), (0.01, -0.02, 0.015)),
    "larger than what the detector sees": VolumeGrid(
        (15, 133, 17), (0.02, 0.004, 0.02), (0.02, 0.01, 0.0)
    ),
    "one voxel": VolumeGrid((1, 1, 1), (0.005, 0.005, 0.005), (0.02, 0.03, 0.01)),
}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_every_voxel_gets_what_the_plain_reference_says(
    device: Device, rng: np.random.Generator, grid: VolumeGrid, kernel: Kernel
) -> None:
    images, geometry = noise(rng), scan()
    expected = reference(images, geometry.matrices, grid)
    found = back_projected(images, geometry, grid, device, kernel=kernel)
    allowed = places_off(device, kernel) * steepest(images, geometry.matrices, grid)
    assert_near(found, expected, 2e-4, allowed)


@pytest.mark.parametrize("kernel", EXACT)
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_tilted_views_too(
    device: Device, rng: np.random.Generator, grid: VolumeGrid, kernel: Kernel
) -> None:
    images, geometry = noise(rng), scan().moved(tilts(rng))
    expected = reference(images, geometry.matrices, grid)
    found = back_projected(images, geometry, grid, device, kernel=kernel)
    allowed = places_off(device, kernel) * steepest(images, geometry.matrices, grid)
    assert_near(found, expected, 2e-4, allowed)


@pytest.mark.parametrize("size", [0.02, 0.1])
def test_columns_follow_tilted_views_to_a_part_of_the_interpolation(
    device: Device, rng: np.random.Generator, size: float
) -> None:
    # lines across the detector are interpolated along themselves, not along the pixels' axes: the
    # difference is of second order
    grid = VolumeGrid((10, 60, 12), (0.003, 0.003, 0.003), (0.01, -0.01, 0.0))
    images, geometry = (
        noise(rng, (80, 100), smooth=2.0),
        scan(shape_vu=(80, 100), pixel_pitch=4e-3).moved(tilts(rng, size)),
    )
    expected = reference(images, geometry.matrices, grid)
    found = back_projected(images, geometry, grid, device, kernel="columns")
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.01 * expected.std()


def test_a_grid_behind_the_source_is_finite_and_gets_nothing_from_behind(
    device: Device, rng: np.random.Generator
) -> None:
    geometry, grid = scan(), VolumeGrid((25, 3, 25), (0.08, 0.05, 0.08), (0.0, 0.0, 0.0))
    images = noise(rng)
    expected, found = (
        reference(images, geometry.matrices, grid),
        back_projected(images, geometry, grid, device),
    )
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    _, depths = geometry.project(np.stack([x, y, z], -1).reshape(-1, 3))
    far = (np.abs(depths).min(0) > 0.1).reshape(
        grid.shape_zyx
    )  # near a source 1 / depth^2 blows up the rounding
    kernel = _backprojection_plan.plan(geometry, grid, device).kernel
    allowed = places_off(device, kernel) * steepest(images, geometry.matrices, grid)
    assert_near(found[far], expected[far], 2e-4, allowed[far])
    assert np.isfinite(found).all()


@pytest.mark.parametrize("kernel", KERNELS)
def test_slabs_do_not_change_the_volume(
    device: Device, rng: np.random.Generator, kernel: Kernel
) -> None:
    geometry, grid, images = scan().moved(tilts(rng, 0.02)), GRIDS["fine"], noise(rng)
    whole = back_projected(images, geometry, grid, device, kernel=kernel)
    slabs = back_projected(
        images, geometry, grid, device, kernel=kernel, slab_bytes=2 * 4 * 45 * 14
    )
    # a place next to where it is rounded up may be rounded down in the other
    allowed = 2 * places_off(device, kernel) * steepest(images, geometry.matrices, grid)
    assert_near(slabs, whole, 1e-4, allowed)


# turns that carry the axis of rotation from y to x and to z, rows reversed, and a detector that
# lies on its side
TURNS = {
    "about x": [0, 0, -np.pi / 2],
    "about z": [np.pi / 2, 0, 0],
    "upside down": [0, 0, np.pi],
    "mirrored": [np.pi, 0, 0],
}


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
def test_columns_run_along_whatever_axis_the_detector_follows(
    device: Device, rng: np.random.Generator, turn: list[float]
) -> None:
    placed = transforms.rigid(transforms.rotation_from_vector(turn), [0.02, 0.01, -0.01])
    geometry = scan().moved(transforms.inverse(placed))
    grid, images = VolumeGrid((13, 12, 11), (0.004, 0.004, 0.004), (0.02, 0.0, 0.01)), noise(rng)
    decided = _backprojection_plan.plan(geometry, grid, device, kernel="columns")
    assert decided.column_axis == int(np.argmax(np.abs(placed[:3, 1])))
    expected = reference(images, geometry.matrices, grid)
    for slab_bytes in (1 << 28, 4 * 4 * 20 * 19):
        found = back_projected(
            images, geometry, grid, device, kernel="columns", slab_bytes=slab_bytes
        )
        np.testing.assert_allclose(found, expected, atol=3e-4 * np.abs(expected).max())


def test_one_pixel_lands_on_its_ray(device: Device, rng: np.random.Generator) -> None:
    geometry = scan().moved(tilts(rng))
    images = np.zeros((VIEWS, 40, 50), np.float32)
    images[3, 22, 31] = 1.0
    grid = VolumeGrid.cubic(41, 0.004, (0.0, 0.0, 0.0))
    volume = back_projected(images, geometry, grid, device)
    z, y, x = np.nonzero(volume)
    points = np.stack([axis[index] for axis, index in zip(grid.axes(), (x, y, z), strict=True)], -1)
    pixels, _ = geometry[3:4].project(points)
    assert len(points) > 50
    assert np.abs(pixels[0] - [31, 22]).max() < 1.25


JOINTS = np.array([[0.0, 0.25, -0.03], [0.03, 0.0, 0.0], [-0.02, -0.25, 0.02]])
FINE = VolumeGrid((16, 40, 18), (0.002, 0.002, 0.002), (0.01, -0.005, 0.0))


def bending(rng: np.random.Generator, times: np.ndarray) -> ControlPointMotion:
    return ControlPointMotion(times, JOINTS, JOINTS + rng.normal(0, 0.01, (len(times), 3, 3)))


def as_field(motion: ControlPointMotion, spacing: float) -> FieldMotion:
    nodes = VolumeGrid((9, 17, 9), (spacing,) * 3, FINE.center)
    z, y, x = np.meshgrid(*nodes.axes()[::-1], indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    fields = [
        moving_least_squares.warp_points(points, motion.reference, moved) - points
        for moved in motion.moved
    ]
    return FieldMotion(
        motion.times,
        nodes,
        np.reshape(fields, (len(fields), *nodes.shape_zyx, 3)).astype(np.float32),
    )


@pytest.mark.parametrize("kernel", KERNELS)
def test_voxels_follow_moving_least_squares(
    device: Device, rng: np.random.Generator, kernel: Kernel
) -> None:
    geometry, images = scan(shape_vu=(80, 100), pixel_pitch=3e-3), noise(rng, (80, 100), smooth=2.0)
    motion = bending(rng, geometry.times)

    def moved(points: np.ndarray, view: int) -> np.ndarray:
        return moving_least_squares.warp_points(points, motion.reference, motion.moved[view])

    expected = reference_moved(images, geometry.matrices, FINE, moved)
    found = back_projected(images, geometry, FINE, device, kernel=kernel, motion=motion)
    if kernel == "columns":
        assert np.sqrt(np.mean((found - expected) ** 2)) < 0.02 * expected.std()
    else:
        allowed = places_off(device, kernel) * steepest(images, geometry.matrices, FINE, moved)
        assert_near(found, expected, 2e-4, allowed)


@pytest.mark.parametrize("kernel", KERNELS)
def test_voxels_follow_a_sampled_field(
    device: Device, rng: np.random.Generator, kernel: Kernel
) -> None:
    geometry, images = scan(shape_vu=(80, 100), pixel_pitch=3e-3), noise(rng, (80, 100), smooth=2.0)
    motion = bending(rng, geometry.times)
    field = as_field(motion, 0.006)
    exact = back_projected(images, geometry, FINE, device, kernel="voxels", motion=motion)
    found = back_projected(images, geometry, FINE, device, kernel=kernel, motion=field)
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.02 * exact.std()


COARSE = VolumeGrid((26, 24, 27), (0.005, 0.004, 0.005), (0.01, 0.0, -0.005))


def in_three_kinds(moved: np.ndarray, times: np.ndarray) -> dict[str, Motion]:
    """The same rigid motion of everything as matrices, as three points that it carries, and as
    displacements, linear as they are.
    """
    nodes = VolumeGrid((2, 3, 2), (0.2, 0.1, 0.2), (0.0, 0.0, 0.0))
    z, y, x = np.meshgrid(*nodes.axes()[::-1], indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    shifts = (transforms.apply(moved, points) - points).reshape(len(times), *nodes.shape_zyx, 3)
    return {
        "rigid": RigidMotion(times, moved),
        "points": ControlPointMotion(times, JOINTS, transforms.apply(moved, JOINTS)),
        "field": FieldMotion(times, nodes, shifts.astype(np.float32)),
    }


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_motion_that_moves_all_alike_is_the_rigid_one_to_rounding(
    device: Device, rng: np.random.Generator, kernel: Kernel
) -> None:
    geometry, images = scan(), noise(rng, smooth=1.0)
    motions = in_three_kinds(tilts(rng, 0.05), geometry.times)
    rigid = back_projected(
        images, geometry, COARSE, device, kernel=kernel, motion=motions.pop("rigid")
    )
    carry = motions["points"].carry
    allowed = (
        2
        * places_off(device, kernel)
        * steepest(images, geometry.matrices, COARSE, lambda points, i: carry(points)[i])
    )
    for motion in motions.values():
        found = back_projected(images, geometry, COARSE, device, kernel=kernel, motion=motion)
        assert_near(found, rigid, 2e-5, allowed)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_motion_that_moves_nothing_changes_nothing(
    device: Device, rng: np.random.Generator, kernel: Kernel
) -> None:
    geometry, images = scan(), noise(rng, smooth=1.0)
    still = back_projected(images, geometry, COARSE, device, kernel=kernel)
    identity = in_three_kinds(np.broadcast_to(np.eye(4), (VIEWS, 4, 4)), geometry.times)
    np.testing.assert_array_equal(
        back_projected(images, geometry, COARSE, device, kernel=kernel, motion=identity["rigid"]),
        still,
    )
    allowed = 2 * places_off(device, kernel) * steepest(images, geometry.matrices, COARSE)
    for motion in identity.values():
        found = back_projected(images, geometry, COARSE, device, kernel=kernel, motion=motion)
        assert_near(found, still, 2e-5, allowed)


@pytest.mark.parametrize("tilt", [1e-6, 1e-5, 1e-4, 1e-3])
def test_columns_leave_the_reference_gradually_as_motion_begins(
    device: Device, rng: np.random.Generator, tilt: float
) -> None:
    """The circular scan, straight lines and curves have loops of their own; none of them may begin
    with a jump.
    """
    geometry, images = scan(), noise(rng, smooth=1.0)
    turned = transforms.rigid(
        transforms.rotation_from_vector(tilt * rng.normal(size=(VIEWS, 3))), np.zeros((VIEWS, 3))
    )
    for motion in in_three_kinds(turned, geometry.times).values():
        expected, found = (
            back_projected(images, geometry, COARSE, device, kernel=kernel, motion=motion)
            for kernel in ("voxels", "columns")
        )
        np.testing.assert_allclose(found, expected, atol=(2e-5 + tilt) * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["rigid", "points", "field"])
def test_rounded_places_cost_what_the_slopes_say(
    device: Device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Texture units of GPUs know places in a pixel to 8 bits. The bound that other tests allow for
    them holds for a kernel that rounds its places so, and is no wider than needed.
    """
    geometry, images = scan(), noise(rng)
    motion = in_three_kinds(tilts(rng, 0.05), geometry.times)[kind]
    exact = back_projected(images, geometry, COARSE, device, kernel="voxels", motion=motion)
    plain = backprojection.VoxelMap.kernel
    monkeypatch.setattr(
        backprojection.VoxelMap,
        "kernel",
        lambda self, *names, **defines: plain(self, *names, **defines, FRACTIONS=256),
    )
    rounded = back_projected(images, geometry, COARSE, device, kernel="voxels", motion=motion)
    most = steepest(images, geometry.matrices, COARSE, lambda points, i: motion.carry(points)[i])
    assert_near(rounded, exact, 2e-5, most / 512)
    seen = most > 0
    assert np.max(np.abs(rounded - exact)[seen] / most[seen]) > 0.3 / 512


@pytest.mark.parametrize("kind", ["still", "rigid", "points", "field"])
@pytest.mark.parametrize("shape_vu", [(40, 50), (1, 50), (40, 1), (1, 1)])
def test_textures_and_buffers_give_the_same(
    device: Device, rng: np.random.Generator, kind: str, shape_vu: tuple[int, int]
) -> None:
    geometry, images = scan(shape_vu=shape_vu, pixel_pitch=0.02), noise(rng, shape_vu)
    motion = {**in_three_kinds(tilts(rng, 0.05), geometry.times), "still": None}[kind]

    def moved(points: np.ndarray, view: int) -> np.ndarray:
        return points if motion is None else motion.carry(points)[view]

    buffers, found = (
        back_projected(images, geometry, COARSE, device, kernel=kernel, motion=motion)
        for kernel in EXACT
    )
    assert buffers.any()
    allowed = places_off(device, "textures") * steepest(images, geometry.matrices, COARSE, moved)
    assert_near(found, buffers, 2e-5, allowed)


@pytest.mark.parametrize("layers", [1, 2, 5])
@pytest.mark.parametrize("views_bytes", [1.0, 3.9])
def test_more_views_than_an_array_of_images_takes_give_the_same_digits(
    device: Device,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    layers: int,
    views_bytes: float,
) -> None:
    geometry, images = scan(), noise(rng)
    motion = RigidMotion(geometry.times, tilts(rng, 0.05))
    options = {"kernel": "textures", "motion": motion, "slab_bytes": 9 * 4 * 32 * 35}
    expected = back_projected(images, geometry, COARSE, device, **options)
    view = 4 * (50 + 2 * _backprojection_plan.PAD) * _backprojection_plan.stride(40)
    limits = textures.ImageLimits(16384, 16384, layers, int(views_bytes * view))
    monkeypatch.setattr(Device, "image_limits", limits)
    decided = _backprojection_plan.plan(geometry, COARSE, device, kernel="textures")
    assert decided.batch == min(layers, int(views_bytes))
    found = back_projected(images, geometry, COARSE, device, **options)
    assert_near(found, expected, 1e-6)


@pytest.mark.parametrize("group", [1, 8, 256])
def test_every_voxel_has_its_work_item_whatever_the_size_of_groups(
    device: Device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, group: int
) -> None:
    """A work-item has several voxels of a line: 301 of them are no multiple of anything."""
    monkeypatch.setattr(opencl_device, "_GROUP", group)
    grid = VolumeGrid((2, 301, 3), (0.004, 0.0005, 0.004), (0.01, -0.01, 0.015))
    images, geometry = noise(rng), scan().moved(tilts(rng))
    expected = reference(images, geometry.matrices, grid)
    found = back_projected(images, geometry, grid, device, kernel="textures")
    allowed = places_off(device, "textures") * steepest(images, geometry.matrices, grid)
    assert_near(found, expected, 2e-4, allowed)
