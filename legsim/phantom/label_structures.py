"""Segmentations and their maps as one grid of structures, each of one side, without islands."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry.label_images import LabelImage
from legsim.phantom.label_maps import LabelEntry, LabelMap, known, own_names

_ISLAND = 0.01
"""of a structure's largest piece: pieces smaller than that are removed"""

_LARGEST_ISLAND_CM3 = 1.0
"""larger pieces stay: they are no noise"""

_LEAST_SHARE = 0.15
"""of the voxels on either side of a gap between two legs"""

_SIDE_NAMES = {"l": "left", "r": "right"}


@dataclass(frozen=True, slots=True)
class Structure:
    """A structure of one side; its place in a list + 1 is its code in the grid."""

    entry: LabelEntry
    side: str | None

    @property
    def name(self) -> str:
        """Name with its side."""
        return self.entry.name if self.side is None else f"{self.entry.name}_{self.side}"

    @property
    def segment(self) -> str | None:
        """What carries it, as PHANTOM.toml has it."""
        if self.entry.segment is None or not self.entry.paired:
            return self.entry.segment
        return f"{self.entry.segment}_{self.side}"


@dataclass(frozen=True, slots=True, eq=False)
class StructureGrid:
    """Structures in order of priority, outermost first, and where they are."""

    codes: np.ndarray
    """(k, j, i) uint16: index of the structure + 1, 0 outside all"""
    structures: tuple[Structure, ...]
    world_from_index: FloatArray
    right_of: float | None
    """m: world z of the plane between both legs; None where there is one leg"""
    remarks: tuple[str, ...]

    def side_mask(self, side: str | None, box: tuple[slice, ...]) -> np.ndarray | bool:
        """Voxels of ``box`` on one side of the plane between the legs."""
        if self.right_of is None or side is None:
            return True
        right = world_z(self.codes.shape, self.world_from_index)[box] > self.right_of
        return right if side == "r" else ~right


def structure_grid(
    images: Sequence[LabelImage],
    maps: Sequence[LabelMap],
    *,
    side: str | None,
    ignore: Collection[int] = (),
) -> StructureGrid:
    """Joins segmentations of one grid; later ones displace earlier ones.

    Args:
        images: on the same voxels.
        maps: one per image.
        side: "l" or "r" of a single leg; None where both are there or the map says it.
        ignore: numbers that are left out although no map knows them.

    Raises:
        LegsimError: grids differ, unknown numbers, no structure, or sides that cannot be told.
    """
    if len(images) != len(maps):
        raise LegsimError(
            f"{len(images)} segmentations and {len(maps)} maps; give each segmentation its --map"
        )
    for image in images[1:]:
        if not image.on_grid_of(images[0]):
            problem = f"lies on another grid than {images[0].path}"
            raise file_error(image.path, problem, "resample it, nearest neighbor, to that grid")
    codes, entries = np.zeros(images[0].labels.shape, np.uint16), list[LabelEntry]()
    remarks = [remark for image in images for remark in image.remarks]
    for image, read in zip(images, maps, strict=True):
        remarks += [*read.remarks, *_contradictions(image, read)]
        _enter(codes, entries, image, read, ignore, remarks)
    if not entries:
        mapped = ", ".join(f"{e.number} {e.name}" for read in maps for e in read.entries)
        raise file_error(images[0].path, "holds no structure of its map", f"the map has {mapped}")
    world_from_index = images[0].world_from_index
    codes, structures, plane = _sided(images[0], codes, entries, world_from_index, side)
    _without_islands(codes, structures, world_from_index, remarks)
    return StructureGrid(codes, structures, world_from_index, plane, tuple(remarks))


