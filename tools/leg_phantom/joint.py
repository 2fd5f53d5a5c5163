"""Right leg's bones in layers, cartilages and menisci, as values on a grid whose surface is where
they are 0 (m, segment frames).
"""

from collections.abc import Callable

import numpy as np

from legsim.phantom.skinning import smooth_step
from tools.leg_phantom.bones import (
    PLATEAU,
    calcaneus,
    femur,
    femur_cartilage_thickness,
    femur_uncut,
    fibula,
    midfoot,
    patella,
    patella_articular,
    patella_bone,
    plateau_outline,
    talus,
    tibia_bone,
)
from tools.leg_phantom.fields import Array, Field, normalized, smooth_intersection
from tools.leg_phantom.motion import femur_from_tibia

JOINT_GAP = 0.0002
"""m that stay free between the femoral cartilage and all that the tibia carries, over the whole
range of flexion
"""
CRUST = 0.0020
"""m that a cartilage reaches into its bone, which displaces it there: no two surfaces coincide"""

Grid = tuple[Array, Array, Array]


def sparse(axes: Grid) -> Grid:
    """The axes as arrays that broadcast against each other."""
    return axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]


def cleared_of_femur(x: Array, y: Array, z: Array, *, last_degrees: float = 110.0) -> Array:
    """Least distance to the femur, its groove filled, over 0 to ``last_degrees`` of flexion, in the
    tibia frame.
    """
    nearest = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), np.inf)
    for matrix in femur_from_tibia(np.radians(np.arange(0.0, last_degrees + 1, 5.0))):
        fx = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 3]
        fy = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 3]
        np.minimum(nearest, femur_uncut(fx, fy, z), out=nearest)
    return nearest


def cortex_thickness(y: Array, places: list[tuple[float, float]]) -> Array:
    """m of compact bone along a long bone, smooth between the given (y, thickness)."""
    order = sorted(places)
    knots, values = [p[0] for p in order], [p[1] for p in order]
    k = np.clip(np.searchsorted(knots, y, side="right") - 1, 0, len(knots) - 2)
    start, end = np.asarray(knots)[k], np.asarray(knots)[k + 1]
    t = smooth_step((np.asarray(y) - start) / (end - start))
    return np.asarray(values)[k] * (1 - t) + np.asarray(values)[k + 1] * t


def cavity(inner: Array, y: Array, low: float, high: float) -> Array:
    """Marrow cavity of a shaft between two heights: 0.8 mm of trabeculae stay on its wall, its ends
    are round.
    """
    return smooth_intersection(inner + 0.0008, np.maximum(low - y, y - high) + 0 * inner, 0.006)


def femur_cartilage(axes: Grid) -> dict[str, Array]:
    """Cartilage of condyles and trochlea, one sheet; it ends where it is thinner than half a
    millimeter.
    """
    x, y, z = sparse(axes)
    total, thickness = normalized(femur(x, y, z), axes), femur_cartilage_thickness(x, y, z)
    bone = total + np.maximum(thickness, 0)
    return {"femur_cartilage": np.maximum(np.maximum(total, -(bone + CRUST)), 0.0005 - thickness)}


def femur_layers(axes: Grid) -> dict[str, Array]:
    """Femur: cortex, cancellous bone, marrow cavity."""
    x, y, z = sparse(axes)
    total = normalized(femur(x, y, z), axes)
    bone = normalized(total + np.maximum(femur_cartilage_thickness(x, y, z), 0), axes)
    wall = cortex_thickness(
        y,
        [
            (-0.45, 0.0011),
            (-0.36, 0.0012),
            (-0.31, 0.003),
            (-0.24, 0.0062),
            (-0.13, 0.0066),
            (-0.07, 0.0042),
            (-0.03, 0.0018),
        ],
    )
    inner = bone + wall
    return {
        "femur_cortex": bone,
        "femur_cancellous": inner,
        "femur_marrow": cavity(inner, y, -0.315, -0.065),
    }


