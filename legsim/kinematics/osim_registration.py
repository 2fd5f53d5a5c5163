"""A user's OpenSim model in the size of a person, found from the model's own markers.

As OpenSim's scale tool does it, in two steps: first factors of the bodies with the landmarks where
the model has them, then the places of the markers. But both from postures of any kind rather than
from distances in the model's default pose, and with priors: people's parts are alike in size, and
the markers show by their misfit how far they are to be believed. In the second step lengths and hip
centers stay open by as much as on legsim's own leg (:mod:`legsim.kinematics.registration`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics import _stance, osim_scaling, registration
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics._osim_person import Growth, OsimPerson, Places
from legsim.kinematics._registration_model import HIP, LENGTH, LOOSE, PLACES
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.registration import Registration
from legsim.kinematics.skeleton import SEGMENTS, segment_index
from legsim.mocap import marker_sets
from legsim.mocap.labels import SEGMENT_OF_PART
from legsim.mocap.trajectories import MarkerTrajectories

_SIZE, _PART, _SIDE, _AXIS, _OWN = 0.3, 0.08, 0.015, 0.06, 0.015
"""of the factors, logarithms: of the whole person; of a part of the body (thighs, shanks, feet)
against the person; of right against left; of an axis of a part; of one axis of one segment alone
"""

_LEAST_ERROR = 5e-5
"""m: markers of a computed model may be as exact"""

_GROUPS = {"patella": "femur", "talus": "foot", "calcn": "foot", "toes": "foot"}

_FEW = 6
"""postures that say whether a model is of another size"""

_LONGEST_PAIR = 0.05
"""m between two markers that tell a size"""

_UNLIKE_PEOPLE = (0.6, 1.5)
"""factors over a grown person's model"""

_HARDLY = 0.04
"""of a factor: standard deviation that says that markers do not tell it"""


@dataclass(frozen=True, slots=True, eq=False)
class SizedModel:
    """What :func:`fit` finds."""

    deviations: dict[str, FloatArray]
    """(3,) standard deviations of the factors of the legs' bodies, relative"""
    registration: Registration
    notes: tuple[str, ...]

    @property
    def leg(self) -> OsimLeg:
        """The scaled model, its markers where the person wears them; its factors are
        ``leg.model.factors``.
        """
        assert isinstance(self.registration.leg, OsimLeg)
        return self.registration.leg


def fit(
    leg: OsimLeg, motion: MarkerTrajectories, sites: MarkerSites, config: IkOptions
) -> SizedModel:
    """The model as large as the person, with the markers where the person wears them.

    Args:
        leg: of the user's model as it is, locked coordinates held.
        motion: markers named like ``sites``.
        sites: the model's own markers that the recording has, with weights above 0.
        config: of inverse kinematics, with the model's priors.

    Raises:
        LegsimError: no frame shows three markers of the pelvis, or factors are no person's.
    """
    sites = sites.only([name for name in motion.marker_names if name in sites.names])
    whole, sized, shown = _whole(leg, motion, sites, config, most=None)
    factors = whole.factors(sized.theta)
    _check_factors(leg, factors)
    first = whole.markers
    second = Places(first.names, first.bodies, whole.places(sized.theta), first.weights,
                    _spreads(sites, marked_by(sites)))  # fmt: skip
    placing = OsimPerson(leg.model, leg.held, _settling_growth(leg, np.log(factors)), second)
    error = min(sized.error, registration.MARKER_ERROR)
    config = _stance.with_feet(config, motion, sites)
    placed = registration.settled(placing, config, shown, error=error, least_error=_LEAST_ERROR)
    assert isinstance(placed.leg, OsimLeg)
    factors = placing.factors(placed.theta)
    others = _others(leg, factors)
    if others:
        whole_body = osim_scaling.scaled(placed.leg.model, others)
        placed = replace(placed, leg=OsimLeg(whole_body, held=leg.held))
    deviations = _deviations(whole, sized, len(leg.bodies))
    return SizedModel(
        dict(zip(leg.bodies, deviations, strict=True)),
        placed,
        _notes(leg, factors, deviations, sized, placed),
    )


def size_off(
    leg: OsimLeg, motion: MarkerTrajectories, sites: MarkerSites, config: IkOptions
) -> dict[str, float]:
    """By how much of the model's the person's thighs, shanks and hips' distance are larger, from a
    few postures, right and left together; only what is twice its standard deviation.
    """
    sites = sites.only([name for name in motion.marker_names if name in sites.names])
    whole, sized, _ = _whole(leg, motion, sites, config, most=_FEW)
    found, deviations = sized.leg, _deviations(whole, sized, len(leg.bodies))
    off = {
        "thighs": ("femur_r", 1, _longer(found.thigh_length, leg.thigh_length)),
        "shanks": ("tibia_r", 1, _longer(found.shank_length, leg.shank_length)),
        "hips' distance": (
            "pelvis",
            2,
            found.scales.of("pelvis")[2] / leg.scales.of("pelvis")[2] - 1,
        ),
    }
    return {
        name: float(share)
        for name, (segment, axis, share) in off.items()
        if abs(share) > 2 * deviations[leg.bodies.index(leg.body_of(segment)), axis]
    }


