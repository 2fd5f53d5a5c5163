"""Settings of the reconstruction reach it, and only those that it reads are taken."""

import os
from typing import get_args

import numpy as np
import pytest

from legsim import config
from legsim.config import ReconstructionConfig
from legsim.core.errors import LegsimError
from legsim.correction.method import Correction
from legsim.geometry import image_files
from legsim.reconstruction import cgls, fdk, ramp_filter
from legsim.reconstruction.fdk import FdkOptions
from legsim.run import c_arm, pipeline, reconstruction

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")


def test_defaults_are_those_of_the_functions():
    assert reconstruction.fdk_options(ReconstructionConfig()) == FdkOptions()
    assert cgls.cgls.__kwdefaults__["iterations"] == ReconstructionConfig().iterations
    fields = ReconstructionConfig.model_fields
    assert get_args(fields["window"].annotation) == get_args(ramp_filter.Window)
    assert get_args(fields["redundancy"].annotation) == get_args(ramp_filter.Redundancy)


def test_settings_become_options_in_si_units():
    settings = ReconstructionConfig(
        window="ram-lak", water_attenuation_per_mm=0.03, redundancy="none"
    )
    assert reconstruction.fdk_options(settings) == FdkOptions(
        window="ram-lak", water_attenuation=30.0, redundancy="none"
    )
    cut = ReconstructionConfig(water_attenuation_per_mm=0)
    assert reconstruction.fdk_options(cut).water_attenuation is None


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"nonnegative": True}, "nonnegative"),
        ({"iterations": 3}, "iterations"),
        ({"algorithm": "cgls", "window": "hann"}, "window"),
        ({"algorithm": "cgls", "redundancy": "none"}, "redundancy"),
        ({"algorithm": "cgls", "water_attenuation_per_mm": 0.0}, "water_attenuation_per_mm"),
    ],
)
def test_an_option_of_the_other_algorithm_is_refused(changes, key):
    with pytest.raises(
        LegsimError, match=rf"^reconstruction\.{key}: (fdk|cgls) has no such option"
    ):
        reconstruction.check(ReconstructionConfig(**changes))
    with pytest.raises(LegsimError, match=rf"^--{key.replace('_', '-')}: "):
        reconstruction.from_options(changes)


def test_every_option_belongs_to_an_algorithm():
    for algorithm in ("fdk", "cgls"):
        reconstruction.check(ReconstructionConfig(algorithm=algorithm))
    owned = {name for names in reconstruction._OPTIONS.values() for name in names}
    assert owned | {"algorithm"} == set(ReconstructionConfig.model_fields)


@pytest.mark.filterwarnings("ignore:voxels of 3 mm")
@pytest.mark.parametrize(
    "changes",
    [
        {"window": "hann"},
        {"algorithm": "cgls", "iterations": 2, "nonnegative": True},
    ],
)
def test_a_run_reconstructs_as_its_settings_say(
    tiny_run, tiny_settings, tmp_path, monkeypatch, changes
):
    """In the folder of a finished run: the changed volumes are made again, as called directly."""
    for path in tiny_run.folder.iterdir():
        if path.is_file():
            os.link(path, tmp_path / path.name)
    wanted = tiny_settings.model_copy(
        update={
            "reconstruction": ReconstructionConfig(**changes),
            "methods": tiny_settings.methods.model_copy(update={"run": ("uncorrected",)}),
        }
    )
    corrections, whole = [], reconstruction.reconstruct

    def watched(settings, scan, *arguments, **named):
        if isinstance(scan, Correction):  # scores make the leg anew where it lies
            corrections.append(scan)
        return whole(settings, scan, *arguments, **named)

    monkeypatch.setattr(reconstruction, "reconstruct", watched)
    pipeline.run_scan(wanted, tmp_path, on_progress=lambda *_: None)
    assert config.load_settings(tmp_path / "config.toml") == wanted
    found = image_files.load_volume(tmp_path / "volume-uncorrected.mha")
    before = image_files.load_volume(tiny_run.folder / "volume-uncorrected.mha")
    assert [c.method for c in corrections] == ["static", "uncorrected"]
    direct = (
        cgls.cgls(corrections[1], found.grid, iterations=2, nonnegative=True)
        if "algorithm" in changes
        else fdk.fdk(corrections[1], found.grid, options=FdkOptions(window="hann"))
    )
    image_files.save_volume(tmp_path / "direct.mha", direct)
    written = image_files.load_volume(tmp_path / "direct.mha")
    np.testing.assert_array_equal(found.attenuation, written.attenuation)
    assert (found.attenuation != before.attenuation).any()


@pytest.mark.parametrize("given", ["scan.views=2", "scan.increment_deg=0"])
def test_views_that_fdk_cannot_use_are_refused_before_anything_is_projected(given: str, tmp_path):
    settings = config.load_settings(preset="demo", overrides=(given,))
    with pytest.raises(LegsimError, match=r"scan\.views, scan\.increment_deg: .* on one line"):
        pipeline.run_scan(settings, tmp_path / "run")
    assert not (tmp_path / "run").exists()
    iterated = settings.reconstruction.model_copy(update={"algorithm": "cgls"})
    reconstruction.check_views(iterated, c_arm.c_arm(settings.scan))


@pytest.mark.parametrize("name", ["water_attenuation_per_mm", "noise", "tv_weight_mm"])
def test_an_option_that_is_not_finite_is_refused_by_its_name(name: str) -> None:
    with pytest.raises(LegsimError, match=f"--{name.replace('_', '-')} inf: .*finite number"):
        reconstruction.from_options({name: float("inf")})
