"""Landmarks of a leg's bones, which register an imaged leg to the leg model.

Condyles and head are centers of spheres fitted to their surfaces; ends of a bone whose joint is
not in the image are middles of its shaft. The same finder measures the leg model's own bones, cut
alike, so that what a landmark means precisely cancels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray

NAMES = ("condyle_medial", "condyle_lateral", "hip", "thigh", "ankle", "shank")
"""condyles of the femur; its head, or else the middle of its shaft at the upper end; the middle of
the tibia's lower end, or else of its shaft at the lower end of what was imaged
"""

_HEAD_RADIUS = (0.016, 0.034)
"""m: radii of a sphere that may be a femoral head"""

_CONDYLE_RADIUS = (0.010, 0.036)
"""m: radii of a sphere that may be the back of a condyle"""

_NARROWEST = 0.045
"""m: width of condyles; a shaft is up to 35 mm wide"""

_KNEE_GAP = 0.045
"""m along the shank between a tibia's upper end and the condyles' middle; people have 25 mm"""

_LEAN_REACH, _LEAST_LEAN_REACH = 0.08, 0.04
"""m above the condyles: where the lean of a shaft is seen best, and the least"""

_LEAST_LEAN_DEG = 1.5

_HEAD_DEPTHS = (0.04, 0.06, 0.08)
"""m from the top of a femur: where its head may end"""

_NEARER = (0.006, 0.004, 0.003, 0.002, 0.002, 0.002)
"""m: greatest distance from the sphere of what the next one is fitted to"""

_LEAST_OF_HEAD = 0.7
"""share of its sphere that a head has at least; of people it was 0.8 to 0.9
"""

_WHOLE = 3.4
"""length over width of a whole femur or tibia; both are about 5"""

_PASSES = 4
"""searches for landmarks, each on the bone as the one before stood it upright"""

_TURNED_DEG = 20.0
"""by which a patella may lie beside world's front until the search begins from where it lies

