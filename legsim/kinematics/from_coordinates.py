"""From joint coordinates in a file to a person that moves: completed, checked, and in the model's
signs.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from legsim.core.errors import LegsimError, file_error, printable
from legsim.core.values import FloatArray
from legsim.kinematics import on_osim_model
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import SEGMENTS
from legsim.mocap.coordinates import RawCoordinates
from legsim.mocap.files import Recording
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories

_Result = TypeVar("_Result")

_MOVING = tuple(name for name in COORDINATES if re.match("hip_flexion|knee_angle", name))
"""a motion without any of these is not a leg's"""

_CALLED = {
    "pelvis": ("pelvis",),
    "hip": ("hip",),
    "knee": ("knee", "tibfem", "tibiofem"),
    "ankle": ("ankle", "talocrural"),
}
"""words for a part of the body in the names of columns"""

_NO_COORDINATE = re.compile(
    "moment|torque|force|power|work|emg|activation|reserve|com|acc|vel|speed|contact|jrf|grf|cop"
    "|rms|error|marker|_[fm][xyz]$|_in_ground"
)
"""in the names of columns that are neither angles nor places"""

_ROTATION = re.compile(
    "angle|tilt|list|obliq|rot|flex|extension|duct|version|(^|_)r[xyz](_|$)", re.IGNORECASE
)
_TRANSLATION = re.compile(
    "(^|_)[tT][xyzXYZ](_|$)|[a-z]T[xyzXYZ](_|$)|(?i:transl|position|displace|height)"
)
"""in the names of columns: what tells one kind from the other, where anything does"""

_LARGEST_EXTENSION_DEG = 20.0
"""more than any knee overextends"""

_OVEREXTENDED_DEG = 5.0
"""few people stand with both knees overextended by more (Beighton et al. 1973)"""

_OFTEN = 0.25
"""of the steps: so many long ones are a rate that varies, no samples left out"""

_POSES = 50
"""in which feet are looked at"""

_LIES_M = 0.15
"""m from the feet up to the pelvis: who squats as deep as can be, or sits on a low stool, has more
"""

_DOWN = -0.5
"""vertical part of the pelvis' axis towards the trunk, for one that points down: a pelvis that lies
flat is rolled back by less than 30 degrees where the knees come to the chest
"""


def named(path: Path, compute: Callable[[], _Result]) -> _Result:
    """Puts the file's name before what a stage that knows no files objects to."""
    try:
        return compute()
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def moving_leg(
    recording: Recording,
    path: Path,
    leg: LegModel,
    *,
    low_pass_hz: float = 0.0,
    knees_turned: bool | None = None,
) -> MovingLeg:
    """The person who moves as the coordinates say.

    Args:
        recording: coordinates in rad and m, of any order. Those of other parts of the body are
            ignored, those that a partial model lacks are at their defaults, with notes.
        path: the file they come from, for messages.
        leg: the model, scaled to the person.
        low_pass_hz: cut-off of a zero-phase low-pass; 0 leaves the coordinates as they are.
        knees_turned: whether the knees' sign was turned in another trial of the same source, which
            decides for straight knees.

    Raises:
        LegsimError: the file has no coordinate of the leg, or the low-pass does not fit it.
    """
    loaded = recording.value
    if not isinstance(loaded, JointTrajectories):
        raise file_error(path, "holds markers, not joint coordinates", "give a .mot or .sto file")
    completed, filled = _completed(loaded, path, leg)
    values, was_turned, said = _with_our_knee_sign(
        path, leg, leg.values_of(completed), loaded, knees_turned
    )
    if low_pass_hz > 0:
        values = low_passed(path, values, loaded.times, low_pass_hz)
    lies = _checked_upright(path, leg, values)
    return MovingLeg(
        printable(path.name),
        leg,
        JointTrajectories(loaded.times, leg.coordinate_names, values),
        None,
        (*recording.notes, *filled, *said, *lies, *gap_note(loaded.times)),
        knees_turned=was_turned,
    )


def on_model(
    path: Path,
    raw: RawCoordinates,
    leg: OsimLeg,
    notes: tuple[str, ...],
    low_pass_hz: float,
    *,
    unit: str | None,
    in_degrees: bool | None,
) -> MovingLeg:
    """Coordinates of a file on the user's own model, as they are but for a low-pass."""
    loaded, read_notes = raw.to_plausible_motion(
        in_degrees=in_degrees, unit=unit, rotations=leg.rotations(raw.names), lengths=leg.shifts
    )
    leg, moved, said = named(path, lambda: on_osim_model.coordinates(leg, loaded))
    values = moved.values
    if low_pass_hz > 0:
        values = low_passed(path, values, loaded.times, low_pass_hz)
    lies = _checked_upright(path, leg, values)
    return MovingLeg(
        printable(path.name),
        leg,
        JointTrajectories(loaded.times, leg.coordinate_names, values),
        None,
        (*read_notes, *notes, *said, *lies, *gap_note(loaded.times)),
    )


