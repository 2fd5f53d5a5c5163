import importlib.metadata
import json
import os
from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.deformation import files
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.run import methods, pipeline, volumes

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
EXAMPLE = Path(__file__).parents[2] / "docs/examples/own_method.py"


def quiet(*_: object) -> None:
    """No progress."""


def branched(run, folder: Path) -> Path:
    """A folder that starts from what the run has."""
    for path in run.folder.iterdir():
        if path.is_file():
            os.link(path, folder / path.name)
    return folder


def changed(settings: config.RunConfig, **methods_changes) -> config.RunConfig:
    return settings.model_copy(
        update={"methods": settings.methods.model_copy(update=methods_changes)}
    )


@pytest.fixture(scope="module")
def every(tiny_run, tiny_settings, tmp_path_factory):
    """All methods, with beads that coarse pixels see, and the example of the documents."""
    names = (
        "uncorrected",
        "marker-based",
        "rigid",
        "nonrigid-2d",
        "nonrigid-3d",
        "articulated",
        "oracle-nonrigid",
        f"{EXAMPLE}:without_drift",
    )
    wanted = changed(
        tiny_settings, run=names, beads=config.BeadsConfig(diameter_mm=6.0), node_mm=12.0
    )
    return pipeline.run_scan(
        wanted, branched(tiny_run, tmp_path_factory.mktemp("every")), on_progress=quiet
    )


def test_every_method_betters_the_scan(every):
    rmse = {m.method: m.metrics.of("leg").rmse for m in every.methods}
    bettering = ("marker-based", "rigid", "nonrigid-2d", "nonrigid-3d", "articulated")
    for name in (*bettering, "oracle-nonrigid"):
        assert rmse[name] < 0.7 * rmse["uncorrected"], name
    assert rmse["oracle-nonrigid"] <= 1.05 * rmse["nonrigid-3d"]


def test_residuals_fall_as_more_is_known(every):
    femur = {
        m.method: next(r.mm for r in m.residuals if r.structure == "femur") for m in every.methods
    }
    assert femur["oracle-nonrigid"] < 0.5 * femur["nonrigid-3d"]
    assert femur["articulated"] < 0.5 * femur["nonrigid-3d"]
    assert femur["nonrigid-3d"] < femur["rigid"] < femur["uncorrected"]
    assert femur["nonrigid-2d"] is None


def test_motions_are_of_their_kind(every):
    kinds = {
        "marker-based": RigidMotion,
        "nonrigid-3d": ControlPointMotion,
        "articulated": FieldMotion,
        "oracle-nonrigid": FieldMotion,
        "without_drift": RigidMotion,
    }
    for name, kind in kinds.items():
        assert isinstance(files.load_motion(every.folder / f"motion-{name}.npz"), kind)
    assert isinstance(files.load_motion(every.folder / "warp-nonrigid-2d.npz"), ControlPointMotion)


def test_what_a_method_says_is_kept_and_reported(every):
    (note,) = json.loads((every.folder / "correction-marker-based.json").read_text())["notes"]
    assert note.startswith("12 beads: ")
    assert note in (every.folder / "report.html").read_text()
    assert "skinning" in (every.folder / "report.html").read_text()


def test_the_example_is_a_method_by_path_and_as_an_entry_point(every, monkeypatch):
    point = importlib.metadata.EntryPoint(
        "without-drift", "own_method:without_drift", methods.ENTRY_POINTS
    )
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda *, group: [point] if group == methods.ENTRY_POINTS else [],
    )
    assert callable(methods.build("without-drift", None))
    assert np.isfinite(
        next(m for m in every.methods if m.method == "without_drift").metrics.of("leg").rmse
    )


