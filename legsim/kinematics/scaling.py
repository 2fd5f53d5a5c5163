"""One person's segment sizes and hip centers from markers on bony landmarks, in any trial:
standing, squatting or walking.

Only distances within a segment are used, or across a knee whose bend the same markers show: a squat
scales as well as a standing trial, where OpenSim's ScaleTool, which measures its model in the
default pose, would be biased. Each distance is the median over all frames that show it.

Hip centers: Harrington et al. 2007 (J Biomech 40:595-602), the regressions on pelvis width PW and
depth PD alone, from the middle of the ASIS: 0.24 PD + 9.9 mm back, 0.30 PW + 10.9 mm down, 0.33 PW
+ 7.3 mm to each side, in the plane of the ASIS and the sacrum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales, segment_index
from legsim.mocap.raw import unit_cure
from legsim.mocap.trajectories import MarkerTrajectories

_PLAUSIBLE = {  # m: from small children to the tallest adults, markers on skin
    "pelvis width": (0.12, 0.42),
    "pelvis depth": (0.06, 0.36),
    "thigh": (0.18, 0.70),
    "shank": (0.16, 0.65),
    "knee width": (0.05, 0.20),
    "ankle width": (0.04, 0.15),
    "foot": (0.09, 0.38),
}


@dataclass(frozen=True, slots=True)
class Measurement:
    """One length of the person beside the model's."""

    name: str
    """for instance ``thigh_r``"""
    measured: float
    """m, median over the frames"""
    spread: float
    """m, robust standard deviation over the frames: soft tissue and marker noise"""
    model: float
    """m, of the unscaled model"""
    frames: int
    """how many frames show it"""

    @property
    def factor(self) -> float:
        """Person over model."""
        return self.measured / self.model


@dataclass(frozen=True, slots=True, eq=False)
class Scaling:
    """What :func:`fit` finds."""

    scales: SegmentScales
    sites: MarkerSites
    """the recording's markers on the scaled segments"""
    measurements: tuple[Measurement, ...]

    def measurement(self, name: str) -> Measurement:
        """One of the measurements by name."""
        return next(m for m in self.measurements if m.name == name)


def fit(
    generic: LegModel, motion: MarkerTrajectories, sites: MarkerSites, *, mass: float | None = None
) -> Scaling:
    """Scale factors of every segment and where the recording's markers sit on them.

    Pelvis: width from the ASIS and depth from ASIS to sacrum (or the middle of the PSIS) give its
    markers and, by regression, its hip centers; these scale it along z, depth along x, their mean
    along y. Thigh: hip center to lateral epicondyle, one factor along all axes; shank: epicondyle
    to lateral malleolus. Where medial markers are seen too, knee and ankle widths scale z of femur
    and tibia apart. Foot: heel to the fifth or first metatarsal head, else as the shank. The
    patella goes with the femur, the talus and toes with the foot. Sides are measured apart.

    Args:
        generic: the unscaled model.
        motion: markers whose names are roles of ``sites``; other names are ignored.
        sites: places on the unscaled model (:func:`legsim.kinematics.marker_sites.load`).
        mass: kg of the person, where known.

    Raises:
        LegsimError: a role that is needed is missing or never seen together with its partner, sides
            are exchanged, or a length is absurd.
    """
    factors = np.ones((len(SEGMENTS), 3))
    pelvis = _Pelvis.measure(motion, sites, _hip_offset(generic))
    measurements = pelvis.measurements()
    factors[segment_index("pelvis")] = pelvis.factors(measurements)
    for side in "rl":
        thigh = _thigh(motion, sites, pelvis.hip(side), side)
        _set_thigh(factors, thigh, side)
        shank = _shank(
            generic, motion, sites, pelvis.hip(side), factors[segment_index(f"femur_{side}")], side
        )
        foot = _foot(motion, sites, side)
        _set_shank(factors, shank, foot, side)
        measurements += [*thigh, *shank, *foot]
    scales = SegmentScales(factors, mass)
    known = sites.only([name for name in motion.marker_names if name in sites.names])
    return Scaling(scales, pelvis.placed(known.scaled(scales), scales), tuple(measurements))


