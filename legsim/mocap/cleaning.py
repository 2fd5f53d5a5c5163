"""From a recording's markers to clean trajectories of the roles on the body: jumps out, short gaps
bridged, noise filtered.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.mocap import _person, copies, exchanged, gap_filling, outliers
from legsim.mocap.held import find_held
from legsim.mocap.in_view import note_of, span_in_view
from legsim.mocap.labels import PAPER_ROLES, MarkerMap, check_covered, check_distinct
from legsim.mocap.low_pass import low_pass, runs
from legsim.mocap.trajectories import MarkerTrajectories

SPLINE_S = 0.25
"""s: a longer gap is filled from other markers on the segment if it can be"""

SLOPE_S = 0.1
"""s on either side of a gap that tell the velocity with which a marker leaves and returns"""

_MANY = 8
"""markers that are named each for itself"""

_FEW_LOST = 0.05
"""of the frames, that may be left out because markers jump there"""

_FASTEST_S, _SLOWEST_S = 3e-4, 0.5
"""s between two samples of a movement"""


@dataclass(frozen=True, slots=True)
class RoleReport:
    """What was found and done on the markers of one role."""

    role: str
    labels: tuple[str, ...]
    samples: int
    missing: int
    """samples not seen in the recording"""
    longest_gap_s: float
    """longest stretch not seen, removed jumps included"""
    jumps_removed: int
    """samples removed because they lie off the trajectory"""
    filled: int
    """samples bridged, by splines or from other markers"""
    rebuilt: int
    """samples of these that come from other markers on the same segment"""
    left_missing: int
    """samples that stay NaN: in gaps too long to bridge, or before the first and after the last
    sight
    """


@dataclass(frozen=True, slots=True)
class CleaningReport:
    """What :func:`prepare` found and did."""

    marker_set: str
    rate_hz: float
    filter_hz: float
    """0: not filtered"""
    resampled: bool
    """the recording's times were uneven"""
    roles: tuple[RoleReport, ...]
    never_seen: tuple[str, ...]
    """roles whose labels are in the file without one sample"""
    notes: tuple[str, ...] = ()
    """what is to be said about single markers, one line each"""

    def of(self, role: str) -> RoleReport:
        """The report of one role.

        Raises:
            LegsimError: the role is not among the prepared ones.
        """
        for report in self.roles:
            if report.role == role:
                return report
        raise LegsimError(
            f"no role named {role!r} was prepared; there are: "
            f"{', '.join(r.role for r in self.roles)}"
        )


