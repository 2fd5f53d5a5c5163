"""The C-arm: when the views are taken, where they stand, what all of them see."""

import re

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.volume import VolumeGrid
from legsim.scan.c_arm import CArm

RECORDED = 3.0 + np.arange(2400) / 120
PAPER = CArm.paper()
TURN = CArm.paper(angles=np.radians(2.0) * np.arange(180), shape_vu=(48, 62), pixel_pitch=6.16e-3)


def test_its_repr_tells_views_pixels_arc_and_time():
    assert repr(PAPER) == ("CArm(248 views of 620x480 pixels of 0.616 mm over 197.6 deg in 7.97 s)")
    assert repr(CArm.half()) == (
        "CArm(248 views of 310x240 pixels of 1.232 mm over 197.6 deg in 7.97 s)"
    )


def test_pixels_of_twice_the_size_see_the_same_field():
    assert CArm.half().field_of_view == pytest.approx(PAPER.field_of_view, rel=1e-12)


def test_changes_are_laid_over_the_published_scan():
    arm = CArm.half(rate_hz=62.0, shape_vu=(120, 310))
    assert (arm.rate_hz, arm.shape_vu, arm.pixel_pitch) == (62.0, (120, 310), 1.232e-3)
    assert arm.duration == pytest.approx(PAPER.duration / 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"angles": [0.0]}, "at least two angles"),
        ({"angles": [0.0, np.nan]}, "all finite numbers"),
        ({"rate_hz": 0.0}, r"CArm\.rate_hz is 0\.0; give a positive number"),
        ({"pixel_pitch": -1e-3}, r"CArm\.pixel_pitch is -0\.001"),
        ({"source_isocenter": np.nan}, r"CArm\.source_isocenter is nan"),
        (
            {"source_detector": 0.5},
            r"0\.5 m from the source, is in front of the isocenter at 0\.78 m",
        ),
    ],
)
def test_what_is_no_c_arm_is_refused(changes, message):
    with pytest.raises(LegsimError, match=message):
        CArm.paper(**changes)


def test_views_come_at_the_detectors_rate_in_the_middle_of_the_recording():
    times = PAPER.view_times(RECORDED)
    assert len(times) == 248
    np.testing.assert_allclose(np.diff(times), 1 / 31)
    assert times[0] - RECORDED[0] == pytest.approx(RECORDED[-1] - times[-1])


def test_a_chosen_start_is_the_first_view():
    assert CArm.paper(start=5.25).view_times(RECORDED)[0] == 5.25


@pytest.mark.parametrize("start", [2.9, 15.1])
def test_a_scan_that_runs_over_an_end_is_refused(start):
    with pytest.raises(LegsimError, match=r"set scan.start_s between 3.00 and 15.02"):
        CArm.paper(start=start).view_times(RECORDED)


def test_a_recording_shorter_than_the_scan_is_refused():
    with pytest.raises(
        LegsimError, match=r"recording lasts 4.99 s, the scan 7.97 s \(248 views at 31 Hz\)"
    ):
        PAPER.view_times(RECORDED[:600])


def test_the_c_arm_is_the_papers():
    times = PAPER.view_times(RECORDED)
    geometry = PAPER.geometry(times, [0.1, 0.5, -0.1])
    np.testing.assert_allclose(np.linalg.norm(geometry.sources() - [0.1, 0.5, -0.1], axis=-1), 0.78)
    np.testing.assert_allclose(geometry.rotation_center(), [0.1, 0.5, -0.1], atol=1e-9)
    pixels, _ = geometry.project(np.array([[0.1, 0.51, -0.1]]))
    np.testing.assert_allclose(
        pixels[:, 0], [[309.5, 239.5 + 10 * 1198 / 780 / 0.616]] * 248, atol=1e-6
    )


def test_field_of_view_is_what_the_outermost_ray_touches():
    radius = PAPER.field_of_view
    geometry = PAPER.geometry(np.arange(248.0), np.zeros(3))
    edge = geometry.ray_directions(619.5, 239.5)[0]
    source = geometry.sources()[0]
    nearest = source - (source @ edge) / (edge @ edge) * edge
    assert np.linalg.norm(nearest) == pytest.approx(radius, rel=1e-6)


@pytest.mark.end_to_end
def test_what_every_view_sees_lies_on_the_detector_and_what_lies_beyond_does_not():
    isocenter = [0.2, 0.5, -0.1]
    grid = VolumeGrid.cubic(40, 6.4e-3, isocenter)
    pixels, _ = TURN.geometry(np.arange(180) / 31, isocenter).project(grid.positions())
    # a pixel reaches half a pixel beyond its middle
    on_detector = (
        ((pixels > -0.5) & (pixels < np.array([62, 48]) - 0.5)).all((0, 2)).reshape(grid.shape_zyx)
    )
    seen = TURN.seen_by_every_view(grid)
    assert (seen & on_detector).sum() > 0.99 * max(seen.sum(), on_detector.sum())


def test_what_every_view_sees_by_a_margin_may_move_up_and_down_by_that_much():
    grid = VolumeGrid.cubic(40, 6.4e-3, [0.0, 0.0, 0.0])
    whole = TURN.seen_by_every_view(grid)
    inner = TURN.seen_by_every_view(grid, margin=6.4e-3 * 3)
    # three voxels are cut off above and below, of columns that have so many
    moved = [np.roll(whole, k, axis=1) for k in (-3, 3)]
    np.testing.assert_array_equal(inner, whole & moved[0] & moved[1])
    assert 0 < inner.sum() < whole.sum()


@pytest.mark.parametrize("last", [12.0029, 9.0, 7.9679, 7.9677419356])
def test_starts_that_are_suggested_are_accepted(last: float):
    recorded = np.linspace(0.0041, 0.0041 + last, 1000)
    with pytest.raises(LegsimError, match=r"set scan\.start_s between") as refused:
        CArm.half(start=99.0).view_times(recorded)
    for start in re.findall(r"([\d.]+) and ([\d.]+)$", str(refused.value))[0]:
        times = CArm.half(start=float(start)).view_times(recorded)
        assert times[0] >= recorded[0]
        assert times[-1] <= recorded[-1] + 1e-12
