"""Curves of a recording hold the values that were logged."""

import numpy as np

from tests.examples.recordings import read


def test_curves_hold_the_values_exactly(scene, written):
    replay = scene.replay
    _, knee = read(written, "/angles/knee_angle_r", "Scalars:scalars")
    np.testing.assert_array_equal(
        np.stack(knee)[:, 0], np.rad2deg(replay.trajectories.coordinate("knee_angle_r"))
    )
    _, height = read(written, "/translations/pelvis_ty", "Scalars:scalars")
    np.testing.assert_allclose(
        np.stack(height)[:, 0],
        1e3 * (replay.trajectories.coordinate("pelvis_ty") - replay.trajectories.values[0, 2]),
    )
    _, force = read(written, "/imu/shank_r/specific_force", "Scalars:scalars")
    np.testing.assert_array_equal(np.stack(force), replay.imu.sensor("shank_r")[1])
    _, rms = read(written, "/residuals/rms", "Scalars:scalars")
    expected = 1e3 * np.sqrt(np.nanmean(replay.marker_residuals() ** 2, -1))
    np.testing.assert_allclose(np.stack(rms)[:, 0], expected)
