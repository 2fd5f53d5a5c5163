"""Oracles: corrections that are given the true motion, the ceilings of all methods.

The phantom's own motion is a displacement field, the ceiling of non-rigid methods.

The field is sampled at nodes and linear between them. Material points of soft tissue follow the
phantom's skinning. So that bones stay exact, every node within one spacing of a bone moves with the
nearest bone. Soft tissue that close to a bone then moves with the bone; this error of the sampling
shrinks with the spacing.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from legsim.core.values import FloatArray, frozen_owned
from legsim.correction.method import Correction, Scan
from legsim.deformation.models import FieldMotion, Motion
from legsim.geometry.volume import VolumeGrid
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom import voxelize
from legsim.phantom.leg_phantom import LegPhantom

_FINER = 4
"""label voxels along one node spacing"""

_LED_BACK = 1e-6
"""m: greatest error of a point mapped to the straight leg and back"""


@dataclass(frozen=True, slots=True)
class Oracle:
    """The correction that knows the motion: the ceiling of all that estimate it."""

    motion: Motion | Callable[[], Motion]
    """the true motion, or a function that computes it when called"""
    name: str = "oracle"

    def __call__(self, scan: Scan, /) -> Correction:
        motion = self.motion() if callable(self.motion) else self.motion
        return Correction(self.name, scan.projections, motion)


def phantom_motion(
    phantom: LegPhantom, poses: SegmentPoses, nodes: VolumeGrid, device: Device, *, side: str = "l"
) -> FieldMotion:
    """Displacements of the material points that lie at ``nodes`` in the first of ``poses``.

    They are of one leg: nodes beyond it move as its soft tissue would, also those in the other leg.
    """
    carrier = _carriers(phantom, poses, nodes, device, side)
    points = nodes.positions()
    fields = np.empty((len(poses.times), len(points), 3), np.float32)
    for segment in sorted(set(carrier.tolist())):
        chosen = np.flatnonzero(carrier == segment)
        paths = phantom.paths(
            points[chosen],
            segment,
            start=poses.world_from_segment[0],
            poses=poses.world_from_segment,
            segment_names=poses.segment_names,
        )
        fields[:, chosen] = _completed(
            paths - paths[0],
            np.linalg.norm(paths[0] - points[chosen], axis=-1) < _LED_BACK,
            points[chosen],
        )
    return FieldMotion(
        poses.times, nodes, frozen_owned(fields.reshape(len(fields), *nodes.shape_zyx, 3))
    )


def _completed(paths: FloatArray, known: np.ndarray, points: FloatArray) -> FloatArray:
    """Replaces unknown displacements (v, p, 3) by those of the nearest known point.

    They are unknown where a point's position in the straight leg was not found. Such points are few
    and lie in air, where the skinning folds space over itself.
    """
    if known.all() or not known.any():
        return paths
    nearest = np.flatnonzero(known)[KDTree(points[known]).query(points[~known])[1]]
    paths[:, ~known] = paths[:, nearest]
    return paths


def _carriers(
    phantom: LegPhantom, poses: SegmentPoses, nodes: VolumeGrid, device: Device, side: str
) -> FloatArray:
    """Names (n,) of the carrier of each node: a bone within one spacing, else the soft tissue."""
    soft = f"soft_{side}"
    members = [k for k, segment in enumerate(phantom.segments) if segment.endswith(f"_{side}")]
    vertices = phantom.posed(poses.world_from_segment[0], poses.segment_names)
    fine = _finer(nodes)
    found = voxelize.labels(
        phantom.phantom.only(members), fine, device, posed=[vertices[k] for k in members]
    )
    names = np.array(["", *(phantom.segments[k] for k in members)])
    bony = ~np.isin(names, ["", soft])[found]
    if not bony.any():
        return np.full(int(np.prod(nodes.shape_zyx)), soft)
    places = np.moveaxis(
        np.indices(fine.shape_zyx)[:, ::_FINER, ::_FINER, ::_FINER], 0, -1
    ).reshape(-1, 3)
    bones = np.argwhere(bony)
    distance, nearest = KDTree(bones * fine.spacing_xyz[::-1]).query(
        places * fine.spacing_xyz[::-1], distance_upper_bound=nodes.spacing_xyz[0]
    )
    near, nearest = np.isfinite(distance), np.asarray(nearest)
    carrier = np.full(len(places), soft, names.dtype)
    carrier[near] = names[found[tuple(bones[nearest[near]].T)]]
    return carrier


def _finer(nodes: VolumeGrid) -> VolumeGrid:
    """Grid whose every fourth point is a node."""
    nz, ny, nx = ((n - 1) * _FINER + 1 for n in nodes.shape_zyx)
    x, y, z = (s / _FINER for s in nodes.spacing_xyz)
    return VolumeGrid((nz, ny, nx), (x, y, z), nodes.center)
