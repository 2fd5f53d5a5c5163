from types import SimpleNamespace
from typing import cast

import numpy as np

from legsim import config
from legsim.correction.rough_start import EXACT
from legsim.opencl.device import Device
from legsim.run import stages
from legsim.run.folder import RunFolder
from legsim.run.stages import StageContext


def scan_key(*overrides: str, compiler: str = "one 1.0") -> str:
    """Hangs on the settings alone."""
    settings = config.load_settings(overrides=overrides)
    device = SimpleNamespace(arithmetic=compiler)
    nothing = cast(RunFolder, None), cast(Device, device), lambda *_: None
    return StageContext(settings, *nothing).scan_key


def test_another_driver_is_another_key():
    assert scan_key(compiler="one 1.0") != scan_key(compiler="one 1.1")


def test_what_decides_the_projections_is_in_their_key_and_the_seed_where_there_is_noise():
    plain = ("scan.detector.photons=0",)
    changes = (
        "scan.detector.photons=10",
        "scan.spectrum.kind=tube",
        "scan.detector.scatter_to_primary=0.1",
        "phantom.tissue_swing.amplitude=1",
        "phantom.legs=scanned",
    )
    keys = [scan_key(*plain, change) for change in ("grid.voxels=99", "seed=5", *changes)]
    assert keys[0] == keys[1]
    assert len(set(keys)) == len(changes) + 1
    noisy = {scan_key("scan.detector.photons=10", f"seed={seed}") for seed in (1, 2)}
    assert len(noisy) == 2


def test_photons_are_others_in_every_recording_seed_and_exposure():
    def first(file: str, seed: int, exposure: int) -> int:
        settings = config.load_settings(overrides=(f"motion.file={file}", f"seed={seed}"))
        return int(stages._photons(settings, exposure).integers(2**62))

    squat, other = "subject01/squat_30.trc", "subject02/squat_30.trc"
    assert first(squat, 1, 0) == first(squat, 1, 0)
    assert (
        len({first(squat, 1, 0), first(other, 1, 0), first(squat, 2, 0), first(squat, 1, 1)}) == 4
    )


def test_a_true_start_is_exact_and_others_are_as_far_off_as_the_settings_say():
    methods = config.load_settings(overrides=("methods.rough.tilt_deg=2",)).methods
    assert stages.start_errors(methods) == EXACT
    for start in ("rough", "fiducials"):
        found = stages.start_errors(methods.model_copy(update={"start": start}))
        assert np.degrees(found.tilt) == 2
        assert (found.velocity, found.place) == (0.03, 0.005)
