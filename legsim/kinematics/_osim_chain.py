"""A tree of OpenSim joints in motion, many samples at once: poses, screws and time derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.kinematics._osim_functions import is_identity
from legsim.kinematics.osim_file import Joint, JointAxis

_EYE = np.eye(3)


class _Axis(NamedTuple):
    """A joint's axis made ready."""

    axis: JointAxis
    column: int
    """of its coordinate; -1 where its function is constant"""
    skew: FloatArray
    """(3, 3) cross product with its direction"""
    square: FloatArray
    """(3, 3) the same twice"""
    free: bool
    """whether it moves by its coordinate itself"""

    def turned(self, angle: FloatArray) -> FloatArray:
        """(n, 3, 3) turns about it (Rodrigues)."""
        s, c = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
        return _EYE + s * self.skew + c * self.square


class _Link(NamedTuple):
    """A joint made ready."""

    joint: Joint
    parent: int
    """index of the parent body, -1 for ground"""
    p: FloatArray
    """(4, 4) parent_from_p"""
    c_inverse: FloatArray
    """(4, 4) c_from_child"""
    rotations: tuple[_Axis, ...]
    translations: tuple[_Axis, ...]


class Screws(NamedTuple):
    """Poses of all bodies and how each coordinate moves what hangs on it, n samples."""

    rotations: FloatArray
    """(n, b, 3, 3) world_from_body"""
    origins: FloatArray
    """(n, b, 3)"""
    angular: FloatArray
    """(n, c, 3) turn per unit of each coordinate"""
    linear: FloatArray
    """(n, c, 3) shift of the point at the world's origin per unit of each coordinate"""


class Jet(NamedTuple):
    """A pose (n, 4, 4) with its first and second time derivative."""

    value: FloatArray
    first: FloatArray
    second: FloatArray

    def __matmul__(self, other: "Jet") -> "Jet":
        return Jet(
            self.value @ other.value,
            self.first @ other.value + self.value @ other.first,
            self.second @ other.value + 2 * self.first @ other.first + self.value @ other.second,
        )


