"""A phantom from segmentations: smooth closed meshes that nest, in a folder with a PHANTOM.toml.

Each structure's surface stays within half a voxel of its labels' border. Soft tissue extends below
what displaces it, so that no gap opens where a bone moves against it; skin, fat and other envelopes
are filled. Bones without a labeled cortex become a cortex around cancellous bone; cartilage can be
laid on the faces of a joint.
"""

import os
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from legsim.core import files, transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.phantom import _label_surfaces, _stance, label_maps, landmarks, surfaces
from legsim.phantom.label_structures import Structure, StructureGrid
from legsim.phantom.landmarks import BoneSurface

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


_UNDERLAP = 0.004
"""m by which a part extends below a later one of its segment, and soft tissue below any"""

_JOINT_SPACE = 0.003
"""m between the cartilages of two bones: bones farther apart than this and both cartilages do not
face each other
"""

_BAND = 1.5
"""voxels from the border of a layer within which distances are exact

Elsewhere they are right to half a voxel; the ends of a step across the border are a voxel from it.
"""

_JOINTS = (("femur", "tibia"), ("femur", "patella"), ("tibia", "talus"))

_TURNED_DEG = (30.0, 120.0)
"""angles between a patella and the front at which a leg is turned: more of them, and less"""

_PLAUSIBLE_CM3 = {"femur": (300, 700), "tibia": (180, 500), "patella": (8, 40)}
"""volumes of whole adult bones"""

_MOST_ALTERED = 0.05
"""relative difference of a mesh's volume from its labels' that is reported"""


@dataclass(frozen=True, slots=True)
class Layers:
    """Thicknesses of layers that the segmentation lacks."""

    cortex: float = 2e-3
    """m; 0: bones are cancellous throughout"""
    cartilage: float = 0.0
    """m; 0: none is added"""


@dataclass(frozen=True, slots=True, eq=False)
class MeshedPart:
    """One part of the phantom."""

    name: str
    material: str
    segment: str | None
    vertices: FloatArray
    """(p, 3) m in world"""
    triangles: np.ndarray
    """(t, 3) int32, outward"""


@dataclass(frozen=True, slots=True)
class VolumeRow:
    """Volume of a structure's labels beside its mesh's."""

    name: str
    labels: float
    """m^3 of its own voxels"""
    meshed: float
    """m^3 of the voxels that were meshed: with those that it extends to below others"""
    mesh: float
    """m^3"""


@dataclass(frozen=True, slots=True, eq=False)
class MeshedLabels:
    """Parts of the phantom, outermost first, and what a user should know of them."""

    parts: tuple[MeshedPart, ...]
    volumes: tuple[VolumeRow, ...]
    landmarks: dict[str, dict[str, FloatArray]]
    """points (3,) m in world by side and name, of :mod:`legsim.phantom.landmarks`"""
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Outer:
    """A structure's mask in its box, and its outer surface."""

    structure: Structure
    mask: np.ndarray
    world_from_index: FloatArray
    vertices: FloatArray
    triangles: np.ndarray
    labeled: int = 0
    """count of its own voxels"""

    def distance(self, where: np.ndarray, surface: KDTree) -> FloatArray:
        """Distances (n,) in m of chosen voxels of the box from the surface, positive inside."""
        return _label_surfaces.exact_distance(self.mask, where, surface, self.world_from_index)

    def part(self, name: str, material: str) -> MeshedPart:
        return MeshedPart(name, material, self.structure.segment, self.vertices, self.triangles)


