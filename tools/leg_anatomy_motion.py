"""How knee and patella of the unscaled leg model move: what the joint faces of the phantom are shaped by."""

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
from leg_anatomy_fields import Array

from legsim import transforms
from legsim.resources import model_file
from legsim.simm_spline import SimmSpline

PATELLA_ORIGIN = (-0.00809, -0.40796, -0.00275)
"""Patellofemoral joint in the femur frame (Rajagopal2016)"""


@cache
def _coupling(joint: str) -> tuple[SimmSpline, float]:
    rows = tomllib.loads(Path(model_file("lower_body/couplings.toml")).read_text())["coupling"]
    row = next(r for r in rows if r["joint"] == joint)
    return SimmSpline(row["x"], row["y"]), float(row["sign"])


def _coupled(joint: str, flexion: Array) -> Array:
    spline, sign = _coupling(joint)
    return spline(-sign * np.asarray(flexion))


def _planar(x: Array, y: Array, angle: Array, z: float) -> Array:
    zero = np.zeros_like(x)
    return transforms.rigid(transforms.axis_rotation((0, 0, 1), angle), np.stack([x, y, zero + z], -1))


def femur_from_tibia(flexion: Array) -> Array:
    """(n, 4, 4) of the right knee at flexion angles (n,) in rad."""
    return _planar(_coupled("knee_tx_r", flexion), _coupled("knee_ty_r", flexion), -np.asarray(flexion), 0.0)


def femur_from_patella(flexion: Array) -> Array:
    """(n, 4, 4) of the right patella at flexion angles (n,) in rad."""
    x = _coupled("patella_tx_r", flexion) + PATELLA_ORIGIN[0]
    y = _coupled("patella_ty_r", flexion) + PATELLA_ORIGIN[1]
    return _planar(x, y, _coupled("patella_angle_r", flexion), PATELLA_ORIGIN[2])


def plateau_contact(flexion: Array, plateau: float) -> Array:
    """Points (n, 2) of the femur, x and y, that a plane at y = ``plateau`` of the tibia touches at each flexion: its envelope."""

    def height(angle: Array) -> Array:
        pose = femur_from_tibia(angle)
        normal = np.stack([np.sin(angle), np.cos(angle)], -1)
        return (pose[:, :2, 3] * normal).sum(-1) + plateau

    h = 1e-4
    slope = (height(flexion + h) - height(flexion - h)) / (2 * h)
    normal, along = np.stack([np.sin(flexion), np.cos(flexion)], -1), np.stack([np.cos(flexion), -np.sin(flexion)], -1)
    return height(flexion)[:, None] * normal + slope[:, None] * along
