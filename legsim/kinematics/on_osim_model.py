"""A recording on the user's own OpenSim model: its coordinates as they are, or its markers solved
for.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.kinematics import osim_file, osim_marker_set, osim_registration, osim_scaling
from legsim.kinematics.ik_options import CoordinatePrior, IkOptions
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap.labels import MarkerMap
from legsim.mocap.raw import unit_cure
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_WEAK = 1e-7
"""m^2/rad^2: decides only what no marker sees"""

_HIP_ROTATION = 8e-4
"""m^2/rad^2, toward neutral, where a thigh carries fewer than three markers"""

_SAME = 1e-3
"""rad or m: a coupled coordinate of a file may differ by this from its coupler unmentioned"""

_LARGEST_EXTENSION_DEG = 25.0

_LEAST_ON_PELVIS = 3

_SOME = 20
"""frames that show on which side the legs are"""

_ABOVE, _CROSSED = 0.3, 0.08
"""sine of the elevation of the legs' markers over the pelvis, and m by which the right leg's lie
left, that nobody's do half of the time
"""

_SHORTEST, _LONGEST = 0.1, 0.8
"""m of thighs and shanks, from babies to giants"""

_FARTHEST = 2.0
"""m from a segment's origin that no marker on it is"""

_UNIT_FACTOR, _OTHER_SIZE = 2.0, 0.05
"""a ratio of sizes that is no person's; a share of a length that is worth a warning"""


def load(
    model: str | Path, scales: str | Path | None, marker_set: str | Path | None = None
) -> tuple[OsimLeg, tuple[str, ...]]:
    """The model's legs, with the markers of a marker set and scaled by a scale file where these are
    given, and what to say about them.

    Raises:
        LegsimError: as :func:`legsim.kinematics.osim_file.read`, :class:`OsimLeg`,
            :func:`legsim.kinematics.osim_marker_set.with_set` and
            :func:`legsim.kinematics.osim_scaling.read`; or the legs are no person's in size.
    """
    read = osim_file.read(model)
    notes = [f"on the model {read.name} ({read.path.name})"]
    if read.homeless:
        notes.append(
            f"warning: markers on bodies that the model lacks are left out: {short(read.homeless)}"
        )
    if marker_set is not None:
        read, said = osim_marker_set.with_set(read, marker_set)
        notes += said
    if scales is not None:
        factors = osim_scaling.read(scales)
        try:
            read = osim_scaling.scaled(read, factors)
        except LegsimError as error:
            raise LegsimError(f"{scales}: {error}") from error
        notes[0] += f", scaled by {Path(scales).name}"
    leg = OsimLeg(read)
    _check_lengths(leg)
    lengths = ", ".join(
        f"{name} {1e2 * length('r'):.1f} and {1e2 * length('l'):.1f} cm"
        for name, length in (("thighs", leg.thigh_length), ("shanks", leg.shank_length))
    )
    notes.append(f"{lengths} (right, left)")
    left_out = leg.bodies_left_out()
    if left_out:
        notes.append(f"left out, being no part of the legs: {', '.join(left_out)}")
    return leg, (*notes, *leg.notes)


def _check_lengths(leg: OsimLeg) -> None:
    """Refuses legs that are no person's: a model in millimeters."""
    for name, length in (("thigh", leg.thigh_length), ("shank", leg.shank_length)):
        for side, word in (("r", "right"), ("l", "left")):
            if not _SHORTEST < length(side) < _LONGEST:
                raise file_error(
                    leg.model.path,
                    f"the {word} {name} is {length(side):.4g} m long, which no person's is",
                    "write its lengths in meters, or repair its joints' places",
                    place="JointSet",
                )


def coordinates(
    leg: OsimLeg, loaded: JointTrajectories
) -> tuple[OsimLeg, JointTrajectories, tuple[str, ...]]:
    """The legs and their coordinates as a file has them, and notes on what it lacks or adds.

    What the file lacks stays at the model's default.

    Raises:
        LegsimError: the file has no coordinate of the legs' joints.
    """
    names = loaded.coordinate_names
    missing = [name for name in leg.coordinate_names if name not in names]
    if len(missing) == len(leg.coordinate_names):
        raise LegsimError(
            f"none of its columns {', '.join(names)} is a coordinate of the model's legs: "
            f"{', '.join(leg.coordinate_names)}"
        )
    notes = []
    if missing:
        defaults = dict(zip(leg.coordinate_names, leg.default_coordinates, strict=True))
        values = ", ".join(f"{name} = {defaults[name]:g}" for name in missing)
        notes.append(f"not in the file, so at the model's default (rad, m): {values}")
        leg = leg.with_held(missing)
    values = leg.values_of(loaded)
    trajectories = JointTrajectories(loaded.times, leg.coordinate_names, values)
    _check_knees(leg, trajectories)
    whole = leg.complete(trajectories)
    extra = [name for name in names if name not in whole.coordinate_names]
    if extra:
        notes.append(f"columns that are no coordinates of the legs are left out: {short(extra)}")
    return leg, trajectories, (*notes, *_coupled_notes(whole, loaded), *_bound_notes(leg, values))


