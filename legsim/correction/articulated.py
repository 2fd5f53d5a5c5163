"""Back-projection along rigid bones with the tissue between them: thigh and shank by two sensors.

Which voxels are bone is seen in a first reconstruction, which follows the two sensors without
knowing the bones. Where none are seen, the motion of that reconstruction is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction.bone_regions import FEMUR, NEAR_AXES, PATELLA, TIBIA, BoneRegions, find_bones
from legsim.correction.control_points import AttachedPoint
from legsim.correction.limb_motion import Limb, articulated_motion, expected_patella
from legsim.correction.method import Correction, Scan
from legsim.correction.rigid import sensor_path
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.imu.strapdown import Scheme
from legsim.opencl.device import Device
from legsim.reconstruction.fdk import FdkOptions, fdk

_SEEN_AT = 2e-3
"""m between the voxels in which bones are looked for"""

_SEEN_BY = 0.5
"""share of the views that must see a place: what fewer see, a reconstruction does not know"""

_SMEARED = 5e-3
"""m, RMS, by which a patella may move against a reconstruction that does not follow it: a quarter
of its thickness"""

_PATELLA_RADIUS = 0.044
"""of a ball as large as a patella, by the thigh's length: 18 mm, 24 cm^3, for 0.41 m"""

_SAME_TIME = 1e-6
"""s"""

_EDGE, _NODE = 0.26, 8e-3
"""m, size of the cube and distance of its nodes where none are given"""


@dataclass(frozen=True, slots=True)
class Articulated:
    """Femur, tibia and patella move as rigid bodies, the tissue in between takes shares of each.

    >>> Articulated(grid.coarse(0.008))(scan).motion
    FieldMotion(248 views over 7.968 s, 33x33x33 nodes (x, y, z) 8x8x8 mm apart)
    """

    nodes: VolumeGrid | None = None
    """coarse grid over the volume, on which the motion is sampled

    None: nodes 8 mm apart in a cube of 26 cm about the rotation center.
    """
    scheme: Scheme = "accurate"
    device: Device | None = None
    """None opens the fastest"""
    kneecap: str | RigidMotion | None = None
    """what the scanned leg's patella follows: a sensor on it, by name, or its motion at the views,
    however it was found (registered to a CT, say); None: the knee's flexion, as published"""

    def __call__(self, scan: Scan, /) -> Correction:
        nodes = self.nodes or around_center(scan.projections)
        limbs = limbs_of(scan, self.scheme)
        if self.kneecap is not None:
            at = scan.joints.index(scanned_leg(scan))
            led = replace(limbs[at], kneecap=_kneecap(scan, self.kneecap, self.scheme))
            limbs = (*limbs[:at], led, *limbs[at + 1 :])
        motion, notes = follow_limbs(scan.projections, limbs, nodes, self.device)
        return Correction("articulated", scan.projections, motion, notes=notes)


def follow_limbs(
    projections: Projections,
    limbs: Sequence[Limb],
    nodes: VolumeGrid,
    device: Device | None = None,
) -> tuple[FieldMotion, tuple[str, ...]]:
    """Motion at ``nodes`` of limbs whose thigh and shank move as any two estimates say.

    Bones are looked for in a first reconstruction; what was found is in the sentences beside it.
    """
    times = projections.geometry.times
    first = articulated_motion(times, limbs, nodes).on_grid(nodes)
    volume = fdk(
        projections,
        _around_legs(nodes.coarse(_SEEN_AT), limbs),
        motion=first,
        options=FdkOptions(window="hann"),
        device=device,
    )
    volume = _seen(volume, projections.geometry, first)
    found = [_with_bones(limb, volume, first) for limb in limbs]
    notes = tuple(f"articulated: {note}" for _, note in found)
    if all(limb.bones is None for limb, _ in found):
        return first, notes
    return articulated_motion(times, [limb for limb, _ in found], nodes).on_grid(nodes), notes


def limbs_of(scan: Scan, scheme: Scheme = "accurate") -> tuple[Limb, ...]:
    """Legs whose joints are known, moved as the signals of their sensors say.

    Raises:
        LegsimError: no leg's joints are on sensors.
    """
    if not scan.joints:
        raise LegsimError(
            "articulated follows thigh and shank, and this scan knows the place of hip, knee and "
            "ankle on no sensor: configure a sensor on the femur and one on the tibia (imu.sensors)"
        )
    limbs = []
    for leg in scan.joints:
        hip, knee, ankle = leg[:3]
        joints = [
            transforms.apply(scan.start(j.sensor).world_from_sensor, j.position_sensor[None])[0]
            for j in (hip, knee, ankle)
        ]
        thigh, shank = (sensor_path(scan, j.sensor, scheme) for j in (hip, ankle))
        limbs.append(Limb(np.stack(joints), thigh, shank))
    return tuple(limbs)


def _kneecap(scan: Scan, source: str | RigidMotion, scheme: Scheme) -> FloatArray:
    """Poses (v, 4, 4) in world of something that is fixed to the patella.

    Raises:
        LegsimError: an unknown sensor, or a motion at other times than the views.
    """
    if isinstance(source, str):
        return sensor_path(scan, source, scheme)
    if len(source.times) != len(scan.times) or np.abs(source.times - scan.times).max() > _SAME_TIME:
        raise LegsimError(
            f"the patella's motion has {len(source.times)} times from {source.times[0]:g} s, the "
            f"scan {len(scan.times)} views from {scan.times[0]:g} s; give it at the views' times"
        )
    return source.moved_from_reference


