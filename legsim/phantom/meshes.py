"""Closed triangle meshes with an attenuation each; later ones displace earlier ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One closed surface, outward-oriented, and its filling."""

    name: str
    material: str
    attenuation: float
    """1/m of the filling itself (not a difference)"""
    vertices: FloatArray
    """(p, 3) m, in world (of the reference pose where the part moves)"""
    triangles: np.ndarray
    """(t, 3) int32, anticlockwise seen from outside"""

    def __repr__(self) -> str:
        return f"Part({self.name}: {self.material}, {len(self.triangles)} triangles)"

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "vertices", frozen(f"part {self.name!r} vertices", self.vertices, (None, 3))
        )
        object.__setattr__(
            self,
            "triangles",
            frozen(f"part {self.name!r} triangles", self.triangles, (None, 3), np.int32),
        )
        if (
            len(self.triangles) == 0
            or self.triangles.min() < 0
            or self.triangles.max() >= len(self.vertices)
        ):
            raise LegsimError(
                f"part {self.name!r} has no triangles, or some that name vertices it does not "
                f"have (0..{len(self.vertices) - 1})"
            )
        if (
            not np.isfinite(self.vertices).all()
            or not np.isfinite(self.attenuation)
            or self.attenuation < 0
        ):
            raise LegsimError(
                f"part {self.name!r} has a vertex or an attenuation that is not a finite number "
                "(attenuation at least 0)"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Phantom:
    """Parts in order of priority.

    At any point the last part that contains it decides the attenuation; outside all it is 0.
    """

    parts: tuple[Part, ...]

    def __repr__(self) -> str:
        count = sum(len(part.triangles) for part in self.parts)
        return f"Phantom({len(self.parts)} parts, {count} triangles)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        names = [part.name for part in self.parts]
        doubles = sorted({n for n in names if names.count(n) > 1})
        if not names or doubles:
            raise LegsimError(
                "a phantom needs parts with different names; repeated: "
                f"{', '.join(doubles) or 'none, but it has no part'}"
            )

    def only(self, indices: Sequence[int]) -> "Phantom":
        """Restricts the phantom to some of its parts, in the order given."""
        return Phantom(tuple(self.parts[k] for k in indices))

    def with_vertices(self, vertices: "tuple[FloatArray, ...]") -> "Phantom":
        """Replaces the vertices of the parts: one (p, 3) array per part."""
        return Phantom(
            tuple(
                replace(part, vertices=moved)
                for part, moved in zip(self.parts, vertices, strict=True)
            )
        )


def sphere(radius: float) -> tuple[FloatArray, np.ndarray]:
    """Vertices (162, 3) m about the origin and triangles (320, 3) of a sphere of ``radius`` m."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(ball.vertices), np.asarray(ball.faces)