def marker_map(
    leg: OsimLeg, labels: Sequence[str]
) -> tuple[MarkerMap, MarkerSites, tuple[str, ...]]:
    """The model's own markers that a recording has, by name, and how many these are.

    Raises:
        LegsimError: too few for the pelvis and both legs.
    """
    sites, elsewhere = leg.marker_sites()
    if not sites.names:
        raise file_error(
            leg.model.path,
            "the model has no markers on its legs",
            "give its marker set, as in --marker-set FILE.xml (motion.marker_set)",
            place="MarkerSet",
        )
    every = MarkerMap.one_to_one(leg.model.path.stem, sites.names, sites.names, sites.segments)
    found = _found(every, labels)
    known = sites.only([name for name in sites.names if name in found])
    on_pelvis = known.segments.count("pelvis")
    bare = [s for s in "rl" if not any(k.endswith(f"_{s}") for k in known.segments)]
    if on_pelvis < _LEAST_ON_PELVIS or bare:
        lacks = ["three on the pelvis"] if on_pelvis < _LEAST_ON_PELVIS else []
        lacks += [f"one on the {'right' if s == 'r' else 'left'} leg" for s in bare]
        raise LegsimError(
            f"{len(found)} of the {len(sites.names)} markers on the model's legs are in the "
            f"recording ({', '.join(found) or 'none'}); needed are at least {' and '.join(lacks)}; "
            f"the model has {', '.join(sites.names)}, the recording {', '.join(labels)}: give "
            "markers of equal names"
        )
    # a place that bears two names needs one of them
    used = {_place(sites, name) for name in found}
    absent = [n for n in sites.names if n not in found and _place(sites, n) not in used]
    count = len(found) + len(absent)
    notes = [f"{len(found)} of the {count} markers on the model's legs are in the recording"]
    if absent:
        notes[0] += f"; not there: {short(absent)}"
    spelled = [
        f"{name} ({label})"
        for name, (label,) in found.items()
        if name != label.rpartition(":")[2] and name != label
    ]
    if spelled:
        notes.append(f"markers that the recording spells otherwise: {short(spelled)}")
    if elsewhere:
        notes.append(f"markers on other bodies are not used: {short(elsewhere)}")
    chosen = MarkerMap.one_to_one(every.name, known.names, known.names, known.segments)
    return chosen, known, tuple(notes)


