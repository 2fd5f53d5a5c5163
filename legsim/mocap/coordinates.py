"""Joint coordinates as a file gives them, and the one border where they become radians and meters
that a body can have.

A file's words about its units are often wrong. What no body does is refused with the fix; what has
one explanation only (angles that wrap) is put right and noted.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.mocap import copies, mixed_units, outliers
from legsim.mocap.raw import UNITS_PER_METER
from legsim.mocap.trajectories import JointTrajectories, written_twice

_TRANSLATION = re.compile(r".*_t[xyz](_[rl])?")

_COUPLED = re.compile(r".*_beta")

_PELVIS = re.compile(r"pelvis_(tilt|list|rotation)")

_PLACES = ("pelvis_ty", "pelvis_tx", "pelvis_tz")
"""the height first: it tells another unit best"""

_JOINT = re.compile(
    r"(hip_flexion|hip_adduction|hip_rotation|knee_angle|ankle_angle|subtalar_angle|mtp_angle)_[rl]"
    r"|lumbar_(extension|bending|rotation)"
)

_REACH_DEG = {"hip_flexion": (-120, 170), "knee_angle": (-180, 180)}
"""beyond any pose of a joint, as its median over a recording"""

_OTHER_REACH_DEG = (-110, 110)

_SMALL = 0.05
"""of either unit: angles below it are a person who stands straight, in whichever unit"""

_HALF_TURN, _TURN = np.pi + 0.05, 2 * np.pi + 0.05
"""rad, with room for rounding"""

_USUAL, _HIGHEST, _FARTHEST = 0.9, 3.0, 30.0
"""m: a pelvis is about so high over the floor, never higher, nor so far from the origin of a
laboratory
"""

_SLOWEST_S, _FASTEST_S = 0.5, 1e-5
"""s between two samples of a motion"""

_STILL = 0.1
"""of the usual step: so short a step back is a halt"""

_FEW = 20
"""samples: so few poses may be a second apart"""


@dataclass(frozen=True, slots=True)
class _Limits:
    """How a coordinate of a body may move from one sample to the next."""

    unit: str
    factor: float
    """from SI to ``unit``"""
    floor: float
    """a step that deviates less from its neighbors' is no jump"""
    acceleration: float
    """per s^2"""
    speed: float
    """per s: faster is a jump, whatever the neighbors do"""


_ROTATING = _Limits("degrees", float(np.degrees(1)), 0.05, 500.0, 60.0)
_SLIDING = _Limits("m", 1.0, 0.01, 50.0, 15.0)


@dataclass(frozen=True, slots=True, eq=False)
class RawCoordinates:
    """Joint coordinates in the units of their file."""

    path: str
    times: FloatArray
    """(n,) s"""
    names: tuple[str, ...]
    values: FloatArray
    """(n, c)"""
    degrees: bool | None
    """whether rotations are in degrees, as the file says; None if it does not"""
    place: str = "header"
    """where the file says so"""
    notes: tuple[str, ...] = field(default=())
    """what a careful reader noticed, one line each"""

    def to_motion(
        self,
        *,
        in_degrees: bool | None = None,
        unit: str | None = None,
        rotations: Collection[str] | None = None,
        lengths: Collection[str] | None = None,
    ) -> JointTrajectories:
        """The coordinates in radians and meters, whatever they then are.

        Rotations alone are in degrees: not the translations (``*_ty``, ``*_ty_r``), and not the
        coupled coordinates (``*_beta``), which OpenSim leaves in radians.

        Args:
            in_degrees: overrides what the file says.
            unit: of the translations, a key of ``UNITS_PER_METER``; meters by default.
            rotations: names of the coordinates that are in degrees in such a file; None tells by
                name.
            lengths: names of those that are lengths, the same.

        Raises:
            LegsimError: the file does not say whether angles are in degrees, or times repeat.
        """
        degrees = self.degrees if in_degrees is None else in_degrees
        if degrees is None:
            raise file_error(
                self.path,
                "the header does not say whether angles are in degrees",
                "write inDegrees=yes or inDegrees=no into the header, or give the unit, as in "
                "--set motion.angles=degrees (in Python: in_degrees=True)",
                place=self.place,
            )
        values = np.array(self.values, float)
        if degrees:
            turning = [
                k
                for k, name in enumerate(self.names)
                if (is_rotation(name) if rotations is None else name in rotations)
            ]
            values[:, turning] = np.deg2rad(values[:, turning])
        if unit is not None:
            sliding = [
                k
                for k, name in enumerate(self.names)
                if (is_translation(name) if lengths is None else name in lengths)
            ]
            values[:, sliding] /= UNITS_PER_METER[unit]
        return JointTrajectories(self.times, self.names, values)

    def to_plausible_motion(
        self,
        *,
        in_degrees: bool | None = None,
        unit: str | None = None,
        rotations: Collection[str] | None = None,
        lengths: Collection[str] | None = None,
    ) -> tuple[JointTrajectories, tuple[str, ...]]:
        """The coordinates in radians and meters, without wraps, and notes on what was put right and
        on what no body does.

        What is given by ``in_degrees`` and ``unit`` is believed; ``rotations`` and
        ``lengths`` as of :meth:`to_motion`.

        Raises:
            LegsimError: as :meth:`to_motion`; or the times are not in seconds, the angles not in
                the unit that the file says, or the positions not in meters.
        """
        raw, notes = _without_repeats(self)
        raw, copied = _without_copies(raw)
        motion = raw.to_motion(
            in_degrees=in_degrees, unit=unit, rotations=rotations, lengths=lengths
        )
        _check_seconds(raw)
        if in_degrees is None:
            _check_degrees(raw)
        motion, turned = _unwrapped(motion)
        if in_degrees is None:
            _check_reach(raw, motion)
        if unit is None:
            _check_meters(raw)
        mixed = mixed_units.doubts(motion)
        return motion, (*self.notes, *notes, *copied, *turned, *mixed, *_jumps(motion))


