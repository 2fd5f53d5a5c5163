"""Femur and tibia registered to their own reconstruction by reprojection: with or without sensors.

Round by round a volume is reconstructed along the present motion. Bones are found in it, projected
along their motions, and moved such that the edges of the projections fit better. What is between
the bones follows as in :mod:`legsim.correction.articulated`.

A volume agrees with the motion along which it was made: what it shows of a bone in the directions
that only a few views see is what these views have, wherever they have it. So a part of a motion is
found, not all (docs/fusion.md has what was measured). What may be no larger than the method's own
error is not followed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import bone_registration
from legsim.correction.articulated import around_center, follow_limbs, scanned_leg
from legsim.correction.bone_images import BoneTemplate, EdgeFilter, bone_template
from legsim.correction.bone_regions import (
    FEMUR,
    NEAR_AXES,
    TIBIA,
    axis_distances,
    find_bones,
    soft_tissue,
)
from legsim.correction.bone_registration import BonePoses, BonePriors
from legsim.correction.fused import SensorPriors, discerned, sensor_state
from legsim.correction.leg_axes import find_axes
from legsim.correction.limb_motion import Limb, articulated_motion
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import StandingPrior
from legsim.correction.path_problem import DivergedError
from legsim.correction.smoother import SmoothedPath, smooth
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.evaluation import image_gauge
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction.fdk import FdkOptions, fdk
from legsim.reconstruction.field_of_view import pixel_at_isocenter
from legsim.reconstruction.system_matrix import SystemMatrix

_TURN = (0.12, 0.45, 0.08)
"""rad, of the volume against the detector: voxels in step with pixels leave patterns in images"""

_PIXEL, _VIEWS = 2e-3, 124
"""m at the isocenter, and how many views: finer scans are averaged and thinned to about this"""

_VOXEL = 0.8
"""of a pixel"""

_EDGE, _NODE = 0.22, 0.012
"""m, side of the cube that is reconstructed, and between the nodes of its motion"""

_AIR = 8.0
"""1/m below which a volume is taken to be empty"""

_ARM = 0.03
"""m from the middle of a bone, of the points by which motions are compared"""

_SETTLED = 0.2
"""standard deviations of the prior, RMS of a step after which no more is made"""

_DOUBT = (
    "At best it is part of how the bones moved. Femur and tibia may be off by millimeters along "
    "the rays, which images do not show: compare with the uncorrected volume."
)

_FLOOR, _FLOOR_PX = 0.6e-3, 0.3
"""m at the isocenter, and averaged pixels, by which rounds from a true motion leave it; the greater
counts (docs/fusion.md)"""


@dataclass(frozen=True, slots=True)
class Bones2D3D:
    """Femur and tibia by the misfit of their projections; sensors say where to start, if any.

    >>> Bones2D3D()(scan).motion
    FieldMotion(248 views over 7.968 s, 33x33x33 nodes (x, y, z) 8x8x8 mm apart)
    """

    nodes: VolumeGrid | None = None
    """coarse grid over the volume; None: as :class:`legsim.correction.articulated.Articulated`"""
    sensors: SensorPriors = field(default_factory=SensorPriors)
    """what is known of the sensors, where the scan has joints on some"""
    priors: BonePriors = field(default_factory=BonePriors)
    rounds: int = 6
    """at most; they end with the first small step"""
    device: Device | None = None
    """None opens the fastest"""

    def __call__(self, scan: Scan, /) -> Correction:
        if self.rounds < 1:
            raise LegsimError(f"bones-2d3d was given {self.rounds} rounds; give at least 1")
        device = self.device or open_device()
        started, notes = _by_sensors(scan, self.sensors)
        try:
            begun, found, said = _registered(scan, started, self.priors, self.rounds, device)
        except LegsimError as error:
            kept = "the motion of the sensors is kept" if started else "the scan is left as it is"
            notes = (*notes, f"bones-2d3d: {error}; {kept}.")
            return self._followed(scan, started, notes, device)
        moved_px, floor_px = _seen_change(scan.projections.geometry, begun, found)
        judged = (
            f"{said}; the images see {moved_px:.2g} px RMS of what this changes, and should see "
            f"{floor_px:.2g} px of the method's own error"
        )
        if discerned(moved_px, floor_px):
            return self._followed(scan, found, (*notes, f"{judged}. {_DOUBT}"), device)
        kept = "that of the sensors is kept" if started else "the scan is left as it is"
        notes = (*notes, f"{judged}: the data do not determine a motion, and {kept}.")
        return self._followed(scan, started, notes, device)

    def _followed(
        self, scan: Scan, limb: Limb | None, notes: tuple[str, ...], device: Device
    ) -> Correction:
        """The correction of a limb's motion; nothing moves where there is none."""
        if limb is None:
            still = RigidMotion.identity(scan.times)
            return Correction("bones-2d3d", scan.projections, still, notes=notes)
        nodes = self.nodes or around_center(scan.projections)
        motion, seen = follow_limbs(scan.projections, [limb], nodes, device)
        return Correction("bones-2d3d", scan.projections, motion, notes=(*notes, *seen))