def _found(every: MarkerMap, labels: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """The model's markers that the recording has, by their labels: a label that is one marker's
    very name is no other's that differs in case or punctuation.
    """
    found = every.found_in(labels)
    exact = {
        label: name for name, (label,) in found.items() if name in (label, label.rpartition(":")[2])
    }
    return {name: (label,) for name, (label,) in found.items() if exact.get(label, name) == name}


def _place(sites: MarkerSites, name: str) -> tuple[str, bytes]:
    return sites.segments[sites.index(name)], sites.position(name).tobytes()


def check_unit(sites: MarkerSites, measured: MarkerTrajectories) -> None:
    """Refuses markers of one segment so far apart, or so near, that a unit is wrong."""
    away = np.linalg.norm(sites.positions, axis=1)
    if away.max() > _FARTHEST:
        name = sites.names[int(away.argmax())]
        raise LegsimError(
            f"the model has {name} {away.max():.4g} m from the origin of its body: its markers' "
            "places are not in meters; write meters into the model or its marker set"
        )
    known = sites.only([name for name in sites.names if name in measured.marker_names])
    ratio = osim_registration.size_ratio(known, measured) or 1.0
    if not 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR:
        raise LegsimError(
            f"markers of one segment are {ratio:.3g} times as far apart as on the model: the unit "
            f"of length is wrong; {unit_cure(ratio)}"
        )


def check_sides(sites: MarkerSites, measured: MarkerTrajectories) -> None:
    """Refuses legs that lie above the pelvis or on its other side, by the pelvis' own markers: left
    and right are exchanged.
    """
    names = [name for name in sites.names if name in measured.marker_names]
    known, shown = sites.only(names), np.stack([measured.marker(n) for n in names], 1)
    segments = np.array(known.segments)
    pelvis = segments == "pelvis"
    upright = np.flatnonzero(np.isfinite(shown[:, pelvis]).all((1, 2)))
    if pelvis.sum() < _LEAST_ON_PELVIS or len(upright) == 0:
        return
    some = shown[upright[np.unique(np.linspace(0, len(upright) - 1, _SOME).astype(int))]]
    poses = transforms.best_rigid(known.positions[pelvis], some[:, pelvis], known.weights[pelvis])
    local = transforms.apply(transforms.inverse(poses), some)
    legs = local[:, ~pelvis].reshape(-1, 3)
    legs = legs[np.isfinite(legs).all(1)]
    if len(legs) and np.median(legs[:, 1] / np.linalg.norm(legs, axis=1)) > _ABOVE:
        raise LegsimError(
            "by the pelvis' markers the legs lie above it: left and right are exchanged in the "
            "labels, or the axes mirrored; exchange them in the recording"
        )
    for part, what in (("femur", "thigh"), ("tibia", "shank"), ("calcn", "foot")):
        right, left = (local[:, segments == f"{part}_{side}", 2] for side in "rl")
        if not (np.isfinite(right).any() and np.isfinite(left).any()):
            continue
        apart = float(np.nanmedian(right)) - float(np.nanmedian(left))
        if apart < -_CROSSED:
            raise LegsimError(
                f"the markers of the right {what} lie {-1e3 * apart:.0f} mm left of the left "
                f"one's, by the sides of the pelvis: the labels of the legs are exchanged; "
                "exchange them in the recording"
            )


def size_note(
    leg: OsimLeg, measured: MarkerTrajectories, sites: MarkerSites, config: IkOptions
) -> tuple[str, ...]:
    """A warning where the person is larger or smaller than the model, with the fix.

    Raises:
        LegsimError: no frame shows three markers of the pelvis.
    """
    off = osim_registration.size_off(leg, measured, sites, config)
    if max(map(abs, off.values()), default=0.0) <= _OTHER_SIZE:
        return ()
    sizes = ", ".join(f"{name} {100 * share:+.0f} %" for name, share in off.items())
    return (
        f"warning: the model is not of this person's size; by its markers the person's are: "
        f"{sizes}; scale it to the recording by --scale-model (motion.scale_model = true), or "
        "scale it in OpenSim",
    )


def held_leg(leg: OsimLeg) -> tuple[OsimLeg, tuple[str, ...]]:
    """The legs with the coordinates that the model locks held, and a word on them."""
    if not leg.locked:
        return leg, ()
    return leg.with_held(leg.locked), (
        f"locked in the model, so held at its default: {', '.join(leg.locked)}",
    )


def model_priors(leg: OsimLeg, sites: MarkerSites) -> tuple[CoordinatePrior, ...]:
    """Priors for this model: the markers decide, as in OpenSim, and what they do not see stays at
    the model's default. Hip rotation is drawn toward neutral where a thigh carries fewer than three
    markers, as on legsim's own leg.
    """
    weights = {}
    for k, name in enumerate(leg.coordinate_names):
        if k >= leg.pelvis_coordinates:
            weights[name] = _WEAK
    for side in "rl":
        rotation = f"hip_rotation_{side}"
        if rotation in weights and sites.segments.count(f"femur_{side}") < 3:
            weights[rotation] = _HIP_ROTATION
    defaults = dict(zip(leg.coordinate_names, leg.default_coordinates, strict=True))
    return tuple(CoordinatePrior(n, w, float(defaults[n])) for n, w in weights.items())


def _check_knees(leg: OsimLeg, trajectories: JointTrajectories) -> None:
    """Refuses knees that bend forwards: the file counts flexion the other way."""
    poses = leg.segment_poses(trajectories)
    for side, word in (("r", "right"), ("l", "left")):
        flexion = np.degrees(poses.knee_flexion(side))
        worst = int(flexion.argmin())
        if flexion[worst] < -_LARGEST_EXTENSION_DEG:
            raise LegsimError(
                f"on this model the {word} knee bends forwards by {-flexion[worst]:.0f} degrees at "
                f"{trajectories.times[worst]:g} s: the file counts flexion the other way; give the "
                "file of this model"
            )


def _coupled_notes(whole: JointTrajectories, loaded: JointTrajectories) -> list[str]:
    """A word on coordinates that the file has and the model sets by a coupler, where they
    differ.
    """
    notes = []
    for name in whole.coordinate_names:
        if name in loaded.coordinate_names:
            away = float(np.abs(whole.coordinate(name) - loaded.coordinate(name)).max())
            if away > _SAME:
                notes.append(
                    f"warning: {name} in the file differs from its coupler by up to {away:.3g} "
                    "(rad or m); the coupler's is taken"
                )
    return notes


def _bound_notes(leg: OsimLeg, values: FloatArray) -> list[str]:
    """A word on clamped coordinates that go beyond their range."""
    low, high = leg.coordinate_ranges.T
    beyond = np.maximum(low - values, values - high).max(0)
    beyond[: leg.pelvis_coordinates] = 0
    names = [n for n, b in zip(leg.coordinate_names, beyond, strict=True) if b > _SAME]
    return [f"beyond the model's range, and taken as it is: {', '.join(names)}"] if names else []


def short(names: Sequence[str], limit: int = 12) -> str:
    """Names in a row, the first twelve of many."""
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
