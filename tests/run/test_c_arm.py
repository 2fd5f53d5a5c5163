"""The settings of a scan become views, a grid, a beam and a detector."""

from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.run import c_arm as run_c_arm
from legsim.run.c_arm import c_arm, field_of_view, seen_by_every_view, view_times, volume_grid
from legsim.scan.acquisition import Imaging
from legsim.scan.detector import Detector

RECORDED = 3.0 + np.arange(2400) / 120


def scan(**changes) -> config.ScanConfig:
    return config.ScanConfig(**changes)


def with_detector(**changes) -> config.ScanConfig:
    return scan(detector=config.DetectorConfig(**changes))


def with_spectrum(tmp_path: Path, text: str = "40,1\n80,1\n", **changes) -> config.ScanConfig:
    (tmp_path / "s.csv").write_text(f"energy_kev,weight\n{text}")
    return scan(
        spectrum=config.SpectrumConfig(kind="file", file=str(tmp_path / "s.csv"), **changes)
    )


def test_views_come_at_the_detectors_rate_in_the_middle_of_the_recording():
    times = view_times(scan(), RECORDED)
    assert len(times) == 248
    np.testing.assert_allclose(np.diff(times), 1 / 31)
    assert times[0] - RECORDED[0] == pytest.approx(RECORDED[-1] - times[-1])


def test_a_chosen_start_is_the_first_view():
    assert view_times(scan(start_s=5.25), RECORDED)[0] == 5.25


@pytest.mark.parametrize("start", [2.9, 15.1])
def test_a_scan_that_runs_over_an_end_is_refused(start):
    with pytest.raises(LegsimError, match=r"set scan.start_s between 3.00 and 15.02"):
        view_times(scan(start_s=start), RECORDED)


def test_a_recording_shorter_than_the_scan_is_refused():
    with pytest.raises(
        LegsimError, match=r"recording lasts 4.99 s, the scan 7.97 s \(248 views at 31 Hz\)"
    ):
        view_times(scan(), RECORDED[:600])


def test_the_c_arm_is_the_papers():
    times = view_times(scan(), RECORDED)
    geometry = c_arm(scan(), times, np.array([0.1, 0.5, -0.1]))
    np.testing.assert_allclose(np.linalg.norm(geometry.sources() - [0.1, 0.5, -0.1], axis=-1), 0.78)
    np.testing.assert_allclose(geometry.rotation_center(), [0.1, 0.5, -0.1], atol=1e-9)
    pixels, _ = geometry.project(np.array([[0.1, 0.51, -0.1]]))
    np.testing.assert_allclose(
        pixels[:, 0], [[309.5, 239.5 + 10 * 1198 / 780 / 0.616]] * 248, atol=1e-6
    )


def test_field_of_view_is_what_the_outermost_ray_touches():
    radius = field_of_view(scan())
    geometry = c_arm(scan(), np.arange(248.0), np.zeros(3))
    edge = geometry.ray_directions(619.5, 239.5)[0]
    source = geometry.sources()[0]
    nearest = source - (source @ edge) / (edge @ edge) * edge
    assert np.linalg.norm(nearest) == pytest.approx(radius, rel=1e-6)


@pytest.mark.end_to_end
def test_what_every_view_sees_lies_on_the_detector_and_what_lies_beyond_does_not():
    turn = scan(views=180, increment_deg=2.0, columns=62, rows=48, pixel_mm=6.16)
    isocenter = np.array([0.2, 0.5, -0.1])
    grid = volume_grid(config.GridConfig(voxels=40, voxel_mm=6.4), isocenter)
    pixels, _ = c_arm(turn, np.arange(180) / 31, isocenter).project(grid.positions())
    # a pixel reaches half a pixel beyond its middle
    on_detector = (
        ((pixels > -0.5) & (pixels < np.array([62, 48]) - 0.5)).all((0, 2)).reshape(grid.shape_zyx)
    )
    seen = seen_by_every_view(turn, grid)
    assert (seen & on_detector).sum() > 0.99 * max(seen.sum(), on_detector.sum())


