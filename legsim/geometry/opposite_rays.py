"""Whether images and geometry belong together, by rays that two views measure.

The line between the sources of two views is a ray of both, from either end, so both views read the
same along it, whatever was scanned and however it is cut off. Over more than half a turn there are
many such pairs. Mirrored columns, views in reverse order, a pixel size of the unbinned detector or
an offset of the wrong sign make their readings differ; so does motion, but by less. Where no such
ray meets the object, as in short scans, or one in the middle of the scan that looks alike from both
sides, planes that two views measure say less, but something.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.shared_planes import SharedPlanes

_MOST_VIEWS = 300
"""views that are compared with each other; of more, every second or third and so on"""

_FEWEST_PAIRS = 12
"""pairs of readings that say something"""

_APART = 0.3
"""difference from which on images and geometry are doubted: a squat that sways by centimeters
leaves 0.04, readings that have nothing to do with each other are at 1
"""

_NAMED_APART = 0.08
"""the same where a mistake explains the difference"""

_EXPLAINS = 0.35
"""share of the difference that may be left where a mistake is named"""

_PLANES_APART, _PLANES_EXPLAINED = 4e-3, 0.6
"""the same for planes: a knee in the middle of its scan leaves 0.005 to 0.012 where its columns are
mirrored, and 0.0004 where it stands still and they are not. Where rays say something too, planes
must be explained as well as they: mirroring explains 40 % of how a round leg sways in the middle
"""

_SURELY, _SURELY_APART = 0.25, 0.1
"""share of the difference that may be left, and the least difference, where another size of pixels
is the only explanation: of 619 scans of somebody who sways by up to 8 mm, 5 are explained by it
between these and the above, none beyond, and so are a sixth of those with such pixels
"""

_BEYOND_MOTION = 0.5
"""difference that sways of up to 8 mm did not reach in a scan of any length; 0.3 in 2 % of them"""

_OR_MOTION = ", unless somebody moved by several millimeters during the scan"

_WIDEST_GAP = np.radians(30.0)
"""between views that are all around; only then a shift of all columns is sought: half a turn of
somebody who drifts by 5 mm looks like one, and so does one forth and back
"""

_MOST_SHIFT, _SHIFTS = 0.12, 49
"""of the columns; how many shifts are tried, and tried again about the best one"""

_THIN = 0.05
"""spread of the readings, as line integrals, below which the rays met nothing"""


@dataclass(frozen=True, slots=True, eq=False)
class OppositeRays:
    """Rays that two views measure: for each the views and where each has it on its detector."""

    views: np.ndarray
    """(pairs, 2)"""
    pixels: FloatArray
    """(pairs, 2, 2) as u, v"""

    @classmethod
    def of(cls, geometry: ConeBeamGeometry) -> "OppositeRays":
        """All pairs of views, or of a part of the views, whose sources see each other."""
        step = -(-len(geometry) // _MOST_VIEWS)
        numbers = np.arange(0, len(geometry), step)
        matrices, sources = geometry.matrices[numbers], geometry.sources()[numbers]
        seen = np.einsum("iab,jb->ija", matrices[:, :, :3], sources) + matrices[:, None, :, 3]
        first, second = np.triu_indices(len(numbers), 1)
        both = np.stack([seen[first, second], seen[second, first]], axis=1)
        ahead = (both[..., 2] > 1e-6).all(axis=1)
        first, second, both = first[ahead], second[ahead], both[ahead]
        return cls(
            np.stack([numbers[first], numbers[second]], axis=1), both[..., :2] / both[..., 2:]
        )

    def difference(self, projections: Projections, mapped: "_Mistake") -> float | None:
        """RMS difference of both readings over their spread: 0 where all agree, 1 where they have
        nothing to do with each other. None where too few rays meet something.

        ``mapped`` moves the pixels to where they would be under a mistake.
        """
        rows, columns = projections.geometry.shape_vu
        pixels = mapped(self.pixels, self.views)
        inside = ((pixels >= 0) & (pixels <= [columns - 1, rows - 1])).all(axis=(1, 2))
        if inside.sum() < _FEWEST_PAIRS:
            return None
        u, v = np.moveaxis(pixels[inside], -1, 0)
        places = [self.views[inside].astype(float), v, u]
        read = ndimage.map_coordinates(
            projections.line_integrals, places, np.float64, order=1, mode="nearest"
        )
        spread = float(read.std())
        if spread < _THIN:
            return None
        return float(np.sqrt(np.mean((read[:, 0] - read[:, 1]) ** 2) / 2)) / spread


@dataclass(frozen=True, slots=True, eq=False)
class _Mistake:
    """A mistake that one may make with images, as pixels (u) that it exchanges."""

    said: str
    scale: float
    """of the columns, about the detector's middle"""
    middle: float
    """column in the detector's middle"""
    shift: FloatArray
    """(v,) columns"""

    def __call__(self, pixels: FloatArray, views: np.ndarray) -> FloatArray:
        moved = pixels.copy()
        moved[..., 0] = self.middle + self.scale * (pixels[..., 0] - self.middle)
        moved[..., 0] += self.shift[views]
        return moved


