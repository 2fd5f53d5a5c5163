"""Both legs as closed surfaces: loaded from models/leg_phantom, sized to a person, posed by the segments of the leg model."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from legsim import materials, skinning, transforms
from legsim.anatomy import SEGMENTS, SegmentScales
from legsim.arrays import FloatArray, frozen
from legsim.errors import LegsimError
from legsim.phantom import Part, Phantom
from legsim.resources import model_file
from legsim.skinning import LegAxes, SoftWeights, smooth_step

Detail = Literal["coarse", "fine"]
SIDES = ("l", "r")

# gait2392 with every coordinate at zero; the patella after Rajagopal2016: positions in the parent's frame, right leg, m
_HIP_HALF_WIDTH = 0.0835
_FEMUR_TIBIA = np.array([-0.004499856517536013, -0.39582069644835033, 0.0])
_FEMUR_PATELLA = np.array([0.04431, -0.41876, -0.00275])
_PATELLA_TILT = 0.00113686
_TIBIA_TALUS = np.array([0.0, -0.43, 0.0])
_TALUS_CALCN = np.array([-0.04877, -0.04195, 0.00792])


@dataclass(frozen=True, slots=True)
class _Recipe:
    """One row of parts.toml with its mesh, of the right leg."""

    name: str
    segment: str
    material: str
    vertices: FloatArray
    triangles: np.ndarray


@cache
def _recipes(detail: str) -> tuple[_Recipe, ...]:
    """The meshes that ship with legsim; read once."""
    rows = tomllib.loads(model_file("leg_phantom/parts.toml").read_text())["part"]
    with np.load(model_file(f"leg_phantom/{detail}.npz"), allow_pickle=False) as arrays:
        return tuple(
            _Recipe(
                row["name"],
                row["segment"],
                row["material"],
                frozen("vertices", arrays[f"{row['name']}.vertices"], (None, 3)),
                frozen("triangles", arrays[f"{row['name']}.triangles"], (None, 3), np.int32),
            )
            for row in rows
        )


@dataclass(frozen=True, slots=True, eq=False)
class LegPhantom:
    """A phantom that can be posed. Its reference pose is the straight leg: every coordinate zero, hips at height 0."""

    phantom: Phantom
    """parts in world of the reference pose, outermost first, named ``<part>_<side>``"""
    segments: tuple[str, ...]
    """a part's segment, for instance ``femur_l``; ``soft_l`` for what deforms"""
    reference_world_from_segment: FloatArray
    """(13, 4, 4) in the order of :data:`legsim.anatomy.SEGMENTS`"""
    _axes: tuple[LegAxes, LegAxes]
    _weights: tuple[SoftWeights | None, ...]
    """a soft part's weights; None where a part is rigid"""

    def part_index(self, name: str) -> int:
        """Place of a part.

        Raises:
            LegsimError: there is no such part; the message lists them.
        """
        names = [part.name for part in self.phantom.parts]
        if name not in names:
            raise LegsimError(f"the phantom has no part named {name!r}; there are: {', '.join(names)}")
        return names.index(name)

    def posed(self, world_from_segment: FloatArray, segment_names: Sequence[str]) -> tuple[FloatArray, ...]:
        """Vertices of every part, each (p, 3) m in world, for one pose (s, 4, 4) of the named segments.

        Raises:
            LegsimError: a segment that carries a part has no pose.
        """
        moved = self.moved_from_reference(world_from_segment, segment_names)
        return tuple(
            transforms.apply(moved[segment], part.vertices)
            if weights is None
            else self._soft(part.vertices, weights, moved, segment[-1])
            for part, segment, weights in zip(self.phantom.parts, self.segments, self._weights, strict=True)
        )

    def moved_from_reference(self, world_from_segment: FloatArray, segment_names: Sequence[str]) -> "dict[str, FloatArray]":
        """World motion (4, 4) of each bone since the reference pose, by segment name: the truth of the rigid parts."""
        needed = {s for s in self.segments if not s.startswith("soft")} | {f"calcn_{side}" for side in SIDES}
        missing = sorted(needed - set(segment_names))
        if missing:
            raise LegsimError(f"no pose for the segments {', '.join(missing)}; there are: {', '.join(segment_names)}")
        poses = np.asarray(world_from_segment, float)
        return {
            name: poses[list(segment_names).index(name)] @ transforms.inverse(self.reference_world_from_segment[SEGMENTS.index(name)])
            for name in sorted(needed)
        }

    def displaced(
        self,
        points: FloatArray,
        segment: str,
        *,
        start: FloatArray,
        end: FloatArray,
        segment_names: Sequence[str],
    ) -> FloatArray:
        """Where material points (p, 3), in world at pose ``start``, are at pose ``end`` (each (s, 4, 4)).

        ``segment`` says what carries them: a bone (``tibia_l``) or ``soft_l``, ``soft_r``, as in :attr:`segments`.
        """
        before, after = self.moved_from_reference(start, segment_names), self.moved_from_reference(end, segment_names)
        points = np.asarray(points, float)
        if not segment.startswith("soft"):
            return transforms.apply(after[segment] @ transforms.inverse(before[segment]), points)
        reference = self._unposed(points, before, segment[-1])
        return self._soft(reference, self._weights_at(reference, segment[-1]), after, segment[-1])

    def _weights_at(self, points: FloatArray, side: str) -> SoftWeights:
        hip = self.reference_world_from_segment[SEGMENTS.index(f"femur_{side}")]
        return SoftWeights.at(transforms.apply(transforms.inverse(hip), points), self._axes[SIDES.index(side)])

    def _soft(self, points: FloatArray, weights: SoftWeights, moved: "dict[str, FloatArray]", side: str) -> FloatArray:
        """Points (p, 3) of the reference pose, in world, carried by the soft map of one side."""
        hip = self.reference_world_from_segment[SEGMENTS.index(f"femur_{side}")]
        femur, tibia, foot = (moved[f"{name}_{side}"] @ hip for name in ("femur", "tibia", "calcn"))
        return skinning.deform(points - hip[:3, 3], weights, femur, tibia, foot)

    def _unposed(self, points: FloatArray, moved: "dict[str, FloatArray]", side: str) -> FloatArray:
        """The reference points that the soft map carries to ``points`` (p, 3): Newton's method, differences for the slope."""
        guess = transforms.apply(transforms.inverse(moved[f"femur_{side}"]), points)
        below = transforms.apply(transforms.inverse(moved[f"tibia_{side}"]), points)
        knee = self._axes[SIDES.index(side)].knee[1]
        guess = np.where(below[:, 1:2] < guess[:, 1:2].clip(max=knee), below, guess)
        step = 1e-6

        def carried(p: FloatArray) -> FloatArray:
            return self._soft(p, self._weights_at(p, side), moved, side)

        for _ in range(30):
            residual = carried(guess) - points
            if np.abs(residual).max(initial=0.0) < 1e-9:
                break
            slope = np.stack([(carried(guess + step * e) - carried(guess - step * e)) / (2 * step) for e in np.eye(3)], -1)
            change = np.linalg.solve(slope, residual[..., None])[..., 0]
            guess = guess - change * np.minimum(1.0, 0.02 / np.maximum(np.linalg.norm(change, axis=-1, keepdims=True), 1e-12))
        return guess


