"""Whether images and geometry belong together, by planes that two views measure.

A plane through the sources of two views is a fan of rays from each. A fan's line integrals, each
over the cosine of its angle to the normal of the line between the sources, add up to the integral
of attenuation over the distance from that line, which is the same for both (the condition of order
0 of sources on a line: Clackdoyle, Phys. Med. Biol. 58 (2013); by planes of a cone beam: Lesaint et
al., Med. Phys. 44 (2017)). It needs no more than a few degrees between two views, but objects that
the fans see whole.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections

_VIEWS = 24
"""that are compared with each other"""

_BETWEEN = (np.radians(15.0), np.radians(90.0))
"""rad between two views: nearer ones always agree; from farther ones the object may reach the line
between the sources
"""

_PLANES, _RAYS = 24, 256
"""per pair of views, and per plane"""

_REACH = 2.0
"""of the field of view's radius, to which planes are followed: a fan that looks by 45 degrees at
their middle meets all of a cylinder that is seen whole within 1.8
"""

_AIR = 0.03
"""of the largest reading: more at a detector's side is an object that is cut off"""

_FEWEST = 100
"""planes that say something"""


@dataclass(frozen=True, slots=True, eq=False)
class SharedPlanes:
    """Pairs of views whose sources share planes through the object."""

    geometry: ConeBeamGeometry
    pairs: np.ndarray
    """(pairs, 2) views"""

    @classmethod
    def of(cls, geometry: ConeBeamGeometry) -> "SharedPlanes":
        """Pairs among some of the views, evenly over the scan."""
        numbers = np.unique(np.linspace(0, len(geometry) - 1, _VIEWS).astype(int))
        arms = geometry.sources()[numbers] - geometry.rotation_center()
        arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
        first, second = np.triu_indices(len(numbers), 1)
        between = np.arccos(np.clip((arms[first] * arms[second]).sum(-1), -1.0, 1.0))
        some = (between > _BETWEEN[0]) & (between < _BETWEEN[1])
        return cls(geometry, np.stack([numbers[first[some]], numbers[second[some]]], axis=1))

    def difference(
        self,
        projections: Projections,
        mapped: Callable[[FloatArray, np.ndarray], FloatArray],
    ) -> float | None:
        """RMS difference of both sums over their mean. None where too few planes are seen whole.

        ``mapped`` moves pixels (1, rays, 2) of a view (1,) to where they would be under a mistake.
        """
        rows, columns = self.geometry.shape_vu
        means = (max(rows // _PLANES, 1), max(columns // _RAYS, 1))
        images = {
            view: ndimage.uniform_filter(projections.line_integrals[view], means)
            for view in map(int, np.unique(self.pairs))
        }
        air = _AIR * max((float(image.max()) for image in images.values()), default=0.0)
        sums = [
            np.stack([self._fan(images[view], view, points, step, mapped, air) for view in pair])
            for pair, points, step in self._planes()
        ]
        if not sums:
            return None
        both = np.concatenate(sums, axis=1)
        both = both[:, np.isfinite(both).all(0)]
        mean = float(both.mean()) if both.shape[1] >= _FEWEST else 0.0
        if mean <= 0:
            return None
        return float(np.sqrt(np.mean((both[0] - both[1]) ** 2) / 2)) / mean

    def _planes(self) -> Iterator[tuple[np.ndarray, FloatArray, float]]:
        """Per pair: its views, points (planes, rays, 3) in m on the plane through the rotation
        center that lies along the line between the sources, and the step between rays in m.
        """
        sources, center = self.geometry.sources(), self.geometry.rotation_center()
        rows, columns = self.geometry.shape_vu
        away = float(np.linalg.norm(sources - center, axis=-1).mean())
        half = 0.5 * away / float(self.geometry.focal_lengths().mean())
        along = _REACH * half * columns * np.linspace(-1, 1, _RAYS)
        stacked = self.geometry.row_pitch() / self.geometry.pixel_pitch
        heights = half * rows * stacked * np.linspace(-1, 1, _PLANES)
        for pair in self.pairs:
            line = sources[pair[1]] - sources[pair[0]]
            line /= np.linalg.norm(line)
            inwards = center - sources[pair].mean(0)
            up = np.cross(line, inwards)
            up /= np.linalg.norm(up)
            points = center + heights[:, None, None] * up + along[None, :, None] * line
            yield pair, np.asarray(points, np.float64), float(along[1] - along[0])

    def _fan(
        self,
        image: FloatArray,
        view: int,
        points: FloatArray,
        step: float,
        mapped: Callable[[FloatArray, np.ndarray], FloatArray],
        air: float,
    ) -> FloatArray:
        """(planes,) sums of the rays from a view's source through points (planes, rays, 3), NaN
        where the detector does not see a plane whole.
        """
        rows, columns = self.geometry.shape_vu
        matrix = self.geometry.matrices[view]
        seen = points @ matrix[:, :3].T + matrix[:, 3]
        pixels = mapped(seen[..., :2] / seen[..., 2:], np.full(points.shape[:2], view))
        u, v = np.moveaxis(pixels, -1, 0)
        beside = (u < 0) | (u > columns - 1) | (seen[..., 2] <= 0)
        read = ndimage.map_coordinates(image, [v, u], np.float64, order=1, mode="nearest")
        cut_off = (beside & (read > air)).any(1) | ~(u.min(1) < 0) | ~(u.max(1) > columns - 1)
        above = (~beside & ((v < 0) | (v > rows - 1))).any(1)
        read[beside] = 0.0
        sums = (read / np.linalg.norm(points - self.geometry.sources()[view], axis=-1)).sum(1)
        return np.where(cut_off | above, np.nan, step * sums)