def test_what_every_view_sees_by_a_margin_may_move_up_and_down_by_that_much():
    turn = scan(views=180, increment_deg=2.0, columns=62, rows=48, pixel_mm=6.16)
    grid = volume_grid(config.GridConfig(voxels=40, voxel_mm=6.4), np.zeros(3))
    whole = seen_by_every_view(turn, grid)
    inner = seen_by_every_view(turn, grid, margin=6.4e-3 * 3)
    # three voxels are cut off above and below, of columns that have so many
    moved = [np.roll(whole, k, axis=1) for k in (-3, 3)]
    np.testing.assert_array_equal(inner, whole & moved[0] & moved[1])
    assert 0 < inner.sum() < whole.sum()


def test_the_grid_surrounds_the_isocenter():
    grid = volume_grid(config.GridConfig(voxels=20, voxel_mm=2.0), np.array([0.1, 0.5, -0.1]))
    assert (grid.shape_zyx, grid.center) == ((20, 20, 20), (0.1, 0.5, -0.1))
    assert grid.spacing_xyz == pytest.approx((0.002, 0.002, 0.002))


def test_settings_become_a_detector_in_si_units():
    assert run_c_arm.imaging(scan()) == Imaging()
    assert Imaging().detector.perfect
    read = with_detector(
        photons=1e4,
        blur_fwhm_mm=0.5,
        lag_fractions=(0.01,),
        lag_times_s=(0.2,),
        scatter_to_primary=0.3,
        scatter_fwhm_mm=250,
    )
    assert run_c_arm.imaging(read).detector == Detector(1e4, 0.0, 5e-4, ((0.01, 0.2),), 0.3, 0.25)


def test_the_seed_matters_to_noisy_images_alone_and_a_spectrums_numbers_to_its(tmp_path):
    assert run_c_arm.fingerprint(scan(), 1) == run_c_arm.fingerprint(scan(), 2)
    noisy = with_detector(photons=10)
    assert run_c_arm.fingerprint(noisy, 1) != run_c_arm.fingerprint(noisy, 2)
    before = run_c_arm.fingerprint(with_spectrum(tmp_path), 1)
    assert before == run_c_arm.fingerprint(with_spectrum(tmp_path), 1)
    assert before != run_c_arm.fingerprint(with_spectrum(tmp_path, "40,1\n80,2\n"), 1)


def test_the_report_says_what_the_projections_are_of():
    plain = run_c_arm.sentence(scan(), config.PhantomConfig())
    assert plain == (
        "Projections are of one energy, 60 keV; a pixel is the mean of 2x2 rays; the "
        "detector is perfect."
    )
    read = with_detector(photons=2e4, lag_fractions=(0.01, 0.005), lag_times_s=(1.0, 2.0))
    said = run_c_arm.sentence(
        read, config.PhantomConfig(tissue_swing=config.SoftTissueConfig(amplitude=1))
    )
    assert (
        "has 20000 photons a pixel of the open beam, with 0 of readout noise, lag of 1.5 %." in said
    )
    assert "swings at 10 Hz" in said


def test_detectors_and_beams_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(
        LegsimError, match=r"scan\.detector: 2 lag_fractions and 1 lag_times_s; give one time"
    ):
        run_c_arm.imaging(with_detector(lag_fractions=(0.1, 0.1), lag_times_s=(1.0,)))
    with pytest.raises(
        LegsimError, match=r"scan\.detector: electronic noise .* set the detector's photons too"
    ):
        run_c_arm.imaging(with_detector(electronic_noise_photons=3.0))
    with pytest.raises(LegsimError, match="nothing to correct at one energy"):
        run_c_arm.imaging(scan(spectrum=config.SpectrumConfig(water_precorrection=True)))
    with pytest.raises(LegsimError, match=r"no file is named: set scan\.spectrum\.file"):
        run_c_arm.imaging(scan(spectrum=config.SpectrumConfig(kind="file")))
    with pytest.raises(LegsimError, match=r"no\.csv"):
        run_c_arm.imaging(
            scan(spectrum=config.SpectrumConfig(kind="file", file=str(tmp_path / "no.csv")))
        )
