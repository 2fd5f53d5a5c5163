"""The minima of inverse kinematics at single frames, and which of them are one movement.

A straight leg that carries one marker at its knee fits almost as well turned in as turned out, so a
frame may have several minima. Each is followed through the recording, by solutions that start from
the one before, and belongs to the movement in which it arrives. Of all movements the one with the
fewest jumps is kept, and of those the cheapest (dynamic programming, Viterbi 1967).
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics._ik_newton import minimize
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.leg import Leg

_POSTURES_DEG = ((10.0, -10.0, 0.0), (50.0, -60.0, 15.0), (90.0, -100.0, 30.0))
"""hip flexion, knee angle, ankle angle that an anchor frame is tried from: standing, half and deep
squat
"""

_BENT = np.radians(-40.0)
"""rad of a knee's turn to the right beyond which a thigh cannot be turned either way"""

_TURN = np.radians(30.0)
"""rad that such a thigh is turned by to find the other minimum"""

_SAME = np.radians(0.2)
"""rad that one minimum may be found apart: its valley is flat"""

_ABSURD = 3.0
"""times the cost of the best minimum of its frame (and of an error of 2 mm) a minimum is left out,
such as a shank that is turned about
"""

ENOUGH, _ENOUGH_NEARBY = 25, 10
"""iterations after which a start, from afar or from the frame before, is near its minimum; along a
flat valley it may take hundreds
"""

_MOST = 8
"""minima of a frame that are kept, the cheapest"""

_LEFT_OPEN = ("ankle", "subtalar", "mtp")
"""beginnings of coordinates that do not tell minima apart: the floor decides them where the foot
shows no marker
"""


@dataclass(slots=True)
class Minima:
    """The minima of one frame, the cheapest first when found, followed ones behind."""

    problem: Problem
    measured: FloatArray
    """(m, 3) m"""
    weights: FloatArray
    """(m,)"""
    values: list[FloatArray] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)

    def place(self, values: FloatArray, cost: float) -> int | None:
        """Which one ``values`` (c,) is: that with which it shares a valley."""
        for k, known in enumerate(self.values):
            if same(self.problem.leg, known, values) or not self._ridge(
                known, values, max(self.costs[k], cost)
            ):
                return k
        return None

    def add(self, values: FloatArray, cost: float) -> int | None:
        """Which one ``values`` is, after adding it where it is new; None where it is absurd or one
        too many.
        """
        place = self.place(values, cost)
        if place is None and cost <= self._absurd(cost) and len(self.values) < _MOST:
            self.values.append(values)
            self.costs.append(cost)
            return len(self.values) - 1
        return place

    def _absurd(self, first: float) -> float:
        best = min([first, *self.costs])
        return _ABSURD * (best + 0.5 * 0.002**2 * float(self.weights.sum()))

    def _ridge(self, one: FloatArray, other: FloatArray, cost: float) -> bool:
        """Whether the cost rises on the straight way between two solutions."""
        way = one + _ON_THE_WAY[:, None] * (other - one)
        n = len(way)
        between = self.problem.at(
            way,
            self.measured[None].repeat(n, 0),
            self.weights[None].repeat(n, 0),
            np.zeros(n, bool),
        )
        return bool(between.cost.max() > cost * (1 + 1e-6))


_ON_THE_WAY = np.array([0.25, 0.5, 0.75])


def same(leg: Leg, one: FloatArray, other: FloatArray) -> bool:
    """Whether two solutions (c,) of a frame are one minimum."""
    apart = np.abs(one - other)
    return all(
        apart[k] < _SAME
        for k, name in enumerate(leg.coordinate_names)
        if k >= leg.pelvis_coordinates and not name.startswith(_LEFT_OPEN)
    )


