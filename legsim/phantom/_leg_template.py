"""The template of the leg phantom: its meshes at reference pose, and how they scale."""

import tomllib
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import lazy_loader
import numpy as np

from legsim.core import transforms
from legsim.core.resources import model_file
from legsim.core.values import FloatArray, frozen
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.phantom.skinning import LegAxes, smooth_step

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


Detail = Literal["coarse", "fine"]

SIDES = ("l", "r")

# gait2392 with every coordinate at zero; the patella after Rajagopal2016: positions in the parent's
# frame, right leg, m
_HIP_HALF_WIDTH = 0.0835

_FEMUR_TIBIA = np.array([-0.004499856517536013, -0.39582069644835033, 0.0])

_FEMUR_PATELLA = np.array([0.04431, -0.41876, -0.00275])

_PATELLA_MIDDLE = np.array([0.0, 0.022, 0.0])

_PATELLA_TILT = 0.00113686

_TIBIA_TALUS = np.array([0.0, -0.43, 0.0])

_TALUS_CALCN = np.array([-0.04877, -0.04195, 0.00792])


@dataclass(frozen=True, slots=True)
class Recipe:
    """One entry of parts.toml with its mesh, of the right leg."""

    name: str
    segment: str
    material: str
    vertices: FloatArray
    triangles: np.ndarray


@cache
def recipes(detail: str) -> tuple[Recipe, ...]:
    """Reads the meshes that ship with legsim, once."""
    rows = tomllib.loads(model_file("leg_phantom/parts.toml").read_text())["part"]
    with np.load(model_file(f"leg_phantom/{detail}.npz"), allow_pickle=False) as arrays:
        return tuple(
            Recipe(
                row["name"],
                row["segment"],
                row["material"],
                frozen("vertices", arrays[f"{row['name']}.vertices"], (None, 3)),
                frozen("triangles", arrays[f"{row['name']}.triangles"], (None, 3), np.int32),
            )
            for row in rows
        )


def reference_pose(scales: SegmentScales) -> FloatArray:
    """Poses world_from_segment (13, 4, 4) of the straight leg, in the order of SEGMENTS.

    Hips are at x = y = 0, the pelvis at the origin.
    """
    poses = np.broadcast_to(np.eye(4), (len(SEGMENTS), 4, 4)).copy()
    for side in SIDES:
        mirror = np.array([1, 1, 1 if side == "r" else -1])
        place = np.array([0, 0, _HIP_HALF_WIDTH]) * mirror * scales.of("pelvis")
        steps = {"femur": place}
        steps["patella"] = place + _FEMUR_PATELLA * mirror * scales.of(f"femur_{side}")
        steps["tibia"] = place + _FEMUR_TIBIA * mirror * scales.of(f"femur_{side}")
        steps["talus"] = steps["tibia"] + _TIBIA_TALUS * mirror * scales.of(f"tibia_{side}")
        steps["calcn"] = steps["talus"] + _TALUS_CALCN * mirror * scales.of(f"talus_{side}")
        steps["toes"] = steps["calcn"] + np.array([0.1788, -0.002, 0.00108]) * mirror * scales.of(
            f"calcn_{side}"
        )
        for name, position in steps.items():
            tilt = transforms.axis_rotation((0, 0, 1), _PATELLA_TILT if name == "patella" else 0.0)
            poses[SEGMENTS.index(f"{name}_{side}")] = transforms.rigid(tilt, position)
    return frozen("reference pose", poses, poses.shape)


def leg_axes(scales: SegmentScales, side: str) -> LegAxes:
    knee = _FEMUR_TIBIA * scales.of(f"femur_{side}")
    ankle = knee + _TIBIA_TALUS * scales.of(f"tibia_{side}")
    size = float(scales.of(f"femur_{side}")[1])
    mirror = np.array([1, 1, 1 if side == "r" else -1])
    patella = (_FEMUR_PATELLA * scales.of(f"femur_{side}") + _PATELLA_MIDDLE * size) * mirror
    return LegAxes(
        (knee[0], knee[1], 0.0),
        (ankle[0], ankle[1], 0.0),
        (patella[0], patella[1], patella[2]),
        size,
    )


def scaled_vertices(
    vertices: FloatArray, segment: str, scales: SegmentScales, side: str
) -> FloatArray:
    """Template vertices (p, 3) at a person's size and side.

    They are in their segment's frame (soft ones in the femur's); the template is of the right leg.
    """
    mirror = np.array([1, 1, 1 if side == "r" else -1])
    femur, tibia, calcn = (scales.of(f"{name}_{side}") for name in ("femur", "tibia", "calcn"))
    if segment == "patella":
        return vertices * np.array([femur[1], femur[1], femur[2]]) * mirror
    if segment == "femur":
        return _scaled_thigh(vertices, femur) * mirror
    if segment == "tibia":
        return _scaled_shank(vertices, femur, tibia) * mirror
    if segment in ("talus", "calcn"):
        return vertices * scales.of(f"{segment}_{side}") * mirror
    below = vertices - _FEMUR_TIBIA
    shank = _scaled_shank(below, femur, tibia) + _FEMUR_TIBIA * femur
    foot_origin = _TIBIA_TALUS + _TALUS_CALCN
    foot = (
        (below - foot_origin) * calcn
        + _TALUS_CALCN * scales.of(f"talus_{side}")
        + _TIBIA_TALUS * tibia
        + _FEMUR_TIBIA * femur
    )
    # instep and heel belong to the foot although they reach up to the ankle
    share = smooth_step((-0.38 - below[:, 1:2] + 0.45 * np.abs(below[:, :1])) / 0.06)
    share = np.where(below[:, 1:2] < -0.33, share, 0.0)
    leg = np.where(
        below[:, 1:2] > 0, _scaled_thigh(vertices, femur), shank * (1 - share) + foot * share
    )
    return leg * mirror


def _knee_depth(x: FloatArray, femur: FloatArray) -> FloatArray:
    """Scales x from the knee axis.

    In front the femur's x scales it, which carries the patella; behind its y, as the plateau turns
    there.
    """
    front = smooth_step((x + 0.012) / 0.024)
    return x * (femur[0] * front + femur[1] * (1 - front))


def _scaled_thigh(points: FloatArray, femur: FloatArray) -> FloatArray:
    x, y, z = points.T
    near = smooth_step((-0.28 - y) / 0.09)
    depth = x - _FEMUR_TIBIA[0]
    return np.stack(
        [
            _FEMUR_TIBIA[0] * femur[0]
            + near * _knee_depth(depth, femur)
            + (1 - near) * depth * femur[0],
            y * femur[1],
            z * femur[2],
        ],
        -1,
    )


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
