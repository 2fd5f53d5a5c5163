"""What the reconstruction functions take, and that they agree on it."""

import doctest
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.method import Correction
from legsim.deformation.models import Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import open_device
from legsim.reconstruction import cgls, corrected_scan, fdk

GRID = VolumeGrid.cubic(14, 0.0044, (0.0, 0.0, 0.0))
RECONSTRUCTIONS = [fdk.fdk, cgls.cgls]


@dataclass(frozen=True)
class Bare:
    """No more than images and a motion."""

    projections: Projections
    motion: Motion | None


def scanned(rng: np.random.Generator) -> tuple[Projections, RigidMotion]:
    geometry = ConeBeamGeometry.circular(
        times=np.arange(40) * 1.0,
        angles=np.radians(np.linspace(0, 230, 40)),
        source_isocenter=0.5,
        source_detector=0.9,
        shape_vu=(16, 20),
        pixel_pitch=8e-3,
    )
    shifts = transforms.translation(rng.normal(0, 0.005, (40, 3)))
    images = rng.random((40, 16, 20), np.float32)
    return Projections(geometry, images), RigidMotion(geometry.times, shifts)


@pytest.mark.parametrize("reconstruct", RECONSTRUCTIONS)
def test_the_motion_of_a_correction_is_followed(
    reconstruct: Callable[..., Volume], rng: np.random.Generator
) -> None:
    images, motion = scanned(rng)
    expected = reconstruct(images, GRID, motion=motion, device=open_device()).attenuation
    for given in (Correction("own", images, motion), Bare(images, motion)):
        np.testing.assert_array_equal(reconstruct(given, GRID).attenuation, expected)
    still = reconstruct(Correction("own", images, None), GRID).attenuation
    np.testing.assert_array_equal(still, reconstruct(images, GRID).attenuation)
    assert (still != expected).any()


@pytest.mark.parametrize("reconstruct", RECONSTRUCTIONS)
def test_two_motions_or_none_of_the_kinds_are_refused(
    reconstruct: Callable[..., Volume], rng: np.random.Generator
) -> None:
    images, motion = scanned(rng)
    with pytest.raises(LegsimError, match="a motion of its own; leave out motion="):
        reconstruct(Bare(images, None), GRID, motion=motion)
    with pytest.raises(LegsimError, match=r"or a Correction .*, not ndarray"):
        reconstruct(images.line_integrals, GRID)


@pytest.mark.parametrize("module", [fdk, cgls])
def test_the_examples_in_the_docstrings_run(module: ModuleType) -> None:
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


def test_values_that_are_not_finite_are_refused_with_their_view():
    matrices = np.tile([[1.0, 0, 3, 0], [0, 1, 2, 0], [0, 0, 1, 1]], (3, 1, 1))
    geometry = ConeBeamGeometry(np.arange(3.0), matrices, (3, 4))
    images = np.ones((3, 3, 4), np.float32)
    for bad in (np.nan, np.inf):
        values = images.copy()
        values[1, 2, 3] = bad
        with pytest.raises(LegsimError, match="view 1 of the projections holds values"):
            corrected_scan.images_and_motion(Projections(geometry, values), None)


@pytest.mark.parametrize("reconstruct", RECONSTRUCTIONS)
def test_a_scan_without_views_is_refused(
    reconstruct: Callable[..., Volume], rng: np.random.Generator
) -> None:
    images, _ = scanned(rng)
    none = Projections(images.geometry[:0], images.line_integrals[:0])
    with pytest.raises(LegsimError, match="hold no view"):
        reconstruct(none, GRID)


@pytest.mark.parametrize(
    "wrong",
    [
        2 * np.eye(4),
        np.diag([1.004, 1.004, 1.004, 1]),
        np.diag([1.0, 1, -1, 1]),
        np.eye(4) + np.eye(4)[:, ::-1] * 0.1,
    ],
)
def test_matrices_that_are_not_rigid_are_refused_with_their_view(wrong):
    """Another scale, a mirror, a translation in the last row."""
    matrices = np.tile([[1.0, 0, 3, 0], [0, 1, 2, 0], [0, 0, 1, 1]], (3, 1, 1))
    geometry = ConeBeamGeometry(np.arange(3.0), matrices, (3, 4))
    motion = np.tile(np.eye(4), (3, 1, 1))
    motion[2] = wrong
    moved = RigidMotion(np.arange(3.0), motion)
    images = Projections(geometry, np.ones((3, 3, 4), np.float32))
    with pytest.raises(LegsimError, match="is not rigid in view 2"):
        corrected_scan.images_and_motion(images, moved)
