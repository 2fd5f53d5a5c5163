"""Both legs as closed surfaces, sized to a person and posed by the leg model's segments.

They are loaded from models/leg_phantom.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.phantom import materials, skinning
from legsim.phantom._leg_template import (
    SIDES,
    Detail,
    leg_axes,
    recipes,
    reference_pose,
    scaled_vertices,
)
from legsim.phantom.meshes import Part, Phantom, sphere
from legsim.phantom.skinning import LegAxes, SoftWeights, TissueMobility, swing_of


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """All parts that one segment carries, concatenated, so that posing is a few large products."""

    segment: str
    parts: tuple[int, ...]
    ends: tuple[int, ...]
    points: FloatArray
    """(p, 3) m, in the frame of the segment; soft ones in the frame of the straight leg's femur"""
    weights: SoftWeights | None
    """None for rigid parts"""
    swing: FloatArray | None
    """(p,) share of the soft tissue's swing; None for rigid parts, and where nothing swings"""
    offsets: FloatArray | None = None
    """(p, 3) m in world, added after the points have moved

    It keeps small spheres on the skin spheres.
    """


@dataclass(frozen=True, slots=True, eq=False)
class LegPhantom:
    """A phantom that can be posed.

    Its reference pose is the straight leg: every coordinate zero, the pelvis at the origin.
    """

    phantom: Phantom
    """parts in world of the reference pose, outermost first, named ``<part>_<side>``"""
    segments: tuple[str, ...]
    """each part's segment, for instance ``femur_l``; ``soft_l`` for soft tissue"""
    reference_world_from_segment: FloatArray
    """(13, 4, 4) in the order of :data:`legsim.kinematics.skeleton.SEGMENTS`"""
    _axes: tuple[LegAxes, LegAxes]
    _swings: tuple[TissueMobility, TissueMobility] | None
    _groups: tuple[_Group, ...]

    def __repr__(self) -> str:
        return f"LegPhantom({self.phantom!r})"

    def part_index(self, name: str) -> int:
        """Finds the index of a part.

        Raises:
            LegsimError: unknown part; the message lists the known ones.
        """
        names = [part.name for part in self.phantom.parts]
        if name not in names:
            raise LegsimError(f"unknown part {name!r}; known: {', '.join(names)}")
        return names.index(name)

    def in_segment(self, name: str) -> FloatArray:
        """Vertices (p, 3) of a bone's surface in the frame of its segment."""
        k = self.part_index(name)
        pose = self.reference_world_from_segment[SEGMENTS.index(self.segments[k])]
        return transforms.apply(transforms.inverse(pose), self.phantom.parts[k].vertices)

    def posed(
        self, world_from_segment: ArrayLike, segment_names: Sequence[str]
    ) -> tuple[FloatArray, ...]:
        """Vertices of every part, each (p, 3) m in world, for one pose (s, 4, 4).

        The pose is that of the named segments. Where the names hold
        :func:`legsim.phantom.skinning.swing_of` a bone, its soft tissue is shifted by that pose's
        translation.

        Raises:
            LegsimError: a segment that carries a part has no pose, or the soft tissue swings and
                the phantom was not loaded for it.
        """
        poses = _Poses.of(world_from_segment, segment_names)
        vertices: list[FloatArray] = [np.empty((0, 3))] * len(self.phantom.parts)
        for group in self._groups:
            if group.weights is None:
                moved = transforms.apply(poses[group.segment], group.points)
            else:
                moved = self._soft(
                    group.points, group.weights, group.swing, poses, group.segment[-1]
                )
            moved = moved if group.offsets is None else moved + group.offsets
            for part, piece in zip(group.parts, np.split(moved, group.ends[:-1]), strict=True):
                vertices[part] = piece
        return tuple(vertices)

    def paths(
        self,
        points_world: ArrayLike,
        segment: str,
        *,
        start: ArrayLike,
        poses: ArrayLike,
        segment_names: Sequence[str],
    ) -> FloatArray:
        """Paths (v, p, 3) of material points at each of ``poses`` (v, s, 4, 4): the truth.

        The points (p, 3) are given in world at pose ``start`` (s, 4, 4). ``segment`` carries them:
        a bone (``tibia_l``) or ``soft_l``, ``soft_r``, as in :attr:`segments`.

        Raises:
            LegsimError: no part moves with ``segment``, or a segment that carries it has no pose.
        """
        before, points = _Poses.of(start, segment_names), np.asarray(points_world, float)
        after = [_Poses.of(pose, segment_names) for pose in np.asarray(poses, float)]
        if segment not in self.segments:
            raise LegsimError(
                f"no part moves with {segment!r}; known: {', '.join(sorted(set(self.segments)))}"
            )
        if not segment.startswith("soft"):
            local = transforms.apply(transforms.inverse(before[segment]), points)
            return np.stack([transforms.apply(pose[segment], local) for pose in after])
        side = segment[-1]
        straight = self._straightened(points, before, side)
        weights, swing = self._weights(straight, side)
        return np.stack([self._soft(straight, weights, swing, pose, side) for pose in after])

    def skin_points(self, side: str, *, heights: ArrayLike, directions: ArrayLike) -> FloatArray:
        """Points (n, 3) on the skin of the reference pose, in world, for beads and the like.

        ``heights`` (n,) m above the knee axis; ``directions`` (n,) rad about the vertical: 0 in
        front, positive to the lateral side.
        """
        part = self.phantom.parts[self.part_index(f"skin_{side}")]
        knee = self._reference(f"tibia_{side}")[:3, 3]
        outward = 1.0 if side == "r" else -1.0
        heights, directions = np.broadcast_arrays(
            np.asarray(heights, float), np.asarray(directions, float)
        )
        aims = np.stack(
            [np.cos(directions), np.zeros(directions.shape), outward * np.sin(directions)], -1
        )
        starts = knee + heights[..., None] * np.array([0.0, 1.0, 0.0])
        return np.array(
            [_first_exit(part, start, aim) for start, aim in zip(starts, aims, strict=True)]
        ).reshape(-1, 3)

    def with_spheres(
        self,
        name: str,
        centers: ArrayLike,
        *,
        segment: str,
        radius: float,
        material: str = "tantalum",
        energy_kev: float = materials.DEFAULT_ENERGY_KEV,
    ) -> "LegPhantom":
        """Adds a sphere at each of ``centers`` (n, 3), parts ``<name>_0``, ``<name>_1``, ...

        The spheres are beads on the skin, or fiducials of sensors. ``segment`` carries them: a
        bone's name, with centers in its frame, or ``soft_l`` or ``soft_r``, with centers in world
        of the reference pose (see :meth:`skin_points`).
        """
        centers = np.asarray(centers, float).reshape(-1, 3)
        soft = segment in ("soft_l", "soft_r")
        if not soft and segment not in SEGMENTS:
            raise LegsimError(
                f"unknown segment {segment!r}; known: soft_l, soft_r, {', '.join(SEGMENTS)}"
            )
        if len(centers) == 0 or not radius > 0:
            raise LegsimError(
                f"spheres {name!r}: {len(centers)} centers of radius {radius} m; at least one and "
                "a positive radius are needed"
            )
        offsets, triangles = sphere(radius)
        world_from_carrier = self._reference(f"femur_{segment[-1]}" if soft else segment)
        world = centers if soft else transforms.apply(world_from_carrier, centers)
        points = np.repeat(
            transforms.apply(transforms.inverse(world_from_carrier), world), len(offsets), axis=0
        )
        value = materials.attenuation(material, energy_kev)
        first = len(self.phantom.parts)
        parts = [
            Part(f"{name}_{k}", material, value, c + offsets, triangles)
            for k, c in enumerate(world)
        ]
        weights, swing = self._weights(points, segment[-1]) if soft else (None, None)
        members = tuple(range(first, first + len(parts)))
        ends = tuple(len(offsets) * (k + 1) for k in range(len(parts)))
        group = _Group(
            segment, members, ends, points, weights, swing, np.tile(offsets, (len(parts), 1))
        )
        return replace(
            self,
            phantom=Phantom((*self.phantom.parts, *parts)),
            segments=(*self.segments, *[segment] * len(parts)),
            _groups=(*self._groups, group),
        )

    def one_leg(self, side: str) -> "LegPhantom":
        """Restricts the phantom to the leg of ``side`` ("l" or "r")."""
        kept = [k for k, segment in enumerate(self.segments) if segment.endswith(f"_{side}")]
        place = {k: n for n, k in enumerate(kept)}
        groups = tuple(
            replace(group, parts=tuple(place[k] for k in group.parts))
            for group in self._groups
            if group.segment.endswith(f"_{side}")
        )
        return replace(
            self,
            phantom=self.phantom.only(kept),
            segments=tuple(self.segments[k] for k in kept),
            _groups=groups,
        )

    def _reference(self, segment: str) -> FloatArray:
        return self.reference_world_from_segment[SEGMENTS.index(segment)]

    def _weights(self, points: FloatArray, side: str) -> tuple[SoftWeights, FloatArray | None]:
        """Weights of soft points (p, 3), and their share of the swing.

        The points are in the femur's frame of the straight leg.
        """
        k = SIDES.index(side)
        return SoftWeights.at(
            points, self._axes[k]
        ), None if self._swings is None else self._swings[k].at(points)

    def _soft(
        self,
        points: FloatArray,
        weights: SoftWeights,
        swing: FloatArray | None,
        poses: "_Poses",
        side: str,
    ) -> FloatArray:
        """Carries points (p, 3) to world by the soft map.

        The points are in the femur's frame of the straight leg.
        """
        hip = self._reference(f"femur_{side}")
        femur, tibia, patella, foot = (
            poses[f"{name}_{side}"] @ transforms.inverse(self._reference(f"{name}_{side}")) @ hip
            for name in ("femur", "tibia", "patella", "calcn")
        )
        moved = skinning.deform(
            points, weights, femur=femur, tibia=tibia, patella=patella, foot=foot
        )
        of_thigh, of_shank = (swing_of(f"{bone}_{side}") for bone in ("femur", "tibia"))
        if of_thigh not in poses.names:
            return moved
        if swing is None:
            raise LegsimError(
                "the poses hold a swing of soft tissue; load the phantom with swinging=True"
            )
        thigh, shank = (poses[name][:3, 3] for name in (of_thigh, of_shank))
        return moved + swing[:, None] * (thigh + weights.knee_share[:, None] * (shank - thigh))

    def straightened(
        self, points: FloatArray, pose: ArrayLike, segment_names: Sequence[str], side: str
    ) -> FloatArray:
        """Soft points (p, 3) of one pose (s, 4, 4) as of the straight leg, in its femur's frame."""
        return self._straightened(points, _Poses.of(pose, segment_names), side)

    def from_straight(
        self, points: FloatArray, pose: ArrayLike, segment_names: Sequence[str], side: str
    ) -> FloatArray:
        """Inverse of :meth:`straightened`."""
        poses = _Poses.of(pose, segment_names)
        return self._soft(points, *self._weights(points, side), poses, side)

    def _straightened(self, points: FloatArray, poses: "_Poses", side: str) -> FloatArray:
        """Points of the straight leg that the soft map carries to world ``points`` (p, 3).

        Found by damped Newton steps from two starts.
        """

        def carried(p: FloatArray) -> FloatArray:
            return self._soft(p, *self._weights(p, side), poses, side)

        offset = transforms.inverse(self._reference(f"femur_{side}")) @ self._reference(
            f"tibia_{side}"
        )
        thigh = transforms.apply(transforms.inverse(poses[f"femur_{side}"]), points)
        shank = transforms.apply(offset @ transforms.inverse(poses[f"tibia_{side}"]), points)
        found, best = thigh.copy(), np.full(len(points), np.inf)
        for start in (thigh, shank, 0.5 * (thigh + shank)):
            left = np.flatnonzero(best > 1e-9)
            trial = _newton(carried, points[left], start[left])
            error = np.linalg.norm(carried(trial) - points[left], axis=-1)
            better = left[error < best[left]]
            found[better], best[better] = trial[error < best[left]], error[error < best[left]]
        return found


