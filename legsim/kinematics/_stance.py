"""Whether a recording's feet stand on a floor: only then is a foot that no marker shows flat."""

from dataclasses import replace

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.trajectories import MarkerTrajectories

_UPRIGHT = 0.5
"""of a shank's length that its knee is above its ankle: 60 degrees off the vertical, as deep squats
and seats seldom are
"""

_LOW = 0.01
"""m above its lowest height (5th percentile) that every marker of a flat foot is"""

_FEW = 0.02
"""of the frames that show a foot: the flattest, where fewer have all markers low"""

_NEVER_FLAT = 0.03
"""m: a foot whose flattest frames are higher is in swing in all that show two of its markers"""

_BELOW_KNEE = ("tibia", "talus", "calcn", "toes")


def with_feet(config: IkOptions, motion: MarkerTrajectories, sites: MarkerSites) -> IkOptions:
    """The options for this recording: feet rest on the floor, or hang at neutral ankles from
    somebody who lies.
    """
    return replace(config, feet_on_floor=_stands(motion, sites))


def notes(motion: MarkerTrajectories, sites: MarkerSites) -> tuple[str, ...]:
    """A warning where nobody stands: another axis may point up, and gravity with it."""
    if _stands(motion, sites):
        return ()
    return (
        "warning: the shanks are not upright, as of somebody who lies or kneels: ankles are taken "
        "as neutral where no marker shows them; if somebody stands, give the axis that points up, "
        "as in --set motion.up=z",
    )


def flat_feet(motion: MarkerTrajectories, sites: MarkerSites) -> dict[str, np.ndarray]:
    """By foot (``calcn_r``, ``calcn_l``) whether (n,) it stands flat: all of its markers are as low
    as in any frame. Where no such frame shows them all, two do. Nowhere where they are hidden while
    it stands. Empty for a foot without two markers that some frame shows together.
    """
    found: dict[str, np.ndarray] = {}
    for foot in ("calcn_r", "calcn_l"):
        on_segments = zip(sites.names, sites.segments, strict=True)
        names = [n for n, at in on_segments if at == foot and n in motion.marker_names]
        seen = [h for h in (motion.marker(n)[:, 1] for n in names) if np.isfinite(h).any()]
        if len(seen) < 2:
            continue
        lifts = np.array([h - np.nanpercentile(h, 5) for h in seen])
        count = np.isfinite(lifts).sum(0)
        if (count >= 2).any():
            whole, partly = (_low(lifts, count >= least) for least in (len(lifts), 2))
            found[foot] = whole if (np.fmax.reduce(lifts)[whole] <= _LOW).any() else partly
    return found


def _low(lifts: FloatArray, shown: np.ndarray) -> np.ndarray:
    """Whether (n,) a foot is low by its markers' heights (m, n) over their lowest, NaN where not
    seen, of the frames that count.
    """
    lift = np.where(shown, np.fmax.reduce(lifts), np.inf)
    few = float(np.quantile(lift[shown], _FEW)) if shown.any() else np.inf
    return lift <= (max(_LOW, few) if few <= _NEVER_FLAT else -np.inf)


def _stands(motion: MarkerTrajectories, sites: MarkerSites) -> bool:
    """Whether a thigh is above its shank in half of the frames, on either leg: people stand on one.

    Also where no frame shows it.
    """
    upright = np.fmax(*(_height(motion, sites, side) for side in "rl"))
    upright = upright[np.isfinite(upright)]
    return upright.size == 0 or float(np.median(upright)) > _UPRIGHT


def _height(motion: MarkerTrajectories, sites: MarkerSites, side: str) -> FloatArray:
    """How far (n,) a thigh is above its shank, of the distance between them; NaN where not seen."""
    shank = _middle(motion, sites, tuple(f"{name}_{side}" for name in _BELOW_KNEE))
    thigh = _middle(motion, sites, (f"femur_{side}",))
    up = (_middle(motion, sites, ("pelvis",)) if np.isnan(thigh).all() else thigh) - shank
    return up[:, 1] / np.linalg.norm(up, axis=1)


def _middle(
    motion: MarkerTrajectories, sites: MarkerSites, segments: tuple[str, ...]
) -> FloatArray:
    """Mean (n, 3) of the markers on some segments; NaN where one is not seen, or without any."""
    carried = zip(sites.names, sites.segments, strict=True)
    names = [name for name, at in carried if at in segments and name in motion.marker_names]
    positions = [motion.marker(name) for name in names]
    return np.mean(positions, axis=0) if positions else np.full((len(motion.times), 3), np.nan)