def _enter(
    codes: np.ndarray,
    entries: list[LabelEntry],
    image: LabelImage,
    read: LabelMap,
    ignore: Collection[int],
    remarks: list[str],
) -> None:
    mapped = {entry.number: entry for entry in read.entries}
    there = image.numbers
    unknown = [n for n in there if n not in mapped and n not in read.left_out and n not in ignore]
    named_here = {n: " or ".join(called) for n, called in image.names.items()} | read.foreign
    if unknown:
        named = (f"{n} {named_here.get(n, '')}".strip() for n in unknown[:20])
        listed = ", ".join(f"{n} ({image.counts[int(n.split()[0])]} voxels)" for n in named)
        by_names = read.foreign or read.path == image.path
        cure = "give their tissues in a .toml" if by_names else "name them there"
        raise file_error(
            image.path,
            f"{read.path.name} does not know the numbers {listed}",
            f"{cure}, or leave them out: --ignore {','.join(map(str, unknown))}",
        )
    table = np.zeros(len(image.counts), np.uint16)
    for n in there:
        if n in mapped and n not in ignore:
            entries.append(mapped[n])
            table[n] = len(entries)
    found = table[image.labels]
    codes[found > 0] = found[found > 0]
    called = named_here | {n: entry.name for n, entry in mapped.items()} | read.left_out
    left = [f"{called.get(n, 'unnamed')} ({n})" for n in there if table[n] == 0]
    if left:
        remarks.append(f"{image.path}: left out: {', '.join(left)}")


def _contradictions(image: LabelImage, read: LabelMap) -> list[str]:
    """A line on numbers that the file itself names otherwise than its map."""
    named, where = own_names(image)
    mapped = {entry.number: entry for entry in read.entries}
    called = read.left_out | {
        n: f"{e.name} {_SIDE_NAMES.get(e.side or '', '')}".strip() for n, e in mapped.items()
    }
    other = [
        f"{n} is {named[n]} there, {called[n]} in the map"
        for n in image.numbers
        if n in named and n in called and known().differ(named[n], called[n], mapped.get(n))
    ]
    if not other:
        return []
    more = f" and {len(other) - 5} more" if len(other) > 5 else ""
    return [
        f"In doubt: {image.path}: by the names {where} numbers are others than by "
        f"{read.path.name}: "
        f"{'; '.join(other[:5])}{more}; the map is followed: leave it out to follow the file"
    ]


def world_z(shape: tuple[int, ...], world_from_index: FloatArray) -> FloatArray:
    """World z (k, j, i) of the voxel centers, m."""
    nk, nj, ni = shape
    a, b, c, first = world_from_index[2]
    return (
        first
        + c * np.arange(nk)[:, None, None]
        + b * np.arange(nj)[None, :, None]
        + a * np.arange(ni)
    ).astype(np.float32)


def _sided(
    image: LabelImage,
    codes: np.ndarray,
    entries: list[LabelEntry],
    world_from_index: FloatArray,
    side: str | None,
) -> tuple[np.ndarray, tuple[Structure, ...], float | None]:
    """Gives what each leg has a side, and orders the structures, outermost first."""
    open_sides = [k for k, e in enumerate(entries, 1) if e.paired and e.side is None]
    stated = {e.side for e in entries if e.paired and e.side is not None}
    if side is not None and stated - {side}:
        problem = f"the map names structures of the {_SIDE_NAMES[(stated - {side}).pop()]} leg"
        raise file_error(image.path, problem, "leave out --side")
    plane = None
    if side is None and (len(stated) == 2 or (open_sides and not stated)):
        plane = _plane(codes, entries, world_from_index)
        if plane is None and open_sides:
            raise file_error(
                image.path,
                f"the map leaves the side of {entries[open_sides[0] - 1].name} open, and the bones "
                "show no gap between two legs",
                "say --side left or --side right, or give segments with _l and _r in the map",
            )
    one = side or (next(iter(stated)) if len(stated) == 1 else None)
    right = None if plane is None else world_z(codes.shape, world_from_index) > plane
    pieces: list[tuple[Structure, int, str | None]] = []
    for k, entry in enumerate(entries, 1):
        if not entry.paired or entry.side is not None:
            pieces.append((Structure(entry, entry.side), k, None))
        elif right is None:
            pieces.append((Structure(entry, one), k, None))
        else:
            pieces += [(Structure(entry, s), k, s) for s in "lr"]
    pieces.sort(key=lambda piece: piece[0].entry.rank)
    left_table, right_table = (np.zeros(len(entries) + 1, np.uint16) for _ in "lr")
    for place, (_, k, s) in enumerate(pieces, 1):
        if s != "r":
            left_table[k] = place
        if s != "l":
            right_table[k] = place
    sided = left_table[codes]
    if right is not None:
        sided[right] = right_table[codes[right]]
    there = np.bincount(sided.ravel(), minlength=len(pieces) + 1)[1:] > 0
    renumbered = np.concatenate([[0], np.cumsum(there)]).astype(np.uint16)
    kept = tuple(p[0] for p, is_there in zip(pieces, there, strict=True) if is_there)
    doubled = sorted({s.name for s in kept if [x.name for x in kept].count(s.name) > 1})
    if doubled:
        problem = f"two structures are named {doubled[0]!r}"
        raise file_error(image.path, problem, "give them different names in their maps")
    return renumbered[sided], kept, plane