def is_rotation(coordinate: str) -> bool:
    """Whether OpenSim converts a coordinate of this name between degrees and radians."""
    return not (is_translation(coordinate) or _COUPLED.fullmatch(coordinate))


def is_translation(coordinate: str) -> bool:
    """Whether a coordinate of this name is a length, also a joint's (knee_ty_r)."""
    return _TRANSLATION.fullmatch(coordinate) is not None


def is_of_leg(name: str) -> bool:
    """Whether a column of this name is a coordinate of pelvis, leg or lumbar joint."""
    bare = name.removesuffix("_beta")
    return bool(_JOINT.fullmatch(bare) or _PELVIS.fullmatch(bare)) or name in _PLACES


def _columns(names: Sequence[str], pattern: re.Pattern[str]) -> list[int]:
    return [k for k, name in enumerate(names) if pattern.fullmatch(name)]


def _without_repeats(raw: RawCoordinates) -> tuple[RawCoordinates, tuple[str, ...]]:
    """Without the rows that follow the row before by less than any rounding, and a note on them.

    Rows at the very same time are left to :class:`JointTrajectories`, which refuses them.
    """
    twice = written_twice(raw.times)
    twice = twice[np.diff(raw.times)[twice - 1] > 0]
    if twice.size == 0:
        return raw, ()
    k = int(twice[0])
    note = (
        f"{twice.size} row{'s'[: twice.size - 1]} left out, which follow the row before by less "
        f"than any rounding (first {raw.times[k] - raw.times[k - 1]:.2g} s after "
        f"{raw.times[k - 1]:.6g} s)"
    )
    kept = np.delete(np.arange(len(raw.times)), twice)
    return RawCoordinates(
        raw.path, raw.times[kept], raw.names, raw.values[kept], raw.degrees, raw.place
    ), (note,)


def _without_copies(raw: RawCoordinates) -> tuple[RawCoordinates, list[str]]:
    """Without the rows that repeat the row before, where they come at a beat, and a note on them.

    Elsewhere a computed movement may pause.
    """
    if len(raw.times) < 2:
        return raw, []
    found = copies.find_copies(raw.values, float(np.median(np.diff(raw.times))))
    if not found.at_a_beat:
        return raw, []
    kept = ~found.frames
    fewer = replace(raw, times=raw.times[kept], values=raw.values[kept])
    return fewer, replace(found, long=()).notes(raw.times)


def _check_seconds(raw: RawCoordinates) -> None:
    """Refuses times in milliseconds, or numbers of frames."""
    steps = np.diff(raw.times)
    usual = float(np.median(steps)) if len(steps) else 0.1
    if _FASTEST_S <= usual < _SLOWEST_S or (usual >= _SLOWEST_S and len(steps) < _FEW):
        return
    guess = "numbers of frames" if (steps == 1).all() else "milliseconds"
    what = f"milliseconds or {guess}" if guess != "milliseconds" else guess
    raise file_error(
        raw.path,
        f"a sample every {usual:g} s is no motion: times are in seconds, these look like "
        f"{what if usual >= _SLOWEST_S else 'another unit'}",
        "write seconds into the time column",
        place="time",
    )