@dataclass(frozen=True, slots=True, eq=False)
class _Pelvis:
    """The frame of the pelvis markers at every frame, and the model's pelvis to compare it with."""

    origin: FloatArray
    """(n, 3) m, the middle of the ASIS, in world"""
    axes: FloatArray
    """(n, 3, 3) columns forward (from sacrum to ASIS), up, right, in world"""
    width: FloatArray
    """(n,) m between the ASIS"""
    depth: FloatArray
    """(n,) m from the middle of the PSIS, or else the sacrum, to the line of the ASIS"""
    back_half: float
    """m, half the distance of the PSIS; 0 where the recording does not have both"""
    sacrum: FloatArray | None
    """(3,) m, along the axes from the origin, of a sacral marker beside both PSIS"""
    model_width: float
    model_back: FloatArray
    """(3,) m, from the middle of the ASIS to the sacrum on the unscaled model"""
    model_hip: FloatArray
    """(3,) m, right hip center in the unscaled pelvis"""

    @classmethod
    def measure(
        cls, motion: MarkerTrajectories, sites: MarkerSites, model_hip: FloatArray
    ) -> "_Pelvis":
        right, left = _seen(motion, "asis_r"), _seen(motion, "asis_l")
        back, back_site = _back(motion, sites)
        middle, across = (right + left) / 2, right - left
        width = np.linalg.norm(across, axis=1)
        z = across / width[:, None]
        ahead = middle - back
        ahead = ahead - (ahead * z).sum(1)[:, None] * z
        depth = np.linalg.norm(ahead, axis=1)
        x = ahead / depth[:, None]
        front = (sites.position("asis_r") + sites.position("asis_l")) / 2
        model_width = float(np.linalg.norm(sites.position("asis_r") - sites.position("asis_l")))
        axes = np.stack([x, np.cross(z, x), z], -1)
        pelvis = cls(
            middle,
            axes,
            width,
            depth,
            _half_back(motion),
            _beside_psis(motion, middle, axes),
            model_width,
            back_site - front,
            model_hip,
        )
        pelvis._check_sides(motion)
        return pelvis

    def _check_sides(self, motion: MarkerTrajectories) -> None:
        """Refuses a pelvis that is upside down both over its knees and over the floor: bent hips
        turn it against the one, lying against the other.
        """
        up = self.axes[:, :, 1]
        if np.isnan(up).all():
            raise LegsimError(
                "asis_r, asis_l and the sacrum (or both psis) are never seen in the same frame; "
                "the pelvis cannot be measured"
            )
        knees = [_seen(motion, f"epicondyle_lateral_{side}") for side in "rl"]
        over_knees = (up * (self.origin - np.mean(knees, axis=0))).sum(1)
        above = not np.isnan(over_knees).all() and np.nanmedian(over_knees) > 0
        if np.nanmedian(up[:, 1]) < 0 and not above:
            raise LegsimError(
                "the pelvis markers stand upside down: right and left are exchanged, or another "
                "axis points up; "
                "correct the marker map or give motion.up"
            )

    def measurements(self) -> list[Measurement]:
        depth = float(np.linalg.norm(self.model_back))
        return [
            _measurement("pelvis_width", "pelvis width", self.width, self.model_width),
            _measurement("pelvis_depth", "pelvis depth", self.depth, depth),
        ]

    def hip_in_markers(self) -> FloatArray:
        """Right hip center (3,) m from the middle of the ASIS along forward, up, right (Harrington
        2007).
        """
        width, depth = np.nanmedian(self.width), np.nanmedian(self.depth)
        return np.array([-0.24 * depth - 0.0099, -0.30 * width - 0.0109, 0.33 * width + 0.0073])

    def hip(self, side: str) -> FloatArray:
        """Hip center (n, 3) in world."""
        mirror = np.array([1.0, 1.0, 1.0 if side == "r" else -1.0])
        return self.origin + self.axes @ (self.hip_in_markers() * mirror)

    def factors(self, measurements: Sequence[Measurement]) -> FloatArray:
        """Along x from the depth, along z from the distance of the hips, along y their mean."""
        along, across = measurements[1].factor, self.hip_in_markers()[2] / self.model_hip[2]
        return np.array([along, (along + across) / 2, across])

    def placed(self, sites: MarkerSites, scales: SegmentScales) -> MarkerSites:
        """Pelvis markers moved to where they are relative to the hip centers; their plane keeps its
        slope in the model.
        """
        x = -self.model_back / np.linalg.norm(self.model_back)
        turn = np.stack([x, (-x[1], x[0], 0.0), (0.0, 0.0, 1.0)], -1)
        hip = self.model_hip * scales.of("pelvis")
        front = (hip - turn @ self.hip_in_markers()) * (1, 1, 0)
        half, depth = np.nanmedian(self.width) / 2, np.nanmedian(self.depth)
        places = {"asis_r": (0, 0, half), "asis_l": (0, 0, -half), "sacrum": (-depth, 0, 0)}
        if self.back_half > 0:
            places |= {
                "psis_r": (-depth, 0, self.back_half),
                "psis_l": (-depth, 0, -self.back_half),
            }
        if self.sacrum is not None:
            places["sacrum"] = tuple(self.sacrum)
        positions = sites.positions.copy()
        for name in set(places) & set(sites.names):
            positions[sites.index(name)] = front + turn @ np.array(places[name])
        return MarkerSites(sites.names, sites.segments, positions, sites.weights)


