"""A simulated scan is corrected from files as its run did, bit for bit."""

import importlib.util
import re
import tomllib
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

import legsim as ls
from legsim import config
from legsim.config import measured_scan
from legsim.core.errors import LegsimError
from legsim.correction import bead_scan
from legsim.geometry import image_files
from legsim.imu import calibration
from legsim.run import measured, measured_aids, pipeline, sensors, volumes
from legsim.run.scan_file import NAME, known_of

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
METHODS = ("uncorrected", "rigid", "nonrigid-2d", "nonrigid-3d", "articulated")


@pytest.mark.end_to_end
@pytest.mark.parametrize(
    "more", [{}, {"points_per_segment": 1, "node_mm": 20.0}], ids=["joints", "more points"]
)
def test_every_volume_of_a_run_comes_back_bit_for_bit(tiny_settings, tmp_path, more):
    used = tiny_settings.methods.model_copy(update={"run": METHODS, **more})
    wanted = tiny_settings.model_copy(update={"methods": used})
    run = pipeline.run_scan(wanted, tmp_path / "run", presented=False).folder
    ls.correct(run / NAME, METHODS, tmp_path / "out")
    for name in METHODS:
        ours, theirs = (
            image_files.load_volume(folder / f"volume-{name}.mha").attenuation
            for folder in (run, tmp_path / "out")
        )
        np.testing.assert_array_equal(ours, theirs, err_msg=name)


@pytest.mark.end_to_end
def test_estimates_from_calibrated_sensors_come_back(tiny_settings, tmp_path):
    trees = (
        {"imu": {"noise": {"kind": "bmi160", "calibration": "six-positions"}}},
        {"methods": {"start": "rough", "run": ["standing", "rigid"]}},
    )
    wanted = config.from_trees("paper", tiny_settings.model_dump(), *trees)
    run = pipeline.run_scan(wanted, tmp_path / "run", presented=False)
    found = ls.correct(run.folder / NAME, ["standing", "rigid"], tmp_path / "out")
    for name in ("standing", "rigid"):
        ours, theirs = (
            image_files.load_volume(folder / f"volume-{name}.mha").attenuation
            for folder in (run.folder, tmp_path / "out")
        )
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
    drifts = [re.findall(r"rigid follows .*? RMS", str(one)) for one in (run.warnings, found.notes)]
    assert drifts[0] == drifts[1]


BEADED = ("marker-based", "fused-beads", "articulated-beads")


@pytest.mark.end_to_end
def test_methods_that_follow_beads_come_back_from_pixels_of_their_shadows(
    tiny_settings, tmp_path, monkeypatch
):
    """Beads below and above the knee, each in a file, which marker-based takes together."""
    seen: dict[str, np.ndarray] = {}
    add, exact = bead_scan.add_beads, volumes.exact_beads

    def around(*args, **given):
        made = add(*args, **given)
        seen["around"] = bead_scan.shadows_of(made).pixels
        return made

    def on(settings, setup, stream):
        made = exact(settings, setup, stream)
        seen[f"{settings.methods.sensor}-{stream}"] = made.pixels
        return made

    monkeypatch.setattr(volumes.bead_scan, "add_beads", around)
    monkeypatch.setattr(volumes, "exact_beads", on)
    trees = (
        {"imu": {"noise": {"kind": "bmi160", "calibration": "six-positions"}}},
        {"methods": {"start": "rough", "run": BEADED, "fused": {"found": "exact"}}},
    )
    wanted = config.from_trees("paper", tiny_settings.model_dump(), *trees)
    run = pipeline.run_scan(wanted, tmp_path / "run", presented=False).folder
    given = {
        "marker-based": {"shank_l": seen["around"][:, :6], "thigh_l": seen["around"][:, 6:]},
        "fused-beads": {"": seen[f"shank_l-{volumes._FUSED}"]},
        "articulated-beads": {s: seen[f"{s}-{volumes._TIED}"] for s in ("shank_l", "thigh_l")},
    }
    known = (run / NAME).read_text()
    for name, beads in given.items():
        scan = run / f"{name}.toml"
        scan.write_text(known + "".join(beads_table(run, name, *one) for one in beads.items()))
        ls.correct(scan, name, tmp_path / name)
        ours, theirs = (
            image_files.load_volume(folder / f"volume-{name}.mha").attenuation
            for folder in (run, tmp_path / name)
        )
        # linear algebra rounds by where in memory its numbers lie
        np.testing.assert_allclose(ours, theirs, atol=1e-3, err_msg=name)


