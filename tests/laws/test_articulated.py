"""`articulated` comes nearer than `nonrigid-3d` at bones and skin, whoever moves, however they move.

Sensors without errors, and the phantom's own bones in place of those that a first reconstruction
shows: a law of the blend, in seconds per recording. `tools/experiments/recordings.py` measures the
method as a whole.
"""

from pathlib import Path

import numpy as np
import pytest

from legsim import config
from legsim.core import transforms
from legsim.core.values import FloatArray, frozen_owned
from legsim.correction.bone_regions import FEMUR, PATELLA, TIBIA, BoneRegions
from legsim.correction.limb_motion import Limb, articulated_motion
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.phantom import voxelize
from legsim.run import c_arm, scores, stages
from legsim.run import motion as run_motion
from legsim.simulation.setup import ScanSetup
from tools.experiments.recordings import REAL, SHIPPED

pytestmark = pytest.mark.end_to_end

WHOLE_SQUATS = tuple(f"subject0{k}/squats.trc" for k in range(1, 8))
COARSE = (
    *("phantom.legs=scanned", "scan.columns=124", "scan.rows=96", "scan.pixel_mm=3.08"),
    *("grid.voxels=128", "grid.voxel_mm=2"),
)
FEW_VIEWS = ("scan.views=31", "scan.increment_deg=6.4", "scan.rate_hz=3.875")
IN_HALF_THE_TIME = ("scan.rate_hz=7.75",)
"""for a person who stands still for less than 8 s"""


def bones(setup: ScanSetup, device: Device) -> BoneRegions:
    """The phantom's, where every view sees them."""
    center = [float(c) for c in setup.geometry.rotation_center()]
    grid = VolumeGrid.cubic(1, 0.26, center).coarse(2e-3)
    phantom = setup.phantom
    found = voxelize.labels(phantom.phantom, grid, device, posed=setup.scanned_leg())
    labels = {setup.named(n): k for n, k in (("femur", FEMUR), ("tibia", TIBIA))}
    labels[setup.named("patella")] = PATELLA
    named = np.array([0, *(labels.get(s, 0) for s in phantom.segments)], np.uint8)[found]
    seen = setup.c_arm.seen_by_every_view(grid)
    return BoneRegions(grid, frozen_owned(np.where(seen, named, np.uint8(0))))


def motions(setup: ScanSetup, device: Device, nodes: VolumeGrid) -> tuple[Motion, Motion]:
    """`articulated` and `nonrigid-3d` along the true motions of thigh and shank."""
    centers = setup.person.leg.joint_centers(setup.poses)
    joints = np.stack([centers.of(setup.named(j))[0] for j in ("hip", "knee", "ankle")])
    thigh, shank = (setup.poses.of(setup.named(bone)) for bone in ("femur", "tibia"))
    limb = Limb(joints, thigh, shank, bones(setup, device))

    def followed(poses: FloatArray, joint: FloatArray) -> FloatArray:
        return transforms.apply(poses @ transforms.inverse(poses[0]), joint[None])

    moved = np.concatenate(
        [followed(p, j) for p, j in zip((thigh, shank, shank), joints, strict=True)], 1
    )
    field = articulated_motion(setup.times, [limb], nodes).on_grid(nodes)
    return field, ControlPointMotion(setup.times, joints, moved)


def nearer(file: str, own: tuple[str, ...]) -> None:
    settings = config.load_settings(
        preset="demo", overrides=(f"motion.file={file}", *COARSE, *FEW_VIEWS, *own)
    )
    setup, device = stages.place(settings, run_motion.solve(settings.motion)), open_device()
    grid = c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
    ours, theirs = motions(setup, device, grid.coarse(8e-3))
    for shown in scores.structures(setup, grid):
        left = [
            np.sqrt(((m.carry(shown.paths[0]) - shown.paths) ** 2).sum(-1).mean())
            for m in (ours, theirs)
        ]
        assert left[0] < left[1], shown.name


@pytest.mark.parametrize("file", [*SHIPPED, *WHOLE_SQUATS])
def test_it_is_nearer_in_every_squat(file: str):
    nearer(file, ())


@pytest.mark.parametrize("file", REAL)
def test_it_is_nearer_in_every_measured_recording(file: str, shared_data: Path):
    own = tuple(key for key in REAL[file] if not key.startswith("scan.rate_hz"))
    quick = () if len(own) == len(REAL[file]) else IN_HALF_THE_TIME
    nearer(str(shared_data / "mocap" / file), (*own, *quick))