def mesh_labels(grid: StructureGrid, layers: Layers) -> MeshedLabels:
    """Meshes all structures.

    Raises:
        LegsimError: a layer is below 0, or thinner than half a voxel.
    """
    voxel = float(np.linalg.norm(grid.world_from_index[:3, :3], axis=0).max())
    for option, thickness in (("cortex", layers.cortex), ("cartilage", layers.cartilage)):
        if thickness != 0 and not 0.5 * voxel <= thickness <= 0.02:
            raise LegsimError(
                f"--{option}-mm {1e3 * thickness:g}: give 0, or from half a voxel "
                f"({500 * voxel:.3g} mm) to 20 mm"
            )
    boxes = ndimage.find_objects(grid.codes)
    remarks = [*grid.remarks, *_cuts(grid, boxes)]
    outers = _outers(grid, boxes)
    volumes = tuple(_volume_row(outer) for outer in outers)
    remarks += _volume_remarks(outers, volumes, grid, boxes)
    parts: list[MeshedPart] = []
    bony = [outer for outer in outers if outer.structure.entry.tissue == label_maps.BONE]
    for outer in outers:
        if outer not in bony:
            parts.append(outer.part(outer.structure.name, outer.structure.entry.tissue))
    if layers.cartilage > 0:
        parts += _cartilages(grid, bony, layers.cartilage, remarks)
    for outer in bony:
        parts += _bone(grid, outer, layers.cortex, remarks)
    if not any(structure.entry.envelope for structure in grid.structures):
        remarks.append(
            "no structure encloses the others: what is not labeled is air; add a segmentation of "
            "the body or skin"
        )
    turns = _turns(bony, remarks)
    remarks += _stance.objections(
        {
            outer.structure.name: outer.vertices @ turns.get(outer.structure.side, np.eye(3))
            for outer in bony
        }
    )
    found = _landmarks(bony, remarks)
    return MeshedLabels(tuple(parts), volumes, found, tuple(remarks))


def _surfaces(bony: Sequence[_Outer], side: str) -> dict[str, BoneSurface]:
    """Bones of one leg."""
    return {
        outer.structure.entry.name: BoneSurface(outer.vertices, outer.triangles)
        for outer in bony
        if outer.structure.side == side
    }


def _turns(bony: Sequence[_Outer], remarks: list[str]) -> dict[str | None, FloatArray]:
    """Rotations (3, 3) about the vertical of legs that stand turned, from world's front.

    A leg that faces backwards is none: its front and back are exchanged.
    """
    found: dict[str | None, FloatArray] = {}
    for side in ("l", "r"):
        angle = landmarks.turned(_surfaces(bony, side))
        if _TURNED_DEG[0] < abs(np.degrees(angle)) < _TURNED_DEG[1]:
            found[side] = transforms.axis_rotation((0, 1, 0), angle)
            remarks.append(
                f"femur_{side}: the leg stands turned about its length: its patella lies "
                f"{abs(np.degrees(angle)):.0f} degrees to the {'left' if angle > 0 else 'right'} "
                "of the image's front; a run turns it; if it is not, check the image's directions"
            )
    return found


def _landmarks(bony: Sequence[_Outer], remarks: list[str]) -> dict[str, dict[str, FloatArray]]:
    """Landmarks of each leg that has a femur."""
    found = {}
    for side in ("l", "r"):
        bones = _surfaces(bony, side)
        if not bones:
            continue
        try:
            marks = landmarks.find(bones, side)
            leans = landmarks.of_other_side(bones, marks, side)
        except LegsimError as error:
            remarks.append(f"no landmarks, so that this leg can only rest: {error}")
            continue
        found[side] = marks
        if "patella" not in bones:
            remarks.append(
                f"femur_{side}: no patella shows where its front is, so that it is taken to be the "
                "image's, to some 30 degrees; if the leg stood turned more, give its [landmarks]"
            )
        if leans:
            remarks.append(
                f"In doubt: femur_{side} leans as one of the other leg: check --side, the map's "
                "sides, the axes of the image (--axes) and its directions"
            )
    return found


