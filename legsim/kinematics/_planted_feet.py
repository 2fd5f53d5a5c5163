"""Feet that stand still on the floor: points that neither move in the world nor on the foot.

Two lateral markers hardly see how far a straight leg is turned about itself. But a foot that stays
where it is keeps its heading, so the heading that is seen while the knee is bent holds while it is
straight. Each foot that stands carries two pegs, far points ahead of it and above it. In the world
they stay where they are, but for what foot, subtalar joint and a knee that is no hinge allow. Where
they are on the foot, that is how far it is turned out, registration finds with all other places.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.values import FloatArray, frozen_owned
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import segment_index
from legsim.mocap.trajectories import MarkerTrajectories

PLAY = np.radians(3.0)
"""rad that a foot on the floor turns about any axis against the model's, per posture: in squats of
two people with markers on their feet, headings ranged over 3 to 5 degrees and soles tilted by 2
(standard deviation), and shanks turn in the knee as it bends, which the model's do not
"""

_FAR = 1.0
"""m from the foot's origin to its pegs: so far that they hold the foot's directions, not its place
"""

_AXES = {"ahead": (1.0, 0.0, 0.0), "above": (0.0, 1.0, 0.0)}

_SPREADS = {
    "ahead": (0.02, _FAR * np.radians(5.0), _FAR * np.radians(20.0)),
    "above": (_FAR * np.radians(5.0), 0.02, _FAR * np.radians(5.0)),
}
"""m along x, y, z of the foot: where pegs may be on it; the heading that is seen before
registration is right within 20 degrees, and soles are level within 5
"""

_STAYS = 0.012
"""m that an ankle may wander on the floor while its foot stands: the skin over it slides by half of
that, and a foot that pivots by 15 degrees moves it by more
"""

_LASTS = 2.0
"""s that a foot stands at least; in walking, feet stand for less than 1 s"""

_BENDS = np.radians(40.0)
"""rad that the knee bends at least during a stay: only a bent knee shows the foot's heading"""

_FADES = 0.5
"""s at the ends of a stay in which its pegs come to count"""

_MOST = 3
"""stays of a foot that are used, the longest"""

_NEAR = 0.1
"""m from the ankle's center to a marker that shows how the foot stays"""


@dataclass(frozen=True, slots=True, eq=False)
class Pegs:
    """Points fixed to feet that stand."""

    sites: MarkerSites
    """on the feet; as found, their weights count beside markers of an error of 1 m"""
    targets: FloatArray
    """(p, 3) m in world"""
    shares: FloatArray
    """(n, p) by how much each counts in each frame: 0 where the foot does not stand there, 1 where
    it does, between at the ends of its stay, so that no step shows
    """

    def at(self, sites: MarkerSites) -> "Pegs":
        """The same pegs at the places among ``sites``."""
        return Pegs(sites.only(self.sites.names), self.targets, self.shares)

    def shown_with(self, seen: np.ndarray) -> FloatArray:
        """(n, m + p) which markers (n, m) are seen, 0 or 1, and how much the pegs count."""
        return np.concatenate([seen, self.shares], axis=1)

    def beside_markers(self, measured: FloatArray) -> FloatArray:
        """(n, m + p, 3) where markers (n, m, 3) and pegs are."""
        n = len(measured)
        return np.concatenate([measured, np.tile(self.targets, (n, 1, 1))], axis=1)

    def beside(self, sites: MarkerSites) -> MarkerSites:
        """Markers, and the pegs behind them."""
        pegs = self.sites
        return MarkerSites(
            (*sites.names, *pegs.names),
            (*sites.segments, *pegs.segments),
            np.concatenate([sites.positions, pegs.positions]),
            np.concatenate([sites.weights, pegs.weights]),
        )


def spread(name: str) -> tuple[float, float, float] | None:
    """m along x, y, z of the foot: how uncertain the place of a peg is; None for a marker."""
    return _SPREADS[name.split(":")[1]] if is_peg(name) else None


def is_peg(name: str) -> bool:
    """Whether a site is a peg, not a marker."""
    return name.startswith("peg:")


def sides(names: Sequence[str]) -> frozenset[str]:
    """The sides, r and l, whose feet have pegs among some sites."""
    return frozenset(name.split(":")[2] for name in names if is_peg(name))


def weighed(sites: MarkerSites, error: float) -> MarkerSites:
    """Sites whose pegs count beside markers of this error, m."""
    unit = np.where([is_peg(name) for name in sites.names], error**2, 1.0)
    return MarkerSites(sites.names, sites.segments, sites.positions, sites.weights * unit)


