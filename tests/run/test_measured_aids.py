"""Beads, clocks and rough starts of a measured scan: a consumer sensor is corrected from files."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import legsim as ls
from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.fiducials import Fiducials
from legsim.correction.rough_start import StartErrors, turned
from legsim.deformation.files import load_motion
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors
from legsim.imu.files import save_imu
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals
from legsim.run import measured_aids
from legsim.run.measured import MeasuredScan, load_measured_scan
from tests.correction.test_fused import BMI160, PLACES, SAMPLES, VIEWS, left_px, motion_of
from tests.correction.test_fused import GEOMETRY as SMALL
from tests.references.sway import Sway

SWAY = Sway.standing(4, position_mm=2.5, angle_deg=0.5)
ALL = range(len(VIEWS))
GEOMETRY = replace(
    SMALL,
    matrices=np.array([[1.0, 0, 60], [0, 1, 200], [0, 0, 1]]) @ SMALL.matrices,
    shape_vu=(180, 150),
)
"""the same rays on a detector that sees all beads, and the sensor"""
LATE = 0.012
"""s by which the sensor's clock is ahead"""

SCAN = """
projections = "projections.mha"
geometry = "geometry.json"

[[imu]]
file = "imu.csv"

[[imu.sensors]]
name = "shank_l"
segment = "tibia_l"

[imu.sensors.start]
known = "roughly"
heading_sd_deg = 3
position_sd_mm = 5
position_mm = {place}
rotation_deg = {turn}

[grid]
shape_zyx = [8, 6, 8]
spacing_mm = [10.0, 10.0, 10.0]
"""
BEADS = '\n[beads]\nfile = "beads.csv"\n'


def bead_pixels() -> np.ndarray:
    exact = GEOMETRY.project(motion_of(SWAY).carry(PLACES))[0]
    return exact + 0.2 * np.random.default_rng(2).standard_normal(exact.shape)


def table(pixels: np.ndarray, views: Sequence[int] = ALL) -> str:
    rows = [f"{v},{b},{u:.3f},{w:.3f}" for v in views for b, (u, w) in enumerate(pixels[v])]
    return "\n".join(["view,bead,u,v", *rows]) + "\n"


def write(folder: Path, more: str = BEADS, beads: str = "") -> Path:
    """A BMI160 with all its errors, late by some milliseconds, strapped on by hand."""
    rng = np.random.default_rng(3)
    rate, force = SWAY.signals(SAMPLES)
    exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    read = read_out(exact, BMI160.without("low-pass"), rng)
    late = ImuSignals(SAMPLES + LATE, ("shank_l",), read.angular_velocity, read.specific_force)
    save_imu(folder / "imu.csv", late)
    geometry_files.save_geometry(folder / "geometry.json", GEOMETRY)
    images = np.zeros((len(VIEWS), *GEOMETRY.shape_vu), np.float32)
    image_files.save_projections(folder / "projections.mha", Projections(GEOMETRY, images))
    first, sigmas = SWAY.poses(VIEWS[:1])[0], StartErrors().sigmas
    rotation = turned(first[:3, :3], sigmas[:3] * rng.standard_normal(3))
    place = first[:3, 3] + sigmas[6:] * rng.standard_normal(3)
    turn = np.degrees(transforms.vector_from_rotation(rotation))
    text = SCAN.format(place=(1e3 * place).tolist(), turn=turn.tolist())
    (folder / "scan.toml").write_text(text.replace("[grid]", f"{more}\n[grid]"))
    (folder / "beads.csv").write_text(beads or table(bead_pixels()))
    return folder / "scan.toml"


def loaded(folder: Path, **given: str) -> MeasuredScan:
    return load_measured_scan(write(folder, **given))


def test_a_consumer_sensor_and_beads_undo_a_sway_from_files_alone(tmp_path):
    result = ls.correct(write(tmp_path), ["standing", "fused-beads"], tmp_path / "out")
    found = load_motion(tmp_path / "out/motion-fused-beads.npz")
    assert isinstance(found, ls.RigidMotion)
    before = left_px(ls.RigidMotion.identity(VIEWS), SWAY)
    assert left_px(found, SWAY) < 0.15 * before
    (said,) = [note for note in result.notes if "sensor's clock is" in note]
    offset, spread = float(said.split()[4]), float(said.split("deviation of ")[1].split()[0])
    assert abs(offset - 1e3 * LATE) < 3 * spread
    assert any("2 beads: 100 % of their shadows" in note for note in result.notes)
    assert not any("dead reckoning" in note for note in result.notes)


