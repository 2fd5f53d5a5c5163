"""A correction is reconstructed once, whoever asks for it."""

import numpy as np

from legsim.config import ReconstructionConfig
from legsim.correction.method import Correction
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import open_device
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
