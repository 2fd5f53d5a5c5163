"""Derivatives of back-projected volumes: against float64 references, finite differences, FDK."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import ControlPointMotion, FieldMotion, Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import image_gradient
from legsim.reconstruction.fdk import FdkOptions, fdk
from legsim.reconstruction.image_gradient import FilteredScan, filtered_scan
from tests.references import image_gradient as reference
from tests.references.backprojection import Ellipsoid, back_projected_at, project

# taller than the detector sees, so that voxels fall beyond its edges; counts that no block divides
GRID = VolumeGrid((13, 38, 17), (0.005, 0.004, 0.006), (0.008, 0.004, -0.006))
VIEWS = 37


def scan(turn: np.ndarray | None = None) -> ConeBeamGeometry:
    geometry = ConeBeamGeometry.circular(
        times=np.arange(VIEWS) / 30,
        angles=np.linspace(0, 2 * np.pi, VIEWS, endpoint=False),
        source_isocenter=0.5,
        source_detector=0.9,
        shape_vu=(24, 30),
        pixel_pitch=8e-3,
    )
    return geometry if turn is None else geometry.moved(about_middle(turn))


def about_middle(turn: np.ndarray) -> np.ndarray:
    return transforms.rigid(transforms.rotation_from_vector(turn), np.zeros(3))


def swaying(rng: np.random.Generator, times: np.ndarray) -> RigidMotion:
    turns, shifts = rng.normal(0, 0.05, (len(times), 3)), rng.normal(0, 0.005, (len(times), 3))
    return RigidMotion(times, transforms.rigid(transforms.rotation_from_vector(turns), shifts))


def bending(rng: np.random.Generator, times: np.ndarray) -> FieldMotion:
    """On nodes that end before the volume does."""
    nodes = VolumeGrid((5, 6, 4), (0.012, 0.021, 0.017), (0.003, 0.0, 0.002))
    sizes = (len(times), *nodes.shape_zyx, 3)
    return FieldMotion(times, nodes, rng.normal(0, 0.006, sizes).astype(np.float32))


def noise(rng: np.random.Generator, device: Device, geometry: ConeBeamGeometry) -> FilteredScan:
    """Smooth noise up to the detector's edges."""
    images = rng.normal(0, 1, (VIEWS, *geometry.shape_vu))
    smooth = ndimage.gaussian_filter(images, (0, 1.5, 1.5)).astype(np.float32)
    return filtered_scan(Projections(geometry, smooth), GRID, device=device)


def smooth_slopes(
    rng: np.random.Generator, geometry: ConeBeamGeometry, motion: Motion | None = None
) -> np.ndarray:
    """(z, y, x) float32, 0 where a voxel is nearer than 1e-4 px to a pixel's edge in any view.

    There the bilinear image has a kink, and single precision does not say on which side a voxel is.
    """
    noise = ndimage.gaussian_filter(rng.normal(0, 1, GRID.shape_zyx), 2.0)
    points = GRID.positions() if motion is None else motion.carry(GRID.positions())
    pixels, _ = geometry.project(points)
    clear = (np.abs(pixels - np.round(pixels)) > 1e-4).all((0, 2)).reshape(noise.shape)
    assert clear.mean() > 0.9
    return np.where(clear, noise, 0.0).astype(np.float32)


def images_of(found: FilteredScan) -> np.ndarray:
    """(v, rows, columns) float64 of the filtered images: single views back-projected by pixels."""
    from legsim.reconstruction._backprojection_plan import LEAD, PAD, stride

    rows, columns = found.geometry.shape_vu
    buffer = np.empty((VIEWS, columns + 2 * PAD, stride(rows)), np.float32)
    found.device.download(found._images, buffer)
    return buffer[:, PAD : PAD + columns, LEAD : LEAD + rows].transpose(0, 2, 1).astype(float)