def _by_sensors(scan: Scan, priors: SensorPriors) -> tuple[Limb | None, tuple[str, ...]]:
    """The limb as sensors and a person who stands say; None where they do not determine it."""
    if not scan.joints:
        return None, ("bones-2d3d: no sensor says where to start; bones start at rest.",)
    geometry = scan.projections.geometry
    prior = StandingPrior.at(geometry.rotation_center(), priors.spread)
    hip, knee, ankle = scanned_leg(scan)[:3]
    paths: list[SmoothedPath] = []
    for name in (hip.sensor, knee.sensor):
        try:
            path = smooth(sensor_state(scan, name, priors, clock=0.0), standing=prior)
        except DivergedError as error:
            return None, (f"In doubt: bones-2d3d: sensor {name}: {error}; bones start at rest.",)
        motion_px, error_px = path.seen_motion(geometry, prior.points)
        if not path.settled or not discerned(motion_px, error_px):
            return None, (
                f"bones-2d3d: sensor {name} sees {motion_px:.2g} px RMS of motion with an error of "
                f"{error_px:.2g} px, which does not determine it; bones start at rest.",
            )
        paths.append(path)
    poses = [path.path.poses for path in paths]
    places = ((0, hip), (1, knee), (1, ankle))
    joints = [transforms.apply(poses[k][0], j.position_sensor[None])[0] for k, j in places]
    names = f"{hip.sensor} and {knee.sensor}"
    started = f"bones-2d3d: bones start along the paths of sensors {names}."
    return Limb(np.stack(joints), poses[0], poses[1]), (started,)


@dataclass(frozen=True, slots=True, eq=False)
class _Coarse:
    """Images as they are compared, seen from a frame that is turned against the detector."""

    images: Projections
    every: int
    """of the scan's views one is here"""
    times: FloatArray
    """(v,) s of all views"""
    world_from_box: FloatArray
    """(4, 4)"""
    grid: VolumeGrid
    device: Device

    @classmethod
    def of(cls, projections: Projections, device: Device) -> "_Coarse":
        geometry = projections.geometry
        factor = max(1, round(_PIXEL / pixel_at_isocenter(geometry)))
        every = max(1, round(len(geometry) / _VIEWS))
        thin = Projections(geometry[::every], projections.line_integrals[::every])
        thin = thin if factor == 1 else thin.coarser(factor)
        frame = transforms.rigid(transforms.rotation_from_vector(_TURN), geometry.rotation_center())
        voxel = _VOXEL * pixel_at_isocenter(thin.geometry)
        grid = VolumeGrid.cubic(round(_EDGE / voxel), voxel, (0.0, 0.0, 0.0))
        turned = Projections(thin.geometry.moved(frame), thin.line_integrals)
        return cls(turned, every, geometry.times, frame, grid, device)

    def volume(self, motion: FieldMotion | None) -> Volume:
        options = FdkOptions(window="hann")
        return fdk(self.images, self.grid, motion=motion, options=options, device=self.device)

    def at_rest(self) -> Limb:
        """A limb as the images show it, which does not move.

        Raises:
            LegsimError: no bone is seen about the rotation center.
        """
        upright = VolumeGrid.cubic(round(_EDGE / 4e-3), 4e-3, self.world_from_box[:3, 3].tolist())
        seen = self.images.geometry.moved(transforms.inverse(self.world_from_box))
        images = Projections(seen, self.images.line_integrals)
        volume = fdk(images, upright, options=FdkOptions(window="hann"), device=self.device)
        still = np.broadcast_to(np.eye(4), (len(self.times), 4, 4))
        return Limb(find_axes(volume, self.world_from_box[:3, 3]), still, still)


def _framed(limb: Limb, b_from_a: FloatArray) -> Limb:
    """A limb whose places and motions are counted in another frame."""
    back = transforms.inverse(b_from_a)
    thigh, shank = (b_from_a @ m @ back for m in np.moveaxis(limb.motions()[:, :2], 1, 0))
    return Limb(transforms.apply(b_from_a, limb.joints), thigh, shank)


