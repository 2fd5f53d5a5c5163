from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid


def scan(**changes) -> ConeBeamGeometry:
    values = {
        "times": np.arange(10) / 31,
        "angles": np.radians(20 * np.arange(10)),
        "source_isocenter": 0.78,
        "source_detector": 1.198,
        "shape_vu": (480, 620),
        "pixel_pitch": 0.616e-3,
        "isocenter": (0.1, 0.5, -0.2),
    } | changes
    return ConeBeamGeometry.circular(**values)


def test_isocenter_projects_to_the_middle_of_the_detector():
    pixels, depth = scan().project(np.array([[0.1, 0.5, -0.2]]))
    np.testing.assert_allclose(pixels[:, 0], [[309.5, 239.5]] * 10, atol=1e-9)
    np.testing.assert_allclose(depth, 0.78)


def test_sources_stand_where_the_angle_says():
    sources = scan(angles=np.radians([0, 90]), times=[0, 1]).sources() - [0.1, 0.5, -0.2]
    np.testing.assert_allclose(sources, [[0, 0, 0.78], [0.78, 0, 0]], atol=1e-12)


def test_rows_count_upwards_and_columns_along_the_stated_axis():
    geometry = scan(angles=np.radians([0, 90]), times=[0, 1])
    middle = geometry.project(np.array([[0.1, 0.5, -0.2]]))[0]
    up = geometry.project(np.array([[0.1, 0.51, -0.2]]))[0] - middle
    np.testing.assert_allclose(up[:, 0], [[0, 10 * 1.198 / 0.78 / 0.616]] * 2, atol=1e-9)
    forward = geometry.project(np.array([[0.11, 0.5, -0.2]]))[0] - middle
    assert forward[0, 0, 0] > 20
    assert abs(forward[1, 0, 0]) < 1e-9


def test_rays_go_through_the_points_that_project_there(rng):
    geometry, points = scan(), np.array([0.1, 0.5, -0.2]) + 0.05 * rng.normal(size=(4, 3))
    pixels, depth = geometry.project(points)
    for view in (0, 7):
        rays = geometry.ray_directions(pixels[view, :, 0], pixels[view, :, 1])[view]
        np.testing.assert_allclose(
            geometry.sources()[view] + depth[view, :, None] * rays, points, atol=1e-12
        )


def test_moving_the_object_is_moving_the_scanner_back(rng):
    geometry, points = scan(), np.array([0.1, 0.5, -0.2]) + 0.05 * rng.normal(size=(4, 3))
    motion = transforms.rigid(
        transforms.rotation_from_vector(0.1 * rng.normal(size=(10, 3))),
        0.01 * rng.normal(size=(10, 3)),
    )
    moved_points = transforms.apply(motion, points)
    np.testing.assert_allclose(
        geometry.project(moved_points)[0], geometry.moved(motion).project(points)[0], atol=1e-8
    )
    np.testing.assert_allclose(
        geometry.moved(motion).moved(transforms.inverse(motion)).matrices,
        geometry.matrices,
        atol=1e-9,
    )


def test_scale_and_sign_of_a_matrix_do_not_matter():
    geometry = scan()
    for factor in (-1.0, 1e-3, -250.0):
        same = ConeBeamGeometry(
            geometry.times, factor * geometry.matrices, geometry.shape_vu, geometry.pixel_pitch
        )
        np.testing.assert_allclose(same.matrices, geometry.matrices, rtol=1e-12, atol=1e-12)


def test_rotation_center_is_the_isocenter():
    np.testing.assert_allclose(scan().rotation_center(), [0.1, 0.5, -0.2], atol=1e-12)


def test_a_slice_of_views_is_a_geometry_of_those_views():
    part = scan()[3:6]
    assert len(part) == 3
    np.testing.assert_array_equal(part.matrices, scan().matrices[3:6])


def test_one_view_of_a_scan_far_from_the_origin_still_looks_at_what_was_scanned():
    """By itself such a view does not say on which side of the source that is."""
    times, center = np.arange(8) / 31.0, np.array([3.0, 0.5, 2.0])
    geometry = ConeBeamGeometry.circular(
        times=times,
        angles=np.linspace(0, 2 * np.pi, 8),
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=(4, 6),
        pixel_pitch=0.1,
        isocenter=center,
    )
    shifts = transforms.translation(np.array([0.0, 0.1, 0.0]))
    for k in range(8):
        view = geometry[k : k + 1]
        np.testing.assert_array_equal(view.matrices, geometry.matrices[k : k + 1])
        for derived in (view, view.finer(2), view.moved(shifts), geometry.finer(2)[k : k + 1]):
            assert derived.project(center[None])[1] == pytest.approx(0.8)