def _checked_upright(path: Path, leg: Leg, values: FloatArray) -> tuple[str, ...]:
    """A warning where somebody lies along world's horizontal, as where another axis points up.

    Raises:
        LegsimError: somebody hangs head down: the pelvis is below the feet, and its axis towards
            the trunk points down. Who lies on the back and raises the legs only has the first.
    """
    some = np.unique(np.linspace(0, len(values) - 1, _POSES).astype(int))
    poses = leg.kinematics(values[some])
    heights = poses.origins[..., 1]
    pelvis, *feet = (SEGMENTS.index(name) for name in ("pelvis", "calcn_r", "calcn_l"))
    trunk = float(np.median(poses.rotations[:, pelvis, 1, 1]))
    above = float(np.median(heights[:, pelvis] - heights[:, feet].mean(-1)))
    if above < -_LIES_M and trunk < _DOWN:
        raise file_error(
            path,
            f"the pelvis is {-above:.2g} m below the feet, so that somebody hangs head down: y is "
            "up here, and another axis in the file",
            "turn pelvis_tilt, pelvis_list, pelvis_rotation and the pelvis' place to y up, or "
            "solve it with markers that are",
            place="pose",
        )
    if above > _LIES_M:
        return ()
    where = f"only {100 * above:.0f} cm above" if above >= 0 else f"{-100 * above:.0f} cm below"
    return (
        f"warning: the pelvis is {where} the feet, so that somebody lies "
        "or sits on the ground: see whether y points up in the file",
    )


def _completed(
    loaded: JointTrajectories, path: Path, leg: LegModel
) -> tuple[JointTrajectories, tuple[str, ...]]:
    """With the coordinates that the file lacks at the model's defaults, and a note on these and on
    what is ignored.
    """
    lacking = [name for name in COORDINATES if name not in loaded.coordinate_names]
    if not any(name in loaded.coordinate_names for name in _MOVING):
        raise file_error(
            path,
            f"has no coordinate of the leg among {', '.join(loaded.coordinate_names[:20])}",
            f"give a motion of {', '.join(COORDINATES)}",
            place="column names",
        )
    others = [
        name
        for name in loaded.coordinate_names
        if name not in COORDINATES and not _is_patella(name)
    ]
    known = tuple(f"{name}_" for name in loaded.coordinate_names if name in COORDINATES)
    # speeds (pelvis_tilt_u) and the like go with a coordinate that is there
    _check_names(path, lacking, [name for name in others if not name.startswith(known)])
    notes = (f"ignored, being no coordinates of the leg: {', '.join(others)}",) if others else ()
    if not lacking:
        return loaded, notes
    defaults = leg.default_coordinates[[COORDINATES.index(name) for name in lacking]]
    values = np.hstack([loaded.values, np.tile(defaults, (len(loaded.times), 1))])
    completed = JointTrajectories(loaded.times, (*loaded.coordinate_names, *lacking), values)
    standing = "".join(
        f" ({name} {value:g} m)" for name, value in zip(lacking, defaults, strict=True) if value
    )
    return completed, (*notes, f"the file has no {', '.join(lacking)}: taken as 0{standing}")


def _check_names(path: Path, lacking: Sequence[str], others: Sequence[str]) -> None:
    """Refuses a joint's flexion or the pelvis' pose under another name, which as 0 would make a
    stiff leg, or a pelvis that stays.

    Raises:
        LegsimError: it names the column and the coordinate that it may be.
    """
    for name in lacking:
        if not name.startswith(("pelvis", "hip_flexion", "knee_angle", "ankle_angle")):
            continue
        part = name.split("_")[0]
        side = "" if part == "pelvis" else name[-1]
        other_kind = _ROTATION if _TRANSLATION.search(name) else _TRANSLATION
        alike = [
            other
            for other in others
            if _is_of(other, part, side)
            and not other_kind.search(other)
            and ("obliq" not in other.lower() or name == "pelvis_list")
        ]
        if alike:
            raise file_error(
                path,
                f"has no {name}, but {alike[0]}, which is no coordinate of legsim's leg",
                f"give the model that it is of by --model, or name the column {name} if it counts "
                "as gait2392's does",
                place="column names",
            )