def find(
    leg: Leg,
    sites: MarkerSites,
    motion: MarkerTrajectories,
    chosen: np.ndarray,
    values: FloatArray,
) -> Pegs | None:
    """Pegs of the feet that stand for a while and carry no marker; None where none does.

    Args:
        leg: scaled.
        sites: of the markers.
        motion: markers named like ``sites``, n frames.
        chosen: (s,) frames that differ in posture; a foot has pegs where its knee bends.
        values: (s, c) coordinates of the leg in those, about as the markers have it.
    """
    pose, found = leg.kinematics(values), []
    for side in "rl":
        foot = segment_index(f"calcn_{side}")
        path = _ankle_path(leg, sites, motion, side)
        shank, thigh = (segment_index(f"{bone}_{side}") for bone in ("tibia", "femur"))
        aligned = (pose.rotations[:, thigh, :, 1] * pose.rotations[:, shank, :, 1]).sum(-1)
        bend = np.arccos(np.clip(aligned, -1.0, 1.0))
        for stay in () if path is None else _stays(motion.times, path):
            here = np.isin(chosen, stay)
            if not here.any() or np.ptp(bend[here]) < _BENDS:
                continue
            bent = here & (bend > bend[here].min() + _BENDS / 2)
            ahead = pose.rotations[bent, foot, :, 0].mean(0) * (1.0, 0.0, 1.0)
            origin = np.median(pose.origins[bent, foot], axis=0)
            share = _share(motion.times, stay)
            for way, axis in _AXES.items():
                direction = ahead / np.linalg.norm(ahead) if way == "ahead" else np.array(axis)
                found.append((way, side, _FAR * np.array(axis), origin + _FAR * direction, share))
    if not found:
        return None
    ways, sides, places, targets, shares = zip(*found, strict=True)
    sites = MarkerSites(
        tuple(
            f"peg:{way}:{side}:{k}" for k, (way, side) in enumerate(zip(ways, sides, strict=True))
        ),
        tuple(f"calcn_{side}" for side in sides),
        np.array(places),
        np.full(len(found), (_FAR * PLAY) ** -2.0),
    )
    return Pegs(sites, frozen_owned(np.array(targets)), frozen_owned(np.stack(shares, axis=1)))


def _share(times: FloatArray, stay: np.ndarray) -> FloatArray:
    """(n,) 1 inside a stay, 0 outside; it rises and falls smoothly, but not at the recording's own
    ends.
    """
    share = np.zeros(len(times))
    since = times[stay] - times[stay[0]] if stay[0] > 0 else np.inf
    until = times[stay[-1]] - times[stay] if stay[-1] < len(times) - 1 else np.inf
    part = np.clip(np.minimum(since, until) / _FADES, 0.0, 1.0)
    share[stay] = part**2 * (3 - 2 * part)
    return share


def _ankle_path(
    leg: Leg, sites: MarkerSites, motion: MarkerTrajectories, side: str
) -> FloatArray | None:
    """(n, 3) m: the marker at the ankle, moved along the shank to the height of the joint's center,
    where bending the ankle does not move it; NaN where the hips are not above. None without such a
    marker, or where the foot has markers of its own.
    """
    if {f"{bone}_{side}" for bone in _FOOT} & set(sites.segments):
        return None
    pose = leg.kinematics(leg.default_coordinates[None])
    thigh, shank, below = (segment_index(f"{s}_{side}") for s in ("femur", "tibia", "talus"))
    knee_center, ankle_center = (
        (pose.origins[0, end] - pose.origins[0, start]) @ pose.rotations[0, start]
        for start, end in ((thigh, shank), (shank, below))
    )
    knee = _nearest(sites, f"femur_{side}", knee_center)
    ankle = _nearest(sites, f"tibia_{side}", ankle_center)
    if knee is None or ankle is None:
        return None
    up = -ankle_center / np.linalg.norm(ankle_center)
    above = float((sites.position(ankle) - ankle_center) @ up)
    line = motion.marker(knee) - motion.marker(ankle)
    path = motion.marker(ankle) - above * line / np.linalg.norm(line, axis=1, keepdims=True)
    pelvis = [n for n, s in zip(sites.names, sites.segments, strict=True) if s == "pelvis"]
    hips = np.mean([motion.marker(name)[:, 1] for name in pelvis], axis=0)
    upright = hips - path[:, 1] > 0.5 * leg.shank_length(side)
    return np.where(upright[:, None], path, np.nan)


_FOOT = ("talus", "calcn", "toes")


def _nearest(sites: MarkerSites, segment: str, center: FloatArray) -> str | None:
    """The marker on a segment that is nearest to a point of it, if any is near."""
    away = {
        name: float(np.linalg.norm(sites.position(name) - center))
        for name, carrier in zip(sites.names, sites.segments, strict=True)
        if carrier == segment
    }
    near = min(away, key=away.__getitem__, default=None)
    return near if near is not None and away[near] < _NEAR else None


def _stays(times: FloatArray, path: FloatArray) -> Sequence[np.ndarray]:
    """The frames of each of the longest times in which a path (n, 3) stays in place."""
    floor, found, first = path[:, [0, 2]], [], 0
    while first < len(floor):
        last, low, high = first, floor[first], floor[first]
        while last < len(floor):
            low, high = np.minimum(low, floor[last]), np.maximum(high, floor[last])
            # not where the path is not known
            if not np.hypot(*(high - low)) <= _STAYS:
                break
            last += 1
        if last > first and times[last - 1] - times[first] >= _LASTS:
            found.append(np.arange(first, last))
        first = max(last, first + 1)
    return sorted(found, key=len, reverse=True)[:_MOST]