def find(
    problem: Problem, pelvis: FloatArray, measured: FloatArray, weights: FloatArray
) -> list[Minima]:
    """The minima of each frame (pelvis (n, p) from its own markers) that starts from scratch lead
    to.
    """
    n, leg = len(pelvis), problem.leg
    starts = np.concatenate([_posture(leg, pelvis, posture) for posture in _POSTURES_DEG])
    found, costs = _solved(problem, starts, measured, weights)
    best = found.reshape(len(_POSTURES_DEG), n, -1)[costs.reshape(-1, n).argmin(0), np.arange(n)]
    straight = np.flatnonzero(_straight(leg, best))
    if len(straight):
        turned = np.concatenate([_turned(leg, best[straight], *signs) for signs in _SIGNS])
        more, more_costs = _solved(problem, turned, measured[straight], weights[straight])
        found, costs = np.concatenate([found, more]), np.concatenate([costs, more_costs])
    owner = np.concatenate([np.tile(np.arange(n), len(_POSTURES_DEG)), np.tile(straight, 4)])
    minima = []
    for frame in range(n):
        here = np.flatnonzero(owner == frame)
        here = here[np.argsort(costs[here], kind="stable")]
        known = Minima(problem, np.nan_to_num(measured[frame]), weights[frame])
        for k in here:
            known.add(found[k], float(costs[k]))
        minima.append(known)
    return minima


_SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def _posture(leg: Leg, pelvis: FloatArray, degrees: tuple[float, float, float]) -> FloatArray:
    start = np.tile(leg.posture(*np.radians(degrees)), (len(pelvis), 1))
    start[:, : pelvis.shape[1]] = pelvis
    return start


def _straight(leg: Leg, values: FloatArray) -> np.ndarray:
    """(n,) whether a knee is bent by less than _BENT, whichever sign the model gives it."""
    extended, bent = leg.posture(0.0, 0.0, 0.0), leg.posture(0.0, _BENT, 0.0)
    knees = np.flatnonzero(bent != extended)
    share = (values[:, knees] - extended[knees]) / (bent - extended)[knees]
    return np.asarray((share < 1).any(1))


def _turned(leg: Leg, values: FloatArray, right: int, left: int) -> FloatArray:
    """Thighs turned in or out, knees all but straight."""
    turned, straight = values.copy(), leg.posture(0.0, np.radians(-5.0), 0.0)
    knees = np.flatnonzero(straight != leg.posture(0.0, 0.0, 0.0))
    turned[:, knees] = straight[knees]
    for side, sign in (("r", right), ("l", left)):
        name = f"hip_rotation_{side}"
        if name in leg.coordinate_names:
            turned[:, leg.coordinate_names.index(name)] = sign * _TURN
    return turned