def _outers(grid: StructureGrid, boxes: Sequence[tuple[slice, ...]]) -> list[_Outer]:
    """Meshes each structure with what it extends below; envelopes contain those within them."""
    outers: list[_Outer] = []
    within: dict[str | None, np.ndarray] = {}
    for k in reversed(range(len(grid.structures))):
        structure = grid.structures[k]
        box, mask = _solid(grid, k, boxes[k])
        placed = grid.world_from_index @ transforms.translation([s.start for s in box][::-1])
        field = _label_surfaces.smoothed(mask)
        if structure.entry.envelope:
            field = np.maximum(field, within.get(structure.side, field))
            within[structure.side] = field
        surface = _label_surfaces.of_smoothed(field, placed)
        labeled = int((grid.codes[boxes[k]] == k + 1).sum())
        outers.append(_Outer(structure, mask, placed, *surface, labeled))
    return outers[::-1]


def _solid(
    grid: StructureGrid, k: int, around: tuple[slice, ...]
) -> tuple[tuple[slice, ...], np.ndarray]:
    """Mask of structure ``k`` and of what it extends below, and its box in the grid.

    The box of an envelope is the whole grid, that of others ``around`` its labels and a margin.
    """
    structure = grid.structures[k]
    below = np.zeros(len(grid.structures) + 1, bool)
    soft = not structure.entry.bodies
    for n, other in enumerate(grid.structures[k + 1 :], k + 2):
        same_leg = structure.side is None or other.side in (None, structure.side)
        below[n] = same_leg and (soft or other.segment == structure.segment)
    if structure.entry.envelope:
        box = tuple(slice(0, n) for n in grid.codes.shape)
        own, covered = grid.codes == k + 1, below[grid.codes]
        covered &= grid.side_mask(structure.side, box)
        return box, np.asarray(ndimage.binary_fill_holes(own | covered))
    steps = _steps(grid.world_from_index)
    margin = int(np.ceil(_UNDERLAP / steps.min())) + 2
    box = tuple(slice(max(s.start - margin, 0), s.stop + margin) for s in around)
    mask, covered = grid.codes[box] == k + 1, below[grid.codes[box]]
    if covered.any():
        near = ndimage.distance_transform_edt(~mask, sampling=steps) <= _UNDERLAP
        mask = mask | (covered & near)
    if structure.entry.tissue == label_maps.BONE:
        mask = np.asarray(ndimage.binary_fill_holes(mask))
    return box, mask


def _bone(
    grid: StructureGrid, outer: _Outer, cortex: float, remarks: list[str]
) -> tuple[MeshedPart, ...]:
    """A bone's cortex and, inside it, its cancellous bone."""
    name, base = outer.structure.name, outer.structure.entry.name
    ending = name.removeprefix(base)
    if cortex == 0:
        return (outer.part(f"{base}_cancellous{ending}", "cancellous_bone"),)
    whole = outer.part(f"{base}_cortex{ending}", "cortical_bone")
    steps = _steps(outer.world_from_index)
    field = _label_surfaces.rough_distance(outer.mask, steps) - cortex
    near = np.abs(field) <= _BAND * steps.max()
    field[near] = outer.distance(near, _surface(grid, outer)) - cortex
    if field.max() <= 0:
        remarks.append(f"{name}: nowhere thicker than twice the cortex; it is cortical throughout")
        return (whole,)
    vertices, triangles = _level(field, outer.world_from_index)
    inner = MeshedPart(
        f"{base}_cancellous{ending}",
        "cancellous_bone",
        outer.structure.segment,
        vertices,
        triangles,
    )
    return whole, inner


def _steps(world_from_index: FloatArray) -> FloatArray:
    """(3,) m between voxels along k, j, i."""
    return np.linalg.norm(world_from_index[:3, :3], axis=0)[::-1]


def _surface(grid: StructureGrid, outer: _Outer) -> KDTree:
    """Points of a bone's surface at most about half a voxel apart: vertices and middles of
    triangles.

    Without those where the image cuts the bone: there is neither cortex nor cartilage.
    """
    points = np.concatenate([outer.vertices, outer.vertices[outer.triangles].mean(axis=1)])
    indices = transforms.apply(np.linalg.inv(grid.world_from_index), points)
    last = np.array(grid.codes.shape[::-1]) - 1
    return KDTree(points[((indices > -0.2) & (indices < last + 0.2)).all(axis=1)])