def of_reference(
    images: np.ndarray, matrices: np.ndarray, points: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """(v,) shares of the views in a criterion with these slopes, in float64."""
    points = np.broadcast_to(points, (VIEWS, *points.shape[-2:]))
    ends = np.concatenate([points, np.ones((*points.shape[:2], 1))], -1)
    return np.array(
        [
            (slopes * back_projected_at(image, end @ matrix.T)).sum()
            for image, end, matrix in zip(images, ends, matrices, strict=True)
        ]
    )


def central(of: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    return (of(step) - of(-step)) / (2 * step)


def assert_alike(found: np.ndarray, expected: np.ndarray) -> None:
    """To 1e-4 of the greatest of all views, entry by entry."""
    size = np.abs(expected).max(0, keepdims=True)
    assert (np.abs(found - expected) < 1e-4 * size + 1e-9 * size.max()).all()


TURNS = {
    "upright": None,
    "turned": np.array([0.31, 0.52, 0.17]),
    "upside down": np.array([np.pi, 0.1, 0]),
    "lying": np.array([0, 0, 1.4]),
}


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS.keys())
@pytest.mark.parametrize("moving", [False, True])
def test_derivatives_by_matrices_are_those_of_the_references(
    device: Device, rng: np.random.Generator, turn: np.ndarray | None, moving: bool
) -> None:
    geometry = scan(turn)
    filtered = noise(rng, device, geometry)
    motion = swaying(rng, geometry.times) if moving else RigidMotion.identity(geometry.times)
    slopes = smooth_slopes(rng, geometry, motion)
    found = filtered.gradient(GRID, slopes, motion if moving else None).by_matrices
    images, q, points = (
        images_of(filtered),
        slopes.ravel().astype(float),
        motion.carry(GRID.positions()),
    )
    exact = reference.by_matrices(images, geometry.matrices, points, q)
    assert_alike(found, exact)
    differences = np.empty_like(exact)
    for entry in np.ndindex(3, 4):
        one = np.zeros((3, 4))
        one[entry] = np.abs(geometry.matrices[:, entry[0]]).max()

        def of(size: float, one: np.ndarray = one) -> np.ndarray:
            return of_reference(images, geometry.matrices + size * one, points, q)

        differences[:, *entry] = central(of, 1e-9) / one[entry]
    assert_alike(found, differences)


def test_derivatives_by_motion_are_finite_differences(
    device: Device, rng: np.random.Generator
) -> None:
    geometry = scan()
    filtered, motion = noise(rng, device, geometry), swaying(rng, geometry.times)
    slopes = smooth_slopes(rng, geometry, motion)
    found = filtered.gradient(GRID, slopes, motion)
    images, points, q = images_of(filtered), GRID.positions(), slopes.ravel().astype(float)
    twists = np.empty((VIEWS, 6))
    for k, one in enumerate(np.eye(6)):

        def of(size: float, one: np.ndarray = one) -> np.ndarray:
            turn = transforms.rotation_from_vector(size * one[:3])
            moved = transforms.rigid(turn, size * one[3:]) @ motion.moved_from_reference
            return of_reference(images, geometry.matrices, transforms.apply(moved, points), q)

        twists[:, k] = central(of, 1e-8)
    assert_alike(found.by_twists(), twists)
    entries = np.zeros((VIEWS, 4, 4))
    for entry in np.ndindex(3, 4):
        one = np.zeros((4, 4))
        one[entry] = 1.0

        def by_entry(size: float, one: np.ndarray = one) -> np.ndarray:
            moved = motion.moved_from_reference + size * one
            return of_reference(images, geometry.matrices, transforms.apply(moved, points), q)

        entries[:, *entry] = central(by_entry, 1e-8)
    assert found.by_motion is not None
    assert_alike(found.by_motion, entries)


def test_derivatives_by_a_field_are_finite_differences(
    device: Device, rng: np.random.Generator
) -> None:
    """At every node along random directions, and by the matrices."""
    geometry = scan()
    filtered, motion = noise(rng, device, geometry), bending(rng, geometry.times)
    slopes = smooth_slopes(rng, geometry, motion)
    found = filtered.gradient(GRID, slopes, motion)
    images, points, q = images_of(filtered), GRID.positions(), slopes.ravel().astype(float)
    exact = reference.by_matrices(images, geometry.matrices, motion.carry(points), q)
    assert_alike(found.by_matrices, exact)
    assert found.by_displacements is not None
    assert found.by_motion is None
    moved = motion.carry(points)
    for _ in range(12):
        direction = np.zeros(motion.displacements.shape)
        node = tuple(rng.integers(0, motion.grid.shape_zyx))
        direction[:, *node] = rng.normal(0, 1, (VIEWS, 3))
        by = replace(motion, displacements=direction.astype(np.float32)).carry(points) - points

        def of(size: float, by: np.ndarray = by) -> np.ndarray:
            return of_reference(images, geometry.matrices, moved + size * by, q)

        given = (found.by_displacements * direction.astype(np.float32)).sum((1, 2, 3, 4))
        size = np.abs(found.by_displacements).max()
        assert np.abs(given - central(of, 1e-8)).max() < 2e-4 * size


def test_a_field_that_moves_all_alike_has_the_gradient_of_the_shift(
    device: Device, rng: np.random.Generator
) -> None:
    geometry = scan()
    filtered, shifts = noise(rng, device, geometry), rng.normal(0, 0.004, (VIEWS, 3))
    rigidly = RigidMotion(geometry.times, transforms.translation(shifts))
    slopes = smooth_slopes(rng, geometry, rigidly)
    field = bending(rng, geometry.times)
    alike = np.broadcast_to(shifts[:, None, None, None], field.displacements.shape)
    along = filtered.gradient(GRID, slopes, replace(field, displacements=alike.astype(np.float32)))
    rigid = filtered.gradient(GRID, slopes, rigidly)
    assert along.by_displacements is not None
    assert_alike(along.by_displacements.sum((1, 2, 3)), rigid.by_twists()[:, 3:])
    assert_alike(along.by_matrices, rigid.by_matrices)


@pytest.mark.parametrize("kind", ["still", "rigid", "field", "tilted detector"])
def test_the_volume_is_that_of_fdk(device: Device, rng: np.random.Generator, kind: str) -> None:
    geometry = scan()
    if kind == "tilted detector":
        middle = np.array([[1, 0, 14.5], [0, 1, 11.5], [0, 0, 1]])
        turn = transforms.rotation_from_vector([0, 0, 0.4])
        geometry = replace(
            geometry, matrices=middle @ turn @ np.linalg.inv(middle) @ geometry.matrices
        )
    motions: dict[str, Motion] = {
        "rigid": swaying(rng, geometry.times),
        "field": bending(rng, geometry.times),
    }
    motion = motions.get(kind)
    images = rng.random((VIEWS, 24, 30), np.float32)
    projections = Projections(geometry, images)
    expected = fdk(
        projections, GRID, motion=motion, options=FdkOptions(kernel="voxels"), device=device
    )
    found = filtered_scan(projections, GRID, motion=motion, device=device).volume(GRID, motion)
    peak = np.abs(expected.attenuation).max()
    np.testing.assert_allclose(found.attenuation, expected.attenuation, atol=2e-5 * peak)


def test_a_tilted_detector_gives_derivatives_by_the_scanners_own_matrices(
    device: Device, rng: np.random.Generator
) -> None:
    """Its images are turned first; a change of the matrices changes them on the turned detector."""
    turn = transforms.rotation_from_vector([0, 0, 0.4])
    middle = np.array([[1, 0, 14.5], [0, 1, 11.5], [0, 0, 1]])
    geometry = scan()
    geometry = replace(geometry, matrices=middle @ turn @ np.linalg.inv(middle) @ geometry.matrices)
    filtered = noise(rng, device, geometry)
    assert filtered.geometry.shape_vu != geometry.shape_vu
    slopes = smooth_slopes(rng, filtered.geometry)
    found = filtered.gradient(GRID, slopes).by_matrices
    images, q = images_of(filtered), slopes.ravel().astype(float)
    change = rng.normal(0, 1, (VIEWS, 3, 4)) * [[[100.0]], [[100.0]], [[1.0]]][0]

    def of(size: float) -> np.ndarray:
        changed = filtered.from_scanner @ (geometry.matrices + size * change)
        return of_reference(images, changed, GRID.positions(), q)

    slope = central(of, 1e-8)
    assert np.abs((found * change).sum((1, 2)) - slope).max() < 1e-4 * np.abs(slope).max()


def test_a_criterion_gets_the_volume_and_gives_the_value(
    device: Device, rng: np.random.Generator
) -> None:
    """By finite differences of a criterion that is not linear, through the device's own volumes."""
    geometry = scan()
    filtered, motion = noise(rng, device, geometry), swaying(rng, geometry.times)

    def squares(volume: np.ndarray) -> tuple[float, np.ndarray]:
        return 0.5 * float((volume.astype(float) ** 2).sum()), volume

    found = image_gradient.image_gradient(filtered, GRID, squares, motion=motion)
    assert found.value == squares(filtered.volume(GRID, motion).attenuation)[0]
    twists = rng.normal(0, 1, (VIEWS, 6)) * [1, 1, 1, 0.03, 0.03, 0.03]

    def of(size: float) -> np.ndarray:
        turn = transforms.rotation_from_vector(size * twists[:, :3])
        moved = transforms.rigid(turn, size * twists[:, 3:]) @ motion.moved_from_reference
        images, points = images_of(filtered), GRID.positions()
        ends = transforms.apply(moved, points)
        ends = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], -1)
        shares = [
            back_projected_at(image, end @ matrix.T)
            for image, end, matrix in zip(images, ends, geometry.matrices, strict=True)
        ]
        return np.array(0.5 * (np.sum(shares, 0) ** 2).sum())

    slope = central(of, 1e-7)
    assert (found.by_twists() * twists).sum() == pytest.approx(float(slope), rel=3e-4)