def test_noise_and_fiducials_are_used_and_said(tiny_run, tiny_settings, tmp_path):
    noise = config.NoiseConfig(kind="paper", f_a=3, f_g=3)
    nearer = [
        s.model_copy(update={"distance_mm": d})
        for s, d in zip(tiny_settings.imu.sensors, (60, 350), strict=True)
    ]
    imu = tiny_settings.imu.model_copy(update={"noise": noise, "sensors": tuple(nearer)})
    wanted = changed(tiny_settings, run=("rigid",), start="fiducials").model_copy(
        update={"imu": imu}
    )
    result = pipeline.run_scan(wanted, branched(tiny_run, tmp_path), on_progress=quiet)
    page = (tmp_path / "report.html").read_text()
    assert "white noise (paper, f_a = 3.0, f_g = 3.0; SI convention)" in page
    assert "Poses start from four fiducials" in page
    assert "Sensor shank_l: fiducials off the real detector: none." in page
    assert "start from the truth" not in page
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["start"] == "fiducials"
    assert "white noise" in manifest["sensors"]
    clean = next(m for m in tiny_run.methods if m.method == "rigid").residuals[1].mm
    assert clean < result.methods[1].residuals[1].mm < 1.0


def test_the_papers_sensors_are_off_its_detector(tiny_run, tiny_settings, tmp_path):
    with pytest.raises(
        LegsimError, match=r"start of sensor shank_l: view 0: fiducial .* off the detector"
    ):
        pipeline.run_scan(
            changed(tiny_settings, start="fiducials"),
            branched(tiny_run, tmp_path),
            on_progress=quiet,
        )


SHANK = config.SensorConfig(name="shank_l", segment="tibia_l", distance_mm=140)


@pytest.mark.parametrize(
    ("imu", "chosen", "message"),
    [
        (
            {},
            {"run": ("nonrigid-3d",), "legs": "both"},
            r'methods\.legs = "both" needs sensors on femur_r and tibia_r; add them',
        ),
        (
            {"sensors": (SHANK,)},
            {"run": ("rigid", "nonrigid-2d")},
            "nonrigid-3d and the articulated methods need sensors on femur_l and tibia_l; add",
        ),
        (
            {},
            {"run": ("rigid",), "sensor": "knee"},
            r"methods\.sensor: unknown sensor 'knee'; name one of shank_l, thigh_l, or add it",
        ),
        ({}, {"run": ("rigid@knee",)}, "methods.run: rigid@knee: unknown sensor 'knee'"),
        (
            {},
            {"run": ("rigid", "{own}:rigid")},
            "rigid would be called 'rigid' like another method; rename its function",
        ),
        ({}, {"run": ("{own}:rigid",)}, "would be called 'rigid' like another method"),
        ({}, {"run": ("{own}:static",)}, "would be called 'static' like another method"),
        ({}, {"run": ("magic",)}, "unknown correction method 'magic'"),
    ],
)
def test_what_cannot_be_run_is_reported_before_anything_is_computed(
    tiny_settings, tmp_path, imu, chosen, message
):
    (tmp_path / "own.py").write_text(
        "from legsim.correction.rigid import Uncorrected\nrigid = static = Uncorrected()\n"
    )
    chosen["run"] = tuple(name.format(own=tmp_path / "own.py") for name in chosen["run"])
    wanted = changed(tiny_settings, **chosen)
    wanted = wanted.model_copy(update={"imu": wanted.imu.model_copy(update=imu)})
    with pytest.raises(LegsimError, match=message):
        pipeline.run_scan(wanted, tmp_path / "run", on_progress=quiet)
    assert not (tmp_path / "run").exists()


def test_one_sensor_is_enough_for_a_rigid_correction(tiny_settings):
    wanted = tiny_settings.model_copy(
        update={"imu": tiny_settings.imu.model_copy(update={"sensors": (SHANK,)})}
    )
    volumes.check(
        changed(
            wanted,
            run=("rigid", "rigid-paper-order", "rigid@shank_l", "uncorrected", "oracle-nonrigid"),
        )
    )