def _plane(
    codes: np.ndarray, entries: list[LabelEntry], world_from_index: FloatArray
) -> float | None:
    """World z (m) of the plane between both legs: the middle of the widest gap of their bones; None
    where there is none, so that there may be one leg.
    """
    bones = np.zeros(len(entries) + 1, bool)
    for k, entry in enumerate(entries, 1):
        bones[k] = entry.paired and entry.rank == 3
    k, j, i = np.nonzero(bones[codes])
    z = world_from_index[2] @ np.stack([i, j, k, np.ones_like(i)])
    steps = np.linalg.norm(world_from_index[:3, :3], axis=0)
    if len(z):
        values = np.sort(z)
        edges = np.flatnonzero(np.diff(values) > 2 * steps.max())
        shares = (edges + 1) / len(values)
        edges = edges[(shares > _LEAST_SHARE) & (shares < 1 - _LEAST_SHARE)]
        if len(edges):
            widest = edges[np.argmax(values[edges + 1] - values[edges])]
            return float((values[widest] + values[widest + 1]) / 2)
    return None


def _without_islands(
    codes: np.ndarray,
    structures: tuple[Structure, ...],
    world_from_index: FloatArray,
    remarks: list[str],
) -> None:
    """Removes pieces far smaller than a structure's largest: their voxels join what is nearest."""
    cm3 = 1e6 * abs(np.linalg.det(world_from_index[:3, :3]))
    boxes = ndimage.find_objects(codes)
    removed = np.zeros(codes.shape, bool)
    for k, structure in enumerate(structures, 1):
        box = boxes[k - 1]
        pieces, count = ndimage.label(codes[box] == k, np.ones((3, 3, 3)))
        if count < 2:
            continue
        sizes = np.bincount(np.ravel(pieces))
        sizes[0] = 0
        small = (sizes < min(_ISLAND * sizes.max(), _LARGEST_ISLAND_CM3 / cm3)) & (sizes > 0)
        if small.any():
            removed[box] |= small[pieces]
            remarks.append(
                f"{structure.name}: {int(small.sum())} islands of together "
                f"{cm3 * sizes[small].sum():.3g} cm3 were removed"
            )
    if removed.any():
        # the box of all that is removed and one voxel around it, in which the nearest others are
        around = tuple(
            slice(max(s.start - 1, 0), s.stop + 1)
            for s in ndimage.find_objects(removed.astype(np.uint8))[0]
        )
        nearest = ndimage.distance_transform_edt(
            removed[around], return_distances=False, return_indices=True
        )
        codes[around] = codes[around][tuple(np.asarray(nearest))]
