"""The setup of a scan: the person, the C-arm and the sensors."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen, to_nanometers
from legsim.correction.control_points import AttachedPoint
from legsim.evaluation.regions import Region, leg_regions
from legsim.evaluation.registration import boxes
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.imu import simulation
from legsim.imu.sensors import Sensor, default_sensors
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics.joint_splines import segment_poses_at
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom import tissue_swing, voxelize
from legsim.phantom.imaged_leg import ImagedLegWarning, load_imaged_leg
from legsim.phantom.leg_phantom import LegPhantom, load_leg_phantom
from legsim.scan.c_arm import CArm

Side = Literal["left", "right"]
_AIR_MARGIN = 0.005
"""m of air around the leg that belongs to its region, so that the skin's edge counts"""


@dataclass(frozen=True, slots=True)
class PhantomOptions:
    """Which phantom is scanned."""

    legs: Literal["both", "scanned"] = "both"
    """"scanned": that leg alone; the other one's edges leave streaks where views are few"""
    detail: Literal["coarse", "fine"] = "coarse"
    energy_kev: float = 60.0
    tissue_swing: SkinMount | None = None
    """how its soft tissue swings on its bones; images and truth both show it"""
    file: Path | None = None
    """a PHANTOM.toml of imaged legs; None for legsim's own legs"""


@dataclass(frozen=True, slots=True, eq=False)
class ScanSetup:
    """A person in the C-arm, as every stage of a scan needs it."""

    person: MovingLeg
    sensors: tuple[Sensor, ...]
    poses: SegmentPoses
    """of the segments at the views"""
    phantom: LegPhantom
    geometry: ConeBeamGeometry
    c_arm: CArm
    side: Side
    """of the scanned leg"""
    energy_kev: float
    """of the phantom's attenuations"""

    def __post_init__(self) -> None:
        if not np.array_equal(self.poses.times, self.geometry.times):
            raise LegsimError(
                "a scanned leg's poses are those at the views: give them at the times of the "
                "geometry"
            )

    def __repr__(self) -> str:
        return f"ScanSetup({self.side} leg of {self.person.name} in {self.c_arm!r})"

    @property
    def times(self) -> FloatArray:
        """(v,) s of the views."""
        return self.geometry.times

    def named(self, what: str) -> str:
        """Name of a segment, joint or part of the scanned leg: "tibia" gives "tibia_l"."""
        return f"{what}_{self.side[0]}"

    def scanned_leg(self) -> tuple[FloatArray, ...]:
        """Vertices (p, 3) m of each part of the phantom, in world at the first view."""
        first = self.poses.world_from_segment[0]
        return self.phantom.posed(first, self.poses.segment_names)


def prepare_scan(
    person: MovingLeg,
    c_arm: CArm,
    *,
    side: Side = "left",
    center: ArrayLike | None = None,
    sensors: tuple[Sensor, ...] | None = None,
    phantom: PhantomOptions | None = None,
) -> ScanSetup:
    """Places a moving person in the C-arm, its axis through the knee of the scanned leg.

    Args:
        person: who moves.
        c_arm: how the scan runs.
        side: of the leg in the isocenter.
        center: (3,) m, the rotation center in world; None for the knee's center at the
            first view.
        sensors: on the person; None for the two of the published study on that leg.
        phantom: which phantom is scanned.

    Raises:
        LegsimError: an unknown side, an impossible center, a recording shorter than the
            scan.
    """
    if side not in ("left", "right"):
        raise LegsimError(f"the scanned side is {side!r}; give left or right")
    wanted = phantom or PhantomOptions()
    times = c_arm.view_times(person.trajectories.times)
    poses = segment_poses_at(person.leg, person.splines, times)
    knee = person.leg.joint_centers(poses).of(f"knee_{side[0]}")[0]
    isocenter = knee if center is None else frozen("center of the scan", center, (3,))
    if not np.isfinite(isocenter).all():
        raise LegsimError(
            f"the center of the scan is {isocenter.tolist()}; give three finite numbers in m"
        )
    geometry = c_arm.geometry(times, isocenter)
    swing = wanted.tissue_swing
    swings = swing is not None and swing.amplitude > 0
    if swing is not None and swings:
        poses = tissue_swing.with_swing(poses, person.leg, person.splines, swing)
    legs = _legs(person, wanted, side, swings)
    if wanted.file is not None:
        _warn_of_ends(wanted.file, legs, poses, geometry, c_arm)
    placed = default_sensors(side) if sensors is None else tuple(sensors)
    return ScanSetup(person, placed, poses, legs, geometry, c_arm, side, wanted.energy_kev)


def _legs(person: MovingLeg, wanted: PhantomOptions, side: Side, swinging: bool) -> LegPhantom:
    """Loads the legs of a file or legsim's own."""
    scales, energy_kev = person.leg.scales, wanted.energy_kev
    if wanted.file is None:
        legs = load_leg_phantom(
            scales=scales, detail=wanted.detail, energy_kev=energy_kev, swinging=swinging
        )
    else:
        legs = load_imaged_leg(wanted.file, scales=scales, energy_kev=energy_kev, swinging=swinging)
        if not any(part.name.endswith(f"_{side[0]}") for part in legs.phantom.parts):
            raise file_error(
                wanted.file, f"holds no {side} leg", "set scan.side to the side that was imaged"
            )
    return legs.one_leg(side[0]) if wanted.legs == "scanned" else legs