def load(
    *,
    scales: SegmentScales | None = None,
    detail: Detail = "coarse",
    energy_kev: float = materials.DEFAULT_ENERGY_KEV,
) -> LegPhantom:
    """The phantom in its reference pose, sized by the scale factors of the leg model's segments.

    The knee keeps one size, the femur's, on both of its sides, so that the joint faces fit; sizes change smoothly along the shafts.
    """
    scales = scales or SegmentScales.uniform()
    recipes = _recipes(detail)
    reference = reference_pose(scales)
    parts: list[Part] = []
    segments: list[str] = []
    weights: list[SoftWeights | None] = []
    axes = tuple(_axes(scales, side) for side in SIDES)
    for recipe in recipes:
        for side, leg_axes in zip(SIDES, axes, strict=True):
            local = _scaled(recipe.vertices, recipe.segment, scales, side)
            triangles = recipe.triangles if side == "r" else recipe.triangles[:, ::-1]
            carrier = "femur" if recipe.segment == "soft" else recipe.segment
            world = transforms.apply(reference[SEGMENTS.index(f"{carrier}_{side}")], local)
            parts.append(
                Part(f"{recipe.name}_{side}", recipe.material, materials.attenuation(recipe.material, energy_kev), world, triangles)
            )
            segments.append(f"{recipe.segment}_{side}")
            weights.append(SoftWeights.at(local, leg_axes) if recipe.segment == "soft" else None)
    return LegPhantom(Phantom(tuple(parts)), tuple(segments), reference, (axes[0], axes[1]), tuple(weights))