def tibia_layers(axes: Grid) -> dict[str, Array]:
    """Tibia: cortex, cancellous bone, marrow cavity; cleared of the femur's path by the thickness
    of the cartilages.
    """
    x, y, z = sparse(axes)
    bone = tibia_bone(x, y, z)
    top = axes[1] > -0.06
    bone[:, top] = smooth_intersection(
        bone[:, top], 0.0022 - cleared_of_femur(x, y[:, top], z), 0.001
    )
    bone = normalized(bone, axes)
    wall = cortex_thickness(
        y,
        [
            (-0.44, 0.0012),
            (-0.40, 0.0014),
            (-0.34, 0.0032),
            (-0.26, 0.0048),
            (-0.16, 0.0050),
            (-0.09, 0.0030),
            (-0.05, 0.0012),
        ],
    )
    inner = bone + wall
    return {
        "tibia_cortex": bone,
        "tibia_cancellous": inner,
        "tibia_marrow": cavity(inner, y, -0.355, -0.105),
    }


def fibula_layers(axes: Grid) -> dict[str, Array]:
    """Fibula: cortex and cancellous inside, in the tibia frame."""
    x, y, z = sparse(axes)
    bone = normalized(fibula(x, y, z), axes)
    wall = cortex_thickness(
        y, [(-0.44, 0.0011), (-0.40, 0.0016), (-0.34, 0.0024), (-0.10, 0.0024), (-0.055, 0.0010)]
    )
    return {"fibula_cortex": bone, "fibula_cancellous": bone + wall}


def patella_layers(axes: Grid) -> dict[str, Array]:
    """Patella: cartilage, cortex, cancellous inside."""
    x, y, z = sparse(axes)
    total, bone = normalized(patella(x, y, z), axes), normalized(patella_bone(x, y, z), axes)
    articular = 0.0030 * patella_articular(y, z) - 0.0005 + 0 * total
    cartilage = np.maximum(np.maximum(total, -(bone + CRUST)), np.maximum(-articular, x - 0.003))
    return {
        "patella_cartilage": cartilage,
        "patella_cortex": bone,
        "patella_cancellous": bone + 0.0013,
    }


def tibia_cartilages(axes: Grid) -> dict[str, Array]:
    """Medial and lateral cartilage of the plateau, to y = PLATEAU, 2.5 mm thick."""
    x, y, z = sparse(axes)
    clear = JOINT_GAP - cleared_of_femur(x, y, z)
    rim = plateau_outline()(x, z) + 0.0015
    layer = np.maximum(np.abs(y - (PLATEAU - 0.0020)) - 0.0020, clear)
    sides = {"medial": z + 0.0085, "lateral": -z + 0.0085}
    return {
        f"tibia_cartilage_{side}": np.maximum(
            smooth_intersection(rim + 0 * y, inward + 0 * rim, 0.004), layer
        )
        for side, inward in sides.items()
    }


def menisci(axes: Grid) -> dict[str, Array]:
    """Wedges on the rim of the plateau that fill what the straight leg's condyles leave free:
    C-shaped medially, more a ring laterally.

    They do not deform: where a flexed condyle presses into them, it displaces them, being later in
    the list of parts.
    """
    x, y, z = sparse(axes)
    clear = 0.0003 - cleared_of_femur(x, y, z, last_degrees=5.0)
    height = np.maximum(PLATEAU - 0.0008 - y, y - (PLATEAU + 0.0068))
    rings = {
        "medial": ((-0.0045, -0.0205), (0.0240, 0.0165), 0.0105, z + 0.0075),
        "lateral": ((-0.0045, 0.0195), (0.0205, 0.0160), 0.0105, -z + 0.0055),
    }
    values = {}
    for side, ((cx, cz), (rx, rz), width, opening) in rings.items():
        outer = (np.sqrt(((x - cx) / rx) ** 2 + ((z - cz) / rz) ** 2) - 1) * min(rx, rz) + 0 * y
        ring = np.maximum(outer, -(outer + width))
        values[f"meniscus_{side}"] = smooth_intersection(
            np.maximum(ring, opening), np.maximum(height, clear), 0.0008
        )
    return values


def short_bone(name: str, bone: Field, wall: float) -> Callable[[Grid], dict[str, Array]]:
    """Layers of a bone of the foot: a thin cortex around cancellous bone."""

    def layers(axes: Grid) -> dict[str, Array]:
        values = normalized(bone(*sparse(axes)), axes)
        return {f"{name}_cortex": values, f"{name}_cancellous": values + wall}

    return layers


FOOT = {
    "talus": short_bone("talus", talus, 0.0012),
    "calcaneus": short_bone("calcaneus", calcaneus, 0.0012),
    "midfoot": short_bone("midfoot", midfoot, 0.0015),
}
"""Layers of the bones of the foot by name"""