def test_dead_reckoning_is_in_doubt_by_the_sensors_model(tmp_path):
    (said,) = measured_aids.doubts(loaded(tmp_path), ["uncorrected", "rigid", "fused-beads"])
    assert said.startswith("In doubt: rigid follows shank_l by dead reckoning")
    assert said.endswith("its errors are taken for those of bmi160.")


MODEL = '\n[methods]\nsensor_model = "{}"\n'


@pytest.mark.parametrize(
    ("model", "counted"),
    [("bmi160", "7 unverified, 10 from secondary sources, 4"), ("lsm6dsv", "10 missing")],
)
def test_what_the_expected_errors_rest_on_is_counted(tmp_path, model: str, counted: str):
    scan = loaded(tmp_path, more=BEADS + MODEL.format(model))
    (said,) = measured_aids.reliance(scan, ["uncorrected", "fused-beads"])
    assert said.startswith(f"The sensors' errors are taken for those of {model}. Of its numbers ")
    assert counted in said
    assert measured_aids.reliance(scan, ["uncorrected", "autofocus"]) == ()


def test_a_sensor_without_a_stated_bias_is_in_doubt(tmp_path):
    scan = loaded(tmp_path, more=BEADS + MODEL.format("adis16505"))
    said = measured_aids.reliance(scan, ["fused-beads"])[1:]
    (line,) = said
    assert line.startswith(
        "In doubt: adis16505 states no turn-on-bias of its accelerometer and gyroscope"
    )


@pytest.mark.parametrize(
    "known",
    [
        'off = ["turn-on-bias"]',
        'calibration = "six-positions"',
        "accelerometer = {turn_on_bias_mg = 0}\ngyroscope = {turn_on_bias_deg_per_s = 0}",
    ],
)
def test_a_bias_that_is_known_to_be_gone_is_in_no_doubt(tmp_path, known: str):
    more = BEADS + MODEL.format("adis16505") + f"[methods.sensor_errors]\n{known}\n"
    (said,) = measured_aids.reliance(loaded(tmp_path, more=more), ["fused-beads"])
    assert "In doubt" not in said


def test_a_sensor_of_which_nothing_is_stated_is_in_doubt(tmp_path):
    scan = loaded(tmp_path, more=BEADS + MODEL.format("custom"))
    said = measured_aids.reliance(scan, ["fused-beads"])
    assert [line.split(" of its")[0] for line in said[1:]] == [
        "In doubt: methods.sensor_errors states no turn-on-bias",
        "In doubt: methods.sensor_errors states no white-noise",
    ]


def test_methods_that_find_the_start_begin_where_the_sensor_was_strapped_on(tmp_path):
    """A biased gyroscope makes standing_start run after its drift."""
    scan = loaded(tmp_path)
    worn = measured_aids.as_worn(scan)
    np.testing.assert_array_equal(worn.starts[0].velocity, 0)
    assert np.linalg.norm(scan.seen.starts[0].velocity) > 0.05
    off = worn.starts[0].world_from_sensor[:3, :3] @ SWAY.poses(VIEWS[:1])[0, :3, :3].T
    assert transforms.rotation_angle(off) < np.radians(9)


def test_priors_are_those_of_the_model_and_of_the_given_start(tmp_path):
    models = Path(load_sensor.__code__.co_filename).parents[2] / "models/sensors/mti300.toml"
    (tmp_path / "mine.toml").write_bytes(models.read_bytes())
    more = '[methods]\nsensor_model = "mine.toml"\nclock_ms = 0\nspread_mm = 3\n'
    found = measured_aids.priors(loaded(tmp_path, more=more))
    assert found.errors == load_sensor("mti300").errors
    assert (found.clock, found.spread) == (0, 3e-3)
    assert found.start.heading == pytest.approx(np.radians(3))
    assert found.start.place == pytest.approx(5e-3)


@pytest.mark.parametrize("known", ["exactly", "roughly"])
def test_a_stated_error_of_a_start_counts_however_it_is_known(tmp_path, known):
    scan = loaded(tmp_path)
    stated = {"known": known, "position_sd_mm": 20.0, "heading_sd_deg": 0.0}
    worn = {n: s.model_copy(update=stated) for n, s in scan.worn.items()}
    errors = measured_aids.priors(replace(scan, worn=worn)).start
    assert errors.place == pytest.approx(20e-3)
    assert errors.heading == StartErrors().heading