def _solved(
    problem: Problem, starts: FloatArray, measured: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solutions and costs of ``starts``, a whole number of times as many as there are frames."""
    times = len(starts) // len(measured)
    state, _, _ = minimize(
        problem,
        starts,
        np.tile(measured, (times, 1, 1)),
        np.tile(weights, (times, 1)),
        iterations_at_most=ENOUGH,
    )
    return state.values, state.cost


@dataclass(frozen=True, slots=True)
class _Track:
    """A minimum followed from one anchor frame to its neighbor."""

    end: int | None
    """which minimum of the neighbor it arrives at"""
    cost: float
    """sum over the frames on the way, the neighbor included"""
    values: FloatArray
    """(s, c) on the way"""


class Course:
    """Minima at anchor frames, followed forwards and backwards over the frames between them."""

    def __init__(
        self,
        problem: Problem,
        minima: list[Minima],
        anchors: np.ndarray,
        frames: np.ndarray,
        measured: FloatArray,
        weights: FloatArray,
        pelvis: FloatArray,
    ) -> None:
        """``frames``: those to step on, anchors among them; markers, weights and pelvis are
        theirs.
        """
        self._problem, self._minima = problem, minima
        self._places = np.searchsorted(frames, anchors)
        self._measured, self._weights, self._pelvis = measured, weights, pelvis
        self._ahead: list[dict[int, _Track]] = [{} for _ in anchors]
        self._behind: list[dict[int, _Track]] = [{} for _ in anchors]
        while self._follow():
            pass

    def _follow(self) -> bool:
        """Follows every minimum that was not yet, one anchor ahead and one back; whether there was
        any.
        """
        last = len(self._minima) - 1
        to_do = [
            (a, k, way)
            for way, tracks in ((1, self._ahead), (-1, self._behind))
            for a in range(last + 1)
            for k in range(self._count(a))
            if 0 <= a + way <= last
            and k not in tracks[a]
            and max(self._count(a), self._count(a + way)) > 1
        ]
        for (a, k, way), path in zip(to_do, self._walk(to_do), strict=True):
            tracks = self._ahead if way > 0 else self._behind
            tracks[a][k] = self._arrived(a + way, *path)
        return bool(to_do)

    def _count(self, anchor: int) -> int:
        return len(self._minima[anchor].values)

    def _walk(self, to_do: list[tuple[int, int, int]]) -> list[tuple[FloatArray, FloatArray]]:
        """Values (s, c) and costs (s,) on each of the ways, from minimum k of an anchor to the
        next one or the one before.
        """
        now = np.array([self._minima[a].values[k] for a, k, _ in to_do])
        ways = np.array([way for _, _, way in to_do], int)
        at = self._places[[a for a, _, _ in to_do]]
        last = self._places[[a + way for a, _, way in to_do]]
        paths: list[list[tuple[FloatArray, float]]] = [[] for _ in to_do]
        while (going := np.flatnonzero(at != last)).size:
            step = at[going] + ways[going]
            starts = now[going]
            shift = self._pelvis[step] - self._pelvis[at[going]]
            starts[:, : shift.shape[1]] += np.where(np.isfinite(shift), shift, 0.0)
            state, _, _ = minimize(
                self._problem,
                starts,
                self._measured[step],
                self._weights[step],
                iterations_at_most=_ENOUGH_NEARBY,
            )
            now[going], at[going] = state.values, step
            for row, values, cost in zip(going, state.values, state.cost, strict=True):
                paths[row].append((values, float(cost)))
        return [(np.array([v for v, _ in path]), np.array([c for _, c in path])) for path in paths]

    def _arrived(self, anchor: int, values: FloatArray, costs: FloatArray) -> _Track:
        end = self._minima[anchor].add(values[-1], float(costs[-1]))
        return _Track(end, float(costs.sum()), values)

    def best(self) -> tuple[np.ndarray, FloatArray]:
        """Places in ``frames`` (s,) and values (s, c) of the movement with the fewest jumps, the
        cheapest of those.
        """
        chosen = self._cheapest()
        places, values = [self._places[0]], [self._minima[0].values[chosen[0]]]
        for a, (k, then) in enumerate(pairwise(chosen)):
            if k in self._ahead[a] and self._joined(a, k, then):
                places += range(self._places[a] + 1, self._places[a + 1])
                values += list(self._ahead[a][k].values[:-1])
            places.append(self._places[a + 1])
            values.append(self._minima[a + 1].values[then])
        return np.array(places), np.array(values)

    def _cheapest(self) -> list[int]:
        """Which minimum of each anchor."""
        score = [(0, cost) for cost in self._minima[0].costs]
        origins: list[list[int]] = []
        for a in range(len(self._minima) - 1):
            reached = [
                min((self._step(score[k], a, k, then), k) for k in range(len(score)))
                for then in range(self._count(a + 1))
            ]
            score = [total for total, _ in reached]
            origins.append([origin for _, origin in reached])
        chosen = [min(range(len(score)), key=score.__getitem__)]
        for origin in reversed(origins):
            chosen.append(origin[chosen[-1]])
        return chosen[::-1]

    def _step(self, before: tuple[int, float], a: int, k: int, then: int) -> tuple[int, float]:
        """Jumps and cost so far after going on from minimum k of anchor a to ``then`` of the
        next.
        """
        jumps, cost = before
        if self._joined(a, k, then):
            track = self._ahead[a].get(k)
            return jumps, cost + (track.cost if track else self._straight_cost(a, then))
        return jumps + 1, cost + self._straight_cost(a, then)

    def _straight_cost(self, a: int, then: int) -> float:
        steps = int(self._places[a + 1] - self._places[a])
        return steps * self._minima[a + 1].costs[then]

    def _joined(self, a: int, k: int, then: int) -> bool:
        """Whether the two are one movement: either leads to the other. A single minimum at both
        ends is.
        """
        if self._count(a) == self._count(a + 1) == 1:
            return True
        return self._ahead[a][k].end == then and self._behind[a + 1][then].end == k
