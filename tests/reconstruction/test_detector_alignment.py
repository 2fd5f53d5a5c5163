"""Scans whose detector is turned in its plane, or stands to one side."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import fdk
from legsim.reconstruction.detector_alignment import align
from legsim.reconstruction.source_path import fan_angles, source_arc
from legsim.reconstruction.weights import ShortScanWarning, redundancy_weights
from tests.references.backprojection import Ellipsoid, project
from tests.references.half_fans import COLUMNS, half_fan, shifted_by_view

SOLIDS = [
    Ellipsoid((0.0, 0.0, 0.0), (0.08, 0.06, 0.07), 20.0),
    Ellipsoid((0.04, 0.02, 0.01), (0.02, 0.02, 0.02), 10.0),
]


def turned(
    degrees: float, shape_vu: tuple[int, int] = (120, 130), *, mirrored: bool = False
) -> ConeBeamGeometry:
    """A scan whose detector is turned about its middle: what is seen at pixel p there is seen at R
    p here.
    """
    rows, columns = shape_vu
    base = ConeBeamGeometry.circular(
        times=np.arange(120) * 1.0,
        angles=np.radians(np.linspace(0, 206, 120)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=shape_vu,
        pixel_pitch=2.5e-3,
    )
    a = np.radians(degrees)
    middle = np.array([[1, 0, 0.5 * (columns - 1)], [0, 1, 0.5 * (rows - 1)], [0, 0, 1]])
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ np.diag(
        [-1 if mirrored else 1, 1, 1]
    )
    return replace(base, matrices=middle @ turn @ np.linalg.inv(middle) @ base.matrices)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("degrees", [-90, -89.9, -30, -2, 0, 2, 45, 90, 150, 180])
def test_the_tilt_is_that_of_the_rows(degrees: float, mirrored: bool) -> None:
    off = (
        np.mod(
            np.degrees(align(turned(degrees, mirrored=mirrored)).tilt) - degrees + 90,
            180,
        )
        - 90
    )
    assert off == pytest.approx(0, abs=1e-6)


def test_a_scan_that_stands_is_left_alone() -> None:
    for degrees in (0, 2.9, 179):
        geometry = turned(degrees)
        assert align(geometry).geometry is geometry
        images = Projections(geometry, np.zeros((120, 120, 130), np.float32))
        assert align(geometry).apply(images) is images


def test_a_quarter_turn_loses_nothing(rng: np.random.Generator) -> None:
    images = rng.normal(size=(120, 12, 20)).astype(np.float32)
    for degrees, turns in ((90, 1), (-90, 1)):
        geometry = turned(degrees, (12, 20))
        stood = align(geometry).apply(Projections(geometry, images))
        assert stood.geometry.shape_vu == (20, 12)
        found = stood.line_integrals
        differences = [
            np.abs(found - np.rot90(images, k, (1, 2))).max() for k in (turns, turns + 2)
        ]
        assert min(differences) < 1e-5


@pytest.mark.parametrize("degrees", [10, 45, 90, -120])
def test_points_are_seen_where_the_turned_images_show_them(
    degrees: float, rng: np.random.Generator
) -> None:
    geometry = turned(degrees)
    v, u = np.mgrid[:120, :130]
    ramp = np.broadcast_to(2 * u + 3 * v, (120, 120, 130)).astype(np.float32)
    stood = align(geometry).apply(Projections(geometry, ramp))
    points = rng.uniform(-0.04, 0.04, (10, 3))
    (before, _), (after, _) = geometry.project(points), stood.geometry.project(points)
    column, row = np.rint(after).astype(int)[60].T
    shown = stood.line_integrals[60, row, column] + (
        after[60] - np.stack([column, row], -1)
    ) @ _slope(stood.line_integrals[60])
    np.testing.assert_allclose(shown, before[60] @ [2, 3], atol=1e-2)


def _slope(image: np.ndarray) -> np.ndarray:
    rows, columns = image.shape
    inner = image[rows // 2 - 5 : rows // 2 + 5, columns // 2 - 5 : columns // 2 + 5].astype(float)
    return np.array([np.diff(inner, axis=1).mean(), np.diff(inner, axis=0).mean()])


@pytest.mark.parametrize("degrees", [5.0, 30.0, 90.0])
def test_attenuation_is_absolute_however_the_detector_is_turned(
    device: Device, degrees: float
) -> None:
    grid = VolumeGrid((44, 44, 44), (0.004,) * 3, (0.002, 0.002, 0.002))
    volume = fdk.fdk(project(turned(degrees), SOLIDS), grid, device=device).attenuation
    places = np.array(
        [
            (0.0, 0.0, 0.0),
            (0.04, 0.02, 0.01),
            (-0.04, 0.0, -0.02),
            (0.0, 0.0, 0.05),
            (0.02, -0.02, -0.05),
        ]
    )
    index = np.rint((places - grid.origin) / grid.spacing_xyz).astype(int)
    found = [volume[tuple(slice(i - 1, i + 2) for i in at[::-1])].mean() for at in index]
    np.testing.assert_allclose(found, [20.0, 30.0, 20.0, 20.0, 20.0], atol=0.005 * 30)


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
    assert align(half_fan(shift, mirrored=mirrored)).added == (added[::-1] if mirrored else added)


def test_only_detectors_of_one_side_are_widened(rng: np.random.Generator) -> None:
    swinging = half_fan(0)
    sideways = np.repeat(np.eye(3)[None], len(swinging), 0)
    sideways[:, 0, 2] = 25 * np.where(np.arange(len(swinging)) % 2, 1, -1)
    swinging = replace(swinging, matrices=sideways @ swinging.matrices)
    for geometry in (swinging, half_fan(3), half_fan(3, span_deg=220)):
        images = Projections(geometry, rng.normal(size=(len(geometry), *geometry.shape_vu)))
        aligned = align(geometry)
        assert aligned.geometry is geometry
        assert aligned.apply(images) is images


@pytest.mark.parametrize("span_deg", [360, 220])
def test_a_detector_that_ends_before_the_axis_is_refused(span_deg: float) -> None:
    with pytest.raises(LegsimError, match="view 0: the detector ends before the axis of rotation"):
        align(half_fan(50, span_deg=span_deg))


@pytest.mark.parametrize("shift", [20, -20])
def test_points_are_seen_in_the_same_pixels(shift: float, rng: np.random.Generator) -> None:
    geometry = half_fan(shift)
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
    assert not np.delete(wide.line_integrals, np.s_[before : before + COLUMNS], axis=2).any()
    assert align(wide.geometry).geometry is wide.geometry, "now it is centered"


@pytest.mark.parametrize("shift", [10, 20, -20, 44])
def test_both_measurements_of_a_line_add_up_to_one(shift: float) -> None:
    geometry = half_fan(shift)
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
    geometry = half_fan(shift, mirrored=mirrored, views=120)
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


FLAT_SOLIDS = [
    Ellipsoid((0.0, 0.0, 0.0), (0.09, 0.03, 0.07), 20.0),
    Ellipsoid((0.05, 0.0, 0.01), (0.022, 0.02, 0.02), 10.0),
]
FLAT = VolumeGrid((50, 1, 50), (0.004,) * 3, (0.0, 0.0, 0.0))


def slow_error(
    angles_deg: np.ndarray, device: Device, shift: float = 28, *, within: float = 0.095
) -> float:
    """Rms in % of the contrast, smoothed by 7.5 mm, in the plane of the sources, off edges."""
    base = half_fan(shift, views=len(angles_deg))
    turn = ConeBeamGeometry.circular(
        times=base.times,
        angles=np.radians(angles_deg),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(14, COLUMNS),
        pixel_pitch=3.2e-3,
    )
    sideways = np.array([[1.0, 0, -shift], [0, 1, 0], [0, 0, 1]])
    scan = replace(turn, matrices=sideways @ turn.matrices)
    volume = fdk.fdk(project(scan, FLAT_SOLIDS), FLAT, device=device).attenuation[:, 0]
    fine = (np.arange(4) - 1.5) / 4 * 0.004
    x, _, z = FLAT.axes()
    truth = np.zeros_like(volume)
    for dx in fine:
        for dz in fine:
            across = np.stack(np.meshgrid(x + dx, z + dz), -1)
            for solid in FLAT_SOLIDS:
                offsets = (across - np.take(solid.center, [0, 2])) / np.take(solid.radii, [0, 2])
                truth += solid.attenuation / 16 * ((offsets**2).sum(-1) < 1)
    slow = ndimage.gaussian_filter(volume - truth, 0.0075 / 2.355 / 0.004)
    even = ndimage.maximum_filter(truth, 7) - ndimage.minimum_filter(truth, 7) < 1e-6
    seen = even & (np.hypot(*np.meshgrid(x, z)) < within)
    return 100 * float(np.sqrt((slow[seen] ** 2).mean())) / 30


TURN = np.arange(180) * 2.0


@pytest.mark.parametrize(
    ("angles", "warned"),
    [
        (TURN, ""),
        (np.delete(TURN, 50), "leave 4.0 deg out"),
        (TURN * 358 / 360, "leave 4.0 deg out"),
        (np.delete(np.linspace(0, 360, 361), 150), ""),
        (TURN[(TURN < 90) | (TURN > 98)], "leave 12.0 deg out"),
    ],
    ids=["full", "one missing", "358 deg", "one of 361 missing", "five missing"],
)
def test_half_fans_with_missing_views_are_full_turns(
    device: Device, angles: np.ndarray, warned: str
) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        error = slow_error(angles, device)
    assert error < (0.2 if len(angles) > 175 else 0.6)
    assert [warned in str(w.message) for w in caught] == [True] * bool(warned)


def test_gaps_cost_nothing_where_all_lines_are_seen_from_the_opposite_side(device: Device) -> None:
    for angles in (np.delete(TURN, 50), TURN[(TURN < 100) | (TURN > 118)]):
        assert slow_error(angles, device, shift=0, within=0.08) < 0.2


def test_a_half_fan_in_a_partial_turn_says_from_where_on_lines_are_missing(
    device: Device,
) -> None:
    """The short side of 17 columns ends 35 mm from the axis."""
    with pytest.warns(ShortScanWarning, match="at 35 mm or more are missing"):
        assert slow_error(np.arange(110) * 2.0, device) < 20
    solids = [Ellipsoid((0.005, 0.0, 0.0), (0.025, 0.03, 0.02), 20.0)]
    geometry = half_fan(28, span_deg=220, views=110)
    with pytest.warns(ShortScanWarning):
        volume = fdk.fdk(project(geometry, solids), FLAT, device=device).attenuation
    inside = volume[23:27, 0, 23:27]
    np.testing.assert_allclose(inside, 20, atol=0.5)
    assert inside.mean() == pytest.approx(20, rel=0.005), "what is seen by all views is complete"


@pytest.mark.parametrize("odd", [-14.0, -30.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_one_odd_view_leaves_a_half_fan_one(device: Device, odd: float, mirrored: bool) -> None:
    """Also one whose detector stands to the other side; both are reported by their number."""
    base = half_fan(20, mirrored=mirrored)
    columns = np.where(np.arange(len(base)) == 7, -odd if mirrored else odd, 0.0)
    geometry = shifted_by_view(base, columns)
    solid = [Ellipsoid((0.11, 0.0, 0.0), (0.03, 0.03, 0.03), 20.0)]
    grid = VolumeGrid((3, 3, 15), (0.004,) * 3, (0.11, 0.0, 0.0))
    with pytest.warns(ShortScanWarning, match=r"farther to one side in 1 of 180 views \(7\)"):
        found = fdk.fdk(project(geometry, solid), grid, device=device).attenuation
    whole = fdk.fdk(project(base, solid), grid, device=device).attenuation
    assert align(geometry).added == align(base).added
    # one view of 180, and its water beyond the edge
    np.testing.assert_allclose(found, whole, atol=0.03 * 20)


@pytest.mark.parametrize("side", [np.where(np.arange(180) < 90, 1, -1), (-1) ** np.arange(180)])
def test_a_detector_that_changes_its_side_is_refused_where_it_cuts_the_object(
    device: Device, side: np.ndarray
) -> None:
    """Views cut off alike would leave it by a tenth too dark; one that fits loses nothing."""
    geometry = shifted_by_view(half_fan(0), 20.0 * side)
    grid = VolumeGrid((1, 1, 5), (0.004,) * 3, (0.0, 0.0, 0.0))
    large, small = ([Ellipsoid((0.005, 0.0, 0.0), (r,) * 3, 20.0)] for r in (0.06, 0.03))
    with pytest.raises(LegsimError, match=r"180 of 180 views \(0, 1.*180 of them show .* by cgls"):
        fdk.fdk(project(geometry, large), grid, device=device)
    with pytest.warns(ShortScanWarning, match="180 of 180 views"):
        found = fdk.fdk(project(geometry, small), grid, device=device)
    np.testing.assert_allclose(found.attenuation, 20, rtol=0.01)


def test_small_wobbles_of_the_detector_are_no_news(rng: np.random.Generator) -> None:
    for base in (half_fan(0), half_fan(20)):
        geometry = shifted_by_view(base, rng.uniform(-3, 3, len(base)))
        images = Projections(geometry, np.zeros((180, *geometry.shape_vu), np.float32))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            fdk.fdk(images, VolumeGrid.cubic(4, 0.004, (0, 0, 0)))


def upright_cylinder(geometry: ConeBeamGeometry) -> Projections:
    """An endless cylinder of 20 1/m and a radius of 3 cm about the axis."""
    v, u = np.mgrid[: geometry.shape_vu[0], : geometry.shape_vu[1]]
    rays, sources = geometry.ray_directions(u, v), geometry.sources()
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    across = np.hypot(rays[..., 0], rays[..., 2])
    forward = np.einsum("vc,vijc->vij", sources[:, [0, 2]], rays[..., [0, 2]]) / across
    passed = (sources[:, [0, 2]] ** 2).sum(-1)[:, None, None] - forward**2
    return Projections(geometry, 40 * np.sqrt(np.maximum(0.03**2 - passed, 0)) / across)


def turned_by_view(degrees: np.ndarray, shape_vu: tuple[int, int]) -> ConeBeamGeometry:
    rows, columns = shape_vu
    base = turned(0, shape_vu)
    middle = np.array([[1, 0, 0.5 * (columns - 1)], [0, 1, 0.5 * (rows - 1)], [0, 0, 1]])
    a = np.radians(degrees)
    turns = np.tile(np.eye(3), (len(base), 1, 1))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(a)
    turns[:, 0, 1], turns[:, 1, 0] = -np.sin(a), np.sin(a)
    return replace(base, matrices=middle @ turns @ np.linalg.inv(middle) @ base.matrices)


@pytest.mark.parametrize("degrees", [10.0, 20.0])
def test_an_object_that_leaves_a_turned_detector_is_not_brighter_there(
    device: Device, degrees: float
) -> None:
    """Its rows end at a slanting edge, which the ramp must not see."""
    grid = VolumeGrid((5, 9, 5), (0.003,) * 3, (0.0, 0.0, 0.0))
    images = upright_cylinder(turned(degrees, (20, 60)))
    found = fdk.fdk(images, grid, device=device).attenuation.mean((0, 2))
    assert found.max() < 20.2
    np.testing.assert_allclose(found[3:6], 20.0, atol=0.2)


def test_rows_of_views_that_are_turned_differently_are_turned_each(device: Device) -> None:
    degrees = np.where(np.arange(120) % 2, 20.0, -20.0)
    geometry = turned_by_view(degrees, (60, 60))
    aligned = align(geometry)
    assert aligned.turns is not None
    np.testing.assert_allclose(np.abs(np.degrees(aligned.turns)), 20.0, atol=1e-9)
    np.testing.assert_allclose(aligned.from_scanner @ geometry.matrices, aligned.geometry.matrices)
    again = align(aligned.geometry)
    assert again.turns is None
    assert again.tilt == pytest.approx(0, abs=1e-9)
    grid = VolumeGrid((7, 7, 7), (0.004,) * 3, (0.0, 0.0, 0.0))
    solid = [Ellipsoid((0.0, 0.0, 0.0), (0.03, 0.03, 0.03), 20.0)]
    found = fdk.fdk(project(geometry, solid), grid, device=device).attenuation
    np.testing.assert_allclose(found, 20.0, atol=0.01 * 20)