def _hip_offset(generic: LegModel) -> FloatArray:
    """Right hip center (3,) in the pelvis frame."""
    origins = generic.kinematics(generic.default_coordinates[None]).origins[0]
    return origins[segment_index("femur_r")] - origins[segment_index("pelvis")]


def _seen(motion: MarkerTrajectories, role: str) -> FloatArray:
    """Positions (n, 3) of a marker that scaling needs."""
    if role not in motion.marker_names:
        raise LegsimError(
            f"no marker has the role {role}; there are: {', '.join(motion.marker_names)}; "
            "complete the marker map"
        )
    positions = motion.marker(role)
    if np.isnan(positions).all():
        raise LegsimError(f"marker {role} is never seen; scaling needs it in one frame at least")
    return positions


def _back(motion: MarkerTrajectories, sites: MarkerSites) -> tuple[FloatArray, FloatArray]:
    """Sacrum (n, 3) and its site (3,): the middle of the PSIS where the recording has both, else
    the sacral marker.
    """
    if _shows_both_psis(motion):
        return (motion.marker("psis_r") + motion.marker("psis_l")) / 2, (
            sites.position("psis_r") + sites.position("psis_l")
        ) / 2
    return _seen(motion, "sacrum"), sites.position("sacrum")


def _shows_both_psis(motion: MarkerTrajectories) -> bool:
    pelvis = ("psis_r", "psis_l", "asis_r", "asis_l")
    if not set(pelvis) <= set(motion.marker_names):
        return False
    return bool(np.isfinite(sum(motion.marker(role) for role in pelvis)).all(1).any())


def _beside_psis(
    motion: MarkerTrajectories, middle: FloatArray, axes: FloatArray
) -> FloatArray | None:
    """Where a sacral marker is in the frame of ASIS and PSIS (3,), median; None without both PSIS
    or without one.
    """
    if not _shows_both_psis(motion) or "sacrum" not in motion.marker_names:
        return None
    local = np.einsum("nji,nj->ni", axes, motion.marker("sacrum") - middle)
    local = local[np.isfinite(local).all(1)]
    return np.median(local, axis=0) if len(local) else None


def _half_back(motion: MarkerTrajectories) -> float:
    if not _shows_both_psis(motion):
        return 0.0
    return (
        float(
            np.nanmedian(np.linalg.norm(motion.marker("psis_r") - motion.marker("psis_l"), axis=1))
        )
        / 2
    )


def _measurement(name: str, kind: str, lengths: FloatArray, model: float) -> Measurement:
    """Median of lengths (n,), refused where absurd."""
    lengths = lengths[np.isfinite(lengths)]
    if len(lengths) == 0:
        raise LegsimError(
            f"{name}: its markers are never seen in the same frame; scaling needs one such frame "
            "at least"
        )
    median = float(np.median(lengths))
    low, high = _PLAUSIBLE[kind]
    if not low <= median <= high:
        raise LegsimError(
            f"{name} measures {median:.4g} m, expected {low:g} to {high:g} m: if a marker plays "
            "another role, correct the marker map; if all "
            f"{unit_cure(median / np.sqrt(low * high))}"
        )
    spread = 1.4826 * float(np.median(np.abs(lengths - median)))
    return Measurement(name, median, spread, model, len(lengths))


