"""Small round shadows in a projection, located to a fraction of a pixel.

They are metal beads on skin or in a sensor. A bead's shadow is round and its background nearly a
plane over a few pixels, so that the center of a Gaussian fitted together with a plane is the center
of the shadow for any profile: to 0.02 pixel for radii from 2 pixels on, to 0.06 for 1.2 pixels (a
millimeter bead at the paper's resolution), where single pixels sample the shadow coarsely.
Perspective shifts it by less than 0.001. All shadows of an image are fitted at once; height and
plane, in which the fit is linear, are eliminated (variable projection after Kaufman, BIT 15, 1975).

Pixels may be higher than wide. Lengths are then counted in the width of a pixel; places stay
columns and rows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry

# Gaussian width that resembles a sphere's shadow of radius 1 best, and half the window of the fit
# in radii
_WIDTH_OF_RADIUS = 0.5

_WINDOW_OF_RADIUS = 2.5

_FEWEST_PIXELS = 12

_NARROWEST = 0.31
"""pixels, least width of a Gaussian

Four pixels around a small shadow's center fit the better, the narrower and higher the Gaussian is:
pixels do not resolve its width, and without a limit the fit has no end.
"""

_ROUNDS = 60

_SETTLED = 1e-4
"""pixels by which the last step of a fit moves the center"""

_HIGHEST = 50.0
"""exponent beyond which a Gaussian is cut off, against overflow of shapes that are no bead"""


def locate(
    image: Float32Array,
    expected: ArrayLike,
    *,
    radius_px: float,
    search_px: float,
    least_contrast: float,
    row_ratio: float = 1.0,
) -> FloatArray:
    """Centers (n, 2) of the shadows nearest to where they are expected, (u, v) in pixels.

    NaN where there is none.

    Args:
        image: (rows, columns) line integrals.
        expected: (n, 2) columns and rows.
        radius_px: of the shadows, in widths of a pixel.
        search_px: how far from the expected place a center may be, likewise.
        least_contrast: least line integral in the middle of a shadow above its surroundings:
            several times the noise.
        row_ratio: height of a pixel over its width.

    Raises:
        LegsimError: sizes that are not positive.
    """
    if not (radius_px > 0 and search_px > 0 and least_contrast > 0 and row_ratio > 0):
        raise LegsimError(
            f"beads need a positive radius, search and contrast, and pixels a height; got "
            f"{radius_px:g} px, {search_px:g} px, {least_contrast:g}, {row_ratio:g} widths"
        )
    expected = np.asarray(expected, float).reshape(-1, 2)
    centers = np.full(expected.shape, np.nan)
    reach, size = search_px + radius_px, np.array([1.0, row_ratio])
    within = (expected > -reach / size) & (
        expected < np.array(image.shape[::-1]) - 1 + reach / size
    )
    at = expected[within.all(-1)]
    if len(at) == 0:
        return centers
    starts, any_near = _roundest(image, at, radius_px, search_px, row_ratio)
    found = _fitted(image, starts, radius_px, least_contrast, size)
    near = any_near & (np.linalg.norm((found - at) * size, axis=-1) <= reach)
    centers[within.all(-1)] = np.where(near[:, None], found, np.nan)
    return centers


def shadow_radii(geometry: ConeBeamGeometry, centers: ArrayLike, radius: float) -> FloatArray:
    """Radii (v, p) of the shadows of spheres of ``radius`` (m), in widths of a pixel.

    Their ``centers`` are (p, 3) or (v, p, 3) m in world.
    """
    return radius * geometry.focal_lengths()[:, None] / geometry.project(centers)[1]


def _roundest(
    image: Float32Array, at: FloatArray, radius: float, search: float, row_ratio: float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Pixels (n, 2) within ``search`` of ``at`` that look most like a shadow (u, v).

    The negative Laplacian of the Gaussian-smoothed image decides; beyond the border the image
    repeats it. The second value says whether the image has any pixel so near.
    """
    of_rows = _Derivatives.of(radius / row_ratio, search / row_ratio)
    of_columns = _Derivatives.of(radius, search)
    middle = np.round(at).astype(np.intp)
    rows, columns = (
        middle[:, k, None] + np.arange(-made.outer, made.outer + 1)
        for k, made in ((1, of_rows), (0, of_columns))
    )
    part = image[
        np.clip(rows, 0, image.shape[0] - 1)[:, :, None],
        np.clip(columns, 0, image.shape[1] - 1)[:, None, :],
    ].astype(float)
    across = of_rows.smooth @ part @ of_columns.curved.T
    along = of_rows.curved @ part @ of_columns.smooth.T / row_ratio**2
    v, u = rows[:, of_rows.kept, None], columns[:, None, of_columns.kept]
    off = (u - at[:, 0, None, None]) ** 2 + (row_ratio * (v - at[:, 1, None, None])) ** 2
    allowed = (off <= search**2) & (v >= 0) & (v < image.shape[0])
    allowed &= (u >= 0) & (u < image.shape[1])
    best = np.where(allowed, -(across + along), -np.inf).reshape(len(at), -1).argmax(-1)
    row, column = np.divmod(best, 2 * of_columns.inner + 1)
    inner = np.array([of_columns.inner, of_rows.inner])
    return middle - inner + np.stack([column, row], -1), allowed.any((1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Derivatives:
    """Smoothing by a Gaussian, and its second derivative, along one axis of a window."""

    inner: int
    """pixels to either side that the result has"""
    outer: int
    """pixels to either side that it takes"""
    smooth: FloatArray
    """(2 inner + 1, 2 outer + 1)"""
    curved: FloatArray

    @classmethod
    def of(cls, radius: float, search: float) -> "_Derivatives":
        """For shadows of ``radius`` within ``search``, both in pixels of this axis."""
        sigma = _WIDTH_OF_RADIUS * radius
        inner = int(np.ceil(search)) + 1
        outer = inner + int(np.ceil(4 * sigma)) + 1
        smooth, curved = (
            ndimage.gaussian_filter1d(np.eye(2 * outer + 1), sigma, axis=0, order=order)[
                outer - inner : outer + inner + 1
            ]
            for order in (0, 2)
        )
        return cls(inner, outer, smooth, curved)

    @property
    def kept(self) -> slice:
        return slice(self.outer - self.inner, self.outer + self.inner + 1)


def _fitted(
    image: Float32Array,
    starts: NDArray[np.intp],
    radius: float,
    least_contrast: float,
    size: FloatArray,
) -> FloatArray:
    """Centers (n, 2) of Gaussians on planes by least squares, from pixels ``starts`` (n, 2).

    NaN where the fit is no bead. ``size`` (2,) is a pixel's, in its width.
    """
    window = _WINDOW_OF_RADIUS * radius + 1
    wide, high = (int(window / length) for length in size)
    v, u = np.mgrid[-high : high + 1, -wide : wide + 1].reshape(2, -1)
    circle = u**2 + (size[1] * v) ** 2 <= window**2
    offsets = np.stack([u[circle], v[circle]], -1)
    columns, rows = (starts[:, k, None] + offsets[:, k] for k in (0, 1))
    seen = (rows >= 0) & (rows < image.shape[0]) & (columns >= 0) & (columns < image.shape[1])
    values = image[
        np.clip(rows, 0, image.shape[0] - 1), np.clip(columns, 0, image.shape[1] - 1)
    ].astype(float)
    center, width, height = np.zeros((len(starts), 2)), np.zeros(len(starts)), np.zeros(len(starts))
    enough = seen.sum(-1) >= _FEWEST_PIXELS
    center[enough], width[enough], height[enough] = _bumps(
        offsets * size, values[enough], seen[enough], radius
    )
    is_bead = (
        enough
        & (height >= least_contrast)
        & (np.linalg.norm(center, axis=-1) <= radius + 1)
        & (width >= 0.2 * radius)
        & (width <= 2 * radius + 1)
    )
    return np.where(is_bead[:, None], starts + center / size, np.nan)


def _bumps(
    offsets: FloatArray, values: FloatArray, seen: NDArray[np.bool_], radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centers (n, 2), widths (n,) and heights (n,) of Gaussians on planes of least squared error.

    ``values`` (n, k) at ``offsets`` (k, 2) count where they are ``seen``. Levenberg and Marquardt's
    rule for all at once, each with a damping of its own. A Gaussian is exp(b x - q x^2), so that
    shapes that fit a few pixels equally well lie on a straight line.
    """
    limits = 0.5 / (3 * radius + 1.5) ** 2, 0.5 / _NARROWEST**2
    shape = np.tile([0, 0, 0.5 / (_WIDTH_OF_RADIUS * radius + 0.3) ** 2], (len(values), 1))
    shape[:, 2] = np.clip(shape[:, 2], limits[0], limits[1])
    damping, active = np.full(len(shape), 1e-3), np.arange(len(shape))
    residual, slopes, height = _without_plane(offsets, values, seen, shape)
    for _ in range(_ROUNDS):
        if len(active) == 0:
            break
        tried = shape[active] + _step(
            residual[active], slopes[active], shape[active, 2], limits, damping[active]
        )
        tried[:, 2] = np.clip(tried[:, 2], limits[0], limits[1])
        made = _without_plane(offsets, values[active], seen[active], tried)
        better = (made[0] ** 2).sum(-1) <= (residual[active] ** 2).sum(-1)
        change = np.abs(_centers(tried) - _centers(shape[active])).max(-1)
        taken = active[better]
        shape[taken], residual[taken] = tried[better], made[0][better]
        slopes[taken], height[taken] = made[1][better], made[2][better]
        damping[active] = np.maximum(damping[active] * np.where(better, 0.1, 10.0), 1e-9)
        active = active[(change > _SETTLED) & (damping[active] < 1e6)]
    peak = np.exp(np.minimum((shape[:, :2] ** 2).sum(-1) / (4 * shape[:, 2]), _HIGHEST))
    return _centers(shape), np.sqrt(0.5 / shape[:, 2]), height * peak


def _centers(shape: FloatArray) -> FloatArray:
    return shape[:, :2] / (2 * shape[:, 2:])


def _step(
    residual: FloatArray,
    slopes: FloatArray,
    sharpness: FloatArray,
    limits: tuple[float, float],
    damping: FloatArray,
) -> FloatArray:
    """Changes of the shapes (n, 3), shortened to end where the sharpness reaches a limit.

    A sharpness at its limit stays there if it is drawn beyond.
    """
    normal = np.swapaxes(slopes, -1, -2) @ slopes
    pull = np.einsum("nki,nk->ni", slopes, residual)
    beyond = ((sharpness <= limits[0]) & (pull[:, 2] < 0)) | (
        (sharpness >= limits[1]) & (pull[:, 2] > 0)
    )
    normal[beyond, 2, :2] = normal[beyond, :2, 2] = pull[beyond, 2] = 0
    diagonal = np.einsum("nii->ni", normal)
    # no slope at all, where a bump has no height: no step
    diagonal += damping[:, None] * diagonal + 1e-12 * diagonal.max(-1, keepdims=True)
    diagonal += np.finfo(float).tiny
    step = np.linalg.solve(normal, pull[..., None])[..., 0]
    allowed = np.clip(sharpness + step[:, 2], limits[0], limits[1]) - sharpness
    share = np.divide(allowed, step[:, 2], out=np.ones_like(allowed), where=allowed != step[:, 2])
    return step * np.where(share > 0, share, 1.0)[:, None]


def _without_plane(
    offsets: FloatArray, values: FloatArray, seen: NDArray[np.bool_], shape: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (n, k), their slopes (n, k, 3) by shape, and heights (n,) at the offset 0.

    Height and plane are those of least squared error for each shape. Slopes are of the bump, less
    what height and plane make up for.
    """
    terms = np.concatenate([offsets, -(offsets**2).sum(-1, keepdims=True)], -1).astype(float)
    bump = seen * np.exp(np.minimum(shape @ terms.T, _HIGHEST))
    plane = np.concatenate([np.ones((len(offsets), 1)), offsets], -1)
    linear = np.concatenate([seen[..., None] * plane, bump[..., None]], -1)
    basis, triangle = np.linalg.qr(linear)
    counted: FloatArray = np.where(seen, values, 0.0)[..., None]
    share, corner = (np.swapaxes(basis, -1, -2) @ counted)[:, 3, 0], triangle[:, 3, 3]
    height = np.divide(share, corner, out=np.zeros_like(corner), where=corner != 0)
    both = np.concatenate([(height[:, None] * bump)[..., None] * terms, counted], -1)
    left = both - basis @ (np.swapaxes(basis, -1, -2) @ both)
    return left[..., 3], left[..., :3], height
