"""What a view shows at an edge that stands nearer to the axis than others' is told from air."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction.cut_off_edges import check_cut_off
from legsim.reconstruction.detector_alignment import align
from tests.references.backprojection import Ellipsoid, project
from tests.references.half_fans import half_fan, shifted_by_view


def rolled(geometry: ConeBeamGeometry, degrees: float) -> ConeBeamGeometry:
    """Its detector turned about its middle; a quarter turn changes its rows to columns."""
    a = np.radians(degrees)
    rows, columns = geometry.shape_vu
    shape_vu = (columns, rows) if degrees % 180 == 90 else (rows, columns)
    from_middle = np.array([[1, 0, -0.5 * (columns - 1)], [0, 1, -0.5 * (rows - 1)], [0, 0, 1]])
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    back = np.array([[1, 0, 0.5 * (shape_vu[1] - 1)], [0, 1, 0.5 * (shape_vu[0] - 1)], [0, 0, 1]])
    return replace(
        geometry, matrices=back @ turn @ from_middle @ geometry.matrices, shape_vu=shape_vu
    )


def of_changing_side(radius: float, degrees: float = 0.0) -> Projections:
    """A ball before a detector that changes its side by 40 columns in every view."""
    geometry = rolled(shifted_by_view(half_fan(0), 20.0 * (-1.0) ** np.arange(180)), degrees)
    ball = Ellipsoid((0.005, 0.0, 0.0), (radius,) * 3, 20.0)
    return project(geometry, [ball])


def cut_off(projections: Projections) -> str:
    """What is said of it: the refusal, else the warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            check_cut_off(align(projections.geometry), projections)
        except LegsimError as error:
            return str(error)
    return str(caught[0].message)


@pytest.mark.parametrize("degrees", [0.0, 12.0, -40.0, 90.0, -90.0, 170.0])
def test_only_what_the_cut_edge_shows_is_refused_however_rows_are_turned(degrees: float) -> None:
    assert "180 of them show the object" in cut_off(of_changing_side(0.06, degrees))
    assert "and are estimated" in cut_off(of_changing_side(0.02, degrees))


def test_pixels_that_are_hot_or_missing_hide_no_cut_off() -> None:
    seen = of_changing_side(0.06)
    for value in (1e4, np.nan, np.inf):
        images = seen.line_integrals.copy()
        images[:, 5, 50] = images[:, 7, 0] = value
        assert "180 of them show the object" in cut_off(Projections(seen.geometry, images))


def test_two_rows_that_are_cut_off_are_enough() -> None:
    seen = of_changing_side(0.06)
    images = np.zeros_like(seen.line_integrals)
    images[:, 39:41] = seen.line_integrals[:, 39:41]
    assert "180 of them show the object" in cut_off(Projections(seen.geometry, images))


@pytest.mark.parametrize(
    ("radius", "said"), [(0.02, "and are estimated"), (0.06, "180 of them show")]
)
def test_air_that_reads_something_is_no_object(
    radius: float, said: str, rng: np.random.Generator
) -> None:
    seen = of_changing_side(radius)
    images = seen.line_integrals + np.float32(0.2)
    images[::3] += 0.1
    assert said in cut_off(Projections(seen.geometry, images))
    noisy = images + rng.normal(0, 0.02, images.shape).astype(np.float32)
    assert said in cut_off(Projections(seen.geometry, noisy))


def test_a_collimator_and_a_hot_pixel_at_the_edges_are_no_object() -> None:
    seen = of_changing_side(0.02)
    images = seen.line_integrals.copy()
    images[:, :, :2] = images[:, :, -2:] = 4.0
    assert "and are estimated" in cut_off(Projections(seen.geometry, images))
    images = seen.line_integrals.copy()
    images[::2, 7, [0, -1]] = 9.0
    assert "and are estimated" in cut_off(Projections(seen.geometry, images))