def _longer(found: Callable[[str], float], model: Callable[[str], float]) -> float:
    return sum(found(side) for side in "rl") / sum(model(side) for side in "rl") - 1


def _whole(
    leg: OsimLeg,
    motion: MarkerTrajectories,
    sites: MarkerSites,
    config: IkOptions,
    *,
    most: int | None,
) -> tuple[OsimPerson, Registration, FloatArray]:
    """The factors of all bodies with the landmarks where the model has them, from ``most`` postures
    at most; and the markers (n, m, 3) of these.
    """
    measured = motion.positions_world[:, [motion.marker_names.index(n) for n in sites.names]]
    config = _stance.with_feet(config, motion, sites)
    start = np.full((len(leg.bodies), 3), np.log(size_ratio(sites, motion) or 1.0))
    first = _first_places(leg, sites, start)
    whole = OsimPerson(leg.model, leg.held, _whole_growth(leg, start), first)
    person = whole(np.zeros(whole.size))
    chosen = registration.postures(Problem(person.leg, person.sites, config), measured)
    shown = measured[chosen[:: 1 if most is None else max(1, -(-len(chosen) // most))]]
    # one posture of landmarks alone shows how far they are from where the model has them
    sized = registration.settled(whole, config, shown, least_error=_LEAST_ERROR, many=1)
    return whole, sized, shown


def size_ratio(sites: MarkerSites, motion: MarkerTrajectories) -> float | None:
    """Median of how many times farther apart the person's markers are than the model's, over pairs
    on one segment; None without any.
    """
    ratios = []
    for k, name in enumerate(sites.names):
        for j in range(k):
            apart = float(np.linalg.norm(sites.positions[k] - sites.positions[j]))
            if sites.segments[j] == sites.segments[k] and apart > _LONGEST_PAIR:
                seen = motion.marker(name) - motion.marker(sites.names[j])
                lengths = np.linalg.norm(seen, axis=1)
                if np.isfinite(lengths).any():
                    ratios.append(float(np.nanmedian(lengths)) / apart)
    return float(np.median(ratios)) if ratios else None


def marked_by(sites: MarkerSites) -> dict[str, str]:
    """Part of the body (``epicondyle_lateral``) that each marker marks, by the names of the shipped
    sets; nothing for clusters and unknown names.
    """
    found: dict[str, str] = {}
    for name in marker_sets.names():
        for role, labels in marker_sets.load(name).found_in(sites.names).items():
            part = role if role == "sacrum" else role.rpartition("_")[0]
            if len(labels) != 1 or part not in SEGMENT_OF_PART:
                continue
            segment = sites.segments[sites.index(labels[0])]
            if segment.partition("_")[0] in (SEGMENT_OF_PART[part], "talus", "toes"):
                found.setdefault(labels[0], part)
    return found


def _first_places(leg: OsimLeg, sites: MarkerSites, start: FloatArray) -> Places:
    """The model's places, tracking markers open: those of a segment that has known landmarks."""
    parts = marked_by(sites)
    known = {s for n, s in zip(sites.names, sites.segments, strict=True) if n in parts}
    loose = [
        n not in parts and s in known for n, s in zip(sites.names, sites.segments, strict=True)
    ]
    by_name = {m.name: m for m in leg.model.markers}
    bodies = tuple(by_name[n].body for n in sites.names)
    rows = [leg.bodies.index(body) for body in bodies]
    locations = np.array([by_name[n].location for n in sites.names]) * np.exp(start[rows])
    spread = np.where(np.array(loose)[:, None], LOOSE, 0.0)
    return Places(sites.names, bodies, locations, sites.weights, spread)


def _without_landmarks(sites: MarkerSites) -> list[str]:
    """Thighs and shanks with markers, none of which is a known landmark."""
    parts = marked_by(sites)
    known = {s for n, s in zip(sites.names, sites.segments, strict=True) if n in parts}
    return [
        s for s in dict.fromkeys(sites.segments) if s[:5] in ("femur", "tibia") and s not in known
    ]


def _spreads(sites: MarkerSites, parts: dict[str, str]) -> FloatArray:
    """(m, 3) m by which the markers' places differ between people and hands."""
    return np.array([PLACES.get(parts.get(name, ""), LOOSE) for name in sites.names])


def _group_of(leg: OsimLeg, body: str) -> str:
    """The group whose factors a body shares: ``pelvis``, ``femur_r``, ``foot_l``; a body between
    two segments shares its parent's.
    """
    for segment in SEGMENTS:
        if not segment.startswith("patella") and leg.body_of(segment) == body:
            part, _, side = segment.partition("_")
            part = _GROUPS.get(part, part)
            return f"{part}_{side}" if side else part
    parent = leg.parent_of(body)
    return "pelvis" if parent == "ground" else _group_of(leg, parent)


def _whole_growth(leg: OsimLeg, start: FloatArray) -> Growth:
    """Three factors for each group."""
    of_bodies = [_group_of(leg, body) for body in leg.bodies]
    groups = list(dict.fromkeys(of_bodies))
    matrix = np.zeros((len(leg.bodies), 3, 3 * len(groups)))
    for row, group in enumerate(of_bodies):
        for axis in range(3):
            matrix[row, axis, 3 * groups.index(group) + axis] = 1.0
    part = np.repeat([group.partition("_")[0] for group in groups], 3)
    group, axis = np.repeat(groups, 3), np.tile(range(3), len(groups))
    same_part, same_axis = part[:, None] == part, axis[:, None] == axis
    covariance = _SIZE**2 + _PART**2 * same_part + _SIDE**2 * (group[:, None] == group)
    covariance = covariance + _AXIS**2 * (same_part & same_axis) + _OWN**2 * np.eye(len(part))
    carries = np.ones(len(leg.bodies), bool)
    return Growth(start, matrix, np.linalg.inv(covariance), carries)


def _settling_growth(leg: OsimLeg, start: FloatArray) -> Growth:
    """Hip centers in the pelvis, and lengths of thighs and shanks, as registration varies them on
    legsim's own leg.
    """
    groups = [_group_of(leg, body) for body in leg.bodies]
    bones = [g for g in dict.fromkeys(groups) if g.startswith(("femur", "tibia"))]
    matrix = np.zeros((len(groups), 3, 3 + len(bones)))
    for row, group in enumerate(groups):
        if group == "pelvis":
            matrix[row, :, :3] = np.eye(3)
        elif group in bones:
            matrix[row, :, 3 + bones.index(group)] = 1.0
    pose = leg.kinematics(leg.default_coordinates[None])
    hip = pose.origins[0, segment_index("femur_r")] - pose.origins[0, segment_index("pelvis")]
    reach = np.abs(pose.rotations[0, segment_index("pelvis")].T @ hip)
    spread = np.concatenate([HIP / np.maximum(reach, 0.02), np.full(len(bones), LENGTH)])
    carries = np.array([group != "pelvis" for group in groups])
    return Growth(start, matrix, np.diag(spread**-2.0), carries)


def _check_factors(leg: OsimLeg, factors: FloatArray) -> None:
    low, high = _UNLIKE_PEOPLE
    row, axis = np.unravel_index(int(np.abs(np.log(factors)).argmax()), factors.shape)
    worst = float(factors[row, axis])
    if not low <= worst <= high:
        raise LegsimError(
            f"scaled to this recording, the model's {leg.bodies[row]} would be {worst:.2f} times "
            f"as large along {'xyz'[axis]}: check that its markers sit where the recording's do "
            f"(markers of the model: {', '.join(leg.marker_sites()[0].names)})"
        )


def _deviations(whole: OsimPerson, sized: Registration, bodies: int) -> FloatArray:
    """(b, 3) standard deviations of the factors, relative."""
    matrix = whole.growth.matrix
    k = matrix.shape[-1]
    covariance = sized.covariance[:k, :k]
    return np.sqrt(np.einsum("bap,pq,baq->ba", matrix, covariance, matrix)).reshape(bodies, 3)


def _others(leg: OsimLeg, factors: FloatArray) -> dict[str, FloatArray]:
    """Factors of the bodies that are no part of the legs: of a patella its thigh's, of all others
    the mean of the legs'.
    """
    own = dict(zip(leg.bodies, factors, strict=True))
    mean = np.full(3, np.exp(np.log(factors).mean()))
    thighs = {leg.patella_body(side): own[leg.body_of(f"femur_{side}")] for side in "rl"}
    return {body: thighs.get(body, mean) for body in leg.model.bodies if body not in own}


def _notes(
    leg: OsimLeg,
    factors: FloatArray,
    deviations: FloatArray,
    sized: Registration,
    placed: Registration,
) -> tuple[str, ...]:
    groups = [_group_of(leg, body) for body in leg.bodies]
    first = [groups.index(group) for group in dict.fromkeys(groups)]
    sizes = ", ".join(f"{groups[k]} {' '.join(f'{f:.3f}' for f in factors[k])}" for k in first)
    notes = [
        f"the model was scaled to the person from {sized.frames} "
        f"posture{'s' * (sized.frames > 1)} (factors along x, y, z): {sizes}; "
        f"markers within {1e3 * sized.rms_after:.1f} mm RMS where the scaled model has "
        f"them, {1e3 * placed.rms_after:.1f} mm where the person wears them"
    ]
    bare = _without_landmarks(placed.sites)
    if bare:
        notes.append(
            f"warning: no marker on {', '.join(bare)} is a landmark that legsim knows by its name, "
            "so that their size rests on where the model has its tracking markers; scale from a "
            "static trial with landmarks (motion.scaling_file)"
        )
    open_ = [
        f"{groups[k]} {'xyz'[a]} ({100 * deviations[k, a]:.0f} %)"
        for k in first
        for a in range(3)
        if deviations[k, a] > _HARDLY
    ]
    if open_:
        notes.append(
            "hardly told by the markers, so much as the other segments (standard deviation): "
            f"{', '.join(open_)}"
        )
    return tuple(notes)