def _registered(
    scan: Scan, started: Limb | None, priors: BonePriors, rounds: int, device: Device
) -> tuple[Limb, Limb, str]:
    """Limbs at the start and at the end, and a sentence on the fit.

    Raises:
        LegsimError: femur and tibia are not seen.
    """
    coarse = _Coarse.of(scan.projections, device)
    begun = started or coarse.at_rest()
    limb = _framed(begun, transforms.inverse(coarse.world_from_box))
    poses = BonePoses(_motions(limb), np.zeros((priors.knots, 12)))
    misfits: list[float] = []
    for _ in range(rounds):
        limb, poses, size = _improved(coarse, limb, poses, priors)
        misfits.append(size)
        if poses.last < _SETTLED:
            break
    said = (
        f"bones-2d3d: in {len(misfits)} rounds the misfit of edges went from {misfits[0]:.4f} to "
        f"{misfits[-1]:.4f} before the last; images determine {poses.determined} of "
        f"{poses.found.size} numbers of the motion better than the prior, the last step was "
        f"{poses.last:.2g} standard deviations of it"
    )
    return begun, _framed(limb, coarse.world_from_box), said


def _motions(limb: Limb) -> FloatArray:
    """(2, v, 4, 4) of femur and tibia."""
    return np.moveaxis(limb.motions()[:, :2], 1, 0)


def _improved(
    coarse: _Coarse, limb: Limb, poses: BonePoses, priors: BonePriors
) -> tuple[Limb, BonePoses, float]:
    """A round: a volume, its bones, and a step; and the misfit before it."""
    geometry, device, edges = coarse.images.geometry, coarse.device, EdgeFilter()
    few = replace(limb, thigh=limb.thigh[:: coarse.every], shank=limb.shank[:: coarse.every])
    nodes = coarse.grid.coarse(_NODE)
    motion = articulated_motion(geometry.times, [few], nodes).on_grid(nodes)
    volume = coarse.volume(motion)
    bones = find_bones(volume, limb.joints)
    near = axis_distances(coarse.grid.positions(), limb.joints).min(-1) < NEAR_AXES
    soft = soft_tissue(volume.attenuation.ravel()[near])
    templates = [bone_template(volume, bones, label, soft) for label in (FEMUR, TIBIA)]
    seen = [template for template in templates if template is not None]
    rest = SystemMatrix(geometry, coarse.grid, device, motion).forward(_rest(volume, seen))
    moved = poses.motions[:, :: coarse.every]
    for template, along in zip(seen, moved, strict=True):
        rest = rest + template.images(geometry, along, device)
    residual = edges(coarse.images.line_integrals - rest)
    misfit = bone_registration.misfit(residual, seen, moved, geometry, edges, priors.sizes, device)
    middles = [template.middle for template in seen]
    found = bone_registration.stepped(poses, misfit, middles, coarse.times, priors, coarse.every)
    limb = replace(limb, thigh=found.motions[0], shank=found.motions[1], bones=bones)
    return limb, replace(found, motions=_motions(limb)), misfit.size


def _rest(volume: Volume, templates: Sequence[BoneTemplate]) -> np.ndarray:
    """(z, y, x) what is neither air nor a template."""
    rest = np.where(volume.attenuation > _AIR, volume.attenuation, 0).astype(np.float32)
    for template in templates:
        first = np.round((template.grid.origin - volume.grid.origin) / volume.grid.spacing_xyz)
        z, y, x = (
            slice(int(start), int(start) + count)
            for start, count in zip(first[::-1], template.grid.shape_zyx, strict=True)
        )
        rest[z, y, x] -= template.attenuation
    return rest


def _seen_change(geometry: ConeBeamGeometry, begun: Limb, found: Limb) -> tuple[float, float]:
    """px RMS between two motions after the similarity that hides most of it, and of the error."""
    arms = _ARM * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1], [-1, 0, -1]])
    axes = np.diff(begun.joints, axis=0)
    directions = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    middles = begun.joints[1] + 2 * _ARM * directions * [[-1.0], [1.0]]
    points = [middle + arms for middle in middles]

    def shown(limb: Limb, at: Sequence[FloatArray]) -> FloatArray:
        carried = [
            transforms.apply(motion, part) for motion, part in zip(_motions(limb), at, strict=True)
        ]
        return geometry.project(np.concatenate(carried, 1))[0]

    def seen(at: FloatArray) -> FloatArray:
        return shown(found, np.split(at, 2))

    true = shown(begun, points)
    every = np.concatenate(points)
    similarity = image_gauge.best_similarity(seen, every, true)
    off = seen(transforms.apply(similarity, every)) - true
    pixel = pixel_at_isocenter(geometry)
    coarse = pixel * max(1, round(_PIXEL / pixel))
    floor_px = max(_FLOOR, _FLOOR_PX * coarse) / pixel
    return float(np.sqrt((off**2).sum(-1).mean())), floor_px
