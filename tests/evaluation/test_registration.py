"""Rigid registration finds a known motion, and misses it by a small part of a voxel."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.evaluation import registration, similarity
from legsim.geometry.volume import Volume
from tests.examples.blob import GRID, blob, regions


def test_registration_undoes_a_rigid_motion():
    center = transforms.translation(GRID.center)
    turned = transforms.rigid(
        transforms.rotation_from_vector([0.02, -0.05, 0.03]), [0.003, -0.002, 0.001]
    )
    moved = blob(GRID, center @ turned @ transforms.inverse(center))
    loose = similarity.evaluate(moved, blob(GRID), regions(GRID), register=False)
    tight = similarity.evaluate(moved, blob(GRID), regions(GRID))
    assert tight.registration is not None
    assert tight.registration.applied
    assert tight.registration.translation_mm == pytest.approx(np.sqrt(14), abs=0.1)
    assert tight.registration.rotation_deg == pytest.approx(
        np.degrees(np.linalg.norm([0.02, 0.05, 0.03])), abs=0.2
    )
    assert tight.of("leg").rmse < 0.1 * loose.of("leg").rmse


def test_registration_never_makes_a_volume_worse(rng):
    reference = blob(GRID)
    noisy = Volume(
        GRID, reference.attenuation + rng.normal(0, 0.3, GRID.shape_zyx).astype(np.float32)
    )
    loose = similarity.evaluate(noisy, reference, regions(GRID), register=False)
    tight = similarity.evaluate(noisy, reference, regions(GRID))
    assert tight.of("leg").rmse <= loose.of("leg").rmse * 1.001


def test_the_registrations_own_error_is_a_small_part_of_a_voxel():
    error = registration.registration_error(blob(GRID), regions(GRID))
    assert 0 < error.translation_mm < 0.1 * 1e3 * GRID.spacing_xyz[0]
    assert 0 < error.rotation_deg < 0.2
