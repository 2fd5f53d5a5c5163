import numpy as np
import pytest

from legsim import acquisition, config
from legsim.errors import LegsimError

RECORDED = 3.0 + np.arange(2400) / 120


def scan(**changes) -> config.ScanConfig:
    return config.ScanConfig(**changes)


def test_views_come_at_the_detectors_rate_in_the_middle_of_the_recording():
    times = acquisition.view_times(scan(), RECORDED)
    assert len(times) == 248
    np.testing.assert_allclose(np.diff(times), 1 / 31)
    assert times[0] - RECORDED[0] == pytest.approx(RECORDED[-1] - times[-1])


def test_a_chosen_start_is_the_first_view():
    assert acquisition.view_times(scan(start_s=5.25), RECORDED)[0] == 5.25


@pytest.mark.parametrize("start", [2.9, 15.1])
def test_a_scan_that_runs_over_an_end_is_refused(start):
    with pytest.raises(LegsimError, match=r"set scan.start_s between 3.00 and 15.02"):
        acquisition.view_times(scan(start_s=start), RECORDED)


def test_a_recording_shorter_than_the_scan_is_refused():
    with pytest.raises(LegsimError, match=r"recording lasts 4.99 s, the scan 7.97 s \(248 views at 31 Hz\)"):
        acquisition.view_times(scan(), RECORDED[:600])


def test_the_c_arm_is_the_papers():
    times = acquisition.view_times(scan(), RECORDED)
    geometry = acquisition.c_arm(scan(), times, np.array([0.1, 0.5, -0.1]))
    np.testing.assert_allclose(np.linalg.norm(geometry.sources() - [0.1, 0.5, -0.1], axis=-1), 0.78)
    np.testing.assert_allclose(geometry.rotation_center(), [0.1, 0.5, -0.1], atol=1e-9)
    pixels, _ = geometry.project(np.array([[0.1, 0.51, -0.1]]))
    np.testing.assert_allclose(pixels[:, 0], [[309.5, 239.5 + 10 * 1198 / 780 / 0.616]] * 248, atol=1e-6)


def test_field_of_view_is_what_the_outermost_ray_touches():
    radius = acquisition.field_of_view(scan())
    geometry = acquisition.c_arm(scan(), np.arange(248.0), np.zeros(3))
    edge = geometry.ray_directions(619.5, 239.5)[0]
    source = geometry.sources()[0]
    nearest = source - (source @ edge) / (edge @ edge) * edge
    assert np.linalg.norm(nearest) == pytest.approx(radius, rel=1e-6)


def test_the_grid_surrounds_the_isocenter():
    grid = acquisition.volume_grid(config.GridConfig(voxels=20, voxel_mm=2.0), np.array([0.1, 0.5, -0.1]))
    assert (grid.shape_zyx, grid.center) == ((20, 20, 20), (0.1, 0.5, -0.1))
    assert grid.spacing_xyz == pytest.approx((0.002, 0.002, 0.002))