@dataclass(frozen=True, slots=True)
class _Poses:
    """One pose of named segments."""

    names: tuple[str, ...]
    world_from_segment: FloatArray

    @classmethod
    def of(cls, world_from_segment: ArrayLike, segment_names: Sequence[str]) -> "_Poses":
        poses = np.asarray(world_from_segment, float)
        if poses.shape != (len(segment_names), 4, 4):
            raise LegsimError(
                f"world_from_segment has shape {poses.shape}; {len(segment_names)} segments are "
                "named: expected (s, 4, 4)"
            )
        return cls(tuple(segment_names), poses)

    def __getitem__(self, name: str) -> FloatArray:
        if name not in self.names:
            raise LegsimError(
                f"no pose for the segment {name}, which carries a part; known: "
                f"{', '.join(self.names)}"
            )
        return self.world_from_segment[self.names.index(name)]


def _first_exit(part: Part, start: FloatArray, aim: FloatArray) -> FloatArray:
    """Last point at which a ray from inside a closed part leaves it.

    Moeller and Trumbore's test against every triangle.

    Raises:
        LegsimError: the ray meets no triangle.
    """
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    facing = normal @ aim
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.einsum("ij,ij->i", normal, a - start) / facing
        across = np.cross(start - a, aim)
        u, v = (
            -np.einsum("ij,ij->i", c - a, across) / facing,
            np.einsum("ij,ij->i", b - a, across) / facing,
        )
        hit = (facing > 0) & (along > 0) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    if not hit.any():
        raise LegsimError(
            f"a ray from {np.round(start, 3).tolist()} toward {np.round(aim, 3).tolist()} does "
            f"not leave {part.name}; choose another height"
        )
    return start + aim * along[hit].max()