def _check_degrees(raw: RawCoordinates) -> None:
    """Refuses degrees that the file calls radians, and radians that it calls degrees, as far as
    the numbers alone tell.
    """
    joints = _columns(raw.names, _JOINT)
    turning = joints + _columns(raw.names, _PELVIS)
    if not turning:
        return
    values = np.abs(raw.values[:, turning])
    if not raw.degrees:
        # an angle from 0 to a whole turn may be meant, if none is negative
        whole = _TURN if (raw.values[:, turning] >= -1e-9).all() else _HALF_TURN
        beyond = np.argwhere(np.abs(raw.values[:, joints]) > whole)
        if len(beyond) and whole == _HALF_TURN and _only_wraps(raw.values[:, joints]):
            beyond = beyond[:0]
        if len(beyond):
            row, column = beyond[0]
            _refuse_radians(
                raw, raw.names[joints[column]], row, float(raw.values[row, joints[column]])
            )
        return
    joint_most = float(np.abs(raw.values[:, joints]).max(initial=0.0))
    most = float(values.max())
    none_negative = (raw.values[:, turning] >= -1e-9).all()
    alike = joint_most <= _HALF_TURN or (none_negative and joint_most <= _TURN)
    wraps = joint_most <= _TURN and _steps_by_turns(raw.values[:, turning])
    if (_SMALL < most <= _TURN and alike) or wraps:
        name = raw.names[turning[int(values.max(0).argmax())]]
        raise file_error(
            raw.path,
            f"all angles stay below {most:.3g} ({name}), as radians do, but the file says degrees",
            "write inDegrees=no into the header, or say which they are: --set "
            "motion.angles=radians or =degrees (in Python: in_degrees=False or True)",
            place=raw.place,
        )


def _steps_by_turns(values: FloatArray) -> bool:
    """Whether (n, c) steps by 2 pi, to 1 %, where it steps most: radians that wrap."""
    steps = np.abs(np.diff(values, axis=0))
    widest = float(steps.max(initial=0.0))
    return abs(widest / (2 * np.pi) - 1) < 0.01 and float(np.quantile(steps, 0.95)) < 1


def _only_wraps(values: FloatArray) -> bool:
    """Whether radians (n, c) beyond half a turn are there by wrapping: never beyond a turn, and
    reached by steps of a turn.
    """
    return bool(np.abs(values).max() <= _TURN) and _steps_by_turns(values)


def _refuse_radians(raw: RawCoordinates, name: str, row: int, value: float) -> None:
    cure = (
        "if its angles are in degrees, write inDegrees=yes into the header, or give --set "
        "motion.angles=degrees (in Python: in_degrees=True)"
        if raw.place != "column names"
        else "if its angles are in degrees, convert them to radians, as the columns' names say"
    )
    raise file_error(
        raw.path,
        f"{name} is {np.degrees(value):.0f} degrees at {raw.times[row]:g} s, which no joint can be",
        cure,
        place="coordinates",
    )


def _unwrapped(motion: JointTrajectories) -> tuple[JointTrajectories, tuple[str, ...]]:
    """Angles without steps of a whole turn, joints within half a turn of straight, and notes."""
    values = np.array(motion.values)
    notes = []
    for k in [
        *_columns(motion.coordinate_names, _PELVIS),
        *_columns(motion.coordinate_names, _JOINT),
    ]:
        steps = np.diff(values[:, k])
        turns = np.rint(steps / (2 * np.pi))
        # what is left of the step must be a step that a body makes
        slack = np.minimum(0.35 + 30.0 * np.diff(motion.times), 3.0)
        wraps = (turns != 0) & (np.abs(steps - 2 * np.pi * turns) < slack)
        name = motion.coordinate_names[k]
        if wraps.any():
            values[1:, k] -= 2 * np.pi * np.cumsum(np.where(wraps, turns, 0))
            first = motion.times[1:][wraps][0]
            notes.append(
                f"{name} wraps by a whole turn at {first:.4g} s"
                + (f" and {wraps.sum() - 1} times more" if wraps.sum() > 1 else "")
                + ": unwrapped"
            )
        away = np.rint(np.median(values[:, k]) / (2 * np.pi))
        if away and _JOINT.fullmatch(name):
            values[:, k] -= 2 * np.pi * away
            if not wraps.any():
                notes.append(f"{name} is counted from 0 to 360 degrees: turned to -180 to 180")
    return JointTrajectories(motion.times, motion.coordinate_names, values), tuple(notes)


