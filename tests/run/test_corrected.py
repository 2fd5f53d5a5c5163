"""A correction is reconstructed once, whoever asks for it."""

import numpy as np
import pytest

from legsim.config import ReconstructionConfig
from legsim.core import transforms
from legsim.correction import image_warp
from legsim.correction.method import Correction
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import open_device
from legsim.run import corrected
from legsim.run.corrected import Reconstructor
from legsim.run.folder import RunFolder
from tests.examples import measured


def test_a_volume_is_made_once_and_loaded_with_its_motion_and_notes(tmp_path, rng):
    views = measured.geometry()
    images = rng.random((measured.VIEWS, *views.shape_vu), np.float32)
    motion = RigidMotion.identity(views.times)
    asked = []

    def correct() -> Correction:
        asked.append(1)
        return Correction("own", Projections(views, images), motion, notes=("a note",))

    made = Reconstructor(
        RunFolder(tmp_path, {}),
        ReconstructionConfig(),
        VolumeGrid.cubic(8, 5e-3, [0, 0, 0]),
        open_device(),
        lambda *_: None,
        Projections(views, images),
    )
    first, second = (made.of("x/own.py:own", "key", correct) for _ in range(2))
    assert len(asked) == 1
    assert second.name == "own"
    assert second.notes == ("a note",)
    assert second.warped_by is None
    assert isinstance(second.motion, RigidMotion)
    np.testing.assert_array_equal(first.load().attenuation, second.load().attenuation)
    made.of("x/own.py:own", "other key", correct)
    assert len(asked) == 2


@pytest.mark.parametrize("algorithm", ["fdk", "cgls"])
def test_a_volume_made_elsewhere_is_the_one_read_there(tmp_path, rng, algorithm):
    """A whole voxel: the same values one voxel further, however the images were corrected."""
    views = measured.geometry()
    images = Projections(views, rng.random((measured.VIEWS, *views.shape_vu), np.float32))
    grid = VolumeGrid.cubic(8, 5e-3, [0, 0, 0])
    settings = ReconstructionConfig(algorithm=algorithm)
    device = open_device()
    made = Reconstructor(RunFolder(tmp_path, {}), settings, grid, device, lambda *_: None, images)
    points = np.array([[0.0, 0.3, 0.01], [0.01, 0.0, 0.0], [0.02, -0.3, 0.0]])
    near = ControlPointMotion(
        views.times, points, points + rng.normal(0, 3e-3, (len(views.times), 3, 3))
    )
    found = {
        "still": Correction("own", images, None),
        "warped": Correction(
            "own", image_warp.warp_images(images, near, device), None, warped_by=near
        ),
    }
    box = (slice(2, 6), slice(1, 7), slice(1, 6))
    further = (slice(2, 6), slice(1, 7), slice(2, 7))
    at = transforms.translation([5e-3, 0.0, 0.0])
    for name, correction in found.items():
        one = made.of(name, "key", lambda c=correction: c)
        again = corrected.reconstructed_at(one, images, settings, grid, device)
        assert again is not None
        moved = again(at, box)
        assert moved.grid == grid.cropped(box)
        if algorithm == "fdk":  # the iterations of another grid end elsewhere
            there = one.load().attenuation[further]
            np.testing.assert_allclose(moved.attenuation, there, atol=1e-4 * np.abs(there).max())


def test_a_method_with_images_of_its_own_is_not_made_anew(tmp_path, rng):
    views = measured.geometry()
    images = Projections(views, rng.random((measured.VIEWS, *views.shape_vu), np.float32))
    grid, settings = VolumeGrid.cubic(8, 5e-3, [0, 0, 0]), ReconstructionConfig()
    made = Reconstructor(
        RunFolder(tmp_path, {}), settings, grid, open_device(), lambda *_: None, images
    )
    smoothed = Projections(views, 0.9 * images.line_integrals)
    one = made.of("own", "key", lambda: Correction("own", smoothed, None))
    assert corrected.reconstructed_at(one, images, settings, grid, open_device()) is None