def _pair(
    motion: MarkerTrajectories, sites: MarkerSites, first: str, second: str, name: str, kind: str
) -> list[Measurement]:
    """Distance of two markers of one segment where a frame shows both, else nothing."""
    if not {first, second} <= set(motion.marker_names):
        return []
    lengths = np.linalg.norm(motion.marker(first) - motion.marker(second), axis=1)
    if np.isnan(lengths).all():
        return []
    return [
        _measurement(
            name,
            kind,
            lengths,
            float(np.linalg.norm(sites.position(first) - sites.position(second))),
        )
    ]


def _thigh(
    motion: MarkerTrajectories, sites: MarkerSites, hip: FloatArray, side: str
) -> list[Measurement]:
    """Thigh length to the knee's middle where the medial epicondyle is seen, else to the lateral
    one; knee width.
    """
    lateral, medial = f"epicondyle_lateral_{side}", f"epicondyle_medial_{side}"
    width = _pair(motion, sites, lateral, medial, f"knee_width_{side}", "knee width")
    knee, site = _seen(motion, lateral), sites.position(lateral)
    if width:
        knee, site = (knee + motion.marker(medial)) / 2, (site + sites.position(medial)) / 2
    length = _measurement(
        f"thigh_{side}", "thigh", np.linalg.norm(knee - hip, axis=1), float(np.linalg.norm(site))
    )
    return [length, *width]


def _set_thigh(factors: FloatArray, found: Sequence[Measurement], side: str) -> None:
    for name in ("femur", "patella"):
        factors[segment_index(f"{name}_{side}")] = (
            found[0].factor,
            found[0].factor,
            found[-1].factor,
        )


def _shank(
    generic: LegModel,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    hip: FloatArray,
    femur: FloatArray,
    side: str,
) -> list[Measurement]:
    """Shank length by the lateral markers, the knee's bend taken from the same markers; ankle
    width.
    """
    knee, ankle = (
        _seen(motion, f"epicondyle_lateral_{side}"),
        _seen(motion, f"malleolus_lateral_{side}"),
    )
    thigh, shank = hip - knee, ankle - knee
    reach = np.linalg.norm(shank, axis=1)
    bend = np.arccos(
        np.clip((thigh * shank).sum(1) / (np.linalg.norm(thigh, axis=1) * reach), -1, 1)
    )
    site, knee_site = (
        sites.position(f"malleolus_lateral_{side}"),
        sites.position(f"epicondyle_lateral_{side}") * femur,
    )
    values = np.tile(generic.default_coordinates, (len(reach), 1))
    column = generic.coordinate_names.index(f"knee_angle_{side}")
    values[:, column] = np.clip(np.nan_to_num(bend) - np.pi, *generic.coordinate_ranges[column])
    pose, f, t = (
        generic.kinematics(values),
        segment_index(f"femur_{side}"),
        segment_index(f"tibia_{side}"),
    )
    # |tibia origin + factor * turned site - epicondyle| = reach, in the femur: a quadratic in the
    # factor
    offset = (pose.origins[:, t] - pose.origins[:, f]) * femur - knee_site
    along = (offset * (pose.rotations[:, t] @ site)).sum(1)
    square = site @ site
    root = along**2 - square * ((offset**2).sum(1) - reach**2)
    factor = (-along + np.sqrt(np.maximum(root, 0))) / square
    length = float(np.linalg.norm(site))
    found = _measurement(f"shank_{side}", "shank", factor * length, length)
    return [
        found,
        *_pair(
            motion,
            sites,
            f"malleolus_lateral_{side}",
            f"malleolus_medial_{side}",
            f"ankle_width_{side}",
            "ankle width",
        ),
    ]


def _foot(motion: MarkerTrajectories, sites: MarkerSites, side: str) -> list[Measurement]:
    """Heel to a metatarsal head; a toe marker is glued anywhere from there to the tip and tells no
    length.
    """
    for toe in ("meta5", "meta1"):
        found = _pair(motion, sites, f"heel_{side}", f"{toe}_{side}", f"foot_{side}", "foot")
        if found:
            return found
    return []


def _set_shank(
    factors: FloatArray, shank: Sequence[Measurement], foot: Sequence[Measurement], side: str
) -> None:
    length = shank[0].factor
    factors[segment_index(f"tibia_{side}")] = (length, length, shank[-1].factor)
    for name in ("talus", "calcn", "toes"):
        factors[segment_index(f"{name}_{side}")] = foot[0].factor if foot else length
