"""Where thigh and shank run, from a volume alone."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction.bone_regions import find_bones
from legsim.correction.leg_axes import find_axes
from legsim.geometry.volume import Volume
from tests.examples import knee


def test_thigh_and_shank_are_found_within_some_degrees(rng):
    found = find_axes(knee.volume(rng), np.zeros(3))
    for k, way in ((0, knee.JOINTS[0]), (2, knee.JOINTS[2])):
        cosine = found[k] @ way / (np.linalg.norm(found[k]) * np.linalg.norm(way))
        assert np.degrees(np.arccos(cosine)) < 8


def test_bones_are_found_along_what_was_found(rng):
    volume = knee.volume(rng)
    truth = knee.truth()
    labels = find_bones(volume, find_axes(volume, np.zeros(3))).labels
    for bone in (1, 2):
        both = ((labels == bone) & (truth == bone)).sum()
        assert both > 0.85 * max((labels == bone).sum(), (truth == bone).sum())


def test_air_and_a_leg_without_bone_are_refused():
    air = np.zeros(knee.GRID.shape_zyx, np.float32)
    with pytest.raises(LegsimError, match="nothing but air"):
        find_axes(Volume(knee.GRID, air), np.zeros(3))
    with pytest.raises(LegsimError, match="no bone is seen above"):
        find_axes(Volume(knee.GRID, air + np.float32(knee.SOFT)), np.zeros(3))
