import numpy as np
import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.kinematics.skeleton import SegmentPoses
from legsim.run import stages
from legsim.run.stages import ScanSetup

TIMES = np.arange(3) / 31
GEOMETRY = ConeBeamGeometry.circular(
    times=TIMES,
    angles=TIMES,
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(48, 62),
    pixel_pitch=6e-3,
)


def scanned(times: np.ndarray) -> ScanSetup:
    poses = SegmentPoses(times, ("tibia_l",), np.tile(np.eye(4), (len(times), 1, 1, 1)))
    return ScanSetup(None, None, (), poses, None, GEOMETRY)


def test_its_times_are_those_of_the_views():
    np.testing.assert_array_equal(scanned(TIMES).times, TIMES)


@pytest.mark.parametrize("times", [TIMES + 1e-3, TIMES[:2]])
def test_poses_at_other_times_are_refused(times):
    with pytest.raises(LegsimError, match="at the times of the geometry"):
        scanned(times)


def test_what_decides_the_projections_is_in_their_key_and_the_seed_where_there_is_noise():
    plain = ("scan.detector.photons=0",)
    changes = (
        "scan.detector.photons=10",
        "scan.spectrum.kind=tube",
        "scan.detector.scatter_to_primary=0.1",
        "phantom.tissue_swing.amplitude=1",
        "phantom.legs=left",
    )
    keys = [
        stages.scan_key(config.load(overrides=(*plain, change)))
        for change in ("grid.voxels=99", "seed=5", *changes)
    ]
    assert keys[0] == keys[1]
    assert len(set(keys)) == len(changes) + 1
    noisy = {
        stages.scan_key(config.load(overrides=("scan.detector.photons=10", f"seed={seed}")))
        for seed in (1, 2)
    }
    assert len(noisy) == 2


def test_photons_are_others_in_every_recording_seed_and_exposure():
    def first(file: str, seed: int, exposure: int) -> int:
        settings = config.load(overrides=(f"motion.file={file}", f"seed={seed}"))
        return int(stages._photons(settings, exposure).integers(2**62))

    squat, other = "subject01/squat_30.trc", "subject02/squat_30.trc"
    assert first(squat, 1, 0) == first(squat, 1, 0)
    assert (
        len({first(squat, 1, 0), first(other, 1, 0), first(squat, 2, 0), first(squat, 1, 1)}) == 4
    )