def _cartilages(
    grid: StructureGrid, bony: list[_Outer], thickness: float, remarks: list[str]
) -> list[MeshedPart]:
    """Cartilage on the faces of each joint whose bones have none that is labeled."""
    parts = []
    for side in ("l", "r"):
        named = {o.structure.entry.name: o for o in bony if o.structure.side == side}
        labeled = {
            s.entry.segment
            for s in grid.structures
            if s.entry.tissue == "cartilage" and s.side == side
        }
        for pair in _JOINTS:
            if not set(pair) <= named.keys():
                continue
            for bone, other in (pair, pair[::-1]):
                if named[bone].structure.entry.segment in labeled:
                    remarks.append(f"{bone}_{side}: its cartilage is labeled; none was added")
                    continue
                made = _cartilage(grid, named[bone], named[other], thickness)
                if made is None:
                    remarks.append(f"{bone}_{side} does not face {other}_{side}: no cartilage")
                    continue
                name = f"{bone}_cartilage_{other}_{side}"
                segment = named[bone].structure.segment
                parts.append(MeshedPart(name, "cartilage", segment, *made))
    return parts


def _cartilage(
    grid: StructureGrid, bone: _Outer, other: _Outer, thickness: float
) -> tuple[FloatArray, np.ndarray] | None:
    """Layer of ``bone`` where it faces ``other``, up to the middle between them."""
    reach = 2 * thickness + _JOINT_SPACE
    box = _both(grid, bone, other, reach + 2 * _UNDERLAP)
    if box is None:
        return None
    placed = grid.world_from_index @ transforms.translation([s.start for s in box][::-1])
    steps = _steps(grid.world_from_index)
    masks = [
        grid.codes[box] == grid.structures.index(outer.structure) + 1 for outer in (bone, other)
    ]
    near, far = (-_label_surfaces.rough_distance(mask, steps) for mask in masks)
    field = _facing(near, far, thickness, reach)
    close = np.abs(field) <= _BAND * steps.max()
    exact = [
        -_label_surfaces.exact_distance(mask, close, _surface(grid, outer), placed)
        for mask, outer in zip(masks, (bone, other), strict=True)
    ]
    field[close] = _facing(exact[0], exact[1], thickness, reach)
    if field.max() <= 0:
        return None
    return _level(field, placed)