def beads_table(folder: Path, method: str, sensor: str, pixels: np.ndarray) -> str:
    """Writes pixels (v, b, 2) as CSV; the table of a SCAN.toml that names it."""
    file = folder / f"{method}-{sensor}.csv"
    shown = np.argwhere(np.isfinite(pixels).all(-1)).tolist()
    rows = [f"{v},{b},{','.join(map(repr, pixels[v, b].tolist()))}" for v, b in shown]
    file.write_text("\n".join(["view,bead,u,v", *rows]) + "\n")
    on = f'sensor = "{sensor}"\n' if sensor else ""
    return f'\n[[beads]]\nfile = "{file.name}"\n{on}'


def test_a_run_knows_no_more_than_a_scanner(tiny_run, tmp_path):
    scan = ls.load_measured_scan(tiny_run.folder / NAME)
    assert scan.seen.signals.sensor_names == ("shank_l", "thigh_l")
    assert len(scan.seen.joints[0]) == 3
    with pytest.raises(LegsimError, match="only a simulated scan has"):
        ls.correct(tiny_run.folder / NAME, ["oracle"], tmp_path)


def test_the_documents_own_scan_is_that_of_the_run(tiny_run, tmp_path):
    """A TIFF, RTK's geometry and tables in g by another clock hold the same scan, but its starts."""
    script = Path(__file__).parents[2] / "docs/examples/own_scan.py"
    spec = importlib.util.spec_from_file_location("own_scan", script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tiny_run.folder, tmp_path / "own")
    ours, theirs = (
        ls.load_measured_scan(folder / NAME) for folder in (tiny_run.folder, tmp_path / "own")
    )
    given, read = ours.seen.projections, theirs.seen.projections
    np.testing.assert_array_equal(read.line_integrals, given.line_integrals)
    center = given.geometry.rotation_center() + 0.05 * np.eye(3)
    pixels = [p.geometry.project(center)[0] for p in (given, read)]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-4)
    np.testing.assert_allclose(theirs.seen.times, ours.seen.times, atol=1e-6)
    np.testing.assert_allclose(
        theirs.seen.signals.specific_force, ours.seen.signals.specific_force, atol=1e-6
    )
    for start, true in zip(theirs.seen.starts, ours.seen.starts, strict=True):
        up = start.world_from_sensor[1, :3] @ true.world_from_sensor[1, :3]
        # mm of true drift within 8 s are microradians of tilt
        assert np.degrees(np.arccos(min(up, 1.0))) < 0.02
        assert np.abs(start.velocity - true.velocity).max() < 0.01


KNOWN = {
    "kind": {"kind": "mti300"},
    "none": {"kind": "none"},
    "rms": {"kind": "rms", "acceleration_bias_mg": 3.0},
    "rest": {"kind": "bmi160", "calibration": "rest", "rest_s": 4.0},
    "six-positions": {
        "kind": "bmi160", "calibration": "six-positions", "temperature_course": [[0, 0], [9, 1]],
    },
    "changed": {
        "kind": "bmi160", "off": ["g-sensitivity"], "accelerometer": {"turn_on_bias_mg": 2.0},
    },
    "custom": {"kind": "custom", "gyroscope": {"turn_on_bias_deg_per_s": 0.1}},
}  # fmt: skip


@pytest.mark.parametrize("noise", KNOWN.values(), ids=KNOWN)
def test_what_methods_know_of_the_sensor_comes_back(tiny_run, tiny_settings, noise):
    """By the usual rough start, which is what a pose that somebody states is taken for."""
    scan = ls.load_measured_scan(tiny_run.folder / NAME)
    trees = (
        {"imu": {"noise": noise}},
        {"methods": {"start": "rough", "fused": {"spread_mm": 7.0, "clock_ms": 3.0}}},
    )
    wanted = config.from_trees("paper", tiny_settings.model_dump(), *trees)
    given = known_of(wanted, scan.seen, sensors.sensors(wanted.imu))
    again = tomllib.loads(measured_scan.dump(given))
    read = replace(scan, settings=measured_scan.MeasuredScanConfig.model_validate(again))
    ours, theirs = measured_aids.priors(read), volumes.sensor_priors(wanted)
    assert (ours.spread, ours.clock) == (theirs.spread, theirs.clock)
    for triad in ("accelerometer", "gyroscope"):
        mine, true = (astuple(getattr(p.errors, triad)) for p in (ours, theirs))
        assert mine == pytest.approx(true, rel=1e-12)
    rested = wanted.imu.noise.calibration != "none"
    if rested:
        assert ours.start.tilt == pytest.approx(theirs.start.tilt)
    placed = measured.assemble(given, tiny_run.folder).seen
    assert (placed.signals.rest_force is not None) == rested
    for k, start in enumerate(placed.starts if rested else ()):
        assert placed.signals.rest_force is not None
        level = calibration.leveled(start, placed.signals.rest_force[k])
        np.testing.assert_allclose(level.world_from_sensor, start.world_from_sensor, atol=1e-12)
