"""Detectors to one side of the axis in a full turn: every line counts once, and values are absolute
all the same.
"""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import fdk
from legsim.reconstruction.detector_alignment import align
from legsim.reconstruction.source_path import fan_angles, source_arc
from legsim.reconstruction.weights import redundancy_weights
from tests.references.backprojection import Ellipsoid, project

COLUMNS = 90


def scan(
    shift: float, *, span_deg: float = 360.0, views: int = 180, mirrored: bool = False
) -> ConeBeamGeometry:
    """A detector moved by ``shift`` columns towards higher ones, so that the axis is seen ``shift``
    columns before its middle.
    """
    base = ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.radians(np.linspace(0, span_deg, views, endpoint=False)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(80, COLUMNS),
        pixel_pitch=3.2e-3,
    )
    flip = np.array([[-1.0, 0, COLUMNS - 1], [0, 1, 0], [0, 0, 1]]) if mirrored else np.eye(3)
    return replace(
        base, matrices=flip @ np.array([[1.0, 0, -shift], [0, 1, 0], [0, 0, 1]]) @ base.matrices
    )


@pytest.mark.parametrize(
    ("shift", "added"),
    [
        (0, (0, 0)),
        (4, (0, 0)),
        (-4, (0, 0)),
        (20, (40, 0)),
        (-20, (0, 40)),
        (44, (88, 0)),
        (20.25, (41, 0)),
    ],
)
@pytest.mark.parametrize("mirrored", [False, True])
def test_as_many_columns_are_added_as_the_short_side_lacks(
    shift: float, added: tuple[int, int], mirrored: bool
) -> None:
    assert align(scan(shift, mirrored=mirrored)).added == (added[::-1] if mirrored else added)


def test_only_full_turns_of_one_side_are_widened(rng: np.random.Generator) -> None:
    short = scan(20, span_deg=220)
    swinging = scan(0)
    sideways = np.repeat(np.eye(3)[None], len(swinging), 0)
    sideways[:, 0, 2] = 25 * np.where(np.arange(len(swinging)) % 2, 1, -1)
    swinging = replace(swinging, matrices=sideways @ swinging.matrices)
    for geometry in (short, swinging, scan(3)):
        images = Projections(geometry, rng.normal(size=(len(geometry), *geometry.shape_vu)))
        aligned = align(geometry)
        assert aligned.geometry is geometry
        assert aligned.apply(images) is images


def test_a_detector_that_ends_before_the_axis_is_refused() -> None:
    with pytest.raises(LegsimError, match="view 0: the detector ends before the axis of rotation"):
        align(scan(50))


@pytest.mark.parametrize("shift", [20, -20])
def test_points_are_seen_in_the_same_pixels(shift: float, rng: np.random.Generator) -> None:
    geometry = scan(shift)
    images = Projections(geometry, rng.normal(size=(len(geometry), *geometry.shape_vu)))
    aligned = align(geometry)
    wide, before = aligned.apply(images), aligned.added[0]
    points = rng.uniform(-0.04, 0.04, (10, 3))
    np.testing.assert_allclose(
        wide.geometry.project(points)[0] - (before, 0), geometry.project(points)[0], atol=1e-9
    )
    np.testing.assert_array_equal(
        wide.line_integrals[:, :, before : before + COLUMNS], images.line_integrals
    )
    assert np.abs(wide.line_integrals).sum() == np.abs(images.line_integrals).sum()
    assert align(wide.geometry).geometry is wide.geometry, "now it is centered"


@pytest.mark.parametrize("shift", [10, 20, -20, 44])
def test_both_measurements_of_a_line_add_up_to_one(shift: float) -> None:
    geometry = scan(shift)
    arc = source_arc(geometry)
    edges = fan_angles(geometry, arc, np.array([-0.5, COLUMNS - 0.5]))
    fans = np.broadcast_to(np.linspace(-0.3, 0.3, 101), (len(geometry), 101))
    shares = redundancy_weights(arc, fans, edges)
    np.testing.assert_allclose(shares + shares[:, ::-1], 1, atol=1e-12)
    unmeasured = (fans < edges.min()) | (fans > edges.max())
    opposite_unmeasured = (-fans < edges.min()) | (-fans > edges.max())
    np.testing.assert_allclose(shares[unmeasured & ~opposite_unmeasured], 0, atol=1e-12)


@pytest.mark.parametrize(("shift", "mirrored"), [(28.0, False), (28.0, True)])
def test_attenuation_is_absolute_on_either_side(
    device: Device, shift: float, mirrored: bool
) -> None:
    """No view holds the whole object: its rows reach 44 columns from the axis, the short side
    17.
    """
    solids = [
        Ellipsoid((0.0, 0.0, 0.0), (0.09, 0.07, 0.09), 20.0),
        Ellipsoid((0.05, 0.02, 0.01), (0.022, 0.02, 0.02), 10.0),
    ]
    geometry = scan(shift, mirrored=mirrored, views=120)
    grid = VolumeGrid.cubic(48, 0.004, (0.002, 0.002, 0.002))
    volume = fdk.fdk(project(geometry, solids), grid, device=device).attenuation
    places = np.array(
        [
            (0.0, 0.0, 0.0),
            (0.05, 0.02, 0.01),
            (-0.06, 0.0, -0.02),
            (0.0, 0.0, 0.065),
            (0.072, 0.0, 0.0),
        ]
    )
    index = np.rint((places - grid.origin) / grid.spacing_xyz).astype(int)
    found = [volume[tuple(slice(i - 1, i + 2) for i in at[::-1])].mean() for at in index]
    np.testing.assert_allclose(found, [20.0, 30.0, 20.0, 20.0, 20.0], atol=0.005 * 30)