def _is_of(column: str, part: str, side: str) -> bool:
    """Whether a column's name tells of a joint's pose on a side ("r", "l"), or of the pelvis', in
    any of the styles in use: knee_flexion_r, RKneeAngles_X, r_knee, Right Knee Flexion, tib_fem_r.
    """
    plain = re.sub(r"[^a-z]", "", column.lower())
    if not any(word in plain for word in _CALLED[part]) or _NO_COORDINATE.search(column.lower()):
        return False
    if not side:
        return True
    words = {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", column)}
    sides = {side, {"r": "right", "l": "left"}[side]}
    return bool(words & sides) or any(plain.startswith(side + word) for word in _CALLED[part])


def _is_patella(name: str) -> bool:
    """Whether a coordinate follows from the knee's, as the patella's does."""
    return name.endswith("_beta")


def low_passed(path: Path, values: FloatArray, times: FloatArray, low_pass_hz: float) -> FloatArray:
    """Coordinates (n, c) after a zero-phase low-pass; refused where times are not even."""
    steps = np.diff(times)
    if len(steps) == 0 or np.ptp(steps) > 0.01 * np.median(steps):
        raise file_error(
            path,
            "its times are not even, as a filter needs them",
            "leave out the filter, or resample the motion",
        )
    return named(path, lambda: low_pass(values, 1 / float(steps.mean()), low_pass_hz))


def gap_note(times: FloatArray) -> tuple[str, ...]:
    """A word on samples left out, across which the curves are only guessed."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    longer = steps > 1.5 * usual
    count = int(longer.sum())
    if count == 0:
        return ()
    k = int(steps.argmax())
    if count > _OFTEN * len(steps):
        return (f"the samples are {steps.min():.3g} to {steps[k]:.3g} s apart, bridged by splines",)
    others = f", and {count - 1} more gap{'s' * (count > 2)}" if count > 1 else ""
    return (
        f"{steps[k]:.3g} s are missing after {times[k]:g} s (elsewhere a sample every "
        f"{usual:.3g} s){others}: bridged by splines",
    )


def _with_our_knee_sign(
    path: Path,
    leg: LegModel,
    values: FloatArray,
    loaded: JointTrajectories,
    turned_there: bool | None,
) -> tuple[FloatArray, bool, tuple[str, ...]]:
    """Knee angles negative in flexion, as in gait2392, whether the file's sign was turned for that,
    and a note where it was, or where neither sign is certain.

    Rajagopal2016 and its kin count flexion positive: they bend where no knee of gait2392 can (its
    limit is 10 degrees of extension). For straight knees the other trial of the laboratory
    (``turned_there``), the feet, or the coordinate of a patella decide.

    Raises:
        LegsimError: the two knees count flexion in opposite ways.
    """
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    turned = np.array(values)
    turned[:, knees] *= -1
    bent = _bent_the_other_way(path, np.degrees(values[:, knees]))
    notes: tuple[str, ...] = ()
    if bent is None:
        bent = turned_there
    if bent is None:
        middle = float(np.degrees(np.median(values[:, knees], axis=0)).min())
        bends = np.degrees(values[:, knees])
        # the way in which it bends farther
        patella = "knee_angle_r_beta" in loaded.coordinate_names and bends.max() > -bends.min()
        flat = _flat_if_turned(leg, values, turned, loaded) if middle > _OVEREXTENDED_DEG else None
        bent = patella if flat is None else flat
        if middle > _OVEREXTENDED_DEG and flat is None and not patella:
            notes = (
                f"warning: both knees are overextended, by {middle:.0f} deg or more in the median, "
                "unless the file counts flexion positive (as Rajagopal2016 does): then turn the "
                "sign of both columns",
            )
    if not bent:
        return values, False, notes
    note = (
        "knee angles were positive in flexion (as in Rajagopal2016); their sign was turned to "
        "gait2392's"
    )
    return turned, True, (note,)


def _bent_the_other_way(path: Path, bends: FloatArray) -> bool | None:
    """Whether knees (n, 2) in degrees bend where no knee of gait2392 can; None for straight ones.

    Raises:
        LegsimError: one does, and the other bends as it should.
    """
    most, least = bends.max(0), bends.min(0)
    forwards = (most > _LARGEST_EXTENSION_DEG) & (most > -least)
    backwards = (least < -_LARGEST_EXTENSION_DEG) & ~forwards
    if forwards.any() and backwards.any():
        one, other = (f"knee_angle_{'rl'[int(way.argmax())]}" for way in (forwards, backwards))
        raise file_error(
            path,
            f"{one} reaches {bends.max():.0f} degrees and {other} {bends.min():.0f}: one of the "
            "knees would bend forwards",
            "turn the sign of one of the two columns",
            place="coordinates",
        )
    return bool(forwards.any()) if forwards.any() or backwards.any() else None


def _flat_if_turned(
    leg: LegModel, values: FloatArray, turned: FloatArray, loaded: JointTrajectories
) -> bool | None:
    """Whether feet stand flat with the knees' sign turned (n, c), and do not as the file has it;
    None where neither is clear, or the file lacks a joint between them and the pelvis.
    """
    needed = [f"{joint}_{side}" for joint in ("hip_flexion", "ankle_angle") for side in "rl"]
    if not {"pelvis_tilt", *needed} <= set(loaded.coordinate_names):
        return None
    some = np.unique(np.linspace(0, len(values) - 1, _POSES).round().astype(int))
    as_is, otherwise = (
        _foot_pitch(leg, JointTrajectories(loaded.times[some], leg.coordinate_names, way[some]))
        for way in (values, turned)
    )
    if min(as_is, otherwise) > 0.5 * max(as_is, otherwise):
        return None
    return otherwise < as_is


def _foot_pitch(leg: LegModel, motion: JointTrajectories) -> float:
    """Mean over the feet of the angle (rad) from horizontal to heel-toe, in the median."""
    poses = leg.segment_poses(motion)
    up = [np.median(np.arcsin(poses.of(f"calcn_{side}")[:, 1, 0])) for side in "rl"]
    return float(np.mean(np.abs(up)))