In people it lies within 16 degrees of the front of their condyles. From starts 20 degrees off all
searches on 15 legs and stumps ended at the same landmarks, from 40 degrees 27 of 30.
"""

_LEAST_BESIDE = 0.015
"""m between the middles of patella and condyles, below which they show no direction"""

_LARGE = 2e-3
"""m: edges of triangles that are small beside what is fitted to them"""

_EDGE = 0.008
"""m, width of the slope of :func:`_below`"""

_SLAB = 0.015
"""m: thickness of the slices whose middles show a shaft"""


@dataclass(frozen=True, slots=True, eq=False)
class BoneSurface:
    """A bone's outer surface, upright in world."""

    vertices: FloatArray
    """(p, 3) m"""
    triangles: np.ndarray
    """(t, 3)"""

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Middles (n, 3) of the triangles, cut where they are large, and their areas (n,)."""
        a, b, c = np.moveaxis(self.divided().corners(), 1, 0)
        return (a + b + c) / 3, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def corners(self) -> FloatArray:
        """(t, 3, 3) m, of each triangle."""
        return self.vertices[self.triangles]

    def divided(self) -> "BoneSurface":
        """Same surface; triangles with an edge above :data:`_LARGE` are cut in two at their longest
        edge, repeatedly.
        """
        done, corners = [], self.corners()
        while len(corners):
            edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
            large = edges.max(axis=1) > _LARGE
            done.append(corners[~large])
            order = (edges[large].argmax(axis=1)[:, None] + np.arange(3)) % 3
            a, b, c = np.moveaxis(
                np.take_along_axis(corners[large], order[..., None], axis=1), 1, 0
            )
            middle = (a + b) / 2
            halves = ((a, middle, c), (middle, b, c))
            corners = np.concatenate([np.stack(half, 1) for half in halves])
        cut = np.concatenate(done)
        return BoneSurface(cut.reshape(-1, 3), np.arange(3 * len(cut)).reshape(-1, 3))


def read(path: Path, tables: Any) -> dict[str, dict[str, FloatArray]]:
    """Reads ``[landmarks.l]`` and ``[landmarks.r]`` of a PHANTOM.toml, mm, to m.

    Raises:
        LegsimError: an unknown side or name, or no point.
    """
    found: dict[str, dict[str, FloatArray]] = {}
    if not isinstance(tables, dict):
        raise file_error(path, "landmarks is no table", "write [landmarks.l] or [landmarks.r]")
    for side, points in tables.items():
        if side not in ("l", "r") or not isinstance(points, dict):
            raise file_error(path, f"unknown key landmarks.{side}", "known: landmarks.l and .r")
        found[side] = {}
        for name, point in points.items():
            place = f"landmarks.{side}"
            if name not in NAMES:
                known = f"known: {', '.join(NAMES)}"
                raise file_error(path, f"unknown landmark {name!r}", known, place=place)
            numbers = isinstance(point, list) and len(point) == 3
            if not numbers or not all(type(x) in (int, float) and np.isfinite(x) for x in point):
                problem = f"{name} = {point!r}"
                raise file_error(path, problem, "give x, y, z in mm, world", place=place)
            found[side][name] = 1e-3 * np.array(point, float)
    return found


def find(
    bones: Mapping[str, BoneSurface],
    side: str,
    *,
    thigh_reach: float | None = None,
    shank_reach: float | None = None,
) -> dict[str, FloatArray]:
    """Finds landmarks (3,) m of one leg on its ``femur`` and ``tibia``.

    A ``patella`` shows where its front is. Without one that is world's, to some 30 degrees.

    Args:
        bones: surfaces by name; without a tibia its landmarks are left out.
        side: "l" or "r".
        thigh_reach: height (m) above the knee at which to take the femur's shaft instead of its
            head; None: the head where it is there.
        shank_reach: depth (m) below the knee at which to take the tibia's shaft instead of its end.

    Raises:
        LegsimError: no femur, one without condyles, or a tibia that does not reach up to them.
    """
    if "femur" not in bones:
        raise LegsimError(f"no femur of side {side}: the leg cannot be placed on the leg model")
    points, areas = bones["femur"].samples()
    off = turned(bones)
    start = off if abs(off) > np.radians(_TURNED_DEG) else 0.0
    thigh, upright = dict[str, FloatArray](), transforms.rigid(_about_vertical(start), (0, 0, 0))
    for _ in range(_PASSES):
        stood = transforms.apply(transforms.inverse(upright), points)
        thigh = _carried(upright, _of_femur(stood, areas, side, thigh_reach))
        upright = femur_frame(thigh, side)
    if "tibia" not in bones:
        return thigh
    points, areas = bones["tibia"].samples()
    shank = dict[str, FloatArray]()
    for _ in range(_PASSES):
        stood = transforms.apply(transforms.inverse(upright), points)
        shank = _carried(upright, _of_tibia(stood, areas, shank_reach))
        (low,) = shank.values()
        upright = _frame(middle_of_knee(thigh) - low, thigh, side)
    top = float(transforms.apply(transforms.inverse(upright), points)[:, 1].max())
    if abs(top) > _KNEE_GAP:
        raise LegsimError(
            f"tibia_{side}: its upper end is {1e3 * abs(top):.0f} mm from the condyles' middle: "
            "the bones form no knee, or are upside down; check the map, the axes of the image "
            "(--axes) and its directions"
        )
    return thigh | shank


def turned(bones: Mapping[str, BoneSurface]) -> float:
    """Angle (rad) about world's vertical by which a leg's patella lies off world's front.

    0 without a femur or a patella, or where they lie one above the other.
    """
    if not {"femur", "patella"} <= bones.keys():
        return 0.0
    femur = bones["femur"].vertices
    low = femur[femur[:, 1] < femur[:, 1].min() + 0.06]
    ahead = bones["patella"].vertices.mean(axis=0) - (low.max(axis=0) + low.min(axis=0)) / 2
    if np.hypot(ahead[0], ahead[2]) < _LEAST_BESIDE:
        return 0.0
    return float(np.arctan2(-ahead[2], ahead[0]))


def _about_vertical(angle: float) -> FloatArray:
    return transforms.axis_rotation((0, 1, 0), angle)


def of_other_side(
    bones: Mapping[str, BoneSurface], points: Mapping[str, FloatArray], side: str
) -> bool:
    """Whether a femur with these landmarks leans as one of the other leg.

    Shafts lean outward from the condyles upward, in people by 2 to 10 degrees. Short stumps say
    nothing, and heads say themselves what is medial.
    """
    if "hip" in points or "thigh" not in points:
        return False
    reach = min(_LEAN_REACH, float(np.linalg.norm(points["thigh"] - middle_of_knee(points))))
    if reach < _LEAST_LEAN_REACH:
        return False
    found = find(
        {name: bone for name, bone in bones.items() if name != "tibia"}, side, thigh_reach=reach
    )
    outward = found["condyle_lateral"] - found["condyle_medial"]
    up = found["thigh"] - middle_of_knee(found)
    lean = np.arcsin(outward @ up / np.linalg.norm(outward) / np.linalg.norm(up))
    return bool(np.degrees(lean) < -_LEAST_LEAN_DEG)


def middle_of_knee(points: Mapping[str, FloatArray]) -> FloatArray:
    """Middle (3,) m between the condyles."""
    return (points["condyle_medial"] + points["condyle_lateral"]) / 2


def femur_frame(points: Mapping[str, FloatArray], side: str) -> FloatArray:
    """World from a frame (4, 4) at the knee: y up the thigh, z along the condyles to the right."""
    top = points["hip"] if "hip" in points else points["thigh"]
    return _frame(top - middle_of_knee(points), points, side)


def _frame(up: FloatArray, points: Mapping[str, FloatArray], side: str) -> FloatArray:
    """World from a frame (4, 4) at the knee with y along ``up`` and z near the condyles' axis."""
    across = (points["condyle_lateral"] - points["condyle_medial"]) * (1 if side == "r" else -1)
    y = up / np.linalg.norm(up)
    z = across - (across @ y) * y
    z /= np.linalg.norm(z)
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), middle_of_knee(points))