def test_what_was_finished_before_a_method_failed_is_kept(tiny_run, tiny_settings, tmp_path):
    (tmp_path / "own.py").write_text("def fails(scan):\n    raise ValueError('not today')\n")
    folder = tmp_path / "run"
    folder.mkdir()
    wanted = changed(tiny_settings, run=("uncorrected", f"{tmp_path / 'own.py'}:fails"))
    with pytest.raises(
        LegsimError, match=r"method fails failed in .*own\.py, line 2: ValueError: not today"
    ):
        pipeline.run_scan(wanted, branched(tiny_run, folder), on_progress=quiet)
    stages = json.loads((folder / "manifest.json").read_text())["stages"]
    assert "volume-uncorrected" in stages
    assert "volume-fails" not in stages


def test_a_consumer_sensor_and_few_beads_better_the_scan_from_a_rough_start(
    tiny_run, tiny_settings, tmp_path
):
    """The sensor alone is useless, and a standing person's is left out where it does not help."""
    wanted = changed(
        tiny_settings.model_copy(
            update={"imu": config.ImuConfig(noise=config.NoiseConfig(kind="bmi160"))}
        ),
        run=("uncorrected", "standing", "fused-beads"),
        start="rough",
        fused=config.FusedConfig(bead_mm=6.0),
    )
    found = pipeline.run_scan(wanted, branched(tiny_run, tmp_path), on_progress=quiet)
    rmse = {m.method: m.metrics.of("shank").rmse for m in found.methods}
    assert rmse["fused-beads"] < 0.7 * rmse["uncorrected"]
    notes = json.loads((tmp_path / "correction-fused-beads.json").read_text())["notes"]
    assert notes[0].startswith("2 beads: ")
    assert "Poses start roughly: 1.5 deg of tilt" in (tmp_path / "report.html").read_text()


def test_the_papers_sensor_shows_its_points_on_a_detector_without_bounds_alone(
    tiny_run, tiny_settings, tmp_path
):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    bounded = changed(tiny_settings, run=("fused-fiducials",), start="rough")
    with pytest.raises(LegsimError, match=r'seen in 0 views.*detector = "unbounded"'):
        pipeline.run_scan(bounded, branched(tiny_run, tmp_path / "a"), on_progress=quiet)
    seen = bounded.methods.fiducials.model_copy(update={"detector": "unbounded", "error_px": 0.2})
    found = pipeline.run_scan(
        changed(bounded, fiducials=seen), branched(tiny_run, tmp_path / "b"), on_progress=quiet
    )
    (tibia,) = [
        r
        for m in found.methods
        for r in m.residuals
        if (m.method, r.structure) == ("fused-fiducials", "tibia")
    ]
    # in mm the scene's depth is open
    assert tibia.pixels_after_similarity < 0.1


def sensors(*segments: str) -> str:
    tables = (f'{{name="on {s}", segment="{s}", distance_mm=140}}' for s in segments)
    return f"imu.sensors=[{', '.join(tables)}]"


@pytest.mark.parametrize(
    "run", ['["rigid"]', '["rigid@on tibia_r"]', '["rigid-paper-order"]', '["uncorrected"]']
)
def test_a_sensor_on_the_other_leg_is_reported_where_a_method_follows_it(run):
    chosen = (sensors("tibia_r"), "methods.sensor=on tibia_r", f"methods.run={run}")
    settings = config.load_settings(overrides=chosen)
    scanned = config.load_settings(overrides=(*chosen, "scan.side=right"))
    volumes.check(scanned)
    if "rigid" in run:
        with pytest.warns(UserWarning, match=r"'on tibia_r' is on tibia_r, but the left leg is"):
            volumes.check(settings)
    else:
        volumes.check(settings)


def test_sensors_slower_than_the_views_are_reported_with_the_fix():
    volumes.check(config.load_settings(overrides=("imu.rate_hz=31",)))
    with pytest.warns(
        UserWarning, match=r"imu\.rate_hz is 30, but 31 views .* set imu\.rate_hz to"
    ):
        volumes.check(config.load_settings(overrides=("imu.rate_hz=30",)))