def scanned_leg(scan: Scan) -> tuple[AttachedPoint, ...]:
    """The leg, of those whose joints are on sensors, whose knee starts nearest to the center."""
    center = scan.projections.geometry.rotation_center()

    def away(leg: tuple[AttachedPoint, ...]) -> float:
        pose = scan.start(leg[1].sensor).world_from_sensor
        knee = transforms.apply(pose, leg[1].position_sensor[None])[0]
        return float(np.linalg.norm(knee - center))

    return min(scan.joints, key=away)


def around_center(projections: Projections) -> VolumeGrid:
    """Nodes 8 mm apart in a cube of 26 cm about the rotation center."""
    center = [float(c) for c in projections.geometry.rotation_center()]
    return VolumeGrid.cubic(1, _EDGE, center).coarse(_NODE)


def _around_legs(grid: VolumeGrid, limbs: Sequence[Limb]) -> VolumeGrid:
    """The part of the grid in which bones are looked for."""
    shares = np.linspace(0, 1, 200)[:, None]
    ends = [(limb.joints[k], limb.joints[k + 1]) for limb in limbs for k in (0, 1)]
    axes = np.concatenate([start + shares * (end - start) for start, end in ends])
    spacing, last = np.array(grid.spacing_xyz), np.array(grid.shape_zyx[::-1]) - 1
    index = (axes - grid.origin) / spacing
    inside = index[((index >= 0) & (index <= last)).all(-1)]
    if not len(inside):
        return grid
    low = np.maximum(np.floor(inside.min(0) - NEAR_AXES / spacing), 0).astype(int)
    high = np.minimum(np.ceil(inside.max(0) + NEAR_AXES / spacing), last).astype(int) + 1
    z, y, x = (slice(int(a), int(b)) for a, b in zip(low[::-1], high[::-1], strict=True))
    return grid.cropped((z, y, x))


def _seen(volume: Volume, geometry: ConeBeamGeometry, motion: FieldMotion) -> Volume:
    """The volume with nothing in places that few views see along the motion."""
    nodes, (rows, columns) = motion.grid.positions(), geometry.shape_vu
    seen = np.zeros(len(nodes))
    for view, field in enumerate(motion.displacements):
        pixels, depth = geometry[view : view + 1].project(nodes + field.reshape(-1, 3))
        u, v = pixels[0].T
        seen += (u > 0) & (u < columns - 1) & (v > 0) & (v < rows - 1) & (depth[0] > 0)
    index = (volume.grid.positions() - motion.grid.origin) / motion.grid.spacing_xyz
    share = ndimage.map_coordinates(
        (seen / len(geometry)).reshape(motion.grid.shape_zyx),
        index.T[::-1],
        order=1,
        mode="nearest",
    )
    known = share.reshape(volume.grid.shape_zyx) >= _SEEN_BY
    return Volume(volume.grid, np.where(known, volume.attenuation, np.float32(0)))


def _with_bones(limb: Limb, volume: Volume, motion: FieldMotion) -> tuple[Limb, str]:
    """The limb with the bones that the volume shows, and a sentence about them.

    ``motion`` is what the volume was reconstructed along.
    """
    try:
        bones = find_bones(volume, limb.joints)
    except LegsimError as error:
        return limb, (
            f"{error}; every point takes shares of the motions of thigh and shank by its distance "
            "from their axes, so that bone near the knee is not rigid"
            f"{'' if limb.kneecap is None else ', and the motion of the patella is not used'}."
        )
    shown = replace(limb, bones=bones)
    led = _with_expected_patella(shown)
    smeared = _smeared(led, motion)
    if led is not shown and smeared > _SMEARED:
        return led, (
            f"{_shown(bones, ('femur', 'tibia'))} The patella moves against it by "
            f"{1e3 * smeared:.0f} mm RMS, which hides it there: it is taken to be where the "
            "published knee has it, and to fill a ball"
            f"{'' if limb.kneecap is None else ', which follows the motion that was given'}."
        )
    without = (
        ""
        if bones.middle(PATELLA) is not None
        else " No patella was told apart: it moves with what it touches there"
        + ("." if limb.kneecap is None else ", and its own motion is not used.")
    )
    return shown, f"{_shown(bones, ('femur', 'tibia', 'patella'))}{without}"


def _shown(bones: BoneRegions, names: Sequence[str]) -> str:
    """A sentence on the sizes of those bones that were found."""
    labels = {"femur": FEMUR, "tibia": TIBIA, "patella": PATELLA}
    sizes = {name: 1e6 * bones.volume(labels[name]) for name in names}
    seen = ", ".join(f"{size:.0f} cm^3 of the {name}" for name, size in sizes.items() if size > 0)
    return f"a first reconstruction shows {seen}."


def _with_expected_patella(limb: Limb) -> Limb:
    """The limb with a ball for the patella, where the published knee has it; as it is where that is
    unknown.
    """
    expected = expected_patella(limb)
    if limb.bones is None or expected is None:
        return limb
    radius = _PATELLA_RADIUS * float(np.linalg.norm(limb.joints[0] - limb.joints[1]))
    return replace(limb, bones=limb.bones.with_patella(expected, radius))


def _smeared(limb: Limb, motion: FieldMotion) -> float:
    """m, RMS, by which the patella moves against a motion; 0 where there is none."""
    if limb.patella is None:
        return 0.0
    own = RigidMotion(motion.times, limb.motions()[:, 2]).carry(limb.patella[None])
    return float(np.sqrt(((own - motion.carry(limb.patella[None])) ** 2).sum(-1).mean()))