@pytest.mark.parametrize("angles", [[0.0], [0.0, np.pi], [0.0, 0.001, 0.002]])
@pytest.mark.parametrize("isocenter", [(0.0, 0.0, -5.0), (0.0, 0.0, 0.5), (4.0, -3.0, 2.0)])
def test_what_a_circular_scan_looks_at_does_not_depend_on_the_origin(angles, isocenter):
    """Few or parallel views do not show it, but angles and distances say it."""
    geometry = scan(angles=angles, times=np.arange(len(angles)), isocenter=isocenter)
    single, again = geometry[:1], replace(geometry, times=geometry.times + 1)
    for made in (geometry, single, single.coarser(2), single.rows_turned(), again[:1].finer(3)):
        np.testing.assert_allclose(made.project([isocenter])[1], 0.78, rtol=1e-9)
    images = np.zeros((1, *geometry.shape_vu), np.float32)
    coarse = Projections(single, images).coarser(4).geometry
    np.testing.assert_allclose(coarse.project([isocenter])[1], 0.78, rtol=1e-9)


def test_noise_in_parallel_views_does_not_say_what_they_look_at(rng):
    """Of matrices alone: the point near the origin, however the axes tremble."""
    base = scan(isocenter=(0, 0, 0))[:1].matrices[0]
    for _ in range(20):
        trembling = transforms.rigid(
            transforms.rotation_from_vector(1e-4 * rng.normal(size=(25, 3))),
            np.stack([np.linspace(-0.2, 0.2, 25), np.zeros(25), np.zeros(25)], -1),
        )
        signs = rng.choice([-1.0, 1.0], 25)[:, None, None]
        made = ConeBeamGeometry(np.arange(25), signs * (base @ trembling), (480, 620))
        assert (made.project([[0, 0, 0]])[1] > 0).all()


def test_arrays_inside_values_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        scan().matrices[0, 0, 0] = 1
    volume = Volume(VolumeGrid.cubic(4, 0.001, (0, 0, 0)), np.zeros((4, 4, 4), np.float32))
    with pytest.raises(ValueError, match="read-only"):
        volume.attenuation[0, 0, 0] = 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ConeBeamGeometry([0, 1], np.zeros((2, 3, 3)), (2, 2)),
            r"shape \(2, 3, 3\); expected \(2, 3, 4\)",
        ),
        (lambda: ConeBeamGeometry([0], np.ones((1, 3, 4)), (2, 2)), "singular"),
        (
            lambda: ConeBeamGeometry([1, 0], scan().matrices[:2], (2, 2)),
            "must increase strictly, .*; sample 1",
        ),
        (lambda: ConeBeamGeometry([0, 1], scan().matrices[:2], (0, 2)), "must be positive"),
        (lambda: replace(scan(), pixel_pitch=np.inf), "finite and positive"),
        (lambda: replace(scan(), shape_vu=(4,)), r"expected \(rows, columns\)"),
        (lambda: replace(scan(), shape_vu=(4, 5, 6)), r"expected \(rows, columns\)"),
        (lambda: ConeBeamGeometry([0.0], [[[1.0], [1.0, 2.0]]], (2, 2)), "different lengths"),
        (lambda: scan().coarser(0), "by a factor of 0"),
        (lambda: scan().finer(1.5), "expected whole numbers"),
        (
            lambda: Projections(scan(), np.zeros((10, 620, 480), np.float32)),
            r"\(10, 480, 620\) \(views, rows, columns\)",
        ),
        (lambda: VolumeGrid((1, 2, 0), (1, 1, 1), (0, 0, 0)), "three positive counts"),
        (lambda: VolumeGrid((1, 2, 3), (1, -1, 1), (0, 0, 0)), "three positive lengths"),
        (
            lambda: Volume(VolumeGrid.cubic(4, 1, (0, 0, 0)), np.zeros((4, 4, 5), np.float32)),
            "the grid says",
        ),
    ],
)
def test_impossible_values_are_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()


