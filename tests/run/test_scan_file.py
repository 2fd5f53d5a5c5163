"""A simulated scan is corrected from files as its run did, bit for bit."""

import numpy as np
import pytest

import legsim as ls
from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.run import pipeline
from legsim.run.scan_file import NAME

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
METHODS = ("uncorrected", "rigid", "nonrigid-2d", "nonrigid-3d")


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


def test_a_run_knows_no_more_than_a_scanner(tiny_run, tmp_path):
    scan = ls.load_measured_scan(tiny_run.folder / NAME)
    assert scan.seen.signals.sensor_names == ("shank_l", "thigh_l")
    assert len(scan.seen.joints[0]) == 3
    with pytest.raises(LegsimError, match="only a simulated scan has"):
        ls.correct(tiny_run.folder / NAME, ["oracle"], tmp_path)