class Chain:
    """Joints in an order that has parents first; bodies are numbered as the joints that carry
    them.
    """

    def __init__(self, joints: Sequence[Joint]) -> None:
        self.bodies = tuple(joint.child for joint in joints)
        self.coordinates = tuple(c for joint in joints for c in joint.coordinates)
        self.names = tuple(c.name for c in self.coordinates)
        self._links = [
            _Link(
                joint,
                -1 if joint.parent == "ground" else self.bodies.index(joint.parent),
                joint.parent_from_p,
                transforms.inverse(joint.child_from_c),
                tuple(map(self._ready, joint.rotations)),
                tuple(map(self._ready, joint.translations)),
            )
            for joint in joints
        ]
        self.moves = self._moves()
        """(c, b) whether a coordinate's joint lies between the world and a body"""
        self.turning = frozenset(
            a.coordinate for joint in joints for a in joint.rotations if a.coordinate
        )
        """names of the coordinates that turn something"""

    def _ready(self, axis: JointAxis) -> _Axis:
        skew = transforms.cross_matrix(axis.direction)
        column = self.names.index(axis.coordinate) if axis.coordinate else -1
        return _Axis(axis, column, skew, skew @ skew, is_identity(axis.function))

    def _moves(self) -> np.ndarray:
        moves = np.zeros((len(self.names), len(self.bodies)), bool)
        for b, link in enumerate(self._links):
            if link.parent >= 0:
                moves[:, b] = moves[:, link.parent]
            for c in link.joint.coordinates:
                moves[self.names.index(c.name), b] = True
        return moves

    def parent_of(self, body: int) -> int:
        """Index of the parent body, -1 for ground."""
        return self._links[body].parent

    def joint_of(self, body: int) -> Joint:
        """The joint that carries a body."""
        return self._links[body].joint

    def poses(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (n, b, 3, 3) and origins (n, b, 3) of all bodies at values (n, c)."""
        screws = self._walk(values, with_screws=False)
        return screws.rotations, screws.origins

    def screws(self, values: FloatArray) -> Screws:
        """Poses and screws at values (n, c)."""
        return self._walk(values, with_screws=True)

    def centers(self, values: FloatArray) -> FloatArray:
        """Origins (n, b, 3) of the frame C of each body's joint, in world."""
        rotations, origins = self.poses(values)
        local = np.stack([link.joint.child_from_c[:3, 3] for link in self._links])
        return origins + (rotations @ local[..., None])[..., 0]

    def growth(self, values: FloatArray, factors: FloatArray) -> FloatArray:
        """(n, b, 3, b, 3) shift of each body's origin in world per relative growth of each body
        along each of its axes, at values (n, c).

        ``factors`` (b, 3) are those that the joints have been scaled by. Rotations do not change.
        """
        rotations, _ = self.poses(values)
        n, b = rotations.shape[:2]
        shift = np.zeros((n, b, 3, b, 3))
        for k, link in enumerate(self._links):
            if link.parent >= 0:
                up, turn = link.parent, rotations[:, link.parent]
                shift[:, k] = shift[:, up]
                shift[:, k, :, up] += turn * link.p[:3, 3]
                for ready in link.translations:
                    if not ready.free:
                        reach = np.abs(ready.axis.direction) * factors[up]
                        along = turn @ link.p[:3, :3] @ ready.axis.direction
                        size = self._of(ready, values)[0][:, None] * along
                        shift[:, k, :, up] += size[..., None] * (reach / reach.sum())
            shift[:, k, :, k] -= rotations[:, k] * link.joint.child_from_c[:3, 3]
        return shift

    def jets(
        self, values: FloatArray, rates: FloatArray, accelerations: FloatArray, body: int
    ) -> Jet:
        """Pose of one body with its time derivatives, from those (n, c) of the coordinates."""
        path, at = [], body
        while at >= 0:
            path.append(self._links[at])
            at = self._links[at].parent
        still = np.zeros((len(values), 4, 4))
        jet = Jet(still + np.eye(4), still, still)
        for link in reversed(path):
            shift = np.zeros((3, len(values), 3))
            for ready in link.translations:
                for k, part in enumerate(self._in_time(ready, values, rates, accelerations)):
                    shift[k] += part[:, None] * ready.axis.direction
            moved = [still.copy() for _ in range(3)]
            moved[0] += np.eye(4)
            for matrix, part in zip(moved, shift, strict=True):
                matrix[:, :3, 3] = part
            jet = jet @ Jet(still + link.p, still, still) @ Jet(*moved)
            for ready in link.rotations:
                jet = jet @ _turning_jet(ready, *self._in_time(ready, values, rates, accelerations))
            jet = jet @ Jet(still + link.c_inverse, still, still)
        return jet

    def _walk(self, values: FloatArray, *, with_screws: bool) -> Screws:
        n = len(values)
        rotations = np.empty((n, len(self._links), 3, 3))
        origins = np.empty((n, len(self._links), 3))
        angular, linear = np.zeros((2, n, len(self.names) if with_screws else 0, 3))
        for b, link in enumerate(self._links):
            if link.parent < 0:
                turn = np.broadcast_to(link.p[:3, :3], (n, 3, 3))
                center = np.broadcast_to(link.p[:3, 3], (n, 3))
            else:
                turn = rotations[:, link.parent] @ link.p[:3, :3]
                center = origins[:, link.parent] + rotations[:, link.parent] @ link.p[:3, 3]
            base = turn
            steps = []
            for ready in link.translations:
                size, slope = self._of(ready, values)
                along = base @ ready.axis.direction
                center = center + size[:, None] * along
                if with_screws and ready.column >= 0:
                    linear[:, ready.column] += slope[:, None] * along
            for ready in link.rotations:
                angle, slope = self._of(ready, values)
                if ready.column >= 0:
                    steps.append((ready.column, slope[:, None] * (turn @ ready.axis.direction)))
                turn = turn @ ready.turned(angle)
            if with_screws:
                for column, rate in steps:
                    angular[:, column] += rate
                    linear[:, column] += transforms.cross(center, rate)
            rotations[:, b] = turn @ link.c_inverse[:3, :3]
            origins[:, b] = center + turn @ link.c_inverse[:3, 3]
        return Screws(rotations, origins, angular, linear)

    def _of(self, ready: _Axis, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value (n,) of an axis and its slope by its coordinate."""
        x = values[:, ready.column] if ready.column >= 0 else values[:, 0] * 0
        if ready.free:
            return x, np.ones_like(x)
        value, first, _ = ready.axis.function.with_derivatives(x)
        return value, first

    def _in_time(
        self, ready: _Axis, values: FloatArray, rates: FloatArray, accelerations: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value (n,) of an axis with its first and second time derivative, by the chain rule."""
        c, function = ready.column, ready.axis.function
        if c < 0:
            nothing = np.zeros(len(values))
            return function.with_derivatives(nothing)[0], nothing, nothing
        value, first, second = function.with_derivatives(values[:, c])
        return value, first * rates[:, c], first * accelerations[:, c] + second * rates[:, c] ** 2


def _turning_jet(
    ready: _Axis, angle: FloatArray, rate: FloatArray, acceleration: FloatArray
) -> Jet:
    """A turn about a unit axis with its time derivatives: R' = w K R, R'' = (w' K + w^2 K^2) R."""
    w, alpha = rate[:, None, None], acceleration[:, None, None]
    turn = ready.turned(angle)
    matrices = np.zeros((3, len(angle), 4, 4))
    matrices[0, :, :3, :3], matrices[0, :, 3, 3] = turn, 1.0
    matrices[1, :, :3, :3] = w * (ready.skew @ turn)
    matrices[2, :, :3, :3] = (alpha * ready.skew + w**2 * ready.square) @ turn
    return Jet(*matrices)
