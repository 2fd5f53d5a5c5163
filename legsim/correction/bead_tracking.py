"""Rigid motion from metal beads on the skin, tracked in all projections.

This is the marker-based standard. After Choi et al., "Fiducial marker-based correction for
involuntary motion in weight-bearing C-arm CT scanning of knees", Part I 2013, II 2014: beads are
found in every projection, and a rigid pose of their reference places in every view minimizes the
distance between found and projected beads. Where a pose is free in every view, a scan that moves
with it cannot be distinguished from one of another size. What fixes place and size is the choice of
the reference:

- "mean", as published: the static mean places, nearest to the rays of all views, as if nothing had
  moved.
- "bundle": places and poses together minimize the distance (bundle adjustment). The smallest motion
  that explains the shadows is taken (a weak prior on every view's motion), which leaves a scale
  error of a few thousandths.

The skin's own motion remains in the reprojection error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.correction import blob_detection
from legsim.correction.triangulation import triangulated
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections

Reference = Literal["mean", "bundle"]
"""what the poses are fitted to, see above"""

FEWEST = 4
"""beads that a view needs: three determine a pose, a fourth shows whether one is wrong"""

_SEARCH_PX = 4.0

_LEAST_CONTRAST = 0.2

_WIDER, _SELDOM = (2.0, 3.0), 0.5
"""times that the search is widened for beads that fewer than this share of views show: their first
guess may be off by more than the search reaches, and what few views show instead is another shadow
"""

_ROUNDS = 30

_PRIOR_TURN, _PRIOR_SHIFT = np.radians(5.0), 0.02
"""rad and m of a view's motion that count as _PRIOR_PX pixels of reprojection error"""

_PRIOR_PX = 0.02

_OUTLIER = 5.0
"""times the typical distance, above which a shadow is rejected"""

_LEAST_TYPICAL_PX = 0.1
"""least typical distance, from skin and detection, even where most shadows fit exactly

No shadow nearer than five times that is rejected.
"""

_DOUBTING_ROUNDS = 5


def track(
    projections: Projections,
    guesses: ArrayLike,
    *,
    radius: float,
    search_px: float = _SEARCH_PX,
    least_contrast: float = _LEAST_CONTRAST,
    progress: Callable[[int, int], None] | None = None,
) -> FloatArray:
    """Tracks the centers (v, b, 2) of the beads' shadows, (u, v) in pixels.

    NaN where a bead is off the detector, lost or overlaps another.

    Args:
        projections: with the beads in them.
        guesses: (b, 3) m in world, where the beads are about at the first view: to within
            ``search_px`` on the detector. One that is farther off is found where views bring its
            bead that near, and followed back from there. A bead that is found in less than half of
            the views is sought within twice and three times as far, too.
        radius: m, of the beads.
        search_px: how far from its expected place a shadow may be, in widths of a pixel. It is
            expected where the resting guess would be seen, plus how far off it was last; the
            others' motion predicts a hidden bead.
        least_contrast: as in :func:`legsim.correction.blob_detection.locate`.
        progress: counts views.
    """
    guesses = frozen("bead guesses", guesses, (None, 3))
    found = _followed(
        projections, guesses, radius, search_px, least_contrast, progress or (lambda *_: None)
    )
    for wider in _WIDER:
        lost = np.isfinite(found).all(-1).mean(0) < _SELDOM
        if not lost.any():
            break
        again = _followed(
            projections, guesses, radius, wider * search_px, least_contrast, lambda *_: None
        )
        better = lost & (np.isfinite(again).all(-1).mean(0) >= _SELDOM)
        found = np.where(better[:, None], again, found)
    return found