def clean(
    motion: MarkerTrajectories,
    marker_map: MarkerMap,
    *,
    filter_hz: float = 6.0,
    longest_gap_s: float = 0.25,
    required: Sequence[str] = PAPER_ROLES,
) -> tuple[MarkerTrajectories, CleaningReport]:
    """Clean trajectories of the roles, at even times, with a report.

    In this order: frames that repeat the frame before are left out (:mod:`legsim.mocap.copies`),
    samples that only repeat the last one are taken as not seen (:mod:`legsim.mocap.held`), labels
    are looked up, times made even, jumps removed (:mod:`legsim.mocap.outliers`), short gaps bridged
    by cubic splines, longer ones from three other markers on the same segment where these are seen
    (:mod:`legsim.mocap.gap_filling`), several labels of a role averaged, and each unbroken stretch
    filtered by itself, so that a dropout never smears into motion. Frames before and after the
    person is in view are left out (:mod:`legsim.mocap.in_view`).

    The filter is a second-order Butterworth low-pass run forwards and backwards (zero phase).
    ``filter_hz`` is the cut-off of each pass, not corrected for the second: together they halve the
    amplitude (-6 dB) at ``filter_hz`` and have -3 dB at 0.80 of it. That is what "2nd-order, 6 Hz,
    zero-phase" means in most published recordings and in the study that is rebuilt here; divide by
    0.802 for -3 dB at a wanted frequency (Winter 2009).

    Args:
        motion: markers in meters in world.
        marker_map: which labels play which role.
        filter_hz: cut-off in hertz; 0 leaves the markers unfiltered.
        longest_gap_s: gaps up to this long are bridged by splines; longer ones that no other
            markers fill stay NaN and are reported. Raise it to bridge them too.
        required: roles that must be there.

    Raises:
        LegsimError: a required role has no marker or is never seen, one marker plays two roles,
            left and right are exchanged, lengths are not a person's (a wrong unit), or the filter
            does not fit the sampling rate.
    """
    check_covered(marker_map, motion.marker_names, required)
    motion, copied = _without_copies(motion)
    motion, held = _without_held(motion)
    found, never = _seen_roles(motion, marker_map, required)
    used = {name for names in found.values() for name in names}
    times, source = _even(motion, sorted(used))
    resampled = len(times) != len(motion.times) or not np.array_equal(times, motion.times)
    dt = float(times[-1] - times[0]) / (len(times) - 1)
    _check_filter(filter_hz, 1 / dt)
    segments = {name: marker_map.segment(r) for r, names in found.items() for name in names}
    stages = _cleaned(source, segments, times, longest_gap_s)
    means = _means(stages.bridged, found)
    _person.check(means, times)
    of_roles = {role: marker_map.segment(role) for role in found}
    span = span_in_view(means, of_roles)
    whole = span_in_view(_means(stages.source, found), of_roles)
    view_notes = (*note_of(whole, times), *_lost_notes(whole, span, times))
    means, stages = {role: x[span] for role, x in means.items()}, stages.within(span)
    times = times[span]
    cleaned = np.stack(
        [low_pass(x, 1 / dt, filter_hz) if filter_hz else x for x in means.values()], axis=1
    )
    reports = tuple(_report(role, names, stages, dt) for role, names in found.items())
    notes = (
        *copied,
        *_few([note for name, note in held.items() if name in used]),
        *_exchange_notes(motion, [n for n in motion.marker_names if n in used]),
        *_guessed_notes(stages, found, times),
        *view_notes,
    )
    report = CleaningReport(marker_map.name, 1 / dt, filter_hz, resampled, reports, never, notes)
    return MarkerTrajectories(times, tuple(means), cleaned), report


