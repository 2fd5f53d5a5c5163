"""The settings of a scan become views, a grid, a beam and a detector."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.run import c_arm as run_c_arm
from legsim.run.c_arm import c_arm, volume_grid
from legsim.scan.acquisition import Imaging
from legsim.scan.c_arm import CArm
from legsim.scan.detector import Detector


def scan(**changes) -> config.ScanConfig:
    return config.ScanConfig(**changes)


def with_detector(**changes) -> config.ScanConfig:
    return scan(detector=config.DetectorConfig(**changes))


def with_spectrum(tmp_path: Path, text: str = "40,1\n80,1\n", **changes) -> config.ScanConfig:
    (tmp_path / "s.csv").write_text(f"energy_kev,weight\n{text}")
    return scan(
        spectrum=config.SpectrumConfig(kind="file", file=str(tmp_path / "s.csv"), **changes)
    )


@pytest.mark.parametrize(("preset", "made"), [("paper", CArm.paper()), ("half", CArm.half())])
def test_the_presets_are_the_published_scan(preset, made):
    """Bit for bit: what is scanned by settings and by hand is the same."""
    configured = c_arm(config.load_settings(preset=preset).scan)
    for field in fields(CArm):
        a, b = getattr(configured, field.name), getattr(made, field.name)
        np.testing.assert_array_equal(a, b, err_msg=field.name)


def test_every_setting_of_the_c_arm_is_passed_on():
    arm = c_arm(
        scan(
            start_s=5.25,
            views=3,
            increment_deg=2.0,
            first_angle_deg=10.0,
            rate_hz=4.0,
            source_detector_mm=1100,
            source_isocenter_mm=700,
            columns=40,
            rows=30,
            pixel_mm=2.5,
            rays_per_pixel=3,
        )
    )
    np.testing.assert_allclose(np.degrees(arm.angles), [10, 12, 14])
    assert (arm.start, arm.rate_hz, arm.shape_vu, arm.rays_per_pixel) == (5.25, 4.0, (30, 40), 3)
    lengths = (arm.source_detector, arm.source_isocenter, arm.pixel_pitch)
    np.testing.assert_allclose(lengths, (1.1, 0.7, 2.5e-3), rtol=1e-15)


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
        "has 20000 photons per pixel of the open beam, with 0 of readout noise, lag of 1.5 %."
        in said
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
    for kind, key, value, reader in (
        ("none", "kvp", 120, "tube"),
        ("none", "file", "no.csv", "file"),
        ("tube", "file", "no.csv", "file"),
        ("file", "copper_mm", 1, "tube"),
    ):
        told = rf"scan\.spectrum\.{key} has no effect with .*'{kind}'; .* set the kind to {reader}"
        with pytest.raises(LegsimError, match=told):
            run_c_arm.imaging(scan(spectrum=config.SpectrumConfig(kind=kind, **{key: value})))
    with pytest.raises(LegsimError, match=r"no file is named: set scan\.spectrum\.file"):
        run_c_arm.imaging(scan(spectrum=config.SpectrumConfig(kind="file")))
    with pytest.raises(LegsimError, match=r"no\.csv"):
        run_c_arm.imaging(
            scan(spectrum=config.SpectrumConfig(kind="file", file=str(tmp_path / "no.csv")))
        )