def _followed(
    projections: Projections,
    guesses: FloatArray,
    radius: float,
    search_px: float,
    least_contrast: float,
    progress: Callable[[int, int], None],
) -> FloatArray:
    """As :func:`track`, with one reach of the search."""
    geometry = projections.geometry
    resting = geometry.project(guesses)[0]
    sizes = blob_detection.shadow_radii(geometry, guesses, radius)
    row_ratio = geometry.row_pitch() / geometry.pixel_pitch
    found, offsets = np.full(resting.shape, np.nan), np.zeros(resting.shape)

    def search(view: int, offset: FloatArray) -> None:
        """Looks where the beads are expected by how far off they were."""
        expected, radius_px = resting[view] + offset, float(sizes[view].mean())
        alone = _alone(expected * (1, row_ratio), search_px + 2 * radius_px)
        found[view, alone] = blob_detection.locate(
            projections.line_integrals[view],
            expected[alone],
            radius_px=radius_px,
            search_px=search_px,
            least_contrast=least_contrast,
            row_ratio=row_ratio,
        )
        found[view, ~alone] = np.nan
        offsets[view] = offset + _shift(found[view] - expected)

    for view in range(len(geometry)):
        search(view, offsets[max(view - 1, 0)])
        progress(view + 1, len(geometry))
    # a bead whose guess was too far off is met later, after other shadows were perhaps taken for it
    # in single views: from its longest run on it is followed back
    forward, surely = found.copy(), _longest_runs(np.asarray(np.isfinite(found).all(-1)))
    early = np.arange(len(found))[:, None] < surely
    for view in np.flatnonzero(early.any(1))[::-1]:
        search(int(view), offsets[view + 1])
        found[view] = np.where(early[view][:, None], found[view], forward[view])
    return found