def _carried(to_world: FloatArray, points: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: transforms.apply(to_world, point[None])[0] for name, point in points.items()}


def _of_femur(
    points: FloatArray, areas: FloatArray, side: str, reach: float | None
) -> dict[str, FloatArray]:
    """Landmarks of an upright femur; ``reach`` as ``thigh_reach`` of :func:`find`."""
    found = _condyles(points, areas, side)
    head = None if reach is not None else _head(points, areas, side)
    if head is not None:
        return found | {"hip": head}
    knee = middle_of_knee(found)
    top = points[:, 1].max() - _SLAB if reach is None else knee[1] + reach
    return found | {"thigh": _middle(points, areas, top)}


def _of_tibia(points: FloatArray, areas: FloatArray, reach: float | None) -> dict[str, FloatArray]:
    """Lower landmark of an upright tibia, whose knee is at the origin."""
    bottom, top = points[:, 1].min(), points[:, 1].max()
    if reach is not None:
        return {"shank": _middle(points, areas, -reach)}
    if top - bottom > _WHOLE * np.ptp(points[:, 2]):
        return {"ankle": _middle(points, areas, bottom + 1.5 * _SLAB)}
    return {"shank": _middle(points, areas, bottom + _SLAB)}


def _condyles(points: FloatArray, areas: FloatArray, side: str) -> dict[str, FloatArray]:
    """Centers of spheres fitted to the backs of both condyles."""
    bottom = points[:, 1].min()
    distal = points[:, 1] < bottom + 0.06
    width = float(np.ptp(points[distal, 2]))
    if width < _NARROWEST:
        raise LegsimError(
            f"femur_{side}: no condyles at its lower end, which is {1e3 * width:.0f} mm wide; "
            "image the knee too, or give the landmarks in PHANTOM.toml"
        )
    low = points[:, 1] < bottom + 0.75 * width
    middle = (points[low].max(0) + points[low].min(0)) / 2
    back = _below(points[:, 1], bottom + 0.6 * width) * _below(points[:, 0], middle[0])
    found = {}
    for name, outward in (("condyle_medial", -1.0), ("condyle_lateral", 1.0)):
        away = (points[:, 2] - middle[2]) * outward * (1 if side == "r" else -1)
        share = back * _below(0.18 * width, away) * _below(away, 0.40 * width)
        chosen = share > 0
        if chosen.sum() < 10:
            raise LegsimError(f"femur_{side}: too few triangles at its condyles")
        center, radius, _ = _sphere(points[chosen], (share * areas)[chosen])
        if not _CONDYLE_RADIUS[0] <= radius <= _CONDYLE_RADIUS[1]:
            raise LegsimError(
                f"femur_{side}: no condyle was found at its lower end (a sphere of "
                f"{1e3 * radius:.0f} mm fits there); give its landmarks in PHANTOM.toml"
            )
        found[name] = center
    return found


