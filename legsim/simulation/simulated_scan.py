"""A simulated scan as one value: the input of methods, the scan at rest, and the truth."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.progress import OnProgress
from legsim.correction.bead_scan import Beads, BeadScan, add_beads
from legsim.correction.initialization import from_truth, leveled
from legsim.correction.method import Scan
from legsim.correction.oracle import phantom_motion
from legsim.correction.rigid import rigid_motion
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.evaluation.regions import Region
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.imu.sensors import default_sensors
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import simulate_imu
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device, open_device
from legsim.scan import acquisition
from legsim.scan.c_arm import CArm
from legsim.simulation.setup import (
    PhantomOptions,
    ScanSetup,
    Side,
    ankles_on_sensors,
    joints_on_sensors,
    prepare_scan,
    scan_regions,
)

_PHOTONS, _BEADS = 4, 3
"""random streams of the seed"""


@dataclass(frozen=True, slots=True, eq=False)
class ScanTruth:
    """The true motion of the leg, which no method sees."""

    setup: ScanSetup
    device: Device

    @property
    def poses(self) -> SegmentPoses:
        """world_from_segment of all segments at the views."""
        return self.setup.poses

    def motion_of(self, segment: str) -> RigidMotion:
        """True motion of a segment ("tibia_l") against the first view."""
        return rigid_motion(self.setup.times, self.setup.poses.of(segment))

    def field(self, nodes: VolumeGrid) -> FieldMotion:
        """True displacements of the scanned leg's material points at ``nodes``."""
        setup = self.setup
        return phantom_motion(setup.phantom, setup.poses, nodes, self.device, side=setup.side[0])


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedScan:
    """A scan with its truth."""

    setup: ScanSetup
    seen: Scan
    """input of methods: projections, IMU signals, starts, joints on the sensors"""
    at_rest: Projections
    """of the phantom that keeps the pose of the first view, with noise of its own"""
    device: Device

    def __repr__(self) -> str:
        return f"SimulatedScan({self.setup!r}, sensors {', '.join(self.seen.signals.sensor_names)})"

    @property
    def truth(self) -> ScanTruth:
        """True motion of the leg."""
        return ScanTruth(self.setup, self.device)

    def grid(self, voxels: int = 256, voxel: float = 1e-3) -> VolumeGrid:
        """A cube of ``voxels`` of ``voxel`` m along each side about the rotation center."""
        center = self.setup.geometry.rotation_center()
        return VolumeGrid.cubic(voxels, voxel, [float(c) for c in center])

    def regions(self, grid: VolumeGrid) -> tuple[Region, ...]:
        """Regions whole leg, shank and thigh on a grid, from the truth at the first view."""
        return scan_regions(self.setup, grid, self.device)

    def beads(self, beads: Beads | None = None, *, seed: int = 0) -> BeadScan:
        """Simulates a second scan of the same motion with beads on the skin."""
        return add_beads(
            self.seen.projections,
            self.setup.phantom,
            self.setup.poses,
            beads or Beads(),
            self.device,
            side=self.setup.side[0],
            energy_kev=self.setup.energy_kev,
            rng=np.random.default_rng([seed, _BEADS]),
            rays_per_pixel=self.setup.c_arm.rays_per_pixel,
        )


def simulate_scan(
    person: MovingLeg,
    c_arm: CArm | None = None,
    imu: ImuSignals | None = None,
    *,
    side: Side = "left",
    center: ArrayLike | None = None,
    phantom: PhantomOptions | None = None,
    seed: int = 0,
    device: Device | None = None,
    progress: OnProgress | None = None,
    force: bool = False,
) -> SimulatedScan:
    """Scans a moving person, and once more at rest in the pose of the first view.

    Args:
        person: who moves, as :func:`legsim.kinematics.from_recording.solve_kinematics` finds.
        c_arm: how the scan runs; None for the published scan.
        imu: what the sensors on that person read; None for noise-free ones on the scanned leg.
        side: of the leg in the isocenter.
        center: (3,) m, the rotation center in world; None for the scanned knee.
        phantom: which phantom is scanned.
        seed: of the photon noise.
        device: that projects; None opens the fastest.
        progress: is called with the name of the work, steps done and total steps.
        force: scan even a movement that no leg makes (``person.implausible``).

    Raises:
        LegsimError: an implausible movement, a recording shorter than the scan, signals whose
            sensors have no known position, a negative seed, no OpenCL device.

    >>> scan = simulate_scan(person, CArm.half(), imu)
    >>> scan.seen.projections.line_integrals.shape
    (248, 240, 310)
    """
    if person.implausible and not force:
        raise LegsimError(
            f"{person.name}: {person.implausible[0]}; check the recording and its marker map, or "
            "scan it all the same with force=True"
        )
    if seed < 0:
        raise LegsimError(f"simulate_scan(seed={seed}): a seed is 0 or a positive whole number")
    arm, opened = c_arm or CArm.paper(), device or open_device()
    signals = imu or simulate_imu(person, default_sensors(side))
    if not signals.sensors:
        raise LegsimError(
            "these IMU signals do not say where their sensors are strapped on; give them with "
            "dataclasses.replace(signals, sensors=(Sensor.placed(...), ...))"
        )
    setup = prepare_scan(
        person, arm, side=side, center=center, sensors=signals.sensors, phantom=phantom
    )
    exact = from_truth(person.leg, person.splines, setup.sensors, float(setup.times[0]))
    starts = leveled(exact, signals).starts
    moving, at_rest = (
        expose(setup, moving, opened, np.random.default_rng([seed, _PHOTONS, k]), progress)
        for k, moving in enumerate((True, False))
    )
    seen = Scan(moving, signals, starts, joints_on_sensors(setup), ankles_on_sensors(setup))
    return SimulatedScan(setup, seen, at_rest, opened)


def expose(
    setup: ScanSetup,
    moving: bool,
    device: Device,
    rng: np.random.Generator,
    progress: OnProgress | None = None,
) -> Projections:
    """Projections of the person as it moves, or at rest in the pose of the first view."""
    shown = "projecting" if moving else "projecting, at rest"
    return acquisition.expose(
        setup.phantom,
        setup.poses if moving else setup.poses.held_at(0),
        setup.geometry,
        device,
        setup.c_arm.imaging,
        rng,
        rays_per_pixel=setup.c_arm.rays_per_pixel,
        progress=None if progress is None else partial(progress, shown),
    )
