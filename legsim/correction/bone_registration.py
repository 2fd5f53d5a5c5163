"""Poses of bones over time that explain projections: Gauss-Newton steps over splines.

Every bone k turns and shifts by six cubic splines about its middle, before the motion M_k(i) that
it has so far. With r(i) the filtered misfit of view i and J(i) the filtered derivatives of the
bones' images, the change z of the splines' coefficients, in standard deviations of their prior, has
the least

    weight / s^2 sum_i |r(i) - J(i) B(i) z|^2 + |z_0 + z|^2

s^2 is the mean square of r, and z_0 what was found before: all of the change from the start is held
by the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigvalsh

from legsim.core import transforms
from legsim.core.values import Float32Array, FloatArray
from legsim.correction.bone_images import BoneTemplate, EdgeFilter
from legsim.correction.image_fit import SplinePath
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device

_TWIST = 6


@dataclass(frozen=True, slots=True)
class BonePriors:
    """How bones are expected to move from where they start, and how far images are trusted."""

    knots: int = 25
    """coefficients of each spline over the scan"""
    turn: float = np.radians(0.5)
    """rad, standard deviation of a coefficient"""
    shift: float = 2e-3
    """m, the same"""
    weight: float = 0.02
    """of a pixel: what a volume leaves unexplained is no white noise, and spreads over many"""

    @property
    def sizes(self) -> FloatArray:
        """(6,) standard deviations."""
        return np.array([self.turn] * 3 + [self.shift] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """What bones must explain, and how it changes as they move."""

    residual: Float32Array
    """(v, rows, columns) filtered"""
    matrices: FloatArray
    """(v, n, n) J^T J of each view, n six numbers per bone, in standard deviations"""
    slopes: FloatArray
    """(v, n) J^T r"""

    @property
    def size(self) -> float:
        """RMS of the residual."""
        return float(np.sqrt(np.mean(np.square(self.residual, dtype=float))))


def misfit(
    residual: Float32Array,
    templates: Sequence[BoneTemplate],
    motions: FloatArray,
    geometry: ConeBeamGeometry,
    edges: EdgeFilter,
    sizes: FloatArray,
    device: Device,
) -> Misfit:
    """Derivatives of a residual (v, rows, columns) by the bones that move along (k, v, 4, 4)."""
    derivatives = []
    for template, motion in zip(templates, motions, strict=True):
        for size, image in zip(sizes, template.derivatives(geometry, motion, device), strict=True):
            derivatives.append(edges(np.float32(size) * image).reshape(len(geometry), -1))
    by_bones = np.stack(derivatives, 1)
    flat = residual.reshape(len(geometry), -1, 1)
    matrices = np.matmul(by_bones, np.swapaxes(by_bones, 1, 2)).astype(float)
    return Misfit(residual, matrices, np.matmul(by_bones, flat)[..., 0].astype(float))


@dataclass(frozen=True, slots=True, eq=False)
class BonePoses:
    """Motions of bones, and what was found of them so far."""

    motions: FloatArray
    """(k, v, 4, 4)"""
    found: FloatArray
    """(knots, 6 k) coefficients in standard deviations, all steps together"""
    determined: int = 0
    """combinations of coefficients that images tell better than the prior"""
    last: float = field(default=np.inf)
    """RMS of the last step, in standard deviations"""


def stepped(
    poses: BonePoses,
    seen: Misfit,
    middles: Sequence[FloatArray],
    times: FloatArray,
    priors: BonePriors,
    every: int = 1,
) -> BonePoses:
    """Poses at all ``times`` after one step, by a misfit of every nth view.

    ``middles`` are those of the templates.
    """
    whole = SplinePath(times, np.zeros(3), priors.knots).basis()
    basis = whole[::every]
    count = seen.slopes.shape[1]
    trust = priors.weight / max(seen.size**2, np.finfo(float).tiny)
    matrix = trust * np.einsum("va,vij,vb->aibj", basis, seen.matrices, basis, optimize=True)
    matrix = matrix.reshape(poses.found.size, poses.found.size)
    right = trust * np.einsum("va,vi->ai", basis, seen.slopes).ravel() - poses.found.ravel()
    factor = cho_factor(matrix + np.eye(len(matrix)))
    change = cho_solve(factor, right).reshape(priors.knots, count)
    twists = whole @ change * np.tile(priors.sizes, len(middles))
    moved = [
        motion @ about(middle, twists[:, first : first + _TWIST])
        for motion, middle, first in zip(
            poses.motions, middles, range(0, count, _TWIST), strict=True
        )
    ]
    determined = int((eigvalsh(matrix) > 1).sum())
    last = float(np.sqrt(np.mean(change**2)))
    return BonePoses(np.stack(moved), poses.found + change, determined, last)


def about(middle: FloatArray, twists: FloatArray) -> FloatArray:
    """Rigid motions (v, 4, 4) that turn about a point by rotation vectors, then shift."""
    rotation = transforms.rotation_from_vector(twists[:, :3])
    return transforms.rigid(rotation, middle + twists[:, 3:] - rotation @ middle)