def _seen_roles(
    motion: MarkerTrajectories, marker_map: MarkerMap, required: Sequence[str]
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """(labels of each role that some sample shows, roles whose labels none does)."""
    seen = [
        name
        for k, name in enumerate(motion.marker_names)
        if np.isfinite(motion.positions_world[:, k]).all(-1).any()
    ]
    found = marker_map.found_in(seen)
    check_distinct(marker_map, found)
    never = tuple(role for role in marker_map.found_in(motion.marker_names) if role not in found)
    _check_seen(never, marker_map, motion, required)
    _check_copies(motion, found)
    return found, never


def _means(
    positions: Mapping[str, FloatArray], found: Mapping[str, tuple[str, ...]]
) -> dict[str, FloatArray]:
    """(n, 3) of each role, the mean of its labels."""
    return {
        role: np.mean([positions[name] for name in names], axis=0) for role, names in found.items()
    }


def _few(notes: list[str]) -> list[str]:
    """Notes on markers that are held; where they are many, the first and how many more."""
    if len(notes) <= _MANY:
        return notes
    return [f"{notes[0]}; and so are {len(notes) - 1} markers more"]


def _without_copies(motion: MarkerTrajectories) -> tuple[MarkerTrajectories, list[str]]:
    """The recording without frames that repeat the frame before, and notes on these."""
    if len(motion.times) < 2:
        return motion, []
    dt = float(np.median(np.diff(motion.times)))
    found = copies.find_copies(motion.positions_world.reshape(len(motion.times), -1), dt)
    notes = found.notes(motion.times)
    if not found.frames.any():
        return motion, notes
    times, positions = motion.times[~found.frames], motion.positions_world[~found.frames]
    return MarkerTrajectories(times, motion.marker_names, positions), notes


def _without_held(motion: MarkerTrajectories) -> tuple[MarkerTrajectories, dict[str, str]]:
    """The markers, NaN where they only repeat their last position, and a note by label."""
    if len(motion.times) < 2:
        return motion, {}
    dt = float(np.median(np.diff(motion.times)))
    held = find_held(motion.positions_world, dt)
    if not held.any():
        return motion, {}
    notes = {}
    for k in np.flatnonzero(held.any(0)):
        stretches = runs(held[:, k])
        first, last = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
        times = motion.times[[first - 1, last]]
        more = f" and {len(stretches) - 1} times more" if len(stretches) > 1 else ""
        notes[motion.marker_names[k]] = (
            f"{motion.marker_names[k]} repeats one position from {times[0]:.4g} to {times[1]:.4g} s"
            f"{more} ({int(held[:, k].sum())} samples): taken as not seen"
        )
    positions = np.where(held[..., None], np.nan, motion.positions_world)
    return MarkerTrajectories(motion.times, motion.marker_names, positions), notes


def _exchange_notes(motion: MarkerTrajectories, names: Sequence[str]) -> list[str]:
    """A warning where labels change places on the way."""
    dt = float(np.median(np.diff(motion.times)))
    positions = motion.positions_world[:, [motion.marker_names.index(name) for name in names]]
    found = exchanged.find_exchanges(positions, dt)
    return exchanged.notes_of(found, tuple(names), motion.times)


def _lost_notes(whole: slice, span: slice, times: FloatArray) -> list[str]:
    """A word on frames of ``whole``, which show the person, that are not in ``span``, because
    markers jump; a warning where these are many.
    """
    lost = max(span.start - whole.start, 0) + max(whole.stop - span.stop, 0)
    if lost == 0:
        return []
    at = times[span.start] if span.start > whole.start else times[span.stop - 1]
    said = f"{lost} frames are left out whose markers jump away at {at:.4g} s"
    if lost <= _FEW_LOST * (whole.stop - whole.start):
        return [said]
    return [
        f"warning: {said}: frames are missing there, or another trial begins; cut the recording "
        "there"
    ]


def _guessed_notes(
    stages: "_Stages", found: dict[str, tuple[str, ...]], times: FloatArray
) -> list[str]:
    """A warning where most roles are guessed at once, across gaps that are not short."""
    hidden = np.mean([_unseen(stages.rebuilt, names) for names in found.values()], axis=0)
    stretches = runs(hidden > 0.5)
    if not stretches:
        return []
    first, last = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    more = f" and in {len(stretches) - 1} places more" if len(stretches) > 1 else ""
    return [
        f"warning: more than half of the markers are not seen from {times[first]:.4g} to "
        f"{times[last]:.4g} s{more}: the movement there is a guess; leave it out"
    ]


def _check_seen(
    never: Sequence[str], marker_map: MarkerMap, motion: MarkerTrajectories, required: Sequence[str]
) -> None:
    blind = [role for role in never if role in required]
    if blind:
        labels = ", ".join(
            sorted(
                {name for role in blind for name in marker_map.found_in(motion.marker_names)[role]}
            )
        )
        raise LegsimError(
            f"{', '.join(blind)} cannot be followed: {labels} is not seen in any sample; label it "
            "and export again, or name a static trial that shows it (motion.scaling_file)"
        )


def _check_copies(motion: MarkerTrajectories, found: dict[str, tuple[str, ...]]) -> None:
    """Refuses two labels that hold one marker's positions, exactly, wherever both are seen."""
    owner = {label: role for role, labels in found.items() for label in labels}
    for (one, role), (other, second) in combinations(owner.items(), 2):
        first, last = motion.marker(one), motion.marker(other)
        both = np.isfinite(first + last).all(1)
        if both.any() and (first[both] == last[both]).all():
            raise LegsimError(
                f"{one} ({role}) and {other} ({second}) hold the same positions: one marker under "
                "two labels; label the markers again and export them"
            )


def _check_filter(filter_hz: float, rate: float) -> None:
    if not (np.isfinite(filter_hz) and 0 <= filter_hz < rate / 2):
        raise LegsimError(
            f"filter_hz = {filter_hz:g} must lie below half the sampling rate of {rate:g} Hz; 0 "
            "leaves the markers unfiltered"
        )


def _even(
    motion: MarkerTrajectories, names: Sequence[str]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """(even times (n,), positions (n, 3) by name at them); NaN where the recording leaves out
    samples.

    A recording of variable rate is sampled at the highest rate that it keeps.
    """
    times = motion.times
    if len(times) < 4:
        raise LegsimError(
            f"the recording holds {len(times)} sample{'s'[: len(times) - 1]}, but at least 4 are "
            "needed; record for longer, or give a static trial as motion.scaling_file of a movement"
        )
    steps = np.diff(times)
    dt = float(np.median(steps))
    if not _FASTEST_S < dt < _SLOWEST_S:
        raise LegsimError(
            f"a sample every {dt:.3g} s is no recording of a movement: its times are not in "
            "seconds; write seconds into its time column, or its rate in hertz"
        )
    positions = {name: np.array(motion.marker(name)) for name in names}
    if np.abs(steps - dt).max() < 1e-6 * dt + 1e-9:
        return times, positions
    shortest = float(np.quantile(steps, 0.1))
    dt = shortest if shortest < 0.75 * dt else dt
    count = int(np.maximum(np.rint(steps / dt), 1).sum()) + 1
    if count > 50 * len(times):
        raise LegsimError(
            f"the times are too uneven: steps of {steps.min():g} to {steps.max():g} s; cut the "
            "recording at its pauses"
        )
    even = times[0] + np.arange(count) * ((times[-1] - times[0]) / (count - 1))
    # a step longer than most around it leaves out samples; where the rate changes, they all are
    usual = ndimage.percentile_filter(steps, 70, size=21, mode="nearest")
    broken = steps > 1.5 * usual
    return even, {name: _resampled(times, x, even, broken) for name, x in positions.items()}


def _resampled(
    times: FloatArray, positions: FloatArray, even: FloatArray, broken: outliers.BoolArray
) -> FloatArray:
    """Positions (n, 3) at even times by cubic splines through each unbroken stretch; NaN between
    stretches. ``broken`` (n - 1,) says which steps leave out samples.
    """
    result = np.full((len(even), 3), np.nan)
    seen = np.flatnonzero(np.isfinite(positions).all(1))
    if seen.size == 0:
        return result
    slack = 1e-6 * (even[1] - even[0])
    breaks = np.flatnonzero((np.diff(seen) > 1) | broken[seen[:-1]]) + 1
    for stretch in np.split(seen, breaks):
        begin, end = times[stretch[0]], times[stretch[-1]]
        inside = (even >= begin - slack) & (even <= end + slack)
        if len(stretch) > 1:
            result[inside] = CubicSpline(times[stretch], positions[stretch])(even[inside])
        else:
            result[inside] = positions[stretch]
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Stages:
    """Positions (n, 3) of every label after each step of the cleaning."""

    source: dict[str, FloatArray]
    without_jumps: dict[str, FloatArray]
    smooth: dict[str, FloatArray]
    """short gaps bridged"""
    rebuilt: dict[str, FloatArray]
    """and longer ones filled from other markers"""
    bridged: dict[str, FloatArray]
    """and what remains bridged as far as asked"""

    def within(self, span: slice) -> "_Stages":
        """The same of some frames alone."""
        steps = (getattr(self, field.name) for field in fields(self))
        return _Stages(*({name: x[span] for name, x in step.items()} for step in steps))


def _cleaned(
    source: dict[str, FloatArray],
    segments: dict[str, str],
    times: FloatArray,
    longest_gap_s: float,
) -> _Stages:
    dt = float(times[-1] - times[0]) / (len(times) - 1)
    without = {
        name: np.where(outliers.find_jumps(x, dt)[:, None], np.nan, x) for name, x in source.items()
    }
    smooth = {name: _bridge(x, times, min(longest_gap_s, SPLINE_S)) for name, x in without.items()}
    rebuilt = _rebuilt(smooth, segments)
    return _Stages(
        source,
        without,
        smooth,
        rebuilt,
        {name: _bridge(x, times, longest_gap_s) for name, x in rebuilt.items()},
    )


def _bridge(positions: FloatArray, times: FloatArray, longest_gap_s: float) -> FloatArray:
    """Positions (n, 3) with inner gaps up to ``longest_gap_s`` filled by the cubic that keeps
    position and velocity at both ends.
    """
    result = positions.copy()
    for first, last in runs(np.isnan(positions).any(1)):
        inner = first > 0 and last < len(times) - 1
        if inner and times[last + 1] - times[first - 1] <= longest_gap_s + 1e-9:
            before = _velocity(positions, times, first - 1, -1)
            after = _velocity(positions, times, last + 1, 1)
            ends = [first - 1, last + 1]
            cubic = CubicHermiteSpline(times[ends], positions[ends], np.stack([before, after]))
            result[first : last + 1] = cubic(times[first : last + 1])
    return result


def _rebuilt(smooth: dict[str, FloatArray], segments: dict[str, str]) -> dict[str, FloatArray]:
    """Every label's gaps filled from the labels on the same segment."""
    result = {}
    for name, positions in smooth.items():
        mates = [
            smooth[other] for other in smooth if other != name and segments[other] == segments[name]
        ]
        gaps = runs(np.isnan(positions).any(1))
        result[name] = (
            gap_filling.fill_from_segment(positions, np.stack(mates, axis=1), gaps)
            if gaps and len(mates) >= 3
            else positions
        )
    return result


def _velocity(positions: FloatArray, times: FloatArray, index: int, side: int) -> FloatArray:
    """Velocity (3,) at sample ``index`` from a parabola through the seen samples on its one
    ``side`` (-1 or 1) within SLOPE_S.
    """
    rows = index + side * np.arange(len(times))
    rows = rows[(rows >= 0) & (rows < len(times))]
    rows = rows[np.abs(times[rows] - times[index]) <= SLOPE_S + 1e-9]
    broken = np.flatnonzero(np.isnan(positions[rows]).any(1))
    rows = rows[: broken[0]] if broken.size else rows
    if len(rows) < 2:
        return np.zeros(3)
    degree = 2 if len(rows) >= 5 else 1
    return np.polynomial.polynomial.polyfit(times[rows] - times[index], positions[rows], degree)[1]


def _report(role: str, names: tuple[str, ...], stages: _Stages, dt: float) -> RoleReport:
    """Counts over the labels of one role; of several, a sample counts where any is concerned."""
    raw, without = _unseen(stages.source, names), _unseen(stages.without_jumps, names)
    before, after, left = (
        _unseen(stage, names) for stage in (stages.smooth, stages.rebuilt, stages.bridged)
    )
    jumped = np.logical_or.reduce(
        [_unseen(stages.without_jumps, [k]) & ~_unseen(stages.source, [k]) for k in names]
    )
    longest = max((last - first + 1 for first, last in runs(without)), default=0) * dt
    filled, from_others = int((without & ~left).sum()), int((before & ~after).sum())
    return RoleReport(
        role,
        names,
        len(raw),
        int(raw.sum()),
        longest,
        int(jumped.sum()),
        filled,
        from_others,
        int(left.sum()),
    )


def _unseen(stage: dict[str, FloatArray], names: Sequence[str]) -> outliers.BoolArray:
    """True (n,) where any of the labels is NaN."""
    return np.logical_or.reduce([np.isnan(stage[name]).any(1) for name in names])
