import json

import numpy as np
import pytest

from legsim.config import EvaluationConfig
from legsim.evaluation.registration import RegistrationError
from legsim.run import folder, scores
from legsim.run.corrected import Reconstructed

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")


def left(run, method: str) -> dict[str, dict]:
    content = json.loads((run.folder / "metrics.json").read_text())
    return {
        r["structure"]: r
        for m in content["methods"]
        if m["method"] == method
        for r in m["residuals"]
    }


def test_every_method_has_its_errors_by_structure(tiny_run):
    for result in tiny_run.methods:
        assert [r.structure for r in result.residuals] == ["femur", "tibia", "patella", "skin"]
        assert all(np.isfinite(r.pixels) for r in result.residuals)
        assert [r.degrees is None for r in result.residuals] == [False, False, False, True]


def test_the_resting_scan_has_nothing_left(tiny_run):
    for found in left(tiny_run, "static").values():
        assert found["mm"] == found["pixels"] == found["pixels_after_similarity"] == 0


def test_a_constant_similarity_takes_some_of_the_pixels_of_every_method(tiny_run):
    for result in tiny_run.methods[1:]:
        assert 0 < result.residual_px_after_similarity < result.residual_px


def test_the_true_shank_leaves_nothing_at_the_tibia_and_what_the_knee_bends_elsewhere(tiny_run):
    oracle, before = left(tiny_run, "oracle"), left(tiny_run, "uncorrected")
    assert oracle["tibia"]["mm"] == pytest.approx(0, abs=1e-6)
    assert 0 < oracle["femur"]["mm"] < 0.5 * before["femur"]["mm"]
    assert oracle["femur"]["degrees"] > 0


def test_the_overall_residual_is_of_femur_and_tibia(tiny_run):
    for result in tiny_run.methods[1:]:
        femur, tibia = (r.mm for r in result.residuals[:2])
        assert result.residual_mm == pytest.approx(np.sqrt((femur**2 + tibia**2) / 2))
    assert tiny_run.methods[0].residual_mm is None


def test_a_run_tells_its_registrations_own_error(tiny_run):
    content = json.loads((tiny_run.folder / "metrics.json").read_text())
    found = folder.registration_error(tiny_run.folder)
    assert found == RegistrationError(**content["registration_error"])
    # of a known shift of 0.98 mm and turn of 0.98 degrees; the voxels are 3 mm
    assert 0 < found.translation_mm < 0.3
    assert 0 < found.rotation_deg < 0.3


def test_metrics_name_their_protocol_and_hold_the_distance_from_the_phantom(tiny_run):
    content = json.loads((tiny_run.folder / "metrics.json").read_text())
    assert (content["scaling"], content["window"]) == ("reference", "uniform")
    assert "the range (minimum to maximum over the grid) of the motion-free" in content["compared"]
    found = {m["method"]: m["metrics"]["regions"][0] for m in content["methods"]}
    assert found["static"]["ssim"] == pytest.approx(1, abs=1e-6)
    # the reference is a reconstruction: its streaks and blur are its own distance from the leg
    assert 0.3 < found["uncorrected"]["ssim_phantom"] < found["static"]["ssim_phantom"] < 0.98
    assert found["uncorrected"]["rmse_phantom"] > found["static"]["rmse_phantom"] > 0.01


def test_volumes_are_compared_where_they_lie(tiny_run):
    assert {m.metrics.registered for m in tiny_run.methods} == {"reconstructed"}
    assert "Volumes that lie elsewhere are reconstructed where they lie" in tiny_run.protocol
    found = {m.method: m.metrics.registration for m in tiny_run.methods}
    assert found["static"] is None
    assert found["uncorrected"].reconstructed


def test_methods_with_images_of_their_own_are_named(tmp_path):
    own = Reconstructed("smooth", tmp_path, None, None, (), True)
    kept = Reconstructed("rigid", tmp_path, None, None, (), False)
    still = Reconstructed("static", tmp_path, None, None, (), True)
    (line,) = scores.resampled(EvaluationConfig(), (still, kept, own))
    assert line.startswith("smooth: its images are its own")
    assert not scores.resampled(EvaluationConfig(registered="resampled"), (own,))


def test_a_folder_without_registration_has_no_error_of_it(tmp_path):
    assert folder.registration_error(tmp_path) is None