def _newton(
    function: Callable[[FloatArray], FloatArray], goal: FloatArray, start: FloatArray
) -> FloatArray:
    """Points (p, 3) with function(points) = goal, each by Newton's method.

    Differences are central, steps at most 1 cm.
    """
    points, step = start.copy(), 1e-6
    unsolved = np.arange(len(points))
    for _ in range(40):
        base = points[unsolved]
        residual = function(base) - goal[unsolved]
        far = np.abs(residual).max(-1) > 1e-10
        unsolved, base, residual = unsolved[far], base[far], residual[far]
        if len(unsolved) == 0:
            break
        slope = np.stack(
            [
                (function(base + step * e) - function(base - step * e)) / (2 * step)
                for e in np.eye(3)
            ],
            -1,
        )
        # damped normal equations: a singular slope gives a small step instead of none
        turned = np.swapaxes(slope, -1, -2)
        change = np.linalg.solve(turned @ slope + 1e-12 * np.eye(3), turned @ residual[..., None])[
            ..., 0
        ]
        length = np.linalg.norm(change, axis=-1, keepdims=True)
        points[unsolved] = base - change * np.minimum(1.0, 0.02 / np.maximum(length, 1e-12))
    return points


def load_leg_phantom(
    *,
    scales: SegmentScales | None = None,
    detail: Detail = "coarse",
    energy_kev: float = materials.DEFAULT_ENERGY_KEV,
    swinging: bool = False,
) -> LegPhantom:
    """Loads the phantom in its reference pose, sized by the leg model's segment scales.

    The knee keeps one size, the femur's, on both of its sides, so that the joint faces fit; sizes
    change smoothly along the shafts. ``swinging`` prepares soft tissue for poses that shift it
    against the bones (see :mod:`legsim.phantom.tissue_swing`).
    """
    scales = scales or SegmentScales.uniform()
    reference = reference_pose(scales)
    parts: list[Part] = []
    local: list[FloatArray] = []
    segments: list[str] = []
    for recipe in recipes(detail):
        value = materials.attenuation(recipe.material, energy_kev)
        for side in SIDES:
            vertices = scaled_vertices(recipe.vertices, recipe.segment, scales, side)
            triangles = recipe.triangles if side == "r" else recipe.triangles[:, ::-1]
            carrier = "femur" if recipe.segment == "soft" else recipe.segment
            world = transforms.apply(reference[SEGMENTS.index(f"{carrier}_{side}")], vertices)
            parts.append(Part(f"{recipe.name}_{side}", recipe.material, value, world, triangles))
            local.append(vertices)
            segments.append(f"{recipe.segment}_{side}")
    axes = (leg_axes(scales, "l"), leg_axes(scales, "r"))
    still = LegPhantom(Phantom(tuple(parts)), tuple(segments), reference, axes, None, ())
    still = with_mobile_tissue(still) if swinging else still
    return replace(still, _groups=grouped(still, local))