def _mistakes(geometry: ConeBeamGeometry) -> list[_Mistake]:
    """No mistake first, then those that are usual."""
    middle, still = 0.5 * (geometry.shape_vu[1] - 1), np.zeros(len(geometry))
    found = [
        _Mistake("", 1.0, middle, still),
        _Mistake(
            "if the columns are mirrored, the views in reverse order or source and detector "
            "exchanged; turn the images, or correct the geometry (its sense of rotation)",
            -1.0,
            middle,
            still,
        ),
        _Mistake("if pixels are half as large; correct the pixel size", 2.0, middle, still),
        _Mistake("if pixels are twice as large; correct the pixel size", 0.5, middle, still),
    ]
    normal = geometry.matrices[:, 2, :3]
    off = (geometry.matrices[:, 0, :3] * normal).sum(-1) - middle
    if np.abs(off).mean() > 1:
        said = "if the detector's offset along its columns has the other sign; correct it"
        found.append(_Mistake(said, 1.0, middle, -2 * off))
    return found


def objection(projections: Projections) -> str | None:
    """A line where images and geometry do not seem to belong together; None where they do, or
    where no two views measure the same.
    """
    geometry = projections.geometry
    rays = OppositeRays.of(geometry)
    plain, *others = _mistakes(geometry)
    apart = rays.difference(projections, plain)
    if apart is None:
        return _of_planes(projections, plain, others, _PLANES_EXPLAINED)
    if apart < _NAMED_APART:
        return _of_planes(projections, plain, others, _EXPLAINS)
    left, mistake = _best(rays, projections, others)
    if not left < _EXPLAINS * apart and _goes_around(geometry):
        left, mistake = _best(rays, projections, [_shifted(rays, projections, plain)])
    begin = (
        "images and geometry do not fit: rays that two views measure from either end differ by "
        f"{100 * apart:.0f} % of their spread"
    )
    if left < _EXPLAINS * apart:
        sure = abs(mistake.scale) == 1 or (left < _SURELY * apart and apart >= _SURELY_APART)
        named = f"{begin}, by {100 * left:.0f} % only {mistake.said}"
        return named if sure else named + _OR_MOTION
    if apart < _APART:
        return _of_planes(projections, plain, others, _EXPLAINS)
    general = f"{begin}; check the order of the views, the angles, the pixel size and the offsets"
    return general if apart >= _BEYOND_MOTION else general + _OR_MOTION


def _best(
    rays: OppositeRays, projections: Projections, mistakes: Sequence[_Mistake]
) -> tuple[float, _Mistake]:
    """(the least difference that one of the mistakes leaves, that one)."""
    found = [rays.difference(projections, mistake) for mistake in mistakes]
    left = [np.inf if difference is None else difference for difference in found]
    best = int(np.argmin(left))
    return left[best], mistakes[best]


def _goes_around(geometry: ConeBeamGeometry) -> bool:
    """Whether the views are all around: what moves in a part of a turn looks like a shift."""
    arms = geometry.sources() - geometry.rotation_center()
    plane = np.linalg.svd(arms, full_matrices=False)[2][:2]  # that of the rotation
    along, across = plane @ arms.T
    angles = np.sort(np.arctan2(across, along))
    return bool(np.diff(angles, append=angles[0] + 2 * np.pi).max() < _WIDEST_GAP)


def _shifted(rays: OppositeRays, projections: Projections, plain: _Mistake) -> _Mistake:
    """The shift of the columns by which both readings differ least."""
    geometry = projections.geometry

    def difference(columns: float) -> float:
        shifted = replace(plain, shift=np.full(len(geometry), columns))
        found = rays.difference(projections, shifted)
        return np.inf if found is None else found

    most = _MOST_SHIFT * geometry.shape_vu[1]
    tried = np.linspace(-most, most, _SHIFTS)
    near = float(tried[np.argmin([difference(columns) for columns in tried])])
    step = float(tried[1] - tried[0])
    fine = np.linspace(near - step, near + step, _SHIFTS)
    best = float(fine[np.argmin([difference(columns) for columns in fine])])
    return replace(
        plain,
        said=f"if what they show stands {abs(best):.2g} columns "
        f"({1e3 * geometry.pixel_pitch * abs(best):.3g} mm) nearer to the "
        f"{'last' if best > 0 else 'first'} than the geometry has it; correct the detector's "
        "offset along its columns",
        shift=np.full(len(geometry), best),
    )


def _of_planes(
    projections: Projections, plain: _Mistake, others: Sequence[_Mistake], share: float
) -> str | None:
    """A line where a mistake leaves at most a share of the difference between planes that two views
    measure; a difference by itself may be motion, or a body that reaches beyond the detector.
    """
    planes = SharedPlanes.of(projections.geometry)
    apart = planes.difference(projections, plain)
    if apart is None or apart < _PLANES_APART:
        return None
    kept = [other for other in others if abs(other.scale) == 1]
    differences = [(planes.difference(projections, other), other.said) for other in kept]
    left, said = min((d, said) for d, said in [*differences, (apart, "")] if d is not None)
    if left > share * apart:
        return None
    return (
        "images and geometry do not seem to fit: planes that two views measure differ by "
        f"{100 * apart:.2g} %, by {100 * left:.2g} % only {said}"
    )
