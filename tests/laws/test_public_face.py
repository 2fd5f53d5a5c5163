"""A path may be a text, and a number numpy's, wherever the public face takes one."""

from pathlib import Path

import numpy as np
import pytest

import legsim as ls
from legsim.geometry import files, image_files
from legsim.kinematics import from_recording


def geometry(number) -> ls.ConeBeamGeometry:
    return ls.ConeBeamGeometry.circular(
        times=np.arange(3),
        angles=np.arange(3) * 0.3,
        source_isocenter=number(0.75),
        source_detector=number(1.25),
        shape_vu=(4, 5) if number is float else (np.int64(4), np.int32(5)),
        pixel_pitch=number(0.0625),
    )


@pytest.mark.parametrize("number", [np.float32, np.float64])
def test_numpys_numbers_make_the_same_values_and_files(tmp_path, number):
    written = []
    for kind in (float, number):
        made = geometry(kind)
        for name in ("g.json", "g.xml"):
            files.save_geometry(tmp_path / name, made)
            written.append((tmp_path / name).read_bytes())
        images = ls.Projections(made, np.zeros((3, 4, 5)))
        image_files.save_projections(tmp_path / "p.mha", images)
        grid = ls.VolumeGrid.cubic(np.int64(4), kind(0.25), np.zeros(3, np.float32))
        ls.save_volume(tmp_path / "v.mha", ls.Volume(grid, np.zeros((4, 4, 4))))
        written += [(tmp_path / name).read_bytes() for name in ("p.mha", "v.mha")]
    assert written[:4] == written[4:]


@pytest.mark.parametrize("path", [str, Path])
def test_a_path_may_be_a_text_or_a_path(tmp_path, path):
    def place(name: str):
        return path(tmp_path / name)

    made = geometry(float)
    files.save_geometry(place("g.json"), made)
    np.testing.assert_array_equal(ls.load_geometry(place("g.json")).matrices, made.matrices)
    images = ls.Projections(made, np.ones((3, 4, 5)))
    image_files.save_projections(place("p.mha"), images)
    assert ls.load_projections(place("p.mha"), made).line_integrals.min() == 1
    grid = ls.VolumeGrid.cubic(4, 0.25, np.zeros(3))
    ls.save_volume(place("v.nii.gz"), ls.Volume(grid, np.zeros((4, 4, 4))))
    assert ls.load_volume(place("v.nii.gz")).grid == grid
    recording = ls.load_recording(path(from_recording.find_recording("subject01/squat_30.trc")))
    ls.save_recording(place("r.csv"), recording)
    (tmp_path / "s.toml").write_text("seed = 3")
    assert ls.load_settings(place("s.toml")).seed == 3


def test_numpys_numbers_describe_sensors_noise_and_scans(rng):
    sensor = ls.Sensor("s", "tibia_l", np.float32(0.25), np.zeros(3, np.float32), np.eye(3))
    assert sensor.distance == 0.25
    noise = ls.ImuNoise.from_rms(
        acceleration_mg=np.int64(2), angular_velocity_deg_per_s=np.float32(1), bandwidth_hz=100
    )
    plain = ls.ImuNoise.from_rms(
        acceleration_mg=2, angular_velocity_deg_per_s=1, bandwidth_hz=np.float64(100)
    )
    assert noise.sample_rms(np.float32(120)) == pytest.approx(plain.sample_rms(120), rel=1e-6)
    ls.Detector(photons=np.int64(1000), electronic_noise=np.float32(3))
    ls.CArm.half(rate_hz=np.float32(31), shape_vu=np.array([44, 60]), rays_per_pixel=np.int64(1))


def test_a_negative_seed_is_refused_in_one_line():
    person = ls.solve_kinematics("subject01/squat_30.trc")
    with pytest.raises(ls.LegsimError, match=r"seed=-1.*: a seed is 0 or a positive whole number"):
        ls.simulate_scan(person, seed=-1)