def _check_reach(raw: RawCoordinates, motion: JointTrajectories) -> None:
    """Refuses a joint that is, most of the time, where no joint can be; also degrees below 180 that
    the header calls radians show so.
    """
    for k in _columns(motion.coordinate_names, _JOINT):
        name = motion.coordinate_names[k]
        low, high = np.radians(_REACH_DEG.get(name.rpartition("_")[0], _OTHER_REACH_DEG))
        middle = float(np.median(motion.values[:, k]))
        beyond = np.flatnonzero(np.abs(motion.values[:, k]) > _HALF_TURN)
        if low <= middle <= high and beyond.size == 0:
            continue
        row = int(np.abs(motion.values[:, k]).argmax())
        value = motion.values[row, k]
        if not raw.degrees:
            _refuse_radians(raw, name, row, float(value))
        raise file_error(
            raw.path,
            f"{name} is {np.degrees(value):.0f} degrees at {raw.times[row]:g} s, which no joint "
            "can be",
            "repair the column, or write the file again",
            place="coordinates",
        )


def _check_meters(raw: RawCoordinates) -> None:
    """Refuses positions of the pelvis that are in millimeters, or another unit.

    A height that can be settles it: who walks on a belt goes far.
    """
    name = next((name for name in _PLACES if name in raw.names), None)
    if name is None:
        return
    middle = float(np.median(raw.values[:, raw.names.index(name)]))
    if abs(middle) <= (_HIGHEST if name == "pelvis_ty" else _FARTHEST):
        return
    unit = min(
        ("mm", "cm", "in"),
        key=lambda u: abs(np.log(abs(middle) / UNITS_PER_METER[u] / _USUAL)),
    )
    likely = f", as in --set motion.unit={unit} (in Python: unit={unit!r})"
    raise file_error(
        raw.path,
        f"{name} is {middle:.4g} m in the median, which no pelvis is: its lengths are not in "
        "meters",
        f"give their unit{likely if name == 'pelvis_ty' else ' (motion.unit)'}",
        place="coordinates",
    )


def _jumps(motion: JointTrajectories) -> tuple[str, ...]:
    """Notes on steps that no body makes: when, which coordinate, how far."""
    if len(motion.times) < 3:
        return ()
    dt = np.diff(motion.times)
    notes = []
    for k, name in enumerate(motion.coordinate_names):
        if name not in _PLACES and not (_JOINT.fullmatch(name) or _PELVIS.fullmatch(name)):
            continue
        limits = _SLIDING if name in _PLACES else _ROTATING
        steps = np.diff(motion.values[:, k])
        rates = (steps / dt)[:, None]
        around = outliers.neighbors_median(rates)[:, 0] * dt
        deviation = np.abs(steps - around)
        usual = outliers.SMOOTHNESS * float(np.quantile(deviation, 0.9))
        off = deviation > np.maximum(limits.floor + limits.acceleration * dt**2, usual)
        off |= (np.abs(rates[:, 0]) > limits.speed) & (np.abs(steps) > limits.floor)
        if off.any():
            worst = int(np.where(off, deviation, -1).argmax())
            moved = _moved(steps[worst] * limits.factor, around[worst] * limits.factor, limits.unit)
            notes.append(
                f"warning: {name} {moved} "
                f"at {motion.times[worst + 1]:.4g} s, within {dt[worst]:.3g} s"
                + (f", and {off.sum() - 1} times more" if off.sum() > 1 else "")
                + ": no body moves so; repair the recording"
            )
    return tuple(notes)


def _moved(step: float, usual: float, unit: str) -> str:
    """What a step is, beside the usual one around it: a jump on, a halt, or a jump back."""
    onward = step * np.sign(usual)
    if abs(step) > abs(usual) and onward >= 0:
        return f"jumps by {abs(step):.3g} {unit}"
    if onward >= -_STILL * abs(usual):
        return f"halts: it moves by {abs(step):.3g} instead of {abs(usual):.3g} {unit}"
    return f"jumps by {abs(step - usual):.3g} {unit}"