def with_mobile_tissue(phantom: LegPhantom) -> LegPhantom:
    """Prepares the soft tissue for poses that shift it; :func:`grouped` comes after."""
    left, right = (_swing_share(phantom, side) for side in SIDES)
    return replace(phantom, _swings=(left, right))


def _swing_share(phantom: LegPhantom, side: str) -> TissueMobility:
    """Share of the swing at points of one leg, by the distance from all its rigid parts."""
    femur_from_world = transforms.inverse(phantom._reference(f"femur_{side}"))
    rigid = [
        part
        for part, segment in zip(phantom.phantom.parts, phantom.segments, strict=True)
        if segment.endswith(f"_{side}") and not segment.startswith("soft")
    ]
    return TissueMobility(
        [(transforms.apply(femur_from_world, part.vertices), part.triangles) for part in rigid]
    )


def grouped(phantom: LegPhantom, local: Sequence[FloatArray]) -> tuple[_Group, ...]:
    """Groups all parts by segment; ``local`` are their points (p, 3), as of :class:`_Group`."""
    groups, segments = [], phantom.segments
    for segment in sorted(set(segments)):
        members = tuple(k for k, name in enumerate(segments) if name == segment)
        points = np.concatenate([local[k] for k in members])
        weights, swing = (
            phantom._weights(points, segment[-1]) if segment.startswith("soft") else (None, None)
        )
        ends = tuple(int(n) for n in np.cumsum([len(local[k]) for k in members]))
        groups.append(_Group(segment, members, ends, points, weights, swing))
    return tuple(groups)
