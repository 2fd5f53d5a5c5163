"""Scans whose detector is turned in its plane."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import fdk
from legsim.reconstruction.detector_alignment import align
from tests.references.backprojection import Ellipsoid, project

SOLIDS = [
    Ellipsoid((0.0, 0.0, 0.0), (0.08, 0.06, 0.07), 20.0),
    Ellipsoid((0.04, 0.02, 0.01), (0.02, 0.02, 0.02), 10.0),
]


def scan(
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
            np.degrees(align(scan(degrees, mirrored=mirrored)).tilt) - degrees + 90,
            180,
        )
        - 90
    )
    assert off == pytest.approx(0, abs=1e-6)


def test_a_scan_that_stands_is_left_alone() -> None:
    for degrees in (0, 2.9, 179):
        geometry = scan(degrees)
        assert align(geometry).geometry is geometry
        images = Projections(geometry, np.zeros((120, 120, 130), np.float32))
        assert align(geometry).apply(images) is images


def test_a_quarter_turn_loses_nothing(rng: np.random.Generator) -> None:
    images = rng.normal(size=(120, 12, 20)).astype(np.float32)
    for degrees, turns in ((90, 1), (-90, 1)):
        geometry = scan(degrees, (12, 20))
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
    geometry = scan(degrees)
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
    volume = fdk.fdk(project(scan(degrees), SOLIDS), grid, device=device).attenuation
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
