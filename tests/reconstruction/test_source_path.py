"""The source's path as an arc about any axis."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.reconstruction.source_path import source_arc


def scan(span_deg: float, views: int, start_deg: float = 0.0) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(start_deg + np.linspace(0, span_deg, views)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(12, 62),
        pixel_pitch=6.16e-3,
        isocenter=(0.1, -0.2, 0.3),
    )


def test_angles_follow_the_sources_about_any_axis_in_any_order_and_sense(
    rng: np.random.Generator,
) -> None:
    uneven = np.sort(rng.uniform(0, 200, 80))
    base = ConeBeamGeometry.circular(
        times=np.arange(80) * 1.0,
        angles=np.radians(rng.permutation(uneven)),
        source_isocenter=0.5,
        source_detector=1.0,
        shape_vu=(10, 20),
        pixel_pitch=1e-3,
        isocenter=(0.3, 0.1, 0.2),
    )
    placed = transforms.rigid(transforms.rotation_from_vector([0.4, 1.0, -0.7]), [0.1, 0.2, 0.3])
    arc = source_arc(base.moved(transforms.inverse(placed)))
    np.testing.assert_allclose(
        arc.center, transforms.apply(placed, [[0.3, 0.1, 0.2]])[0], atol=1e-9
    )
    np.testing.assert_allclose(np.abs(arc.axis @ placed[:3, 1]), 1.0, atol=1e-9)
    np.testing.assert_allclose(arc.radii, 0.5, atol=1e-9)
    assert arc.span == pytest.approx(np.radians(uneven[-1] - uneven[0]))
    inner = np.argsort(arc.angles)[1:-1]
    trapezoid = np.radians(0.5 * (uneven[2:] - uneven[:-2]))
    np.testing.assert_allclose(np.sort(arc.increments[inner]), np.sort(trapezoid), atol=1e-9)


def test_sources_on_a_line_are_refused() -> None:
    with pytest.raises(LegsimError, match="axis of rotation"):
        source_arc(scan(10, 2))


def moved_by_view(geometry: ConeBeamGeometry, shifts: np.ndarray) -> ConeBeamGeometry:
    """Source and detector of each view moved by shifts (v, 3) m."""
    return geometry.moved(transforms.translation(-shifts))


def test_a_line_that_trembles_is_no_arc(rng: np.random.Generator) -> None:
    along = np.linspace(-0.4, 0.4, 60)[:, None] * [1.0, 0, 0]
    line = moved_by_view(scan(0, 60), along + 1e-4 * rng.normal(size=(60, 3)))
    with pytest.raises(LegsimError, match="on one line"):
        source_arc(line)


@pytest.mark.parametrize(("rise", "fits"), [(0.1, True), (0.7, True), (2.4, False)])
def test_a_steep_helix_is_no_circle(rise: float, fits: bool) -> None:
    helix = moved_by_view(scan(1080, 180), np.linspace(-0.5, 0.5, 180)[:, None] * [0, rise, 0])
    if fits:
        assert source_arc(helix).full_turn
        return
    with pytest.raises(LegsimError, match=r"off the plane of the circle.*a helix\?"):
        source_arc(helix)