def reference_pose(scales: SegmentScales) -> FloatArray:
    """world_from_segment (13, 4, 4) of the straight leg, in the order of SEGMENTS; hips at x = y = 0, pelvis at the origin."""
    poses = np.broadcast_to(np.eye(4), (len(SEGMENTS), 4, 4)).copy()
    for side in SIDES:
        mirror = np.array([1, 1, 1 if side == "r" else -1])
        place = np.array([0, 0, _HIP_HALF_WIDTH]) * mirror * scales.of("pelvis")
        steps = {"femur": place}
        steps["patella"] = place + _FEMUR_PATELLA * mirror * scales.of(f"femur_{side}")
        steps["tibia"] = place + _FEMUR_TIBIA * mirror * scales.of(f"femur_{side}")
        steps["talus"] = steps["tibia"] + _TIBIA_TALUS * mirror * scales.of(f"tibia_{side}")
        steps["calcn"] = steps["talus"] + _TALUS_CALCN * mirror * scales.of(f"talus_{side}")
        steps["toes"] = steps["calcn"] + np.array([0.1788, -0.002, 0.00108]) * mirror * scales.of(f"calcn_{side}")
        for name, position in steps.items():
            tilt = transforms.axis_rotation((0, 0, 1), _PATELLA_TILT if name == "patella" else 0.0)
            poses[SEGMENTS.index(f"{name}_{side}")] = transforms.rigid(tilt, position)
    return frozen("reference pose", poses, poses.shape)


def _axes(scales: SegmentScales, side: str) -> LegAxes:
    knee = _FEMUR_TIBIA * scales.of(f"femur_{side}")
    ankle = knee + _TIBIA_TALUS * scales.of(f"tibia_{side}")
    return LegAxes((knee[0], knee[1], 0.0), (ankle[0], ankle[1], 0.0), float(scales.of(f"femur_{side}")[1]))


def _scaled(vertices: FloatArray, segment: str, scales: SegmentScales, side: str) -> FloatArray:
    """Template vertices (p, 3) of the right leg, in their segment's frame (soft ones in the femur's), at a person's size and side."""
    mirror = np.array([1, 1, 1 if side == "r" else -1])
    femur, tibia, calcn = (scales.of(f"{name}_{side}") for name in ("femur", "tibia", "calcn"))
    if segment == "patella":
        return vertices * np.array([femur[1], femur[1], femur[2]]) * mirror
    if segment == "femur":
        return _scaled_thigh(vertices, femur) * mirror
    if segment == "tibia":
        return _scaled_shank(vertices, femur, tibia) * mirror
    below = vertices - _FEMUR_TIBIA
    shank = _scaled_shank(below, femur, tibia) + _FEMUR_TIBIA * femur
    foot_origin = _TIBIA_TALUS + _TALUS_CALCN
    foot = (below - foot_origin) * calcn + _TALUS_CALCN * scales.of(f"talus_{side}") + _TIBIA_TALUS * tibia + _FEMUR_TIBIA * femur
    share = smooth_step((-0.38 - below[:, 1:2]) / 0.06)
    leg = np.where(below[:, 1:2] > 0, _scaled_thigh(vertices, femur), shank * (1 - share) + foot * share)
    return leg * mirror


def _knee_depth(x: FloatArray, femur: FloatArray) -> FloatArray:
    """x from the knee axis, sized: in front by the femur's x, which carries the patella; behind by its y, as the plateau turns there."""
    front = smooth_step((x + 0.012) / 0.024)
    return x * (femur[0] * front + femur[1] * (1 - front))


def _scaled_thigh(points: FloatArray, femur: FloatArray) -> FloatArray:
    x, y, z = points.T
    near = smooth_step((-0.28 - y) / 0.09)
    depth = x - _FEMUR_TIBIA[0]
    return np.stack([_FEMUR_TIBIA[0] * femur[0] + near * _knee_depth(depth, femur) + (1 - near) * depth * femur[0], y * femur[1], z * femur[2]], -1)


def _scaled_shank(points: FloatArray, femur: FloatArray, tibia: FloatArray) -> FloatArray:
    x, y, z = points.T
    near = 1 - smooth_step((-0.06 - y) / 0.30)
    return np.stack(
        [
            near * _knee_depth(x, femur) + (1 - near) * x * tibia[0],
            y * (near * femur[1] + (1 - near) * tibia[1]),
            z * (near * femur[2] + (1 - near) * tibia[2]),
        ],
        -1,
    )