def _longest_runs(has: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(b,) first view of the longest run of views (v, b) that show a bead; 0 where none does."""
    ends = np.zeros(has.shape, np.intp)
    for view, shown in enumerate(has):
        ends[view] = shown * (1 + (ends[view - 1] if view else 0))
    last = ends.argmax(0)
    return np.where(has.any(0), last - ends.max(0) + 1, 0)


def _shift(change: FloatArray) -> FloatArray:
    """(b, 2) how far beads moved; those that are not seen as the others' median."""
    has = np.asarray(np.isfinite(change).all(-1))
    if not has.any():
        return np.zeros_like(change)
    return np.where(has[:, None], np.nan_to_num(change), np.median(change[has], axis=0))


def _alone(expected: FloatArray, clearance: float) -> NDArray[np.bool_]:
    """Whether no other bead is expected within ``clearance`` pixels, (b,).

    Overlapping shadows shift each other's centers.
    """
    apart = np.linalg.norm(expected[:, None] - expected, axis=-1)
    np.fill_diagonal(apart, np.inf)
    return apart.min(-1) > clearance


@dataclass(frozen=True, slots=True, eq=False)
class BeadMotion:
    """Motion and bead positions estimated from the shadows."""

    motion: RigidMotion
    """motion against the first view"""
    positions: FloatArray
    """(b, 3) m in world at the first view; NaN for a bead seen too seldom"""
    used: NDArray[np.bool_]
    """(v, b) shadows that were seen and used"""
    residual_px: float
    """RMS distance of these to the projected beads"""

    def __post_init__(self) -> None:
        shape = (len(self.motion.times), len(self.positions))
        object.__setattr__(
            self, "positions", frozen("BeadMotion.positions", self.positions, (None, 3))
        )
        object.__setattr__(self, "used", frozen("BeadMotion.used", self.used, shape, np.bool_))


def estimate(
    geometry: ConeBeamGeometry, pixels: ArrayLike, *, reference: Reference = "bundle"
) -> BeadMotion:
    """Estimates the beads' positions and rigid motion from shadows (v, b, 2), NaN where unseen.

    Outliers are rejected with either reference.

    Raises:
        LegsimError: a view with fewer than four beads that are seen elsewhere too, the shadows fit
            no rigid motion, or an unknown reference.
    """
    pixels = frozen("bead pixels", pixels, (len(geometry), None, 2))
    if reference not in ("mean", "bundle"):
        raise LegsimError(f"beads: the reference is {reference!r}; give mean or bundle")
    fitted = _adjusted if reference == "bundle" else _fitted_to_mean
    used = np.asarray(np.isfinite(pixels).all(-1))
    used = used & (used.sum(0) >= max(2, len(geometry) // 10))
    _require_enough(used)
    seen, weights = used, used.astype(float)
    positions, motion = (
        triangulated(geometry, pixels, used.astype(float)),
        RigidMotion.identity(geometry.times).moved_from_reference,
    )
    # first with weights that wrong shadows lose step by step (Cauchy's), then with the accepted
    # ones only
    for doubting in [True] * _DOUBTING_ROUNDS + [False] * 2:
        positions, motion = fitted(geometry, pixels, weights, positions, motion)
        miss = np.linalg.norm(pixels - _projected(geometry, motion, positions), axis=-1)
        typical = max(float(np.median(miss[used])), _LEAST_TYPICAL_PX)
        used = np.asarray(seen & (miss <= _OUTLIER * typical), bool)
        weights = (
            np.where(seen, 1 / (1 + (np.nan_to_num(miss) / typical) ** 2), 0.0)
            if doubting
            else used.astype(float)
        )
    _require_enough(used)
    positions, motion = fitted(geometry, pixels, used.astype(float), positions, motion)
    miss = np.linalg.norm(pixels - _projected(geometry, motion, positions), axis=-1)
    residual = float(np.sqrt(np.mean(miss[used] ** 2)))
    placed = transforms.apply(motion[0], np.where(seen.any(0)[:, None], positions, np.nan))
    return BeadMotion(
        RigidMotion(geometry.times, motion @ transforms.inverse(motion[0])), placed, used, residual
    )


def poses(geometry: ConeBeamGeometry, pixels: ArrayLike, positions: ArrayLike) -> RigidMotion:
    """Fits, per view, the motion of beads at known ``positions`` (b, 3) to their shadows.

    Shadows (v, b, 2) are NaN where unseen.

    Raises:
        LegsimError: a view with fewer than four beads.
    """
    pixels, positions = (
        frozen("bead pixels", pixels, (len(geometry), None, 2)),
        frozen("bead positions", positions, (None, 3)),
    )
    used = np.asarray(np.isfinite(pixels).all(-1))
    _require_enough(used)
    still = RigidMotion.identity(geometry.times).moved_from_reference
    return RigidMotion(
        geometry.times, _posed(geometry, pixels, used.astype(float), positions, still)
    )


def _posed(
    geometry: ConeBeamGeometry,
    pixels: FloatArray,
    weights: FloatArray,
    positions: FloatArray,
    motion: FloatArray,
) -> FloatArray:
    """Poses (v, 4, 4) of least reprojection error of known positions, from ``motion`` on."""
    for _ in range(_ROUNDS):
        miss, by_pose, _ = _linearized(geometry, pixels, weights, positions, motion)
        normal = np.einsum("vbki,vbkj->vij", by_pose, by_pose)
        step = np.linalg.solve(normal, np.einsum("vbki,vbk->vi", by_pose, miss)[..., None])[..., 0]
        motion = _stepped(motion, step, positions.mean(0))
        if np.abs(step).max() < 1e-13:
            break
    return motion


def _fitted_to_mean(
    geometry: ConeBeamGeometry,
    pixels: FloatArray,
    weights: FloatArray,
    positions: FloatArray,
    motion: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Static mean positions of the weighted shadows, and the poses of these.

    A bead without any weight stays at its ``positions``.
    """
    shares = weights.sum(0)[:, None]
    means = np.where(shares > 0, triangulated(geometry, pixels, weights), positions)
    return means, _posed(geometry, pixels, weights, means, motion)


def _require_enough(used: NDArray[np.bool_]) -> None:
    counts = used.sum(-1)
    if counts.min() < FEWEST:
        raise LegsimError(
            f"view {int(np.argmin(counts))} shows {int(counts.min())} beads that can be used; "
            f"a pose needs {FEWEST}: "
            "use more or larger beads, or place them nearer to the knee"
        )


def _projected(geometry: ConeBeamGeometry, motion: FloatArray, positions: FloatArray) -> FloatArray:
    return geometry.project(transforms.apply(motion, positions))[0]


def _linearized(
    geometry: ConeBeamGeometry,
    pixels: FloatArray,
    weights: FloatArray,
    positions: FloatArray,
    motion: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (v, b, 2), and derivatives of the projection by pose and position.

    Derivatives by pose are (v, b, 2, 6), by position (v, b, 2, 3), times the root of the weights. A
    pose changes by a rotation about the beads' middle, then a shift, both in world.
    """
    moved = transforms.apply(motion, positions)
    homogeneous = (
        moved @ np.swapaxes(geometry.matrices[:, :, :3], -1, -2) + geometry.matrices[:, None, :, 3]
    )
    depth, pixel = homogeneous[..., 2:], homogeneous[..., :2] / homogeneous[..., 2:]
    root = np.sqrt(weights)
    miss = np.where(weights[..., None] > 0, root[..., None] * (pixels - pixel), 0.0)
    rows = geometry.matrices[:, None, :, :3]
    by_point = (rows[..., :2, :] - pixel[..., None] * rows[..., 2:, :]) / depth[..., None]
    by_point = by_point * root[..., None, None]
    arms = moved - transforms.apply(motion, positions.mean(0)[None])
    by_pose = np.concatenate([by_point @ -transforms.cross_matrix(arms), by_point], -1)
    return miss, by_pose, by_point @ motion[:, None, :3, :3]


def _stepped(motion: FloatArray, step: FloatArray, middle: FloatArray) -> FloatArray:
    """Updates poses (v, 4, 4) by changes (v, 6)."""
    center = transforms.apply(motion, middle[None])[:, 0]
    turn = transforms.rotation_from_vector(step[:, :3])
    change = transforms.rigid(turn, center + step[:, 3:] - np.einsum("vij,vj->vi", turn, center))
    return change @ motion


def _prior(motion: FloatArray, middle: FloatArray) -> FloatArray:
    """Rotation vector and shift of the beads' middle of each view, (v, 6).

    They are in units of their weight.
    """
    shift = transforms.apply(motion, middle[None])[:, 0] - middle
    return (
        np.concatenate(
            [
                transforms.vector_from_rotation(motion[:, :3, :3]) / _PRIOR_TURN,
                shift / _PRIOR_SHIFT,
            ],
            -1,
        )
        * _PRIOR_PX
    )


def _adjusted(
    geometry: ConeBeamGeometry,
    pixels: FloatArray,
    weights: FloatArray,
    positions: FloatArray,
    motion: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Positions and poses of least reprojection error and prior.

    Levenberg and Marquardt's rule, poses eliminated (Schur).
    """
    firmness = _PRIOR_PX / np.array([_PRIOR_TURN] * 3 + [_PRIOR_SHIFT] * 3)
    damping, cost = 1e-6, _cost(geometry, pixels, weights, positions, motion)
    for _ in range(_ROUNDS):
        miss, by_pose, by_place = _linearized(geometry, pixels, weights, positions, motion)
        pull = np.einsum("vbki,vbk->vi", by_pose, miss) - firmness * _prior(
            motion, positions.mean(0)
        )
        steps = _schur_step(by_pose, by_place, miss, pull, np.diag(firmness**2), damping)
        tried = positions + steps[0], _stepped(motion, steps[1], positions.mean(0))
        tried_cost = _cost(geometry, pixels, weights, *tried)
        if tried_cost >= cost:
            damping *= 10
            if damping > 1e3:
                break
            continue
        gained, cost = cost - tried_cost, tried_cost
        (positions, motion), damping = tried, max(damping / 10, 1e-12)
        if gained < 1e-9 * cost + 1e-18:
            break
    return positions, motion


def _cost(
    geometry: ConeBeamGeometry,
    pixels: FloatArray,
    weights: FloatArray,
    positions: FloatArray,
    motion: FloatArray,
) -> float:
    seen = weights > 0
    squared = ((pixels - _projected(geometry, motion, positions)) ** 2).sum(-1)[seen]
    return float(weights[seen] @ squared + (_prior(motion, positions.mean(0)) ** 2).sum())


def _schur_step(
    by_pose: FloatArray,
    by_place: FloatArray,
    miss: FloatArray,
    pull: FloatArray,
    prior: FloatArray,
    damping: float,
) -> tuple[FloatArray, FloatArray]:
    """Changes of positions (b, 3) and poses (v, 6)."""
    views, beads = miss.shape[:2]
    of_poses = np.einsum("vbki,vbkj->vij", by_pose, by_pose) + prior
    of_poses += damping * np.eye(6) * np.diagonal(of_poses, axis1=-2, axis2=-1)[:, None]
    of_places = np.einsum("vbki,vbkj->bij", by_place, by_place)
    # a bead that is never used has no equations: keep it where it is
    scale = np.diagonal(of_places, axis1=-2, axis2=-1)[:, None]
    of_places = of_places + np.eye(3) * np.where(scale > 0, damping * scale, 1.0)
    mixed = np.einsum("vbki,vbkj->vibj", by_pose, by_place).reshape(views, 6, 3 * beads)
    whole = np.zeros((beads, 3, beads, 3))
    whole[np.arange(beads), :, np.arange(beads)] = of_places
    solved = np.linalg.solve(of_poses, np.concatenate([mixed, pull[..., None]], -1))
    reduced = whole.reshape(3 * beads, 3 * beads) - np.einsum(
        "via,vib->ab", mixed, solved[..., :-1]
    )
    right = np.einsum("vbki,vbk->bi", by_place, miss).ravel() - np.einsum(
        "via,vi->a", mixed, solved[..., -1]
    )
    places = np.linalg.solve(reduced, right)
    return places.reshape(beads, 3), solved[..., -1] - solved[..., :-1] @ places