def _level(field: FloatArray, world_from_index: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Closed surface where a field of distances (k, j, i) in m is 0."""
    most = _BAND * _steps(world_from_index).max()
    return _label_surfaces.of_field(np.clip(field, -most, most), world_from_index)


def _facing(near: FloatArray, far: FloatArray, thickness: float, reach: float) -> FloatArray:
    """Above 0 in the layer of one bone that faces another, by the distances (m) from both."""
    layer = np.minimum(thickness - near, near + _UNDERLAP)
    return np.minimum(layer, np.minimum(far - near, reach - near - far) / 2)


def _both(
    grid: StructureGrid, bone: _Outer, other: _Outer, margin: float
) -> tuple[slice, ...] | None:
    """Box of the grid within ``margin`` m of two bones; None where there is none."""
    index_from_world = np.linalg.inv(grid.world_from_index)
    low, high = np.zeros(3, int), np.array(grid.codes.shape)[::-1]
    around = margin / _steps(grid.world_from_index)[::-1]
    for outer in (bone, other):
        indices = transforms.apply(index_from_world, outer.vertices)
        low = np.maximum(low, np.floor(indices.min(0) - around).astype(int))
        high = np.minimum(high, np.ceil(indices.max(0) + around).astype(int) + 1)
    if (high <= low).any():
        return None
    return tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))


def _cuts(grid: StructureGrid, boxes: Sequence[tuple[slice, ...]]) -> list[str]:
    """Names the structures that end at the image's border."""
    names = (("behind", "in front"), ("below", "above"), ("on the left", "on the right"))
    lines: dict[str, list[str]] = {}
    for structure, box in zip(grid.structures, boxes, strict=True):
        where = []
        for axis in range(3):
            direction = grid.world_from_index[:3, 2 - axis]
            world = int(np.argmax(np.abs(direction)))
            ends = (box[axis].start == 0, box[axis].stop == grid.codes.shape[axis])
            for upper, is_cut in enumerate(ends):
                if is_cut:
                    where.append(names[world][upper if direction[world] > 0 else 1 - upper])
        if where:
            lines.setdefault(" and ".join(sorted(where)), []).append(structure.name)
    return [
        f"cut by the image's border {where}: {', '.join(names)}" for where, names in lines.items()
    ]


def _volume_row(outer: _Outer) -> VolumeRow:
    voxel = abs(np.linalg.det(outer.world_from_index[:3, :3]))
    mesh = surfaces.volume(outer.vertices, outer.triangles)
    meshed = float(voxel * outer.mask.sum())
    return VolumeRow(outer.structure.name, float(voxel * outer.labeled), meshed, mesh)


def _volume_remarks(
    outers: Sequence[_Outer],
    rows: Sequence[VolumeRow],
    grid: StructureGrid,
    boxes: Sequence[tuple[slice, ...]],
) -> list[str]:
    remarks = []
    for outer, row, box in zip(outers, rows, boxes, strict=True):
        change = row.mesh / row.meshed - 1
        if abs(change) > _MOST_ALTERED:
            remarks.append(
                f"{row.name}: the mesh's volume differs by {100 * change:+.1f} % from its voxels'; "
                "it is only a few voxels thick: segment on smaller voxels"
            )
        whole = all(s.start > 0 and s.stop < n for s, n in zip(box, grid.codes.shape, strict=True))
        low, high = _PLAUSIBLE_CM3.get(outer.structure.entry.name, (0, np.inf))
        if whole and not low <= 1e6 * row.labels <= high:
            remarks.append(
                f"{row.name}: {1e6 * row.labels:.3g} cm3 is not an adult's ({low} to {high} cm3); "
                "check the map's numbers and the image's spacing"
            )
    return remarks


def save(folder: Path, meshed: MeshedLabels) -> Path:
    """Writes a mesh per part (PLY, mm) and PHANTOM.toml; returns the latter's path.

    The folder is made where it is missing. All files get their names at the end, so that a phantom
    that was there stays whole if this is interrupted.

    Raises:
        LegsimError: the folder cannot be written.
    """
    path = folder / "PHANTOM.toml"
    new = [place for place in (folder, *folder.parents) if not os.path.exists(place)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as renamed:
            listed = renamed.enter_context(files.whole(path))  # the first gets its name last
            for part in meshed.parts:
                mesh = trimesh.Trimesh(1e3 * part.vertices, part.triangles, process=False)
                partial = renamed.enter_context(files.whole(folder / f"{part.name}.ply"))
                mesh.export(str(partial), file_type="ply")
            listed.write_text("\n".join(_lines(meshed)) + "\n", "utf-8")
    except BaseException as error:
        for place in new:
            with suppress(OSError):
                place.rmdir()
        if isinstance(error, OSError):
            problem = f"cannot be written ({error.strerror or error})"
            raise file_error(folder, problem, "choose another folder") from error
        raise
    return path


def _lines(meshed: MeshedLabels) -> list[str]:
    """Lines of PHANTOM.toml."""
    lines = ["# made by `legsim phantom from-labels`; coordinates in world: x front, y up, z right"]
    lines += ['overlaps = "intended"']
    for part in meshed.parts:
        lines += ["", "[[part]]", f'name = "{part.name}"', f'file = "{part.name}.ply"']
        lines += ['unit = "mm"', f'material = "{part.material}"']
        lines += [] if part.segment is None else [f'segment = "{part.segment}"']
    for side, points in meshed.landmarks.items():
        lines += ["", f"[landmarks.{side}]"]
        lines += [
            f"{name} = [{', '.join(f'{1e3 * x:.2f}' for x in point)}]"
            for name, point in points.items()
        ]
    return lines
