"""Small round shadows in a projection, located to a fraction of a pixel.

They are metal beads on skin or in a sensor. A bead's shadow is round and its background nearly a
plane over a few pixels, so that the center of a Gaussian fitted together with a plane is the center
of the shadow for any profile: to 0.02 pixel for radii from 2 pixels on, to 0.06 for 1.2 pixels (a
millimeter bead at the paper's resolution), where single pixels sample the shadow coarsely.
Perspective shifts it by less than 0.001.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.optimize import least_squares

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry

# Gaussian width that resembles a sphere's shadow of radius 1 best, and half the window of the fit
# in radii
_WIDTH_OF_RADIUS = 0.5

_WINDOW_OF_RADIUS = 2.5

_ROUNDS = 60


def locate(
    image: Float32Array,
    expected: ArrayLike,
    *,
    radius_px: float,
    search_px: float,
    least_contrast: float,
) -> FloatArray:
    """Centers (n, 2) of the shadows nearest to where they are expected, (u, v) in pixels.

    NaN where there is none.

    Args:
        image: (rows, columns) line integrals.
        expected: (n, 2) columns and rows.
        radius_px: of the shadows.
        search_px: how far from the expected place a center may be.
        least_contrast: least line integral in the middle of a shadow above its surroundings:
            several times the noise.

    Raises:
        LegsimError: sizes that are not positive.
    """
    if not (radius_px > 0 and search_px > 0 and least_contrast > 0):
        raise LegsimError(
            f"beads need a positive radius, search and contrast; got {radius_px:g} px, "
            f"{search_px:g} px, {least_contrast:g}"
        )
    expected = np.asarray(expected, float)
    return np.array(
        [_nearest(image, at, radius_px, search_px, least_contrast) for at in expected]
    ).reshape(-1, 2)


def shadow_radii(geometry: ConeBeamGeometry, centers: ArrayLike, radius: float) -> FloatArray:
    """Radii (v, p) in pixels of the shadows of spheres of ``radius`` (m) at ``centers``.

    ``centers`` are (p, 3) or (v, p, 3) m in world.
    """
    return radius * geometry.focal_lengths()[:, None] / geometry.project(centers)[1]


def _nearest(
    image: Float32Array, at: FloatArray, radius: float, search: float, least_contrast: float
) -> FloatArray:
    """Center (2,) of the strongest shadow within ``search`` of ``at``, or NaN."""
    nothing = np.full(2, np.nan)
    margin = int(np.ceil(search + 2 * _WINDOW_OF_RADIUS * radius))
    if not np.isfinite(at).all():
        return nothing
    corner = np.maximum(np.round(at).astype(int) - margin, 0)
    part = np.asarray(
        image[corner[1] : round(at[1]) + margin + 1, corner[0] : round(at[0]) + margin + 1], float
    )
    if min(part.shape, default=0) < 3:
        return nothing
    v, u = np.mgrid[: part.shape[0], : part.shape[1]]
    near = (u + corner[0] - at[0]) ** 2 + (v + corner[1] - at[1]) ** 2 <= search**2
    roundness = -ndimage.gaussian_laplace(part, _WIDTH_OF_RADIUS * radius, mode="nearest")
    if not near.any():
        return nothing
    row, column = divmod(int(np.argmax(np.where(near, roundness, -np.inf))), part.shape[1])
    center = _fitted(part, np.array([column, row], float), radius, least_contrast)
    return center + corner if np.hypot(*(center + corner - at)) <= search + radius else nothing


def _fitted(
    part: FloatArray, start: FloatArray, radius: float, least_contrast: float
) -> FloatArray:
    """Center (2,) of a Gaussian on a plane by least squares, or NaN where the fit is no bead."""
    v, u = np.mgrid[: part.shape[0], : part.shape[1]]
    inside = (u - start[0]) ** 2 + (v - start[1]) ** 2 <= (_WINDOW_OF_RADIUS * radius + 1) ** 2
    du, dv, values = u[inside] - start[0], v[inside] - start[1], part[inside]
    if len(values) < 12:
        return np.full(2, np.nan)
    edge = du**2 + dv**2 > (1.2 * radius + 0.5) ** 2
    base = float(np.median(values[edge])) if edge.any() else float(values.min())

    def residual(x: FloatArray) -> FloatArray:
        height, cu, cv, width, offset, slope_u, slope_v = x
        bump = height * np.exp(-((du - cu) ** 2 + (dv - cv) ** 2) / (2 * width**2))
        return bump + offset + slope_u * du + slope_v * dv - values

    first = [
        max(float(values.max()) - base, least_contrast),
        0,
        0,
        _WIDTH_OF_RADIUS * radius + 0.3,
        base,
        0,
        0,
    ]
    fit = least_squares(
        residual, first, x_scale=[first[0], 1, 1, 1, first[0], first[0], first[0]], max_nfev=_ROUNDS
    )
    height, cu, cv, width = fit.x[:4]
    is_bead = (
        height >= least_contrast
        and np.hypot(cu, cv) <= radius + 1
        and 0.2 * radius <= abs(width) <= 2 * radius + 1
    )
    return start + np.array([cu, cv]) if is_bead else np.full(2, np.nan)
