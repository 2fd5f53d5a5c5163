"""Many different scans with their truth, as data to train on or to test with.

    python docs/examples/many_scans.py data 0 100 grid.voxels=128 grid.voxel_mm=2

makes data/00000 to data/00099; what follows are settings as in `legsim run --set`, laid over the
demo preset. A scan's number alone decides
it: the same command goes on where it was stopped, and several may share the work. docs/study.md
says what lies in a folder.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim import config
from legsim.kinematics import from_recording
from legsim.mocap import opensim
from legsim.run import pipeline

PEOPLE = [f"subject{k:02d}" for k in range(1, 8)]


def make(folder: Path, number: int, overrides: tuple[str, ...] = ()) -> None:
    """One scan: somebody's held squat, swaying more or less than it did, by a leg of somebody's
    size, with a photon noise of its own.
    """
    rng = np.random.default_rng([20260, number])
    posture, mover, sizes = rng.choice(["squat_30", "squat_60"]), *rng.choice(PEOPLE, 2)
    recorded = from_recording.solve_kinematics(f"{mover}/{posture}.trc").trajectories
    mean = recorded.values.mean(0)
    swaying = replace(
        recorded, values=mean + rng.uniform(0.5, 3.0, len(mean)) * (recorded.values - mean)
    )
    folder.mkdir(parents=True, exist_ok=True)
    opensim.save(folder / "motion.mot", swaying)
    drawn = (
        f"motion.file={folder / 'motion.mot'}",
        f"motion.scaling_file={sizes}/squats.trc",
        f"scan.start_s={rng.uniform(0.5, 11.0):.3f}",
        f"scan.detector.photons={10 ** rng.uniform(4, 6):.0f}",
        f"seed={number}",
        'methods.run=["uncorrected", "oracle-nonrigid"]',
    )
    settings = config.load_settings(preset="demo", overrides=(*drawn, *overrides))
    pipeline.run_scan(settings, folder, on_progress=lambda *_: None, presented=False)


def main(out: Path, first: int, count: int, overrides: tuple[str, ...]) -> None:
    """A folder a scan."""
    for number in range(first, first + count):
        make(out / f"{number:05d}", number, overrides)
        print(out / f"{number:05d}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), tuple(sys.argv[4:]))