@given(factor=st.integers(1, 4))
def test_a_coarser_detector_undoes_a_finer_one(factor):
    geometry = scan()
    back = geometry.finer(factor).coarser(factor)
    np.testing.assert_allclose(
        back.matrices, geometry.matrices, atol=1e-12 * np.abs(geometry.matrices).max()
    )
    assert (back.shape_vu, back.pixel_pitch) == (
        geometry.shape_vu,
        pytest.approx(geometry.pixel_pitch),
    )


def test_a_coarser_image_holds_the_means_of_whole_blocks(rng):
    geometry = replace(scan(), shape_vu=(47, 64))
    fine = Projections(geometry, rng.random((len(geometry), 47, 64), np.float32))
    coarse = fine.coarser(3)  # two rows and a column are left over
    assert coarse.geometry.shape_vu == (15, 21)
    np.testing.assert_allclose(
        coarse.line_integrals[2, 4, 5], fine.line_integrals[2, 12:15, 15:18].mean(), rtol=1e-6
    )
    np.testing.assert_allclose(
        coarse.line_integrals[2, 14, 20], fine.line_integrals[2, 42:45, 60:63].mean(), rtol=1e-6
    )
    point = geometry.rotation_center()[None]
    np.testing.assert_allclose(
        coarse.geometry.project(point)[0], (geometry.project(point)[0] - 1) / 3, atol=1e-9
    )


def test_the_focal_length_is_the_source_detector_distance_in_pixels():
    geometry = scan()
    np.testing.assert_allclose(geometry.focal_lengths() * geometry.pixel_pitch, 1.198, rtol=1e-12)
    np.testing.assert_allclose(
        geometry.finer(2).focal_lengths(), 2 * geometry.focal_lengths(), rtol=1e-12
    )


@given(factor=st.integers(1, 5), u=st.floats(-0.5, 39.49), v=st.floats(-0.5, 29.49))
def test_a_finer_detector_is_the_same_detector(factor, u, v):
    geometry = ConeBeamGeometry.circular(
        times=[0.0, 1.0],
        angles=[0.0, 0.3],
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(30, 40),
        pixel_pitch=1e-3,
    )
    fine = geometry.finer(factor)
    assert fine.shape_vu == (30 * factor, 40 * factor)
    # the middle of a pixel's parts is its middle, and its border theirs
    parts = [factor * (np.array([u, v]) + 0.5) - 0.5]
    np.testing.assert_allclose(
        fine.ray_directions(*parts[0]), geometry.ray_directions(u, v), atol=1e-12
    )


def test_a_geometry_prints_as_one_short_line_with_units():
    paper = scan(times=np.arange(248) / 31, angles=np.radians(-8.8 + 0.8 * np.arange(248)))
    text = repr(paper)
    assert text == (
        "ConeBeamGeometry(248 views over 197.6 deg of 620x480 pixels of 0.616 mm, source to center "
        "780, to detector 1198 mm)"
    )
    assert len(text) < 120
    assert "(1 view over 0 deg" in repr(paper[:1])


def test_projections_print_as_one_short_line():
    text = repr(Projections(scan(shape_vu=(4, 5)), np.zeros((10, 4, 5))))
    assert text == (
        "Projections(10 views over 180 deg of 5x4 pixels, dimensionless line integrals)"
    )


def test_rows_that_are_higher_than_wide_have_a_pitch_of_their_own():
    geometry = scan()
    assert geometry.row_pitch() == geometry.pixel_pitch
    twice = replace(geometry, matrices=np.array([1, 0.5, 1])[:, None] * geometry.matrices)
    assert twice.row_pitch() == pytest.approx(2 * geometry.pixel_pitch, rel=1e-12)


def test_counts_are_no_line_integrals():
    """Whole numbers of a detector, or of a mask that is none."""
    matrices = np.tile([[1.0, 0, 3, 0], [0, 1, 2, 0], [0, 0, 1, 1]], (2, 1, 1))
    geometry = ConeBeamGeometry(np.arange(2.0), matrices, (3, 4))
    with pytest.raises(LegsimError, match="counts of a detector; make line integrals"):
        Projections(geometry, np.full((2, 3, 4), 50000, np.uint16))
    assert not Projections(geometry, np.zeros((2, 3, 4), int)).line_integrals.any()
    with pytest.raises(LegsimError, match="whole numbers"):
        ConeBeamGeometry(np.arange(2.0), matrices, (3.5, 4))