def test_a_moved_bead_file_makes_the_volume_anew(tmp_path):
    path = write(tmp_path)
    keys = [measured_aids.fingerprint(load_measured_scan(path))]
    (tmp_path / "beads.csv").write_text(table(bead_pixels() + 1))
    keys.append(measured_aids.fingerprint(load_measured_scan(path)))
    assert keys[0] != keys[1]


def fiducial_rows(length: float = 0.03, seed: int = 4) -> str:
    """Shadows of the four points in the sensor that sways, with 0.2 px of noise."""
    places = Fiducials(length).points_sensor
    paths = transforms.apply(SWAY.poses(VIEWS), places)
    pixels = GEOMETRY.project(paths)[0]
    pixels = pixels + 0.2 * np.random.default_rng(seed).standard_normal(pixels.shape)
    rows, columns = GEOMETRY.shape_vu
    seen = ((pixels >= 0) & (pixels <= [columns - 1, rows - 1])).all(-1)
    names = ("origin", "x", "y", "z")
    lines = [
        f"{view},{names[k]},{pixels[view, k, 0]:.3f},{pixels[view, k, 1]:.3f}"
        for view, k in np.argwhere(seen)
    ]
    return "\n".join(["view,point,u,v", *lines]) + "\n"


def test_fiducials_in_the_sensor_undo_a_sway_from_files_alone(tmp_path):
    more = '\n[fiducials]\nfile = "points.csv"\naxis_length_mm = 30\n'
    path = write(tmp_path, more=more)
    (tmp_path / "points.csv").write_text(fiducial_rows())
    result = ls.correct(path, ["fused-fiducials"], tmp_path / "out")
    found = load_motion(tmp_path / "out/motion-fused-fiducials.npz")
    assert isinstance(found, ls.RigidMotion)
    assert left_px(found, SWAY) < 0.15 * left_px(ls.RigidMotion.identity(VIEWS), SWAY)
    assert any("4 fiducials in the sensor" in note for note in result.notes)
    # other pixels are another scan: nothing is taken from the folder
    before = (tmp_path / "out/motion-fused-fiducials.npz").read_bytes()
    (tmp_path / "points.csv").write_text(fiducial_rows(seed=5))
    ls.correct(path, ["fused-fiducials"], tmp_path / "out")
    assert (tmp_path / "out/motion-fused-fiducials.npz").read_bytes() != before


def test_a_scan_without_beads_says_where_they_go(tmp_path):
    with pytest.raises(
        LegsimError, match=r"of sensor shank_l: .* as \[\[beads\]\] with sensor = \"shank_l\""
    ):
        ls.correct(write(tmp_path, more=""), ["fused-beads"], tmp_path / "out")


def test_shadows_that_fit_no_path_of_the_sensor_are_doubted_and_move_nothing(tmp_path):
    path = write(tmp_path, beads=table(bead_pixels()[::-1]))
    result = ls.correct(path, ["fused-beads"], tmp_path / "o")
    assert any("In doubt: fused-beads: the shadows are 3 px RMS from" in n for n in result.notes)
    assert (tmp_path / "o/volume-fused-beads.mha").read_bytes() == (
        tmp_path / "o/volume-uncorrected.mha"
    ).read_bytes()


def test_beads_that_are_exchanged_are_doubted(tmp_path):
    pixels = bead_pixels()
    pixels[20:] = pixels[20:, ::-1]
    (said,) = measured_aids.doubts(loaded(tmp_path, beads=table(pixels)), ["fused-beads"])
    assert said.startswith(
        f"In doubt: {tmp_path / 'beads.csv'}: the rays of a bead miss each other"
    )
    assert not measured_aids.doubts(loaded(tmp_path), ["fused-beads"])


def test_a_start_that_is_stated_exactly_is_no_reason_to_doubt(
    tmp_path, monkeypatch: pytest.MonkeyPatch
):
    """Of a sensor without errors, only the start may drift."""
    monkeypatch.setattr(measured_aids, "priors", lambda _: ls.SensorPriors(SensorErrors()))
    found = []
    spread = {"position_sd_mm": 5.0, "heading_sd_deg": 3.0}
    for known, wide in (("exactly", False), ("roughly", True), ("exactly", True)):
        scan = loaded(tmp_path)
        stated = {"known": known, **(spread if wide else dict.fromkeys(spread, 0.0))}
        worn = {n: s.model_copy(update=stated) for n, s in scan.worn.items()}
        found.append(measured_aids.doubts(replace(scan, worn=worn), ["rigid"]))
    exact, *rough = found
    assert not exact
    for said in rough:
        assert said[0].startswith("In doubt: rigid follows shank_l by dead reckoning")
