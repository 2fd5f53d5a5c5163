"""A volume does not depend on the order of its views, nor on the sense in which the C-arm turns.

Full turns, short scans and overscans, detectors in front of the axis and to one side of it, at rest
and along a motion.
"""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import cgls, fdk
from legsim.reconstruction.fdk import FdkOptions
from legsim.reconstruction.weights import ShortScanWarning
from tests.references.backprojection import Ellipsoid, project

pytestmark = pytest.mark.filterwarnings(f"ignore::{ShortScanWarning.__module__}.ShortScanWarning")

VIEWS, COLUMNS = 61, 80
TIMES = np.arange(VIEWS) / 30
GRID = VolumeGrid((9, 14, 40), (0.004, 0.005, 0.004), (0.01, 0.0, 0.004))
LEG = [
    Ellipsoid((0.0, 0.0, 0.0), (0.07, 0.05, 0.06), 20.0),
    Ellipsoid((0.03, 0.01, 0.02), (0.02, 0.02, 0.015), 20.0),
]
MIRRORED = np.diag([-1.0, 1.0, 1.0])
"""about the plane of x = 0, in which the first source stands"""

SCANS = {
    "full": (360 * 60 / 61, 0.0),
    "full and one view twice": (360.0, 0.0),
    "short": (200.0, 0.0),
    "over": (250.0, 0.0),
    "too short": (150.0, 0.0),
    "half fan": (360 * 60 / 61, 25.0),
    "half fan, short": (220.0, 25.0),
}


def scan(name: str, *, sense: int = 1, steps: np.ndarray | None = None) -> ConeBeamGeometry:
    """``steps`` are the views' places in the range, 0 to 1."""
    span, shift = SCANS[name]
    places = np.linspace(0, 1, VIEWS) if steps is None else steps
    base = ConeBeamGeometry.circular(
        times=TIMES,
        angles=sense * np.radians(span * places),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(40, COLUMNS),
        pixel_pitch=3.0e-3,
    )
    moved = np.array([[1.0, 0, -sense * shift], [0, 1, 0], [0, 0, 1]])
    return replace(base, matrices=moved @ base.matrices)


def reordered(images: Projections, order: np.ndarray) -> Projections:
    """The views in another order; times go on upwards."""
    geometry = replace(images.geometry, matrices=images.geometry.matrices[order])
    return Projections(geometry, images.line_integrals[order])


def volume(images: Projections, device: Device, motion=None, kernel=None) -> np.ndarray:
    options = FdkOptions(kernel=kernel)
    return fdk.fdk(images, GRID, motion=motion, options=options, device=device).attenuation


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    # float32 sums of as many terms, in another order
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5 * np.abs(expected).max())


@pytest.mark.parametrize("kernel", ["voxels", None])
@pytest.mark.parametrize("name", SCANS)
def test_reversed_and_mixed_views_give_the_same_voxels(device, rng, name, kernel):
    uneven = np.sort(np.concatenate([[0, 1], rng.uniform(0, 1, VIEWS - 2)]))
    for steps in (None, uneven):
        images = project(scan(name, steps=steps), LEG)
        expected = volume(images, device, kernel=kernel)
        for order in (np.arange(VIEWS)[::-1], rng.permutation(VIEWS)):
            assert_same(volume(reordered(images, order), device, kernel=kernel), expected)


@pytest.mark.parametrize("name", SCANS)
def test_a_c_arm_that_turns_the_other_way_sees_the_mirror_image(device, name):
    """The mirrored leg, scanned the other way by a mirrored detector, gives the mirrored volume."""
    mirrored = [replace(e, center=tuple(MIRRORED @ e.center)) for e in LEG]
    # texture units round places, one way or the other
    options = FdkOptions(kernel="voxels" if device.uses_textures else None)
    there = fdk.fdk(project(scan(name), LEG), GRID, options=options, device=device).attenuation
    grid = replace(GRID, center=tuple(MIRRORED @ GRID.center))
    images = project(scan(name, sense=-1), mirrored)
    back = fdk.fdk(images, grid, options=options, device=device).attenuation
    assert_same(back[..., ::-1], there)


@pytest.mark.parametrize("name", ["full", "short", "half fan"])
def test_a_motion_is_followed_in_any_order_of_the_views(device, rng, name):
    turns = transforms.rotation_from_vector(rng.normal(0, 0.02, (VIEWS, 3)))
    poses = transforms.rigid(turns, rng.normal(0, 0.003, (VIEWS, 3)))
    images = project(scan(name), LEG)
    expected = volume(images, device, RigidMotion(TIMES, poses))
    for order in (np.arange(VIEWS)[::-1], rng.permutation(VIEWS)):
        found = volume(reordered(images, order), device, RigidMotion(TIMES, poses[order]))
        assert_same(found, expected)


def test_iterations_do_not_know_the_order_of_the_views(device, rng):
    images = project(scan("short"), LEG)
    grid = VolumeGrid((76, 60, 84), (0.0019,) * 3, (0.0, 0.0, 0.0))
    mixed = reordered(images, rng.permutation(VIEWS))
    expected, found = (
        cgls.cgls(one, grid, iterations=3, device=device).attenuation for one in (images, mixed)
    )
    assert_same(found, expected)