def _warn_of_ends(
    file: Path, legs: LegPhantom, poses: SegmentPoses, geometry: ConeBeamGeometry, c_arm: CArm
) -> None:
    """Warns where the scan sees beyond the ends of an imaged leg."""
    vertices = legs.posed(poses.world_from_segment[0], poses.segment_names)
    heights = np.concatenate([part[:, 1] for part in vertices])
    center = float(geometry.rotation_center()[1])
    half = 0.5 * c_arm.shape_vu[0] * c_arm.pixel_pitch
    half *= c_arm.source_isocenter / c_arm.source_detector
    ends = (("above", heights.max() - center), ("below", center - heights.min()))
    for where, reach in ends:
        if reach < half:
            warnings.warn(
                f"{file}: at the first view the imaged leg ends {1e3 * reach:.0f} mm {where} the "
                f"center of the scan, which sees {1e3 * half:.0f} mm: there is air beyond",
                ImagedLegWarning,
                stacklevel=3,
            )


def scan_regions(
    setup: ScanSetup, grid: VolumeGrid, device: Device, *, margin: float = _AIR_MARGIN
) -> tuple[Region, ...]:
    """Regions whole leg, shank and thigh of the scanned leg, at the first view.

    They come from the phantom's truth. ``margin`` (m) of air around the leg belongs to its region.
    """
    vertices, parts = setup.scanned_leg(), setup.phantom.phantom.parts
    chosen = [k for k, part in enumerate(parts) if part.name.endswith(setup.named(""))]
    leg = setup.phantom.phantom.only(chosen).with_vertices(tuple(vertices[k] for k in chosen))
    labels = voxelize.labels(leg, grid, device)
    knee = setup.person.leg.joint_centers(setup.poses).of(setup.named("knee"))[0, 1]
    return leg_regions(labels, grid, float(knee), setup.c_arm.seen_by_every_view(grid), margin)


def true_volume(
    setup: ScanSetup, grid: VolumeGrid, device: Device, regions: Sequence[Region]
) -> Volume:
    """The phantom itself at the first view, around the regions: a reference without streaks.

    Linear attenuation (1/m) at the setup's energy, in each voxel the mean of 2x2x2 points; 0 where
    no measure of :func:`legsim.evaluation.similarity.evaluate` looks.
    """
    mask = np.logical_or.reduce([region.mask for region in regions])
    _, box = boxes(mask, grid)
    part = voxelize.attenuation(
        setup.phantom.phantom, grid.cropped(box), device, posed=setup.scanned_leg(), points=2
    )
    whole = np.zeros(grid.shape_zyx, np.float32)
    whole[box] = part.attenuation
    return Volume(grid, whole)


def sensor_on(sensors: tuple[Sensor, ...], segment: str) -> str | None:
    """Finds the name of the first sensor on a segment; None where there is none."""
    return next((s.name for s in sensors if s.segment == segment), None)


def joints_on_sensors(
    setup: ScanSetup, sides: tuple[Side, ...] | None = None, *, points_per_segment: int = 0
) -> tuple[tuple[AttachedPoint, ...], ...]:
    """Joints on the sensors, per leg: hip, knee and ankle, and points between them.

    The hip is on the thigh's sensor, knee and ankle on the shank's. Their positions in the sensors
    are taken from the truth at the first view: how sensors were strapped on is known. A leg without
    both sensors is left out.

    Args:
        setup: of the scan.
        sides: legs to follow; None for the scanned one.
        points_per_segment: further points, evenly between the joints of a segment.
    """
    poses, legs = _first_poses(setup), []
    centers = setup.person.leg.joint_centers(setup.poses)
    for side in sides or (setup.side,):
        end = side[0]
        thigh, shank = (sensor_on(setup.sensors, f"{bone}_{end}") for bone in ("femur", "tibia"))
        if thigh is None or shank is None:
            continue
        hip, knee, ankle = (centers.of(f"{j}_{end}")[0] for j in ("hip", "knee", "ankle"))
        shares = np.arange(1, points_per_segment + 1)[:, None] / (points_per_segment + 1)
        between = [(thigh, p) for p in hip + shares * (knee - hip)]
        between += [(shank, p) for p in knee + shares * (ankle - knee)]
        points = [(thigh, hip), (shank, knee), (shank, ankle), *between]
        legs.append(tuple(_attached(name, poses, point) for name, point in points))
    return tuple(legs)


def ankles_on_sensors(setup: ScanSetup) -> tuple[AttachedPoint, ...]:
    """The scanned ankle on the shank's sensor, if there is one, as :func:`joints_on_sensors` has it
    where the thigh has a sensor, too.
    """
    name = sensor_on(setup.sensors, setup.named("tibia"))
    if name is None:
        return ()
    ankle = setup.person.leg.joint_centers(setup.poses).of(setup.named("ankle"))[0]
    return (_attached(name, _first_poses(setup), ankle),)


def knee_on_thigh(setup: ScanSetup) -> AttachedPoint | None:
    """The scanned knee on the thigh's sensor, as :func:`joints_on_sensors` takes the joints; None
    without such a sensor.
    """
    name = sensor_on(setup.sensors, setup.named("femur"))
    if name is None:
        return None
    knee = setup.person.leg.joint_centers(setup.poses).of(setup.named("knee"))[0]
    return _attached(name, _first_poses(setup), knee)


def _attached(sensor: str, poses: SegmentPoses, point: FloatArray) -> AttachedPoint:
    """A point (3,) m in world on a sensor, to the nanometer: a file of millimeters then holds the
    same number, to the last bit.
    """
    exact = AttachedPoint.at_start(sensor, poses.of(sensor)[0], point)
    return AttachedPoint(sensor, to_nanometers(exact.position_sensor))


def _first_poses(setup: ScanSetup) -> SegmentPoses:
    """True poses of the sensors at the first two views."""
    person = setup.person
    return simulation.sensor_poses(person.leg, person.splines, setup.sensors, setup.times[:2])
