"""A usual scanner is not doubted; one in another unit, or with distances exchanged, is."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.plausibility import objections


def circle(turn_deg: float = 200.0, views: int = 40, **changed: float) -> ConeBeamGeometry:
    sizes = {"source_isocenter": 0.78, "source_detector": 1.198, "pixel_pitch": 4e-3} | changed
    return ConeBeamGeometry.circular(
        times=np.arange(views) / 30,
        angles=np.radians(np.linspace(0, turn_deg, views)),
        shape_vu=(60, 80),
        isocenter=(0.1, 0.4, 0.0),
        **sizes,
    )


@pytest.mark.parametrize(
    "usual",
    [
        circle(),
        circle(turn_deg=360.0 * 39 / 40),
        circle(views=1),
        circle(views=2),
        circle(turn_deg=40.0),
        circle(source_isocenter=0.06, source_detector=0.2, pixel_pitch=1e-4),
        circle(source_isocenter=2.0, source_detector=2.0),
    ],
)
def test_a_usual_scanner_is_not_doubted(usual):
    assert objections(usual) == ()


def test_a_half_fan_is_not_doubted():
    plain = circle(turn_deg=355.0)
    shift = np.eye(3)
    shift[0, 2] = 35.0
    assert objections(replace(plain, matrices=shift @ plain.matrices)) == ()


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_another_unit_is_named(factor):
    sizes = {"source_isocenter": 0.78 * factor, "source_detector": 1.198 * factor}
    (line,) = objections(circle(**sizes, pixel_pitch=4e-3 * factor))
    assert "give all lengths in mm" in line


@pytest.mark.parametrize(
    "sizes",
    [
        {"source_isocenter": 1.198, "source_detector": 0.78},
        {"source_detector": 1.198 - 0.78},
    ],
)
def test_a_detector_before_the_center_is_named_where_its_distance_is_known(sizes):
    (line,) = objections(circle(**sizes))
    assert "nearer than the rotation center" in line
    assert objections(circle(**sizes), pixel_known=False) == ()


@pytest.mark.parametrize(
    "wrong",
    [
        np.diag([2.0, 2.0, 1.0]),  # pixels of the unbinned detector
        np.array([[1.0, 0, -39.5], [0, 1, -29.5], [0, 0, 1]]),  # counted from the middle
    ],
)
def test_pixels_of_another_detector_are_named(wrong):
    plain = circle()
    lines = objections(replace(plain, matrices=wrong @ plain.matrices), pixel_known=False)
    assert any("the rotation center is seen at" in line for line in lines)


def test_views_from_one_place_are_counted():
    plain = circle()
    twice = np.repeat(plain.matrices[::2], 2, axis=0)
    (line,) = objections(replace(plain, matrices=twice))
    assert line.startswith("20 views are from the same place")
    assert "view 1:" in line


def test_angles_in_radians_are_named():
    (line,) = objections(circle(turn_deg=np.radians(200.0)))
    assert "200 deg in all, " not in line
    assert "would be 200 deg if the angles were in radians" in line