def test_digits_are_the_same_every_time(device: Device, rng: np.random.Generator) -> None:
    filtered = noise(rng, device, scan())
    slopes = smooth_slopes(rng, scan())
    first, second = (filtered.gradient(GRID, slopes).by_matrices for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_only_voxels_with_a_slope_count(device: Device, rng: np.random.Generator) -> None:
    filtered = noise(rng, device, scan())
    slopes = np.zeros(GRID.shape_zyx, np.float32)
    assert not filtered.gradient(GRID, slopes).by_matrices.any()
    slopes[5, 20, 7] = 2.0
    one = GRID.positions().reshape(*GRID.shape_zyx, 3)[5, 20, 7][None]
    expected = reference.by_matrices(
        images_of(filtered), filtered.geometry.matrices, one, np.array([2.0])
    )
    assert_alike(filtered.gradient(GRID, slopes).by_matrices, expected)


def test_refusals(device: Device, rng: np.random.Generator) -> None:
    geometry = scan()
    filtered, slopes = noise(rng, device, geometry), np.ones(GRID.shape_zyx, np.float32)
    with pytest.raises(LegsimError, match=r"slopes have shape \(2, 2\)"):
        filtered.gradient(GRID, np.ones((2, 2), np.float32))
    with pytest.raises(LegsimError, match="no finite number"):
        filtered.gradient(GRID, np.full(GRID.shape_zyx, np.nan, np.float32))
    joints = rng.normal(0, 0.1, (3, 3))
    points = ControlPointMotion(geometry.times, joints, np.tile(joints, (VIEWS, 1, 1)))
    with pytest.raises(LegsimError, match="take its on_grid"):
        filtered.gradient(GRID, slopes, points)
    with pytest.raises(LegsimError, match="5 transforms for 37 views"):
        filtered.gradient(GRID, slopes, RigidMotion.identity(geometry.times[:5]))
    along = filtered.gradient(GRID, slopes, bending(rng, geometry.times))
    with pytest.raises(LegsimError, match="a field has no twists"):
        along.by_twists()


def test_the_example_finds_a_detectors_shift() -> None:
    """Ellipsoids whose images are exact; the scanner says a detector that is not where it was."""
    script = Path(__file__).parents[2] / "docs/examples/align_detector.py"
    spec = importlib.util.spec_from_file_location("align_detector", script)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    true = ConeBeamGeometry.circular(
        times=np.arange(90) / 30,
        angles=np.radians(np.arange(90) * 4.0),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(48, 64),
        pixel_pitch=4e-3,
    )
    solids = [
        Ellipsoid((0.0, 0.0, 0.0), (0.05, 0.03, 0.04), 20.0),
        Ellipsoid((0.02, 0.012, 0.01), (0.012, 0.01, 0.015), 25.0),
        Ellipsoid((-0.025, -0.01, -0.01), (0.008, 0.01, 0.01), 30.0),
    ]
    images = project(true, solids).line_integrals
    shift = np.array([[1, 0, -1.5], [0, 1, 0], [0, 0, 1]])
    said = replace(true, matrices=shift @ true.matrices)
    grid = VolumeGrid((40, 28, 48), (0.0025,) * 3, (0.0, 0.0, 0.0))
    found = example.found_shift(Projections(said, images), grid)
    assert found == pytest.approx(1.5, abs=0.02)


def test_images_that_are_not_finite_are_refused_with_their_view(device: Device) -> None:
    images = np.zeros((VIEWS, 24, 30), np.float32)
    images[5, 3, 4] = np.nan
    with pytest.raises(LegsimError, match="view 5 of the projections holds values"):
        filtered_scan(Projections(scan(), images), GRID, device=device)