def _head(points: FloatArray, areas: FloatArray, side: str) -> FloatArray | None:
    """Center of the femoral head; None where there is none.

    The sphere that shares the most of its surface with the bone's upper end, of those that start
    from the most medial places of its uppermost centimeters.
    """
    height = float(np.ptp(points[:, 1]))
    bottom = points[:, 1].min()
    width = float(np.ptp(points[points[:, 1] < bottom + 0.06, 2]))
    if height < _WHOLE * width:
        return None
    end = points[:, 1] > bottom + height - max(_HEAD_DEPTHS)
    points, areas = points[end], areas[end]
    medial = points[:, 2] * (-1 if side == "r" else 1)
    most, found = _LEAST_OF_HEAD, None
    for depth in _HEAD_DEPTHS:
        top = points[:, 1] > bottom + height - depth
        chosen = top & (medial > medial[top].max() - 0.025)
        center, radius, share = _grown(points, areas, chosen)
        if share > most and _HEAD_RADIUS[0] <= radius <= _HEAD_RADIUS[1]:
            most, found = share, center
    return found


def _grown(
    points: FloatArray, areas: FloatArray, chosen: np.ndarray
) -> tuple[FloatArray, float, float]:
    """(center, radius, share of its surface) of the sphere that the chosen points grow to."""
    center, radius = np.zeros(3), 0.0
    for reach in _NEARER:
        if chosen.sum() < 10:
            return center, radius, 0.0
        center, radius, _ = _sphere(points[chosen], areas[chosen])
        chosen = np.abs(np.linalg.norm(points - center, axis=1) - radius) < reach
    return center, radius, float(areas[chosen].sum() / (4 * np.pi * radius**2))


def _below(values: FloatArray | float, limit: FloatArray | float) -> FloatArray:
    """1 below a limit, 0 above, and a slope across :data:`_EDGE` between them.

    Without the slope landmarks would jump with the triangles at the edges of what is fitted.
    """
    return np.clip(0.5 - (values - limit) / _EDGE, 0, 1)


def _sphere(points: FloatArray, areas: FloatArray) -> tuple[FloatArray, float, float]:
    """(center, radius, RMS distance) of a sphere, by linear least squares.

    Nothing is rejected as an outlier: the same surface gives the same sphere whatever its triangles
    are.
    """
    weight = np.sqrt(areas)
    matrix = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1) * weight[:, None]
    solution = np.linalg.lstsq(matrix, weight * (points**2).sum(1), rcond=None)[0]
    center = solution[:3]
    radius = float(np.sqrt(max(solution[3] + center @ center, 0.0)))
    off = np.linalg.norm(points - center, axis=1) - radius
    return center, radius, float(np.sqrt(np.average(off**2, weights=areas)))


def _middle(points: FloatArray, areas: FloatArray, height: float) -> FloatArray:
    """Middle of a slice of a bone at a height, m."""
    near = np.abs(points[:, 1] - height) < 0.5 * _SLAB
    if not near.any():
        raise LegsimError(f"a bone has no surface at height {1e3 * height:.0f} mm")
    return np.average(points[near], axis=0, weights=areas[near])
