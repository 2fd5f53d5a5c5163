"""The grid of what a scan sees."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.reconstruction.field_of_view import grid_of, pixel_at_isocenter

CENTER = (0.1, -0.2, 0.3)
PIXEL = 3e-3 * 0.8 / 1.2


def scan(span_deg: float = 360.0) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(60) * 1.0,
        angles=np.radians(np.linspace(0, span_deg, 60, endpoint=False)),
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=(40, 100),
        pixel_pitch=3e-3,
        isocenter=CENTER,
    )


def test_voxels_are_pixels_and_hold_the_cylinder_that_is_seen() -> None:
    grid = grid_of(scan())
    assert grid.spacing_xyz == pytest.approx((PIXEL,) * 3)
    assert pixel_at_isocenter(scan()) == pytest.approx(PIXEL)
    np.testing.assert_allclose(grid.center, CENTER, atol=1e-9)
    radius = 0.8 * np.sin(np.arctan(0.15 / 1.2))
    across = int(np.ceil(2 * radius / PIXEL))
    assert grid.shape_zyx == (across, 40, across)


def test_a_half_fan_sees_its_longer_side_and_a_low_detector_what_lies_below() -> None:
    whole = scan()
    moved = np.array([[1.0, 0, -25], [0, 1, 5], [0, 0, 1]])
    grid = grid_of(replace(whole, matrices=moved @ whole.matrices))
    radius = 0.8 * np.sin(np.arctan(75 * 3e-3 / 1.2))
    assert grid.shape_zyx[0] == pytest.approx(2 * radius / PIXEL, abs=2)
    assert grid.shape_zyx[1] == 40
    np.testing.assert_allclose(grid.center, np.subtract(CENTER, (0, 5 * PIXEL, 0)), atol=1e-9)


def test_any_axis_and_spacing() -> None:
    quarter = transforms.rigid(transforms.rotation_from_vector([np.pi / 2, 0, 0]), [0.0] * 3)
    grid = grid_of(scan().moved(transforms.inverse(quarter)), (0.002, 0.002, 0.004))
    assert grid.shape_zyx[0] == 20
    assert grid.shape_zyx[1] == grid.shape_zyx[2] > 90
    np.testing.assert_allclose(grid.center, transforms.apply(quarter, [CENTER])[0], atol=1e-9)
